//! Sums over the pixels of an ellipse: the inner loops of the centroid.
//!
//! ```text
//! v = I r(x, y)                      level as it were under the light of the dot's centre
//! w = clamp(edge - v, 0, span)       dark dots; light ones: clamp(v - edge, 0, span)
//! ```
//! `r` is a quadric about the centre. Pixels well inside the dot have full weight, whatever their level.

use super::ellipse::PixelEllipse;
use crate::imaging::ImageView;

/// How pixels of one dot are weighed. Levels are in sixteenths.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Scale {
    /// Level at which the plate begins.
    pub(super) edge: i16,
    /// From there to the dot's own level.
    pub(super) span: i16,
    /// How far from either end a weight is free: nearer, noise is cut off as much as it passes elsewhere.
    pub(super) margin: i16,
    /// Whether the dot is lighter than the plate.
    pub(super) light: bool,
    /// Reciprocal of the light, relative to that at the centre: `1 + [x, y, xx, xy, yy]` about it.
    pub(super) relative: [f64; 5],
}

/// Sums of weights in sixteenths of a level.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct WeightSums {
    pub(super) w: i64,
    /// By the distance from the ellipse's centre, rounded to whole pixels.
    pub(super) wx: i64,
    pub(super) wy: i64,
    /// Pixels whose weight is free, and about the sum of their squared distances from the centre, px^2.
    pub(super) rim: u32,
    pub(super) rim_px4: f64,
}

impl WeightSums {
    /// Adds pixels on the rim in a row, at [`PixelEllipse::rim_at`].
    #[inline(always)]
    fn add_rim(&mut self, count: u32, rim_px2: f64) {
        self.rim += count;
        self.rim_px4 += f64::from(count) * rim_px2;
    }
}

/// Sum of levels, pixels, squared differences of neighbours, pairs of neighbours; over a dozen rows at most.
pub(super) fn inner_sums(image: &ImageView<'_>, ellipse: &PixelEllipse) -> (u32, u32, u32, u32) {
    let (mut sum, mut count, mut rough, mut pairs) = (0u32, 0u32, 0u32, 0u32);
    let step = (ellipse.height / 6.0) as usize + 1;
    for (y, x0, x1) in ellipse.rows(image.width(), image.height(), step) {
        let Some(pixels) = image.row(y).get(x0..x1) else { continue };
        let (chunks, rest) = pixels.as_chunks::<16>();
        for chunk in chunks {
            let (mut total, mut square) = (0, 0);
            for i in 0..8 {
                let (a, b) = (i32::from(chunk[2 * i]), i32::from(chunk[2 * i + 1]));
                total += a + b;
                square += (a - b) * (a - b);
            }
            sum += total as u32;
            rough = rough.saturating_add(square as u32);
        }
        for pair in rest.chunks_exact(2) {
            let [a, b] = [i32::from(pair[0]), i32::from(pair[1])];
            sum += (a + b) as u32;
            rough = rough.saturating_add(((a - b) * (a - b)) as u32);
        }
        count += pixels.len() as u32 / 2 * 2;
        pairs += pixels.len() as u32 / 2;
        if pixels.len() == 1 {
            sum += u32::from(pixels[0]);
            count += 1;
        }
    }
    (sum, count, rough, pairs)
}

/// One in the fixed point of relative light along a row, and its further bits beyond those of a pixel's. Derived: with 26 bits light may be 31 in
/// an `i32`, and what is left of them for a pixel, 12, makes 1/4096, below a sixteenth of a level of 255.
const ONE: f64 = (1 << 26) as f64;
const MORE_BITS: u32 = 14;

/// Sums of weights over the ellipse `outer`; what lies in `inner` counts whole. The dot itself ends at `rim`; all have one centre.
pub(super) fn weighted_sums(
    image: &ImageView<'_>,
    ellipses: [&PixelEllipse; 2],
    inner: Option<&PixelEllipse>,
    scale: &Scale,
) -> WeightSums {
    #[cfg(target_arch = "x86_64")]
    if inner.is_none() && crate::imaging::simd::has_avx2() {
        // SAFETY: the features were just detected.
        #[allow(unsafe_code)]
        let sums = unsafe { x86::weighted_sums_avx2(image, ellipses, scale) };
        if let Some(sums) = sums {
            return sums;
        }
    }
    weighted_sums_by_rows(image, ellipses, inner, scale)
}

/// The sums row by row: as every other path gives them.
fn weighted_sums_by_rows(
    image: &ImageView<'_>,
    [outer, rim]: [&PixelEllipse; 2],
    inner: Option<&PixelEllipse>,
    scale: &Scale,
) -> WeightSums {
    let mut sums = WeightSums::default();
    let (cx, cy) = (outer.x.round() as i64, outer.y.round() as i64);
    let light = DotLight::about([outer.x - cx as f64, outer.y - cy as f64], &scale.relative);
    let span = i64::from(scale.span);
    for (y, x0, x1) in outer.rows(image.width(), image.height(), 1) {
        let (row, dy) = (image.row(y), y as i64 - cy);
        let (mut w, mut wx, mut rim_count) = (0, 0, 0);
        let mut add = |from: usize, to: usize| {
            let mut from = from;
            while from < to {
                let Some(pixels) = row.get(from..) else { return };
                let count = (to - from).min(LONGEST);
                let dx = from as i64 - cx;
                let part = row_sums(pixels, count, scale, &light.row(dx, dy));
                w += i64::from(part.w);
                wx += i64::from(part.wx) + i64::from(part.w) * dx;
                rim_count += part.rim;
                from += count;
            }
        };
        match inner.and_then(|e| e.row(y)) {
            None => add(x0, x1),
            Some((a, b)) => {
                let a = a.clamp(x0, x1);
                let b = b.clamp(a, x1);
                add(x0, a);
                add(b, x1);
                let n = (b - a) as i64;
                w += span * n;
                // twice the mean of a, a + 1 ... b - 1
                wx += span * n * (a as i64 + b as i64 - 1 - 2 * cx) / 2;
            }
        }
        sums.w += w;
        sums.wx += wx;
        sums.wy += w * dy;
        let (away, length) = (f64::from(y as u32) - outer.y, f64::from((x1 - x0) as u32));
        sums.add_rim(rim_count, rim.rim_at(away, length));
    }
    sums
}

/// Relative light about a dot in fixed point, from the whole pixel nearest to its centre: [`ONE`] times that, and `FINE` bits more.
#[derive(Debug, Clone, Copy)]
struct DotLight {
    level: i64,
    x: i64,
    y: i64,
    xx: i64,
    xy: i64,
    yy: i64,
}

/// Further bits of the coefficients. Chosen by hand: they are multiplied by squares of pixels, which rounding to 2^-34 leaves below 1e-6 at 100 px.
const FINE: u32 = 8;

impl DotLight {
    /// `1 + [x, y, xx, xy, yy]` about a centre that lies so far from the whole pixel.
    fn about([u, v]: [f64; 2], [x, y, xx, xy, yy]: &[f64; 5]) -> Self {
        let one = ONE * f64::from(1 << FINE);
        let fixed = |value: f64| (value * one) as i64;
        Self {
            level: fixed(1.0 - x * u - y * v + xx * u * u + xy * u * v + yy * v * v),
            x: fixed(x - 2.0 * xx * u - xy * v),
            y: fixed(y - 2.0 * yy * v - xy * u),
            xx: fixed(*xx),
            xy: fixed(*xy),
            yy: fixed(*yy),
        }
    }

    /// Along a row from a place on.
    #[inline(always)]
    fn row(&self, dx: i64, dy: i64) -> RowLight {
        let slope = self.x.wrapping_add(self.xy.wrapping_mul(dy));
        let along = slope.wrapping_add(self.xx.wrapping_mul(dx)).wrapping_mul(dx);
        let across = self.y.wrapping_add(self.yy.wrapping_mul(dy)).wrapping_mul(dy);
        RowLight {
            at: (self.level.wrapping_add(along).wrapping_add(across) >> FINE) as i32,
            slope: (slope.wrapping_add(self.xx.wrapping_mul(2 * dx)) >> FINE) as i32,
            bend: (self.xx >> FINE) as i32,
        }
    }
}

/// Relative light along a row, in units of one over [`ONE`]: `at + slope i + bend i^2` at the part's pixel `i`.
#[derive(Debug, Clone, Copy)]
struct RowLight {
    at: i32,
    slope: i32,
    bend: i32,
}

impl RowLight {
    /// The chord over the 16 pixels from `i` on, in 4096ths: its start, and 16 times its slope.
    #[inline(always)]
    fn chord(&self, i: usize) -> (i16, i16) {
        let i = i as i32;
        let at = self.at.wrapping_add(self.slope.wrapping_add(self.bend.wrapping_mul(i)).wrapping_mul(i));
        let slope = self.slope.wrapping_add(self.bend.wrapping_mul(2 * i + 15));
        ((at >> MORE_BITS) as i16, (slope >> (MORE_BITS - 4)) as i16)
    }
}

/// Sums over a part of a row; columns count from its start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct RowSums {
    w: i32,
    wx: i32,
    rim: u32,
}

/// Longest part of a row: its sums fit 32 bits. Derived: weights of 4080 sixteenths by places up to 511 sum up to 5.3e8.
const LONGEST: usize = 512;

#[cfg(target_arch = "x86_64")]
use x86::row_sums;

#[cfg(not(target_arch = "x86_64"))]
use row_sums_portable as row_sums;

/// What every path computes.
#[cfg(any(test, not(target_arch = "x86_64")))]
fn row_sums_portable(row: &[u8], count: usize, scale: &Scale, light: &RowLight) -> RowSums {
    let mut sums = RowSums { w: 0, wx: 0, rim: 0 };
    let Scale { edge, span, .. } = *scale;
    for (i, &p) in (0i32..).zip(row.iter().take(count)) {
        let (start, slope) = light.chord(i as usize / 16 * 16);
        let light = start.wrapping_add((i as i16 % 16).wrapping_mul(slope) >> 4);
        let v = (u32::from(p) * u32::from(light as u16)) >> 8;
        let away = if scale.light { v as i32 - i32::from(edge) } else { i32::from(edge) - v as i32 };
        let w = away.clamp(0, i32::from(span));
        sums.w += w;
        sums.wx += w * i;
        let margin = i32::from(scale.margin);
        sums.rim += u32::from(w > margin && w < i32::from(span) - margin);
    }
    sums
}

#[cfg(target_arch = "x86_64")]
mod x86;

#[cfg(test)]
mod tests;
