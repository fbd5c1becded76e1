//! Adaptive threshold: the mean level of a pixel's surroundings, and so much above or below it.

use super::ImageView;
use super::simd::kernel;

/// Greatest half side, px. Derived: 2895^2 pixels by 256 levels are 2.1455e9, the last below 2^31, so that sums and products fit 32 bits.
const GREATEST_RADIUS_PX: u16 = 1447;

/// Thresholds that follow the mean level of the square of `2 r + 1` px about each pixel, as far as the image reaches.
#[derive(Debug, Clone)]
pub struct LocalMean {
    radius: usize,
    offset: i32,
    /// Of each column, the sum over the rows of the square.
    columns: Vec<u32>,
    /// Sums of `columns` from the first on, with a zero before them and copies of the ends on both sides: the sum over the square of
    /// column x is the entry `x + 2 r + 1` less the entry `x`. Wraps; differences are right.
    prefix: Vec<u32>,
    /// Columns of the image in the square about each.
    widths: Vec<i32>,
    sides: Vec<u8>,
}

impl LocalMean {
    /// Squares of half side `radius_px` (at most 1447), and an offset of the threshold from their mean: below 0 for dark objects, so
    /// that a flat background's noise is not taken for them, above 0 for light ones.
    #[must_use]
    pub fn new(radius_px: u16, offset_levels: i16) -> Self {
        Self {
            radius: usize::from(radius_px.min(GREATEST_RADIUS_PX)),
            offset: offset_levels.into(),
            columns: Vec::new(),
            prefix: Vec::new(),
            widths: Vec::new(),
            sides: Vec::new(),
        }
    }

    /// Makes ready for an image. Allocates only when none before was as wide.
    pub(super) fn start(&mut self, image: &ImageView<'_>) {
        let (width, r) = (image.width(), self.radius);
        self.columns.clear();
        self.columns.resize(width, 0);
        self.sides.clear();
        self.sides.resize(width, 0);
        self.prefix.clear();
        self.prefix.resize(width + 2 * r + 1, 0);
        self.widths.clear();
        self.widths.extend((0..width).map(|x| ((x + r + 1).min(width) - x.saturating_sub(r)) as i32));
        for y in 0..r.min(image.height()) {
            add_row(&mut self.columns, image.row(y));
        }
    }

    /// Row `y`, to be asked for in order: a byte for each pixel, 0 where it is at most its threshold.
    pub(super) fn row(&mut self, image: &ImageView<'_>, y: usize) -> &[u8] {
        let r = self.radius;
        add_row(&mut self.columns, image.row(y + r));
        if let Some(gone) = y.checked_sub(r + 1) {
            subtract_row(&mut self.columns, image.row(gone));
        }
        let rows = ((y + r + 1).min(image.height()) - y.saturating_sub(r)) as i32;
        // entries up to r are 0
        let mut sum = 0u32;
        let (inner, beyond) =
            self.prefix.get_mut(r + 1..).unwrap_or(&mut []).split_at_mut(self.columns.len());
        for (entry, column) in inner.iter_mut().zip(&self.columns) {
            sum = sum.wrapping_add(*column);
            *entry = sum;
        }
        beyond.fill(sum);
        let high = self.prefix.get(2 * r + 1..).unwrap_or(&[]);
        compare_row(image.row(y), &self.prefix, high, &self.widths, rows, self.offset, &mut self.sides);
        &self.sides
    }
}

kernel!(fn add_row(columns: &mut [u32], pixels: &[u8]) = add_row_body);
kernel!(fn subtract_row(columns: &mut [u32], pixels: &[u8]) = subtract_row_body);
kernel!(
    fn compare_row(
        pixels: &[u8],
        low: &[u32],
        high: &[u32],
        widths: &[i32],
        rows: i32,
        offset: i32,
        sides: &mut [u8],
    ) = compare_row_body
);

#[inline(always)]
fn add_row_body(columns: &mut [u32], pixels: &[u8]) {
    for (column, &p) in columns.iter_mut().zip(pixels) {
        *column += u32::from(p);
    }
}

#[inline(always)]
fn subtract_row_body(columns: &mut [u32], pixels: &[u8]) {
    for (column, &p) in columns.iter_mut().zip(pixels) {
        *column = column.wrapping_sub(u32::from(p));
    }
}

/// `p <= sum / n + offset`, without a division: `(p - offset) n <= sum`.
#[inline(always)]
fn compare_row_body(
    pixels: &[u8],
    low: &[u32],
    high: &[u32],
    widths: &[i32],
    rows: i32,
    offset: i32,
    sides: &mut [u8],
) {
    let count = sides.len();
    let (Some(pixels), Some(low), Some(high), Some(widths)) =
        (pixels.get(..count), low.get(..count), high.get(..count), widths.get(..count))
    else {
        return;
    };
    for x in 0..count {
        // beyond these limits the answer is the same, and the product stays within 32 bits
        let level = (i32::from(pixels[x]) - offset).clamp(-1, 256);
        let sum = high[x].wrapping_sub(low[x]) as i32;
        sides[x] = if level * (rows * widths[x]) <= sum { 0 } else { 255 };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::imaging::{Polarity, Run, Runs};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn pixels_are_compared_with_the_mean_of_their_square(
            width in 1usize..90, height in 1usize..20, radius in 0u16..30, offset in -300i16..300, seed in any::<u64>(),
            flat in any::<bool>(),
        ) {
            let mut state = seed;
            let pixels: Vec<u8> = (0..width * height).map(|_| {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                (state >> 56) as u8 & if flat { 0x07 } else { 0xff }
            }).collect();
            let image = ImageView::new(&pixels, width, height).unwrap();
            let r = i64::from(radius);
            let dark = |x: usize, y: usize| {
                let (mut sum, mut n) = (0, 0);
                for v in 0..height as i64 {
                    for u in 0..width as i64 {
                        if (u - x as i64).abs() <= r && (v - y as i64).abs() <= r {
                            sum += i64::from(pixels[v as usize * width + u as usize]);
                            n += 1;
                        }
                    }
                }
                (i64::from(pixels[y * width + x]) - i64::from(offset)) * n <= sum
            };
            let mut mean = LocalMean::new(radius, offset);
            let mut runs = Runs::with_limit(5000);
            for polarity in [Polarity::Dark, Polarity::Light] {
                runs.binarize_mean(&image, &mut mean, polarity);
                let mut inside = vec![false; width * height];
                for &Run { y, x0, x1 } in runs.as_slice() {
                    inside[y as usize * width..][x0 as usize..x1 as usize].fill(true);
                }
                for (at, &got) in inside.iter().enumerate() {
                    prop_assert_eq!(got, dark(at % width, at / width) == (polarity == Polarity::Dark));
                }
            }
        }
    }

    #[test]
    fn a_flat_image_has_no_objects() {
        for level in [0, 128, 255] {
            let pixels = vec![level; 100 * 40];
            let image = ImageView::new(&pixels, 100, 40).unwrap();
            let mut runs = Runs::with_limit(100);
            runs.binarize_mean(&image, &mut LocalMean::new(u16::MAX, -5), Polarity::Dark);
            assert!(runs.as_slice().is_empty());
            runs.binarize_mean(&image, &mut LocalMean::new(7, 5), Polarity::Light);
            assert!(runs.as_slice().is_empty());
        }
    }
}
