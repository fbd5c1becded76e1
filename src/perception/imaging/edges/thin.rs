//! Gradient and non-maximum suppression on three rows at a time: no plane is written, and flat areas cost a comparison.

use super::super::ImageView;
use super::super::gradient::SobelColumns;
use super::super::magnitude::sum_row;
use super::super::simd::kernel;
use super::{Around, EdgeCandidate, Norm};

/// Pixels that are processed together. Chosen by hand: two or four registers.
const BLOCK: usize = 32;
/// Pixels that are compared with their neighbours together. Chosen by hand: half a block.
const HALF: usize = 16;
/// `tan(22.5 degrees)` in units of 2^-15, by which the four directions of Canny's paper are distinguished.
const TAN_22_5: u32 = 13573;
/// Derivatives of one row, each as long as a whole number of blocks.
#[derive(Debug, Clone, Default)]
pub(super) struct GradientRow {
    pub(super) dx: Vec<i16>,
    pub(super) dy: Vec<i16>,
}

/// Three rows: above, here, below.
#[derive(Debug, Clone, Default)]
pub(super) struct RowWindow {
    columns: SobelColumns,
    width: usize,
    gradient: [GradientRow; 3],
    /// One more on either side of a whole number of blocks.
    magnitude: [Vec<u16>; 3],
    kept: Vec<u32>,
}

impl RowWindow {
    /// Empties all for an image of this width.
    pub(super) fn start(&mut self, width: usize) {
        self.width = width;
        let size = width.next_multiple_of(BLOCK);
        for row in &mut self.gradient {
            for values in [&mut row.dx, &mut row.dy] {
                values.clear();
                values.resize(size, 0);
            }
        }
        for row in &mut self.magnitude {
            row.clear();
            row.resize(size + 2, 0);
        }
        self.kept.clear();
        self.kept.reserve(width);
    }

    /// Moves the rows up by one; row `y` comes in below, without gradient where the image ends.
    pub(super) fn push(&mut self, image: &ImageView<'_>, y: usize, norm: Norm) {
        self.gradient.rotate_left(1);
        self.magnitude.rotate_left(1);
        let (gradient, magnitude) = (&mut self.gradient[2], &mut self.magnitude[2]);
        if y >= image.height() {
            gradient.dx.fill(0);
            gradient.dy.fill(0);
            magnitude.fill(0);
            return;
        }
        let (Some(dx), Some(dy), Some(size)) = (
            gradient.dx.get_mut(..self.width),
            gradient.dy.get_mut(..self.width),
            magnitude.get_mut(1..=self.width),
        ) else {
            return;
        };
        let (above, below) = (image.row(y.saturating_sub(1)), image.row((y + 1).min(image.height() - 1)));
        self.columns.row(above, image.row(y), below, dx, dy);
        match norm {
            Norm::Sum => sum_row(dx, dy, size),
            Norm::Euclidean => euclidean_row(dx, dy, size),
        }
    }

    /// Finds the pixels of the middle row that are greatest across their edge, and above `low`.
    pub(super) fn thin(&mut self, low: u16) {
        thin_row(&self.magnitude, &self.gradient[1], low, &mut self.kept);
    }

    /// Their columns.
    pub(super) fn kept(&self) -> &[u32] {
        &self.kept
    }

    /// The pixel at column `x` of the middle row, which is row `y` of the image; without neighbours yet.
    #[inline]
    pub(super) fn pixel(&self, x: u32, y: u32, high: u16) -> Option<EdgeCandidate> {
        let at = x as usize;
        let [above, here, below] = &self.gradient;
        let (dx, dy) = (*here.dx.get(at)?, *here.dy.get(at)?);
        let across = |row: &GradientRow, at: usize| match (row.dx.get(at), row.dy.get(at)) {
            (Some(&a), Some(&b)) => (i32::from(a) * i32::from(dx) + i32::from(b) * i32::from(dy)) as f32,
            _ => 0.0,
        };
        let (before, after) = if dx.unsigned_abs() >= dy.unsigned_abs() {
            (across(here, at.wrapping_sub(1)), across(here, at + 1))
        } else {
            (across(above, at), across(below, at))
        };
        let strong = *self.magnitude[1].get(at + 1)? > high;
        let across = [before, across(here, at), after];
        Some(EdgeCandidate {
            column: x,
            row: y,
            dx,
            dy,
            across,
            around: Around::default(),
            parent: 0,
            strong,
        })
    }
}

kernel!(pub(super) fn euclidean_row(dx: &[i16], dy: &[i16], out: &mut [u16]) = euclidean_body);
kernel!(pub(super) fn thin_row(magnitude: &[Vec<u16>; 3], gradient: &GradientRow, low: u16, kept: &mut Vec<u32>) = thin_body);

#[inline(always)]
pub(super) fn euclidean_body(dx: &[i16], dy: &[i16], out: &mut [u16]) {
    for ((out, &a), &b) in out.iter_mut().zip(dx).zip(dy) {
        let (a, b) = (f32::from(a), f32::from(b));
        let rounded = 32.0 * (a * a + b * b).sqrt() + 0.5;
        // SAFETY: a number between 0 and 46 163. The checked cast is not done side by side.
        #[allow(unsafe_code)]
        let whole = unsafe { rounded.to_int_unchecked::<i32>() };
        *out = whole as u16;
    }
}

/// Columns of the pixels that are greatest across their edge.
#[inline(always)]
pub(super) fn thin_body(magnitude: &[Vec<u16>; 3], gradient: &GradientRow, low: u16, kept: &mut Vec<u32>) {
    kept.clear();
    let (dx, dy) = (gradient.dx.as_chunks::<BLOCK>().0, gradient.dy.as_chunks::<BLOCK>().0);
    let [up, here, down] = magnitude;
    for (i, (dx, dy)) in dx.iter().zip(dy).enumerate() {
        let from = i * BLOCK;
        let Some(now) = here.get(from + 1..).and_then(|row| row.first_chunk::<BLOCK>()) else { return };
        if greatest(now) <= low {
            continue;
        }
        // edges are narrow: often one half has none
        for (half, (now, (dx, dy))) in halves(now).iter().zip(halves(dx).iter().zip(halves(dy))).enumerate() {
            let from = from + half * HALF;
            if greatest(now) <= low {
                continue;
            }
            let block =
                |row: &'_ [u16]| -> Option<[u16; HALF + 2]> { row.get(from..)?.first_chunk().copied() };
            let (Some(up), Some(here), Some(down)) = (block(up), block(here), block(down)) else { return };
            let mut keep = [0u8; HALF];
            thin_block(&up, &here, &down, dx, dy, low, &mut keep);
            for (word, bytes) in keep.as_chunks::<8>().0.iter().enumerate() {
                let mut bits = u64::from_le_bytes(*bytes);
                while bits != 0 {
                    kept.push((from + 8 * word) as u32 + bits.trailing_zeros() / 8);
                    bits &= bits - 1;
                }
            }
        }
    }
}

#[inline(always)]
fn greatest(values: &[u16]) -> u16 {
    values.iter().fold(0, |a, &m| a.max(m))
}

#[inline(always)]
fn halves<T>(values: &[T; BLOCK]) -> &[[T; HALF]] {
    values.as_chunks::<HALF>().0
}

/// 1 where a pixel is greatest across its edge and above `low`.
#[inline(always)]
fn thin_block(
    up: &[u16; HALF + 2],
    here: &[u16; HALF + 2],
    down: &[u16; HALF + 2],
    dx: &[i16; HALF],
    dy: &[i16; HALF],
    low: u16,
    keep: &mut [u8; HALF],
) {
    for i in 0..HALF {
        let m = here[i + 1];
        let (x, y) = (dx[i].unsigned_abs(), dy[i].unsigned_abs());
        // x tan(22.5 degrees), cut; x tan(67.5 degrees) is 2 x more
        let t = ((u32::from(2 * x) * TAN_22_5) >> 16) as u16;
        // choices as masks: as branches they would be taken one pixel at a time
        let (flat, steep) = (mask(y <= t), mask(y > t + 2 * x));
        let falling = mask((dx[i] ^ dy[i]) >= 0);
        let a = choose(falling, up[i], up[i + 2]);
        let b = choose(falling, down[i + 2], down[i]);
        let (a, b) = (choose(steep, up[i + 1], a), choose(steep, down[i + 1], b));
        let (a, b) = (choose(flat, here[i], a), choose(flat, here[i + 2], b));
        // of two equal ones along a row or column the first; along a diagonal none
        let tie = (flat | steep) & 1;
        keep[i] = (mask(m > low) & mask(m > a) & mask(m + tie > b) & 1) as u8;
    }
}

#[inline(always)]
fn mask(is: bool) -> u16 {
    u16::from(is).wrapping_neg()
}

/// `yes` where the mask is set.
#[inline(always)]
fn choose(mask: u16, yes: u16, no: u16) -> u16 {
    no ^ ((yes ^ no) & mask)
}
