//! The sums with SSE2, part of every x86-64, and with AVX2.

use super::{DotLight, RowLight, RowSums, Scale, WeightSums};
use crate::detect::dots::ellipse::PixelEllipse;
use crate::imaging::ImageView;
use std::arch::x86_64::{
    __m128i, _mm_add_epi16, _mm_add_epi32, _mm_and_si128, _mm_cmpgt_epi16, _mm_cmpgt_epi32,
    _mm_cvtsi128_si32, _mm_loadu_si128, _mm_madd_epi16, _mm_min_epi16, _mm_min_epi32, _mm_mulhi_epu16,
    _mm_mullo_epi16, _mm_set1_epi16, _mm_set1_epi32, _mm_setr_epi16, _mm_setr_epi32, _mm_setzero_si128,
    _mm_shuffle_epi32, _mm_srai_epi16, _mm_storeu_si128, _mm_sub_epi16, _mm_sub_epi32, _mm_subs_epu16,
    _mm_unpackhi_epi8, _mm_unpacklo_epi8, _mm256_add_epi16, _mm256_add_epi32, _mm256_add_pd,
    _mm256_and_si256, _mm256_castsi256_si128, _mm256_ceil_pd, _mm256_cmpgt_epi16, _mm256_cvtepi8_epi16,
    _mm256_cvtepi32_pd, _mm256_cvtepu8_epi16, _mm256_cvttpd_epi32, _mm256_extracti128_si256, _mm256_floor_pd,
    _mm256_madd_epi16, _mm256_max_pd, _mm256_min_epi16, _mm256_movemask_epi8, _mm256_mul_pd,
    _mm256_mulhi_epu16, _mm256_mullo_epi16, _mm256_set1_epi16, _mm256_set1_pd, _mm256_setr_epi16,
    _mm256_setzero_pd, _mm256_setzero_si256, _mm256_slli_epi16, _mm256_sqrt_pd, _mm256_srai_epi16,
    _mm256_storeu_pd, _mm256_sub_epi16, _mm256_sub_pd, _mm256_subs_epu16,
};

/// Pixels that are weighed at once. Derived: a register of AVX2 has as many 16-bit lanes, and two of SSE2.
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

/// The 16 pixels at `at`; 0 where the image ends within them.
#[inline(always)]
fn pixels(row: &[u8], at: usize) -> __m128i {
    if let Some(pixels) = row.get(at..at + LANES).and_then(|p| p.first_chunk()) {
        return load(pixels);
    }
    let mut pixels = [0; LANES];
    pixels.iter_mut().zip(row.get(at..).unwrap_or(&[])).for_each(|(a, b)| *a = *b);
    load(&pixels)
}

/// Ones in the first `left` of 16 lanes.
#[inline(always)]
fn keep(left: usize) -> __m128i {
    let none = [0; LANES];
    load(KEEP.get(LANES.saturating_sub(left)..).and_then(|k| k.first_chunk()).unwrap_or(&none))
}

/// Rows that are made side by side, so that their roots do not wait for each other. Derived: a register of AVX holds as many `f64`.
const BLOCK: usize = 4;

/// Rows one after the other: where each begins and ends (nothing where `x0 >= x1`), and [`PixelEllipse::rim_at`] of it.
struct RowBlock {
    x0: [i32; BLOCK],
    x1: [i32; BLOCK],
    rim_px2: [f64; BLOCK],
}

impl RowBlock {
    /// Rows from `y` on of `outer` and `rim`, up to `bottom`, in an image `limit` px wide: as [`PixelEllipse::rows`] has them.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn at(y: i32, bottom: i32, limit: i32, outer: &PixelEllipse, rim: &PixelEllipse) -> Self {
        let all = |value: f64| _mm256_set1_pd(value);
        let (one, zero) = (all(1.0), _mm256_setzero_pd());
        let rows = _mm_add_epi32(_mm_set1_epi32(y), _mm_setr_epi32(0, 1, 2, 3));
        let away = _mm256_sub_pd(_mm256_cvtepi32_pd(rows), all(outer.y));
        let square = _mm256_mul_pd(away, away);
        let left = _mm256_max_pd(_mm256_sub_pd(one, _mm256_mul_pd(square, all(outer.inverse))), zero);
        let half = _mm256_mul_pd(all(outer.width), _mm256_sqrt_pd(left));
        let middle = _mm256_add_pd(all(outer.x), _mm256_mul_pd(all(outer.slope), away));
        let low = _mm256_max_pd(_mm256_sub_pd(middle, half), zero);
        let x0 = _mm256_cvttpd_epi32(_mm256_ceil_pd(low));
        let last = _mm256_cvttpd_epi32(_mm256_floor_pd(_mm256_add_pd(middle, half)));
        let x1 = _mm_min_epi32(_mm_add_epi32(last, _mm_set1_epi32(1)), _mm_set1_epi32(limit));
        let x1 = _mm_and_si128(x1, _mm_cmpgt_epi32(_mm_set1_epi32(bottom), rows));
        let length = _mm256_cvtepi32_pd(_mm_sub_epi32(x1, x0));
        let least = _mm256_mul_pd(_mm256_mul_pd(length, length), all(1.0 / 24.0));
        let along = _mm256_add_pd(
            _mm256_mul_pd(
                all(rim.width * rim.width),
                _mm256_sub_pd(one, _mm256_mul_pd(square, all(rim.inverse))),
            ),
            _mm256_mul_pd(all(rim.slope * rim.slope), square),
        );
        let rim = _mm256_add_pd(_mm256_max_pd(along, least), square);
        let mut block = Self { x0: [0; BLOCK], x1: [0; BLOCK], rim_px2: [0.0; BLOCK] };
        // SAFETY: unaligned stores of as many bytes as the arrays hold.
        #[allow(unsafe_code)]
        unsafe {
            _mm_storeu_si128(block.x0.as_mut_ptr().cast::<__m128i>(), x0);
            _mm_storeu_si128(block.x1.as_mut_ptr().cast::<__m128i>(), x1);
            _mm256_storeu_pd(block.rim_px2.as_mut_ptr(), rim);
        }
        block
    }
}

/// Largest half side of an ellipse whose sums fit 32 bits in each lane, px. Derived: half a square of 180 px, weights of 4080 sixteenths, 90 px away,
/// over eight lanes: 7.4e8 of 2.1e9; twice as far it would be eight times as much.
const MAX_PX: f64 = 90.0;

/// See [`super::weighted_sums`]; without an inner ellipse. `None` for ellipses that are too large.
#[target_feature(enable = "avx2,popcnt")]
pub(super) fn weighted_sums_avx2(
    image: &ImageView<'_>,
    [outer, rim]: [&PixelEllipse; 2],
    scale: &Scale,
) -> Option<WeightSums> {
    if !(outer.height < MAX_PX && outer.width + outer.slope.abs() * outer.height < MAX_PX) {
        return None;
    }
    let (cx, cy) = (outer.x.round() as i64, outer.y.round() as i64);
    let lights = DotLight::about([outer.x - cx as f64, outer.y - cy as f64], &scale.relative);
    let (edge, span) = (_mm256_set1_epi16(scale.edge), _mm256_set1_epi16(scale.span));
    let (margin, ones) = (_mm256_set1_epi16(scale.margin), _mm256_set1_epi16(1));
    let upper = _mm256_sub_epi16(span, margin);
    let place = _mm256_setr_epi16(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    let mut totals = [_mm256_setzero_si256(); 3];
    let mut sums = WeightSums::default();
    let (top, bottom) = outer.span(image.height());
    for y in (top..bottom).step_by(BLOCK) {
        let RowBlock { x0, x1, rim_px2 } = RowBlock::at(y, bottom, image.width() as i32, outer, rim);
        for i in 0..BLOCK {
            if x0[i] >= x1[i] {
                continue;
            }
            let (y, count) = (y + i as i32, (x1[i] - x0[i]) as usize);
            let Some(row) = image.row(y as usize).get(x0[i] as usize..) else { continue };
            let (dx, dy) = (i64::from(x0[i]) - cx, i64::from(y) - cy);
            let light = lights.row(dx, dy);
            let across = _mm256_set1_epi16(dy as i16);
            let mut column = _mm256_add_epi16(place, _mm256_set1_epi16(dx as i16));
            let (mut at, mut free) = (0, 0);
            while at < count {
                let (start, slope) = light.chord(at);
                let rise = _mm256_srai_epi16::<4>(_mm256_mullo_epi16(place, _mm256_set1_epi16(slope)));
                let lit = _mm256_add_epi16(_mm256_set1_epi16(start), rise);
                let v =
                    _mm256_mulhi_epu16(_mm256_slli_epi16::<8>(_mm256_cvtepu8_epi16(pixels(row, at))), lit);
                let away = if scale.light { _mm256_subs_epu16(v, edge) } else { _mm256_subs_epu16(edge, v) };
                let mut weight = _mm256_min_epi16(away, span);
                if count - at < LANES {
                    weight = _mm256_and_si256(weight, _mm256_cvtepi8_epi16(keep(count - at)));
                }
                for (total, by) in totals.iter_mut().zip([ones, column, across]) {
                    *total = _mm256_add_epi32(*total, _mm256_madd_epi16(weight, by));
                }
                let between =
                    _mm256_and_si256(_mm256_cmpgt_epi16(weight, margin), _mm256_cmpgt_epi16(upper, weight));
                // two bits a pixel
                free += (_mm256_movemask_epi8(between) as u32).count_ones() / 2;
                column = _mm256_add_epi16(column, _mm256_set1_epi16(LANES as i16));
                at += LANES;
            }
            sums.add_rim(free, rim_px2[i]);
        }
    }
    let [w, wx, wy] = totals.map(|total| {
        let sum = _mm_add_epi32(_mm256_castsi256_si128(total), _mm256_extracti128_si256::<1>(total));
        let mut lanes = [0i32; 4];
        // SAFETY: an unaligned store of 16 bytes to the 16 bytes of `lanes`.
        #[allow(unsafe_code)]
        unsafe {
            _mm_storeu_si128(lanes.as_mut_ptr().cast::<__m128i>(), sum);
        }
        lanes.iter().map(|&lane| i64::from(lane)).sum::<i64>()
    });
    Some(WeightSums { w, wx, wy, ..sums })
}

/// With SSE2, which belongs to the x86-64 baseline. `count` is at most 512.
#[inline(always)]
pub(super) fn row_sums(row: &[u8], count: usize, scale: &Scale, light: &RowLight) -> RowSums {
    let count = count.min(row.len());
    // SAFETY: SSE2 belongs to the x86-64 baseline.
    #[allow(unsafe_code, unused_unsafe)]
    unsafe {
        let (zero, ones) = (_mm_setzero_si128(), _mm_set1_epi16(1));
        let (edge, span) = (_mm_set1_epi16(scale.edge), _mm_set1_epi16(scale.span));
        let margin = _mm_set1_epi16(scale.margin);
        let upper = _mm_sub_epi16(span, margin);
        let (first, second) =
            (_mm_setr_epi16(0, 1, 2, 3, 4, 5, 6, 7), _mm_setr_epi16(8, 9, 10, 11, 12, 13, 14, 15));
        let (mut low, mut high) = (first, second);
        let (mut w, mut wx, mut rim) = (zero, zero, zero);
        let mut at = 0;
        while at < count {
            let left = count - at;
            let (pixels, keep) = (pixels(row, at), keep(left));
            let (start, slope) = light.chord(at);
            let (start, slope) = (_mm_set1_epi16(start), _mm_set1_epi16(slope));
            let parts = [
                (_mm_unpacklo_epi8(zero, pixels), _mm_unpacklo_epi8(keep, keep), first, low),
                (_mm_unpackhi_epi8(zero, pixels), _mm_unpackhi_epi8(keep, keep), second, high),
            ];
            for (pixels, keep, place, column) in parts {
                let lit = _mm_add_epi16(start, _mm_srai_epi16::<4>(_mm_mullo_epi16(place, slope)));
                let v = _mm_mulhi_epu16(pixels, lit);
                let away = if scale.light { _mm_subs_epu16(v, edge) } else { _mm_subs_epu16(edge, v) };
                let weight = _mm_and_si128(_mm_min_epi16(away, span), keep);
                w = _mm_add_epi32(w, _mm_madd_epi16(weight, ones));
                wx = _mm_add_epi32(wx, _mm_madd_epi16(weight, column));
                let free = _mm_and_si128(_mm_cmpgt_epi16(weight, margin), _mm_cmpgt_epi16(upper, weight));
                // a lane of ones is -1
                rim = _mm_sub_epi16(rim, free);
            }
            low = _mm_add_epi16(low, _mm_set1_epi16(LANES as i16));
            high = _mm_add_epi16(high, _mm_set1_epi16(LANES as i16));
            at += LANES;
        }
        let total = |sum: __m128i| {
            let sum = _mm_add_epi32(sum, _mm_shuffle_epi32::<0b01_00_11_10>(sum));
            _mm_cvtsi128_si32(_mm_add_epi32(sum, _mm_shuffle_epi32::<0b10_11_00_01>(sum)))
        };
        RowSums { w: total(w), wx: total(wx), rim: total(_mm_madd_epi16(rim, ones)) as u32 }
    }
}
