//! Half as large an image: means of two by two pixels. A pixel at `x` of the half lies at `2 x + 1/2` of the whole.

use crate::imaging::ImageView;

/// Fills `out` with the half of `image` (an odd last column or row is left out); its columns and rows. Nothing is allocated where
/// the buffer has room.
pub(crate) fn halve(image: &ImageView<'_>, out: &mut Vec<u8>) -> (usize, usize) {
    let (width, height) = (image.width() / 2, image.height() / 2);
    if out.len() != width * height {
        out.clear();
        out.resize(width * height, 0);
    }
    for (y, out) in out.chunks_exact_mut(width.max(1)).enumerate() {
        halve_row(image.row(2 * y), image.row(2 * y + 1), out);
    }
    (width, height)
}

/// One row from two.
fn halve_row(upper: &[u8], lower: &[u8], out: &mut [u8]) {
    let mut done = 0;
    #[cfg(target_arch = "x86_64")]
    {
        let parts = upper.as_chunks::<32>().0.iter().zip(lower.as_chunks::<32>().0);
        for ((upper, lower), out) in parts.zip(out.as_chunks_mut::<16>().0) {
            sse2_part(upper, lower, out);
            done += 16;
        }
    }
    let rest = upper.as_chunks::<2>().0.iter().zip(lower.as_chunks::<2>().0).zip(out);
    for ((&[a, b], &[c, d]), out) in rest.skip(done) {
        *out = average(average(a, c), average(b, d));
    }
}

/// Rounded up, as the processors do it.
fn average(a: u8, b: u8) -> u8 {
    (u16::from(a) + u16::from(b)).div_ceil(2) as u8
}

/// 16 pixels of the half.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn sse2_part(upper: &[u8; 32], lower: &[u8; 32], out: &mut [u8; 16]) {
    use std::arch::x86_64::{
        __m128i, _mm_and_si128, _mm_avg_epu8, _mm_avg_epu16, _mm_loadu_si128, _mm_packus_epi16,
        _mm_set1_epi16, _mm_srli_epi16, _mm_storeu_si128,
    };
    // SAFETY: SSE2 belongs to the x86-64 baseline; the arrays hold the bytes that are read and written, unaligned.
    #[allow(unsafe_code)]
    unsafe {
        let load = |row: &[u8; 32], at: usize| _mm_loadu_si128(row.as_ptr().cast::<__m128i>().add(at));
        let half = |at: usize| {
            let both = _mm_avg_epu8(load(upper, at), load(lower, at));
            _mm_avg_epu16(_mm_and_si128(both, _mm_set1_epi16(255)), _mm_srli_epi16::<8>(both))
        };
        _mm_storeu_si128(out.as_mut_ptr().cast(), _mm_packus_epi16(half(0), half(1)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn is_the_mean_of_four(width in 1usize..120, height in 1usize..5, seed in any::<u64>()) {
            let mut state = seed;
            let pixels: Vec<u8> = (0..width * height).map(|_| {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                (state >> 56) as u8
            }).collect();
            let image = ImageView::new(&pixels, width, height).unwrap();
            let mut out = vec![9; 3];
            let (w, h) = halve(&image, &mut out);
            prop_assert_eq!((w, h, out.len()), (width / 2, height / 2, (width / 2) * (height / 2)));
            for (i, &p) in out.iter().enumerate() {
                let (x, y) = (2 * (i % w), 2 * (i / w));
                let sum: f64 = [(x, y), (x + 1, y), (x, y + 1), (x + 1, y + 1)]
                    .iter().map(|&(x, y)| f64::from(image.row(y)[x])).sum();
                let (a, b) = (image.row(y), image.row(y + 1));
                prop_assert_eq!(p, average(average(a[x], b[x]), average(a[x + 1], b[x + 1])));
                prop_assert!((f64::from(p) - sum / 4.0).abs() <= 1.0);
            }
        }
    }
}
