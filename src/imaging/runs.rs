//! Binarisation: the dark pixels of an image or of a window as runs, row by row.

use super::ImageView;
use super::mask::dark_mask_each;
#[cfg(any(test, not(target_arch = "x86_64")))]
use super::mask::dark_mask_portable;

/// Dark pixels `x0..x1` of row `y`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Run {
    /// Row, px.
    pub y: u32,
    /// First dark column, px.
    pub x0: u32,
    /// Column behind the last dark one, px.
    pub x1: u32,
}

/// A rectangle of pixels, `x0..x1` by `y0..y1`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Window {
    /// First column.
    pub x0: usize,
    /// First row.
    pub y0: usize,
    /// Column behind the last.
    pub x1: usize,
    /// Row behind the last.
    pub y1: usize,
}

impl Window {
    /// The whole image.
    #[must_use]
    pub fn whole(image: &ImageView<'_>) -> Self {
        Self { x0: 0, y0: 0, x1: image.width(), y1: image.height() }
    }

    /// The pixels whose centres lie within `half_x`, `half_y` px of the point, as far as they are in the image;
    /// empty when nothing is.
    #[must_use]
    pub fn around(x: f64, y: f64, half_x: f64, half_y: f64, image: &ImageView<'_>) -> Self {
        // the casts saturate: negative and NaN become 0
        let low = |v: f64| v.ceil().max(0.0) as usize;
        let high = |v: f64, size: usize| (v.floor() + 1.0).clamp(0.0, size as f64) as usize;
        let (x0, y0) = (low(x - half_x), low(y - half_y));
        let (x1, y1) = (high(x + half_x, image.width()), high(y + half_y, image.height()));
        Self { x0: x0.min(x1), y0: y0.min(y1), x1, y1 }
    }
}

/// Thresholds that follow the local light: one per tile of [`LocalThreshold::TILE`] px.
#[derive(Debug, Clone, Default)]
pub struct LocalThreshold {
    low: Vec<u8>,
    high: Vec<u8>,
    tiles: Vec<u8>,
    row: Vec<u8>,
}

impl LocalThreshold {
    /// Side of a tile, px.
    pub const TILE: usize = 32;

    /// Buffers for images of at most this size, allocated at once.
    #[must_use]
    pub fn with_size(width: usize, height: usize) -> Self {
        let tiles = width.div_ceil(Self::TILE) * height.div_ceil(Self::TILE);
        let buffer = || Vec::with_capacity(tiles);
        Self { low: buffer(), high: buffer(), tiles: buffer(), row: Vec::with_capacity(width) }
    }

    /// Half-way between the least and the greatest level of each tile and its eight neighbours; `otherwise` where
    /// they differ by less than `contrast`.
    pub fn set(&mut self, image: &ImageView<'_>, contrast: u8, otherwise: u8) {
        let (columns, rows) = (image.width().div_ceil(Self::TILE), image.height().div_ceil(Self::TILE));
        for (buffer, value) in [(&mut self.low, 255), (&mut self.high, 0), (&mut self.tiles, otherwise)] {
            buffer.clear();
            buffer.resize(columns * rows, value);
        }
        self.row.clear();
        self.row.resize(image.width(), otherwise);
        for y in 0..image.height() {
            let from = y / Self::TILE * columns;
            let (Some(low), Some(high)) = (self.low.get_mut(from..), self.high.get_mut(from..)) else {
                return;
            };
            for ((part, low), high) in image.row(y).chunks(Self::TILE).zip(low).zip(high) {
                *low = part.iter().fold(*low, |a, &p| a.min(p));
                *high = part.iter().fold(*high, |a, &p| a.max(p));
            }
        }
        for ty in 0..rows {
            for tx in 0..columns {
                let (mut low, mut high) = (255, 0);
                for ny in ty.saturating_sub(1)..(ty + 2).min(rows) {
                    for nx in tx.saturating_sub(1)..(tx + 2).min(columns) {
                        low = self.low.get(ny * columns + nx).map_or(low, |&v| v.min(low));
                        high = self.high.get(ny * columns + nx).map_or(high, |&v| v.max(high));
                    }
                }
                if high.saturating_sub(low) >= contrast
                    && let Some(tile) = self.tiles.get_mut(ty * columns + tx)
                {
                    *tile = ((u16::from(low) + u16::from(high)) / 2) as u8;
                }
            }
        }
    }

    /// Thresholds of the pixels of row `y`.
    fn row(&mut self, y: usize) -> &[u8] {
        let columns = self.row.len().div_ceil(Self::TILE);
        if y.is_multiple_of(Self::TILE)
            && let Some(tiles) = self.tiles.get(y / Self::TILE * columns..)
        {
            for (part, &tile) in self.row.chunks_mut(Self::TILE).zip(tiles) {
                part.fill(tile);
            }
        }
        &self.row
    }
}

/// The runs of a binarised image, in reading order. The buffer is reused.
#[derive(Debug, Clone)]
pub struct Runs {
    runs: Vec<Run>,
    limit: usize,
    full: bool,
    #[cfg_attr(not(target_arch = "x86_64"), allow(dead_code))]
    wide: bool,
}

impl Runs {
    /// A buffer for at most `limit` runs, allocated at once.
    #[must_use]
    pub fn with_limit(limit: usize) -> Self {
        #[cfg(target_arch = "x86_64")]
        let wide = std::arch::is_x86_feature_detected!("avx2");
        #[cfg(not(target_arch = "x86_64"))]
        let wide = false;
        Self { runs: Vec::with_capacity(limit), limit, full: false, wide }
    }

    /// The runs found last.
    #[must_use]
    pub fn as_slice(&self) -> &[Run] {
        &self.runs
    }

    /// Whether the last image had more runs than the buffer holds (noise, a fine pattern): the rest is missing.
    #[must_use]
    pub fn overflowed(&self) -> bool {
        self.full
    }

    /// Finds the pixels of a window that are at most `threshold`.
    pub fn find(&mut self, image: &ImageView<'_>, window: &Window, threshold: u8) {
        self.runs.clear();
        self.full = false;
        #[cfg(target_arch = "x86_64")]
        if self.wide {
            // SAFETY: `wide` is set only where the processor has AVX2.
            #[allow(unsafe_code)]
            unsafe {
                self.find_avx2(image, window, threshold);
            }
            return;
        }
        #[cfg(target_arch = "x86_64")]
        self.find_with(image, window, |p| super::mask::x86::dark_mask_sse2(p, threshold), threshold);
        #[cfg(not(target_arch = "x86_64"))]
        self.find_with(image, window, |p| dark_mask_portable(p, threshold), threshold);
    }

    /// Finds the pixels of the whole image that are at most their local threshold.
    pub fn find_local(&mut self, image: &ImageView<'_>, thresholds: &mut LocalThreshold) {
        self.runs.clear();
        self.full = false;
        for y in 0..image.height() {
            let mut row = RowScan::new(y, 0);
            let (chunks, rest) = image.row(y).as_chunks::<64>();
            let (levels, rest_levels) = thresholds.row(y).as_chunks::<64>();
            for (chunk, levels) in chunks.iter().zip(levels) {
                row.add(dark_mask_each(chunk, levels), 64, self);
            }
            let (mut last, mut last_levels) = ([255; 64], [0; 64]);
            last.iter_mut().zip(rest).for_each(|(a, b)| *a = *b);
            last_levels.iter_mut().zip(rest_levels).for_each(|(a, b)| *a = *b);
            row.add(dark_mask_each(&last, &last_levels), rest.len() as u32, self);
            row.end(self);
            if self.full {
                return;
            }
        }
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt")]
    fn find_avx2(&mut self, image: &ImageView<'_>, window: &Window, threshold: u8) {
        self.find_with(image, window, |p| super::mask::x86::dark_mask_avx2(p, threshold), threshold);
    }

    #[inline(always)]
    fn find_with(
        &mut self,
        image: &ImageView<'_>,
        window: &Window,
        kernel: impl Fn(&[u8; 64]) -> u64,
        threshold: u8,
    ) {
        for y in window.y0..window.y1 {
            let mut row = RowScan::new(y, window.x0);
            let Some(pixels) = image.row(y).get(window.x0..window.x1) else { return };
            let (chunks, rest) = pixels.as_chunks::<64>();
            for chunk in chunks {
                row.add(kernel(chunk), 64, self);
            }
            if !rest.is_empty() {
                let mut last = [255; 64];
                last.iter_mut().zip(rest).for_each(|(a, b)| *a = *b);
                let valid = u64::MAX >> (64 - rest.len());
                let mask = if threshold == 255 { u64::MAX } else { kernel(&last) } & valid;
                row.add(mask, rest.len() as u32, self);
            }
            row.end(self);
            if self.full {
                return;
            }
        }
    }

    #[inline(always)]
    fn push(&mut self, run: Run) {
        if self.runs.len() < self.limit {
            self.runs.push(run);
        } else {
            self.full = true;
        }
    }
}

/// Scans the bits of one row for changes.
struct RowScan {
    y: u32,
    at: u32,
    /// The last bit seen.
    carry: u64,
    start: u32,
}

impl RowScan {
    #[inline(always)]
    fn new(y: usize, x: usize) -> Self {
        Self { y: y as u32, at: x as u32, carry: 0, start: 0 }
    }

    #[inline(always)]
    fn add(&mut self, mask: u64, count: u32, runs: &mut Runs) {
        let mut changes = mask ^ (mask << 1 | self.carry);
        if count < 64 {
            changes &= (1 << count) - 1;
        }
        let mut inside = self.carry;
        while changes != 0 {
            let x = self.at + changes.trailing_zeros();
            if inside == 0 {
                self.start = x;
            } else {
                runs.push(Run { y: self.y, x0: self.start, x1: x });
            }
            inside ^= 1;
            changes &= changes - 1;
        }
        self.carry = inside;
        self.at += count;
    }

    #[inline(always)]
    fn end(self, runs: &mut Runs) {
        if self.carry == 1 {
            runs.push(Run { y: self.y, x0: self.start, x1: self.at });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn slow(image: &ImageView<'_>, w: &Window, dark: impl Fn(usize, usize) -> bool) -> Vec<Run> {
        let mut out = Vec::new();
        for y in w.y0..w.y1 {
            let mut x = w.x0;
            while x < w.x1 {
                let x0 = x;
                while x < w.x1 && dark(x, y) {
                    x += 1;
                }
                if x > x0 {
                    out.push(Run { y: y as u32, x0: x0 as u32, x1: x as u32 });
                }
                x += usize::from(x == x0);
            }
        }
        assert!(w.x1 <= image.width());
        out
    }

    proptest! {
        #[test]
        fn runs_are_the_dark_pixels(
            width in 1usize..200, height in 1usize..6, seed in any::<u64>(), threshold in any::<u8>(),
            a in 0usize..200, b in 0usize..200,
        ) {
            let mut state = seed;
            let pixels: Vec<u8> = (0..width * height).map(|_| {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                (state >> 56) as u8 & if state >> 40 & 1 == 1 { 0xff } else { 0xf0 }
            }).collect();
            let image = ImageView::new(&pixels, width, height).unwrap();
            let (x0, x1) = (a.min(b).min(width), a.max(b).min(width));
            for window in [Window::whole(&image), Window { x0, x1, y0: height / 2, y1: height }] {
                let wanted = slow(&image, &window, |x, y| image.row(y)[x] <= threshold);
                let mut runs = Runs::with_limit(4000);
                runs.find(&image, &window, threshold);
                prop_assert_eq!(runs.as_slice(), &wanted[..]);
                runs.wide = false;
                runs.find(&image, &window, threshold);
                prop_assert_eq!(runs.as_slice(), &wanted[..]);
                runs.find_with(&image, &window, |p| dark_mask_portable(p, threshold), threshold);
            }
            let mut local = LocalThreshold::default();
            local.set(&image, 255, 100);
            let mut runs = Runs::with_limit(4000);
            runs.find_local(&image, &mut local);
            let whole = Window::whole(&image);
            let levels = local.tiles.clone();
            let columns = width.div_ceil(32);
            let wanted = slow(&image, &whole, |x, y| image.row(y)[x] <= levels[y / 32 * columns + x / 32]);
            prop_assert_eq!(runs.as_slice(), &wanted[..]);
        }
    }

    #[test]
    fn overflow_is_told() {
        let pixels: Vec<u8> = (0..100).map(|i| if i % 2 == 0 { 0 } else { 255 }).collect();
        let image = ImageView::new(&pixels, 100, 1).unwrap();
        let mut runs = Runs::with_limit(10);
        runs.find(&image, &Window::whole(&image), 128);
        assert!(runs.overflowed());
        assert_eq!(runs.as_slice().len(), 10);
    }
}
