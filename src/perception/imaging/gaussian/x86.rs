//! The filter's sums with AVX2: those of a block of pixels stay in registers over the whole kernel. To the bit the plain loops' sums.

use super::FRACTION;
use crate::imaging::ImageView;
use crate::imaging::simd::has_avx2;
use std::arch::x86_64::{
    __m256i, _mm_loadu_si128, _mm256_add_epi16, _mm256_cvtepu8_epi16, _mm256_loadu_si256, _mm256_min_epu16,
    _mm256_mulhi_epu16, _mm256_packus_epi16, _mm256_permute4x64_epi64, _mm256_set1_epi16, _mm256_slli_epi16,
    _mm256_srli_epi16, _mm256_storeu_si256,
};

/// Pixels of a block, in `PARTS` registers of `LANES`.
const BLOCK: usize = LANES * PARTS;
/// 16-bit numbers of a 256-bit register, by the instruction set's specification, and registers in a block, chosen by hand.
const LANES: usize = 16;
const PARTS: usize = 4;

type ColumnSums = [__m256i; PARTS];

/// Sums over the columns about row `y`; `false`, and nothing done, without AVX2 and for narrow images.
pub(super) fn columns(image: &ImageView<'_>, y: usize, middle: u16, sides: &[u16], sums: &mut [u16]) -> bool {
    if !has_avx2() || sums.len() < BLOCK {
        return false;
    }
    // SAFETY: the feature was just detected.
    #[allow(unsafe_code)]
    unsafe {
        columns_avx2(image, y, middle, sides, sums);
    }
    true
}

/// Levels of a row from its `columns`, which begin and end with as many more as `sides` has; otherwise like [`columns`].
pub(super) fn row(columns: &[u16], middle: u16, sides: &[u16], out: &mut [u8]) -> bool {
    if !has_avx2() || out.len() < BLOCK {
        return false;
    }
    // SAFETY: the feature was just detected.
    #[allow(unsafe_code)]
    unsafe {
        row_avx2(columns, middle, sides, out);
    }
    true
}

/// Where blocks begin that cover `width` pixels: the last one ends with them.
fn blocks(width: usize) -> impl Iterator<Item = usize> {
    (0..width.div_ceil(BLOCK)).map(move |i| (i * BLOCK).min(width.saturating_sub(BLOCK)))
}

/// The block's values from the `x`-th on.
#[inline(always)]
fn block_at<T>(row: &[T], x: usize) -> Option<&[T; BLOCK]> {
    row.get(x..)?.first_chunk()
}

#[target_feature(enable = "avx2")]
fn levels(pixels: &[u8; BLOCK]) -> ColumnSums {
    std::array::from_fn(|i| {
        // SAFETY: an unaligned load of 16 of the 64 bytes that `pixels` holds.
        #[allow(unsafe_code)]
        let part = unsafe { _mm_loadu_si128(pixels.as_ptr().add(i * LANES).cast()) };
        _mm256_cvtepu8_epi16(part)
    })
}

#[target_feature(enable = "avx2")]
fn words(values: &[u16; BLOCK]) -> ColumnSums {
    std::array::from_fn(|i| {
        // SAFETY: an unaligned load of 16 of the 64 words that `values` holds.
        #[allow(unsafe_code)]
        unsafe {
            _mm256_loadu_si256(values.as_ptr().add(i * LANES).cast())
        }
    })
}

#[target_feature(enable = "avx2")]
fn plus(a: ColumnSums, b: ColumnSums) -> ColumnSums {
    std::array::from_fn(|i| _mm256_add_epi16(a[i], b[i]))
}

#[target_feature(enable = "avx2")]
fn scaled(a: ColumnSums) -> ColumnSums {
    std::array::from_fn(|i| _mm256_slli_epi16::<{ FRACTION as i32 }>(a[i]))
}

/// `sums` and the upper halves of the products of `a` and `weight`.
#[target_feature(enable = "avx2")]
fn plus_weighted(sums: ColumnSums, a: ColumnSums, weight: u16) -> ColumnSums {
    let weight = _mm256_set1_epi16(weight.cast_signed());
    std::array::from_fn(|i| _mm256_add_epi16(sums[i], _mm256_mulhi_epu16(a[i], weight)))
}

#[target_feature(enable = "avx2")]
fn columns_avx2(image: &ImageView<'_>, y: usize, middle: u16, sides: &[u16], out: &mut [u16]) {
    let last = image.height().saturating_sub(1);
    let start = [_mm256_set1_epi16(super::given_back(sides).cast_signed()); PARTS];
    for x in blocks(out.len()) {
        let at = |y: usize| block_at(image.row(y), x);
        let Some(own) = at(y) else { return };
        let mut sums = plus_weighted(start, scaled(levels(own)), middle);
        for (k, &weight) in (1..).zip(sides) {
            let (Some(above), Some(below)) = (at(y.saturating_sub(k)), at((y + k).min(last))) else { return };
            sums = plus_weighted(sums, scaled(plus(levels(above), levels(below))), weight);
        }
        let Some(out) = out.get_mut(x..).and_then(|o| o.first_chunk_mut::<BLOCK>()) else { return };
        for (i, sum) in sums.into_iter().enumerate() {
            // SAFETY: an unaligned store into 16 of the 64 words that `out` holds.
            #[allow(unsafe_code)]
            unsafe {
                _mm256_storeu_si256(out.as_mut_ptr().add(i * LANES).cast(), sum);
            }
        }
    }
}

#[target_feature(enable = "avx2")]
fn row_avx2(columns: &[u16], middle: u16, sides: &[u16], out: &mut [u8]) {
    let radius = sides.len();
    let start = [_mm256_set1_epi16(super::given_back(sides).cast_signed()); PARTS];
    let (half, white) = (_mm256_set1_epi16(1 << (FRACTION - 1)), _mm256_set1_epi16(255));
    for x in blocks(out.len()) {
        let at = |x: usize| block_at(columns, x);
        let Some(own) = at(x + radius) else { return };
        let mut sums = plus_weighted(start, words(own), middle);
        for (k, &weight) in (1..).zip(sides) {
            let (Some(left), Some(right)) = (at(x + radius - k), at(x + radius + k)) else { return };
            sums = plus_weighted(sums, plus(words(left), words(right)), weight);
        }
        let [a, b, c, d] = sums.map(|s| {
            _mm256_min_epu16(_mm256_srli_epi16::<{ FRACTION as i32 }>(_mm256_add_epi16(s, half)), white)
        });
        let Some(out) = out.get_mut(x..).and_then(|o| o.first_chunk_mut::<BLOCK>()) else { return };
        for (i, (low, high)) in [(a, b), (c, d)].into_iter().enumerate() {
            // packing works within halves of a register: its quarters are put in order again
            let bytes = _mm256_permute4x64_epi64::<0b11_01_10_00>(_mm256_packus_epi16(low, high));
            // SAFETY: an unaligned store into 32 of the 64 bytes that `out` holds.
            #[allow(unsafe_code)]
            unsafe {
                _mm256_storeu_si256(out.as_mut_ptr().add(2 * i * LANES).cast(), bytes);
            }
        }
    }
}
