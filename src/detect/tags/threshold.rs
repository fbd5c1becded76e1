//! Which pixels are dark, by a threshold that follows the light: half-way between the extremes of a tile and its neighbours.
//!
//! Tiles are small, so that the white margin of a small tag still counts. Where the extremes of 3 x 3 tiles differ by no more
//! than noise nothing is dark: only bands along edges remain of large dark areas, and their outer outline is the same.
#![allow(unsafe_code)] // SSE2

use crate::imaging::{ImageView, Window};

/// Side of a tile, px.
const TILE: usize = 4;
/// Least and greatest contrast that is asked of 3 x 3 tiles, grey levels.
const MIN_CONTRAST: f64 = 10.0;
const MAX_CONTRAST: f64 = 40.0;
/// The noise of an image spreads 16 pixels by 2.9 deviations or less in one tile of five, and 144 pixels by 5.3 on average, by more
/// than 7 hardly ever.
const QUIET_SHARE: usize = 5;
const CONTRAST_IN_SPREADS: f64 = 2.4;

/// The dark pixels of a window, as bits.
#[derive(Debug, Clone)]
pub(super) struct DarkBits {
    /// Rows of words; bit `x % 64` of word `x / 64`.
    bits: Vec<u64>,
    words: usize,
    width: usize,
    height: usize,
    columns: usize,
    low: Vec<u8>,
    high: Vec<u8>,
    beside: Vec<u8>,
    levels: Vec<u8>,
    row_low: Vec<u8>,
    row_high: Vec<u8>,
}

impl DarkBits {
    /// Buffers for windows of at most this size, allocated at once.
    pub(super) fn with_size(width: usize, height: usize) -> Self {
        let tiles = width.div_ceil(TILE) * height.div_ceil(TILE);
        let bytes = |n: usize| Vec::with_capacity(n);
        Self {
            bits: Vec::with_capacity(width.div_ceil(64) * height),
            words: 0,
            width: 0,
            height: 0,
            columns: 0,
            low: bytes(tiles),
            high: bytes(tiles),
            beside: bytes(tiles),
            levels: bytes(tiles),
            row_low: bytes(width),
            row_high: bytes(width),
        }
    }

    /// Width and height of the window, px.
    pub(super) fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Words of row `y`.
    pub(super) fn row(&self, y: usize) -> &[u64] {
        self.bits.get(y * self.words..(y + 1) * self.words).unwrap_or(&[])
    }

    /// Whether a pixel of the window is dark; outside nothing is.
    #[inline]
    pub(super) fn is_dark(&self, x: i32, y: i32) -> bool {
        if x < 0 || y < 0 || x as usize >= self.width || y as usize >= self.height {
            return false;
        }
        let word = self.bits.get(y as usize * self.words + x as usize / 64);
        word.is_some_and(|word| word >> (x as usize % 64) & 1 == 1)
    }

    /// The level below which a pixel of the window is dark: 0 where light is even.
    #[inline]
    pub(super) fn level(&self, x: i32, y: i32) -> u8 {
        let (column, row) = (x.max(0) as usize / TILE, y.max(0) as usize / TILE);
        self.levels.get(row * self.columns + column.min(self.columns.saturating_sub(1))).copied().unwrap_or(0)
    }

    /// Finds the dark pixels of a window of the image. Whether anything has contrast.
    pub(super) fn find(&mut self, image: &ImageView<'_>, window: &Window) -> bool {
        let (x1, y1) = (window.x1.min(image.width()), window.y1.min(image.height()));
        let (x0, y0) = (window.x0.min(x1), window.y0.min(y1));
        (self.width, self.height) = (x1 - x0, y1 - y0);
        (self.words, self.columns) = (self.width.div_ceil(64), self.width.div_ceil(TILE));
        self.bits.clear();
        self.bits.resize(self.words * self.height, 0);
        self.extremes(image, x0, y0);
        let contrast = self.contrast();
        if !self.set_levels(contrast) {
            return false;
        }
        for y in 0..self.height {
            if y % TILE == 0 {
                // thresholds of each pixel of these rows
                let from = y / TILE * self.columns;
                let levels = self.levels.get(from..from + self.columns).unwrap_or(&[]);
                for (pixels, &level) in self.row_low.chunks_mut(TILE).zip(levels) {
                    pixels.fill(level);
                }
            }
            let pixels = image.row(y0 + y).get(x0..x1).unwrap_or(&[]);
            let bits = self.bits.get_mut(y * self.words..).unwrap_or(&mut []);
            let (chunks, rest) = pixels.as_chunks::<64>();
            let (levels, rest_levels) = self.row_low.as_chunks::<64>();
            for ((chunk, levels), word) in chunks.iter().zip(levels).zip(&mut *bits) {
                *word = below(chunk, levels);
            }
            if !rest.is_empty()
                && let Some(word) = bits.get_mut(chunks.len())
            {
                let (mut last, mut last_levels) = ([255; 64], [0; 64]);
                last.iter_mut().zip(rest).for_each(|(a, b)| *a = *b);
                last_levels.iter_mut().zip(rest_levels).for_each(|(a, b)| *a = *b);
                *word = below(&last, &last_levels);
            }
        }
        true
    }

    /// Least and greatest level of each tile.
    fn extremes(&mut self, image: &ImageView<'_>, x0: usize, y0: usize) {
        self.low.clear();
        self.high.clear();
        for top in (0..self.height).step_by(TILE) {
            let part = |y: usize| image.row(y0 + y).get(x0..x0 + self.width).unwrap_or(&[]);
            for rows in [&mut self.row_low, &mut self.row_high] {
                rows.clear();
                rows.extend_from_slice(part(top));
            }
            for y in top + 1..(top + TILE).min(self.height) {
                for ((low, high), &p) in self.row_low.iter_mut().zip(&mut self.row_high).zip(part(y)) {
                    *low = p.min(*low);
                    *high = p.max(*high);
                }
            }
            let least = |part: &[u8]| part.iter().fold(255, |a, &b| b.min(a));
            let greatest = |part: &[u8]| part.iter().fold(0, |a, &b| b.max(a));
            let (lows, low_rest) = self.row_low.as_chunks::<TILE>();
            let (highs, high_rest) = self.row_high.as_chunks::<TILE>();
            self.low.extend(lows.iter().map(|t| t[0].min(t[1]).min(t[2].min(t[3]))));
            self.high.extend(highs.iter().map(|t| t[0].max(t[1]).max(t[2].max(t[3]))));
            if !low_rest.is_empty() {
                self.low.push(least(low_rest));
                self.high.push(greatest(high_rest));
            }
        }
    }

    /// The contrast to ask for: more than the image's noise gives.
    fn contrast(&self) -> f64 {
        let mut counts = [0usize; 256];
        for (low, high) in self.low.iter().zip(&self.high) {
            if let Some(count) = counts.get_mut(usize::from(high.saturating_sub(*low))) {
                *count += 1;
            }
        }
        let (wanted, mut passed) = (self.low.len() / QUIET_SHARE, 0);
        let spread = counts.iter().position(|count| {
            passed += count;
            passed > wanted
        });
        (CONTRAST_IN_SPREADS * spread.unwrap_or(0) as f64).clamp(MIN_CONTRAST, MAX_CONTRAST)
    }

    /// Thresholds from the extremes of 3 x 3 tiles. Whether there is any.
    fn set_levels(&mut self, contrast: f64) -> bool {
        let columns = self.columns;
        self.levels.clear();
        if columns == 0 {
            return false;
        }
        let contrast = contrast as u8;
        // along the rows in place by way of a copy, across them while the levels are set
        for (tiles, pick) in [(&mut self.low, u8::min as fn(u8, u8) -> u8), (&mut self.high, u8::max)] {
            self.beside.clear();
            self.beside.extend_from_slice(tiles);
            for (row, from) in tiles.chunks_mut(columns).zip(self.beside.chunks(columns)) {
                for (tile, &other) in row.iter_mut().zip(from.get(1..).unwrap_or(&[])) {
                    *tile = pick(*tile, other);
                }
                for (tile, &other) in row.get_mut(1..).unwrap_or(&mut []).iter_mut().zip(from) {
                    *tile = pick(*tile, other);
                }
            }
        }
        let mut any = false;
        let rows = self.low.len() / columns;
        for row in 0..rows {
            let at = |tiles: &'_ [u8], row: usize, column: usize| -> u8 {
                tiles.get(row * columns + column).copied().unwrap_or(0)
            };
            let (above, below) = (row.saturating_sub(1), (row + 1).min(rows - 1));
            for column in 0..columns {
                let low = at(&self.low, above, column)
                    .min(at(&self.low, row, column))
                    .min(at(&self.low, below, column));
                let high = at(&self.high, above, column)
                    .max(at(&self.high, row, column))
                    .max(at(&self.high, below, column));
                let clear = high - low >= contrast;
                any |= clear;
                // a pixel half-way is dark
                self.levels.push(if clear { low + (high - low) / 2 + 1 } else { 0 });
            }
        }
        any
    }
}

/// Bit `i` set where pixel `i` is below level `i`.
#[cfg(any(test, not(target_arch = "x86_64")))]
#[inline(always)]
fn below_portable(pixels: &[u8; 64], levels: &[u8; 64]) -> u64 {
    (0u32..).zip(pixels.iter().zip(levels)).fold(0, |mask, (i, (p, l))| mask | u64::from(p < l) << i)
}

#[cfg(not(target_arch = "x86_64"))]
use below_portable as below;

/// The same with SSE2, part of every x86-64.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn below(pixels: &[u8; 64], levels: &[u8; 64]) -> u64 {
    use std::arch::x86_64::{
        __m128i, _mm_cmpeq_epi8, _mm_loadu_si128, _mm_movemask_epi8, _mm_setzero_si128, _mm_subs_epu8,
    };
    let mut mask = 0;
    let parts = pixels.as_chunks::<16>().0.iter().zip(levels.as_chunks::<16>().0);
    for (i, (pixels, levels)) in (0u32..).zip(parts) {
        // SAFETY: SSE2 belongs to the x86-64 baseline; both parts hold the 16 bytes that an unaligned load reads.
        let not_below = unsafe {
            let p = _mm_loadu_si128(pixels.as_ptr().cast::<__m128i>());
            let l = _mm_loadu_si128(levels.as_ptr().cast::<__m128i>());
            _mm_movemask_epi8(_mm_cmpeq_epi8(_mm_subs_epu8(l, p), _mm_setzero_si128())) as u32
        };
        mask |= u64::from(!not_below & 0xffff) << (16 * i);
    }
    mask
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Pixels of few levels in blocks: edges, even parts, noise.
    fn blocks(width: usize, height: usize, seed: u64, side: usize) -> Vec<u8> {
        let hash = |a: u64| {
            (a ^ seed).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(31).wrapping_mul(0x94d0_49bb_1331_11eb)
        };
        (0..width * height)
            .map(|i| {
                let (x, y) = (i % width, i / width);
                let block = hash((x / side + 1000 * (y / side)) as u64) >> 62;
                60 * block as u8 + (hash(i as u64) >> 61) as u8
            })
            .collect()
    }

    /// From the definition, pixel by pixel.
    fn slow(image: &ImageView<'_>, w: &Window, contrast: f64) -> Vec<bool> {
        let (width, height) = (w.x1 - w.x0, w.y1 - w.y0);
        let mut dark = Vec::new();
        for y in 0..height {
            for x in 0..width {
                let near = |v: usize, size: usize| {
                    (v / TILE * TILE).saturating_sub(TILE)..(v / TILE * TILE + 2 * TILE).min(size)
                };
                let (mut low, mut high) = (255u8, 0u8);
                for v in near(y, height) {
                    for u in near(x, width) {
                        let p = image.row(w.y0 + v)[w.x0 + u];
                        (low, high) = (low.min(p), high.max(p));
                    }
                }
                let p = image.row(w.y0 + y)[w.x0 + x];
                dark.push(high - low >= contrast as u8 && p <= low + (high - low) / 2);
            }
        }
        dark
    }

    proptest! {
        #[test]
        fn dark_is_what_lies_below_the_middle_of_its_surroundings(
            width in 1usize..150, height in 1usize..20, seed in any::<u64>(), side in 1usize..20,
            x0 in 0usize..40, y0 in 0usize..5,
        ) {
            let pixels = blocks(width, height, seed, side);
            let image = ImageView::new(&pixels, width, height).unwrap();
            for window in [Window::whole(&image), Window { x0: x0.min(width), y0: y0.min(height), x1: width, y1: height }] {
                let mut bits = DarkBits::with_size(width, height);
        bits.find(&image, &window);
                // the contrast is chosen before neighbours are taken in
                let mut fresh = DarkBits::with_size(width, height);
                (fresh.width, fresh.height) = bits.size();
                fresh.extremes(&image, window.x0, window.y0);
                let wanted = slow(&image, &window, fresh.contrast());
                let (w, _) = bits.size();
                for (i, dark) in wanted.into_iter().enumerate() {
                    prop_assert_eq!(bits.is_dark((i % w) as i32, (i / w) as i32), dark);
                }
            }
        }

        #[test]
        fn kernels_agree(pixels in prop::collection::vec(any::<u8>(), 64), levels in prop::collection::vec(any::<u8>(), 64)) {
            let (pixels, levels) = (pixels.first_chunk().unwrap(), levels.first_chunk().unwrap());
            prop_assert_eq!(below(pixels, levels), below_portable(pixels, levels));
        }
    }
}
