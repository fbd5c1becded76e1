//! Binarisation: the dark, or the light, pixels of an image or of a window as runs, row by row.

#[cfg(any(test, not(target_arch = "x86_64")))]
use super::mask::{dark_mask_each_portable, dark_mask_portable};
use super::simd::has_avx2;
use super::{ImageView, LocalMean, LocalThreshold};

/// Which side of a threshold the objects are on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Polarity {
    /// Dark objects on a light background: at most the threshold.
    #[default]
    Dark,
    /// Light objects on a dark background: above the threshold.
    Light,
}

/// Sides of a threshold.
const AT_MOST: u8 = 0;
const ABOVE: u8 = 1;
const BELOW: u8 = 2;

/// Pixels `x0..x1` of row `y`, all on one side of the threshold.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Run {
    /// Row, px.
    pub y: u32,
    /// First column, px.
    pub x0: u32,
    /// Column behind the last, px.
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
        Self { runs: Vec::with_capacity(limit), limit, full: false, wide: has_avx2() }
    }

    /// From now on holds at most so many runs, and never more than were allocated: more are given up early.
    pub fn limit_to(&mut self, most: usize) {
        self.limit = most.min(self.runs.capacity());
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
        self.binarize(image, window, threshold, Polarity::Dark);
    }

    /// Finds the pixels of a window that are at most `threshold`, or those that are above it.
    pub fn binarize(&mut self, image: &ImageView<'_>, window: &Window, threshold: u8, polarity: Polarity) {
        self.runs.clear();
        self.full = false;
        // a kernel for each polarity: the choice is made once
        match polarity {
            Polarity::Dark => self.find_threshold::<false>(image, window, threshold),
            Polarity::Light => self.find_threshold::<true>(image, window, threshold),
        }
    }

    /// Finds the pixels of the whole image that are at most their local threshold.
    pub fn find_local(&mut self, image: &ImageView<'_>, thresholds: &mut LocalThreshold) {
        self.binarize_local(image, thresholds, Polarity::Dark);
    }

    /// Finds the pixels of the whole image that are at most their local threshold, or those that are above it.
    pub fn binarize_local(
        &mut self,
        image: &ImageView<'_>,
        thresholds: &mut LocalThreshold,
        polarity: Polarity,
    ) {
        self.runs.clear();
        self.full = false;
        match polarity {
            Polarity::Dark => self.find_each::<AT_MOST>(image, thresholds),
            Polarity::Light => self.find_each::<ABOVE>(image, thresholds),
        }
    }

    /// Finds the pixels of the whole image that are below their threshold: [`LocalThreshold::set_below`].
    pub fn find_below(&mut self, image: &ImageView<'_>, thresholds: &mut LocalThreshold) {
        self.runs.clear();
        self.full = false;
        self.find_each::<BELOW>(image, thresholds);
    }

    /// Finds the pixels of the whole image that are at most their threshold by the mean of their surroundings, or those that are
    /// above it.
    pub fn binarize_mean(&mut self, image: &ImageView<'_>, thresholds: &mut LocalMean, polarity: Polarity) {
        self.runs.clear();
        self.full = false;
        thresholds.start(image);
        for y in 0..image.height() {
            let sides = thresholds.row(image, y);
            match polarity {
                Polarity::Dark => self.find_row::<false>(y, sides),
                Polarity::Light => self.find_row::<true>(y, sides),
            }
            if self.full {
                return;
            }
        }
    }

    #[inline(always)]
    fn find_threshold<const LIGHT: bool>(&mut self, image: &ImageView<'_>, window: &Window, threshold: u8) {
        #[cfg(target_arch = "x86_64")]
        if self.wide {
            // SAFETY: `wide` is set only where the processor has AVX2.
            #[allow(unsafe_code)]
            unsafe {
                self.find_avx2::<LIGHT>(image, window, threshold);
            }
            return;
        }
        #[cfg(target_arch = "x86_64")]
        self.find_with::<LIGHT>(image, window, |p| super::mask::x86::dark_mask_sse2(p, threshold));
        #[cfg(not(target_arch = "x86_64"))]
        self.find_with::<LIGHT>(image, window, |p| dark_mask_portable(p, threshold));
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt")]
    fn find_avx2<const LIGHT: bool>(&mut self, image: &ImageView<'_>, window: &Window, threshold: u8) {
        self.find_with::<LIGHT>(image, window, |p| super::mask::x86::dark_mask_avx2(p, threshold));
    }

    #[inline(always)]
    fn find_each<const SIDE: u8>(&mut self, image: &ImageView<'_>, thresholds: &mut LocalThreshold) {
        #[cfg(target_arch = "x86_64")]
        if self.wide {
            // SAFETY: `wide` is set only where the processor has AVX2.
            #[allow(unsafe_code)]
            unsafe {
                self.find_each_avx2::<SIDE>(image, thresholds);
            }
            return;
        }
        #[cfg(target_arch = "x86_64")]
        self.find_each_with::<SIDE>(image, thresholds, super::mask::x86::dark_mask_each_sse2);
        #[cfg(not(target_arch = "x86_64"))]
        self.find_each_with::<SIDE>(image, thresholds, dark_mask_each_portable);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt")]
    fn find_each_avx2<const SIDE: u8>(&mut self, image: &ImageView<'_>, thresholds: &mut LocalThreshold) {
        self.find_each_with::<SIDE>(image, thresholds, |p, t| super::mask::x86::dark_mask_each_avx2(p, t));
    }

    #[inline(always)]
    fn find_each_with<const SIDE: u8>(
        &mut self,
        image: &ImageView<'_>,
        thresholds: &mut LocalThreshold,
        kernel: impl Fn(&[u8; 64], &[u8; 64]) -> u64,
    ) {
        let mask = |pixels: &[u8; 64], levels: &[u8; 64]| match SIDE {
            AT_MOST => kernel(pixels, levels),
            ABOVE => !kernel(pixels, levels),
            _ => !kernel(levels, pixels),
        };
        for y in 0..image.height() {
            let mut row = RowScan::new(y, 0);
            let (chunks, rest) = image.row(y).as_chunks::<64>();
            let (levels, rest_levels) = thresholds.row(y).as_chunks::<64>();
            for (chunk, levels) in chunks.iter().zip(levels) {
                row.add(mask(chunk, levels), 64, self);
            }
            if !rest.is_empty() {
                let (mut last, mut last_levels) = ([255; 64], [0; 64]);
                last.iter_mut().zip(rest).for_each(|(a, b)| *a = *b);
                last_levels.iter_mut().zip(rest_levels).for_each(|(a, b)| *a = *b);
                row.add(mask(&last, &last_levels) & valid(rest), rest.len() as u32, self);
            }
            row.end(self);
            if self.full {
                return;
            }
        }
    }

    #[inline(always)]
    fn find_with<const LIGHT: bool>(
        &mut self,
        image: &ImageView<'_>,
        window: &Window,
        kernel: impl Fn(&[u8; 64]) -> u64,
    ) {
        for y in window.y0..window.y1 {
            let Some(pixels) = image.row(y).get(window.x0..) else { return };
            let count = window.x1.saturating_sub(window.x0);
            self.add_row::<LIGHT>(RowScan::new(y, window.x0), pixels, count, &kernel);
            if self.full {
                return;
            }
        }
    }

    /// Row `y` of bytes that are 0 where a pixel is dark.
    fn find_row<const LIGHT: bool>(&mut self, y: usize, sides: &[u8]) {
        #[cfg(target_arch = "x86_64")]
        self.add_row::<LIGHT>(RowScan::new(y, 0), sides, sides.len(), &|p| {
            super::mask::x86::dark_mask_sse2(p, 0)
        });
        #[cfg(not(target_arch = "x86_64"))]
        self.add_row::<LIGHT>(RowScan::new(y, 0), sides, sides.len(), &|p| dark_mask_portable(p, 0));
    }

    #[inline(always)]
    fn add_row<const LIGHT: bool>(
        &mut self,
        mut row: RowScan,
        pixels: &[u8],
        count: usize,
        kernel: &impl Fn(&[u8; 64]) -> u64,
    ) {
        let flip = if LIGHT { u64::MAX } else { 0 };
        let mut at = 0;
        while at + 64 <= count
            && let Some(chunk) = pixels.get(at..).and_then(|p| p.first_chunk())
        {
            row.add(kernel(chunk) ^ flip, 64, self);
            at += 64;
        }
        if let Some(rest) = pixels.get(at..count).filter(|rest| !rest.is_empty()) {
            // what lies beyond is read too where there is something: a copy would cost more than the rest of the row
            let mut last = [255; 64];
            let chunk = pixels.get(at..).and_then(|p| p.first_chunk()).unwrap_or_else(|| {
                last.iter_mut().zip(rest).for_each(|(a, b)| *a = *b);
                &last
            });
            let mask = kernel(chunk);
            row.add((mask ^ flip) & valid(rest), rest.len() as u32, self);
        }
        row.end(self);
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

/// Bits of the pixels of a last, shorter part of a row: 1 to 64.
#[inline(always)]
fn valid(rest: &[u8]) -> u64 {
    u64::MAX >> (64 - rest.len().clamp(1, 64))
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
mod tests;
