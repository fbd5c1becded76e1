//! The pixels about a corner, eight side by side.

use super::BLOCKS;
use crate::imaging::ImageView;
use crate::imaging::corners::corner_model::CornerPixels;
use crate::imaging::corners::corner_model::parameter::COUNT;
use crate::imaging::simd::kernel;
use crate::linalg::Eight;
use nalgebra::Vector2;

/// The window of one corner. Owns its buffers.
#[derive(Debug, Clone)]
pub(super) struct CornerWindow {
    pixels: [CornerPixels; BLOCKS],
    /// Blocks in use, and pixels that count.
    used: usize,
    count: usize,
    /// Half side for which `x` and `y` of the pixels are, px.
    half: i32,
    /// Levels row by row, and 1 where the image has the pixel.
    levels: [u8; 8 * BLOCKS],
    shown: [u8; 8 * BLOCKS],
}

impl Default for CornerWindow {
    fn default() -> Self {
        let zero = Eight::ZERO;
        Self {
            pixels: [CornerPixels { x: zero, y: zero, level: zero, weight: zero }; BLOCKS],
            used: 0,
            count: 0,
            half: 0,
            levels: [0; 8 * BLOCKS],
            shown: [0; 8 * BLOCKS],
        }
    }
}

/// How far pixels may lie from a point along two directions, px.
#[derive(Debug, Clone, Copy)]
struct WindowBounds {
    about: [f32; 2],
    normals: [[f32; 2]; 2],
    /// Along `-u`, `+u`, `-v`, `+v`; infinite where there is no bound.
    most: [f32; 4],
}

impl CornerWindow {
    /// The pixels, eight by eight.
    pub(super) fn blocks(&self) -> &[CornerPixels] {
        self.pixels.get(..self.used).unwrap_or(&[])
    }

    /// How many pixels count.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// Takes the pixels about a point; the window's middle. `None` when too few are in the image.
    pub(super) fn load(
        &mut self,
        image: &ImageView<'_>,
        about: Vector2<f64>,
        half: i32,
        normals: [Vector2<f64>; 2],
        bounds: [f64; 4],
    ) -> Option<[f64; 2]> {
        let (mx, my) = (about.x.round(), about.y.round());
        let fits = |m: f64, size: usize| m >= 2.0 && m <= size as f64 - 3.0;
        if !(fits(mx, image.width()) && fits(my, image.height())) {
            return None;
        }
        self.place(half);
        let side = (2 * half + 1) as usize;
        let (left, top) = (mx as i64 - i64::from(half), my as i64 - i64::from(half));
        // columns of the window that the image has
        let first = usize::try_from(-left).unwrap_or(0);
        let last = side.min(usize::try_from(image.width() as i64 - left).unwrap_or(0));
        let rows = self.levels.chunks_exact_mut(side).zip(self.shown.chunks_exact_mut(side)).take(side);
        for ((levels, shown), y) in rows.zip(top..) {
            let row = usize::try_from(y).map_or(&[][..], |y| image.row(y));
            let from = (left + first as i64) as usize;
            let part = row.get(from..from + (last - first)).unwrap_or(&[]);
            if part.len() < side {
                levels.fill(0);
                shown.fill(0);
            }
            if let (Some(levels), Some(shown)) =
                (levels.get_mut(first..first + part.len()), shown.get_mut(first..first + part.len()))
            {
                levels.copy_from_slice(part);
                shown.fill(1);
            }
        }
        // the rest of the last block
        if let Some(rest) = self.shown.get_mut(side * side..8 * self.used) {
            rest.fill(0);
        }
        let bounds = WindowBounds {
            about: [(about.x - mx) as f32, (about.y - my) as f32],
            normals: normals.map(|n| [n.x as f32, n.y as f32]),
            most: bounds.map(|b| b as f32),
        };
        self.count = fill(self.pixels.get_mut(..self.used)?, &self.levels, &self.shown, &bounds);
        (self.count >= 2 * COUNT).then_some([mx, my])
    }

    /// Coordinates of the pixels of a window with this half side.
    fn place(&mut self, half: i32) {
        if self.half == half {
            return;
        }
        self.half = half;
        let side = (2 * half + 1) as usize;
        self.used = (side * side).div_ceil(8);
        let each = self.pixels.iter_mut().flat_map(|p| p.x.0.iter_mut().zip(&mut p.y.0));
        for (i, (x, y)) in each.enumerate() {
            (*x, *y) = ((i % side) as f32 - half as f32, (i / side) as f32 - half as f32);
        }
    }

    /// Levels and place of a corner near a point, from sums over what lies between its edges:
    ///
    /// ```text
    /// I = m + a s(u - du) s(v - dv)     s: sign, softened over two pixels
    /// du = -sum (I - m - a s(u) s(v)) s(v) / (a sum s'(u) |s(v)|)
    /// ```
    /// whatever the blur, as long as the window is wider.
    pub(super) fn quadrants(&self, about: [f64; 2], normals: [Vector2<f64>; 2]) -> Quadrants {
        let [nu, nv] = normals;
        let mut sums = [0.0; SUMS];
        sum_quadrants(
            self.blocks(),
            about.map(|p| p as f32),
            normals.map(|n| [n.x as f32, n.y as f32]),
            &mut sums,
        );
        let [n, t, tt, i, it, iv, v, tv, iu, u, tu, du, dv, same, same_n] = sums;
        let amplitude = (it - i * t / n) / (tt - t * t / n);
        let middle = (i - amplitude * t) / n;
        let along_u = (middle * v + amplitude * tv - iv) / (amplitude * du);
        let along_v = (middle * u + amplitude * tu - iu) / (amplitude * dv);
        let side = nu.x * nv.y - nu.y * nv.x;
        Quadrants {
            middle,
            amplitude,
            shift_px: [(along_u * nv.y - along_v * nu.y) / side, (along_v * nu.x - along_u * nv.x) / side],
            means: [same / same_n.max(1.0), (i - same) / (n - same_n).max(1.0)],
        }
    }
}

/// What sums over the window say of a corner.
#[derive(Debug, Clone, Copy)]
pub(super) struct Quadrants {
    /// Level between light and dark, and half the contrast.
    pub(super) middle: f64,
    pub(super) amplitude: f64,
    /// How far the corner lies from the point, px.
    pub(super) shift_px: [f64; 2],
    /// Mean levels where both distances from the edges have one sign, and of the rest.
    pub(super) means: [f64; 2],
}

/// How many sums [`CornerWindow::quadrants`] takes, which follows from their list: of 1, `s(u) s(v)`, its square, levels, levels times that; for either direction of levels, 1 and that
/// times the sign; the divisors; levels and 1 where both signs are one.
const SUMS: usize = 15;

kernel!(
    /// Levels and weights of the pixels; how many count.
    fn fill(pixels: &mut [CornerPixels], levels: &[u8], shown: &[u8], bounds: &WindowBounds) -> usize = fill_body
);

#[inline(always)]
fn fill_body(pixels: &mut [CornerPixels], levels: &[u8], shown: &[u8], bounds: &WindowBounds) -> usize {
    let WindowBounds { about, normals: [nu, nv], most: [low_u, high_u, low_v, high_v] } = *bounds;
    let is_bounded = bounds.most.iter().any(|b| b.is_finite());
    let mut count = Eight::ZERO;
    let eights = levels.as_chunks::<8>().0.iter().zip(shown.as_chunks::<8>().0);
    for (pixels, (levels, shown)) in pixels.iter_mut().zip(eights) {
        pixels.level = Eight(levels.map(f32::from));
        pixels.weight = Eight(shown.map(f32::from));
        if is_bounded {
            let (dx, dy) = (pixels.x + (-about[0]), pixels.y + (-about[1]));
            let within = |n: [f32; 2], low: f32, high: f32| {
                (dx * n[0] + dy * n[1]).each(|d| f32::from(u8::from(-low <= d && d <= high)))
            };
            pixels.weight = pixels.weight * within(nu, low_u, high_u) * within(nv, low_v, high_v);
        }
        count = count + pixels.weight;
    }
    // whole numbers, as exact as they are few
    count.sum() as usize
}

kernel!(
    /// The sums about a point.
    fn sum_quadrants(pixels: &[CornerPixels], about: [f32; 2], normals: [[f32; 2]; 2], out: &mut [f64; SUMS]) = sum_quadrants_body
);

#[inline(always)]
fn sum_quadrants_body(
    pixels: &[CornerPixels],
    about: [f32; 2],
    [nu, nv]: [[f32; 2]; 2],
    out: &mut [f64; SUMS],
) {
    let mut sums = [Eight::ZERO; SUMS];
    for pixels in pixels {
        let one = pixels.weight;
        let (dx, dy) = (pixels.x + (-about[0]), pixels.y + (-about[1]));
        let (u, v) = (dx * nu[0] + dy * nu[1], dx * nv[0] + dy * nv[1]);
        let soft = |d: Eight| d.each(|d| d.clamp(-1.0, 1.0));
        let (su, sv) = (soft(u), soft(v));
        // the slope of the softened sign where it has one, and the amount of the other
        let across = |d: Eight, other: Eight| {
            d.with(other, |d, other| if d.abs() < 1.0 { other.abs() } else { 0.0 }) * one
        };
        let (level, both) = (pixels.level * one, su * sv * one);
        let same = both.each(|both| f32::from(u8::from(both > 0.0)));
        let each = [
            one,
            both,
            both * both,
            level,
            level * both,
            level * sv,
            sv * one,
            both * sv,
            level * su,
            su * one,
            both * su,
            across(u, sv),
            across(v, su),
            level * same,
            same,
        ];
        sums.iter_mut().zip(each).for_each(|(sum, value)| *sum = *sum + value);
    }
    out.iter_mut().zip(sums).for_each(|(out, sum)| *out = f64::from(sum.sum()));
}
