//! Sums over the pixels of an ellipse: the inner loops of the centroid.

use crate::imaging::ImageView;

/// An ellipse of pixels, row by row.
pub(super) struct Ellipse {
    x: f64,
    y: f64,
    height: f64,
    slope: f64,
    width: f64,
}

impl Ellipse {
    /// The ellipse `d^T S^-1 d <= 1` about `(x, y)`, `S = [xx, xy, yy]`.
    pub(super) fn new(x: f64, y: f64, [xx, xy, yy]: [f64; 3]) -> Self {
        let slope = xy / yy;
        Self { x, y, height: yy.max(0.0).sqrt(), slope, width: (xx - xy * slope).max(0.0).sqrt() }
    }

    /// Every `step`-th row of it in an image of the given size, as `(y, x0, x1)`: its pixels are `x0..x1`.
    #[inline(always)]
    fn rows(&self, width: usize, height: usize, step: usize) -> Rows {
        // NaN gives no rows
        let some = self.height > 0.0 && self.y + self.height >= 0.0;
        let (top, bottom) = if some {
            (ceil(self.y - self.height), ((self.y + self.height) as i32 + 1).min(height as i32))
        } else {
            (0, 0)
        };
        let inverse = 1.0 / (self.height * self.height);
        let Self { x, y: centre, slope, width: half, .. } = *self;
        Rows { y: top, bottom, step: step as i32, limit: width as i32, x, centre, slope, half, inverse }
    }
}

/// See [`Ellipse::rows`].
struct Rows {
    y: i32,
    bottom: i32,
    step: i32,
    limit: i32,
    x: f64,
    centre: f64,
    slope: f64,
    half: f64,
    inverse: f64,
}

impl Iterator for Rows {
    type Item = (usize, usize, usize);

    #[inline(always)]
    fn next(&mut self) -> Option<Self::Item> {
        while self.y < self.bottom {
            let y = self.y;
            self.y += self.step;
            let dy = f64::from(y) - self.centre;
            let square = 1.0 - dy * dy * self.inverse;
            let half = self.half * if square > 0.0 { square } else { 0.0 }.sqrt();
            let middle = self.x + self.slope * dy;
            if middle + half < 0.0 {
                continue;
            }
            let (x0, x1) = (ceil(middle - half), ((middle + half) as i32 + 1).min(self.limit));
            if x0 < x1 {
                return Some((y as usize, x0 as usize, x1 as usize));
            }
        }
        None
    }
}

/// The least whole number that is not below `x`, nor below 0. A cast: `ceil` is a call on the baseline processor.
#[inline(always)]
fn ceil(x: f64) -> i32 {
    let x = if x > 0.0 { x } else { 0.0 };
    let whole = x as i32;
    whole + i32::from(x > f64::from(whole))
}

/// Sums of weights (in units of one grey level), and the number of pixels on the rim.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Sums {
    pub(super) w: u64,
    pub(super) wx: u64,
    pub(super) wy: u64,
    pub(super) rim: u32,
}

/// Sum of levels, pixels, squared differences of neighbours, pairs of neighbours; over a dozen rows at most.
pub(super) fn inner_sums(image: &ImageView<'_>, ellipse: &Ellipse) -> (u32, u32, u32, u32) {
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

/// Sums of `min(hi - I, span)`, not below 0, over the ellipse.
pub(super) fn weighted_sums(image: &ImageView<'_>, ellipse: &Ellipse, hi: u8, span: u8) -> Sums {
    let mut sums = Sums::default();
    for (y, x0, x1) in ellipse.rows(image.width(), image.height(), 1) {
        // parts whose sums fit 32 bits, and whose columns fit 16
        for from in (x0..x1).step_by(LONGEST) {
            let Some(row) = image.row(y).get(from..) else { continue };
            let part = row_sums(row, (x1 - from).min(LONGEST), hi, span);
            sums.w += u64::from(part.w);
            sums.wx += u64::from(part.wx) + u64::from(part.w) * from as u64;
            sums.wy += u64::from(part.w) * y as u64;
            sums.rim += part.rim;
        }
    }
    sums
}

/// Sums over a part of a row; columns count from its start.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct RowSums {
    w: u32,
    wx: u32,
    rim: u32,
}

/// Longest part of a row.
const LONGEST: usize = 4096;

#[cfg(target_arch = "x86_64")]
use x86::row_sums;

#[cfg(not(target_arch = "x86_64"))]
use row_sums_portable as row_sums;

/// What every path computes.
#[cfg(any(test, not(target_arch = "x86_64")))]
fn row_sums_portable(row: &[u8], count: usize, hi: u8, span: u8) -> RowSums {
    let mut sums = RowSums { w: 0, wx: 0, rim: 0 };
    for (i, &p) in (0u32..).zip(row.iter().take(count)) {
        let weight = hi.saturating_sub(p).min(span);
        sums.w += u32::from(weight);
        sums.wx += u32::from(weight) * i;
        sums.rim += u32::from(weight != 0 && weight != span);
    }
    sums
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::RowSums;
    use std::arch::x86_64::{
        __m128i, _mm_add_epi16, _mm_add_epi32, _mm_add_epi64, _mm_and_si128, _mm_andnot_si128,
        _mm_cmpeq_epi8, _mm_cvtsi128_si32, _mm_loadu_si128, _mm_madd_epi16, _mm_min_epu8, _mm_or_si128,
        _mm_sad_epu8, _mm_set1_epi8, _mm_set1_epi16, _mm_setr_epi16, _mm_setzero_si128, _mm_shuffle_epi32,
        _mm_subs_epu8, _mm_unpackhi_epi8, _mm_unpacklo_epi8,
    };

    const LANES: usize = 16;
    /// The window of 16 that starts at `16 - n` keeps the first `n` lanes.
    static KEEP: [u8; 2 * LANES] = {
        let mut keep = [0; 2 * LANES];
        let mut i = 0;
        while i < LANES {
            keep[i] = 255;
            i += 1;
        }
        keep
    };

    #[inline(always)]
    fn load(bytes: &[u8; LANES]) -> __m128i {
        // SAFETY: an unaligned load of the 16 bytes that `bytes` holds.
        #[allow(unsafe_code)]
        unsafe {
            _mm_loadu_si128(bytes.as_ptr().cast::<__m128i>())
        }
    }

    /// With SSE2, which belongs to the x86-64 baseline. `count` is at most 4096.
    #[inline(always)]
    pub(super) fn row_sums(row: &[u8], count: usize, hi: u8, span: u8) -> RowSums {
        let count = count.min(row.len());
        // SAFETY: SSE2 belongs to the x86-64 baseline.
        #[allow(unsafe_code, unused_unsafe)]
        unsafe {
            let zero = _mm_setzero_si128();
            let (hi, span) = (_mm_set1_epi8(hi as i8), _mm_set1_epi8(span as i8));
            let mut low = _mm_setr_epi16(0, 1, 2, 3, 4, 5, 6, 7);
            let mut high = _mm_setr_epi16(8, 9, 10, 11, 12, 13, 14, 15);
            let (mut w, mut wx, mut rim) = (zero, zero, zero);
            let mut at = 0;
            while at < count {
                let left = count - at;
                let pixels = match row.get(at..at + LANES).and_then(|p| p.first_chunk()) {
                    Some(pixels) => load(pixels),
                    // the image ends within the group
                    None => {
                        let mut pixels = [255; LANES];
                        pixels.iter_mut().zip(row.get(at..).unwrap_or(&[])).for_each(|(a, b)| *a = *b);
                        load(&pixels)
                    }
                };
                let mut weight = _mm_min_epu8(_mm_subs_epu8(hi, pixels), span);
                if left < LANES
                    && let Some(keep) = KEEP.get(LANES - left..).and_then(|k| k.first_chunk())
                {
                    weight = _mm_and_si128(weight, load(keep));
                }
                w = _mm_add_epi64(w, _mm_sad_epu8(weight, zero));
                wx = _mm_add_epi32(wx, _mm_madd_epi16(_mm_unpacklo_epi8(weight, zero), low));
                wx = _mm_add_epi32(wx, _mm_madd_epi16(_mm_unpackhi_epi8(weight, zero), high));
                let ends = _mm_or_si128(_mm_cmpeq_epi8(weight, zero), _mm_cmpeq_epi8(weight, span));
                rim = _mm_add_epi64(rim, _mm_sad_epu8(_mm_andnot_si128(ends, _mm_set1_epi8(1)), zero));
                low = _mm_add_epi16(low, _mm_set1_epi16(LANES as i16));
                high = _mm_add_epi16(high, _mm_set1_epi16(LANES as i16));
                at += LANES;
            }
            w = _mm_add_epi64(w, _mm_shuffle_epi32::<0b01_00_11_10>(w));
            rim = _mm_add_epi64(rim, _mm_shuffle_epi32::<0b01_00_11_10>(rim));
            wx = _mm_add_epi32(wx, _mm_shuffle_epi32::<0b01_00_11_10>(wx));
            wx = _mm_add_epi32(wx, _mm_shuffle_epi32::<0b10_11_00_01>(wx));
            RowSums {
                w: _mm_cvtsi128_si32(w) as u32,
                wx: _mm_cvtsi128_si32(wx) as u32,
                rim: _mm_cvtsi128_si32(rim) as u32,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Every path gives the sums of the definition, at the border of the image too.
        #[test]
        fn sums_are_those_of_the_definition(
            x in -5.0..75.0f64, y in -5.0..45.0f64, a in 1.0..30.0f64, b in 1.0..30.0f64, r in -0.9..0.9f64,
            seed in any::<u64>(), hi in 60u8..250, span in 2u8..60,
        ) {
            let mut state = seed;
            let pixels: Vec<u8> = (0..70 * 40).map(|_| {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                (state >> 56) as u8
            }).collect();
            let image = ImageView::new(&pixels, 70, 40).unwrap();
            let S = [a * a, r * a * b, b * b];
            let ellipse = Ellipse::new(x, y, S);
            let got = weighted_sums(&image, &ellipse, hi, span);
            let mut wanted = Sums::default();
            let det = S[0] * S[2] - S[1] * S[1];
            for v in 0..40 {
                for u in 0..70 {
                    let (dx, dy) = (u as f64 - x, v as f64 - y);
                    let d = (S[2] * dx * dx - 2.0 * S[1] * dx * dy + S[0] * dy * dy) / det;
                    prop_assume!((d - 1.0).abs() > 1e-9);
                    if d < 1.0 {
                        let w = u64::from(hi.saturating_sub(pixels[v * 70 + u]).min(span));
                        wanted.w += w;
                        wanted.wx += w * u as u64;
                        wanted.wy += w * v as u64;
                        wanted.rim += u32::from(w != 0 && w != u64::from(span));
                    }
                }
            }
            prop_assert_eq!(got, wanted);
            let mut portable = Sums::default();
            for (y, x0, x1) in ellipse.rows(70, 40, 1) {
                let part = row_sums_portable(&image.row(y)[x0..], x1 - x0, hi, span);
                portable.w += u64::from(part.w);
                portable.wx += u64::from(part.wx) + u64::from(part.w) * x0 as u64;
                portable.wy += u64::from(part.w) * y as u64;
                portable.rim += part.rim;
            }
            prop_assert_eq!(portable, wanted);
        }
    }
}
