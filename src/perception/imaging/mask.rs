//! Which of 64 pixels are dark, as bits: the kernel of binarisation, for what the processor offers.

/// 64 bits, bit `i` set where pixel `i` is at most `threshold`.
pub(super) type Mask = u64;

/// Portable kernel.
#[cfg(any(test, not(target_arch = "x86_64")))]
#[inline(always)]
pub(super) fn dark_mask_portable(pixels: &[u8; 64], threshold: u8) -> Mask {
    let mut mask = 0;
    for (i, &p) in (0u32..).zip(pixels) {
        mask |= u64::from(p <= threshold) << i;
    }
    mask
}

/// Portable kernel with per-pixel thresholds.
#[cfg(any(test, not(target_arch = "x86_64")))]
#[inline(always)]
pub(super) fn dark_mask_each_portable(pixels: &[u8; 64], thresholds: &[u8; 64]) -> Mask {
    let mut mask = 0;
    for (i, (&p, &t)) in (0u32..).zip(pixels.iter().zip(thresholds)) {
        mask |= u64::from(p <= t) << i;
    }
    mask
}

#[cfg(target_arch = "x86_64")]
pub(super) mod x86 {
    use super::Mask;
    use std::arch::x86_64::{
        __m128i, __m256i, _mm_cmpeq_epi8, _mm_loadu_si128, _mm_min_epu8, _mm_movemask_epi8, _mm_set1_epi8,
        _mm256_cmpeq_epi8, _mm256_loadu_si256, _mm256_min_epu8, _mm256_movemask_epi8, _mm256_set1_epi8,
    };

    /// SSE2 kernel: part of every x86-64.
    #[inline(always)]
    pub(in super::super) fn dark_mask_sse2(pixels: &[u8; 64], threshold: u8) -> Mask {
        let mut mask = 0;
        for (i, part) in (0u32..).zip(pixels.as_chunks::<16>().0) {
            // SAFETY: SSE2 belongs to the x86-64 baseline; `part` holds the 16 bytes that an unaligned load reads.
            #[allow(unsafe_code)]
            let bits = unsafe {
                let p = _mm_loadu_si128(part.as_ptr().cast::<__m128i>());
                let least = _mm_min_epu8(p, _mm_set1_epi8(threshold as i8));
                _mm_movemask_epi8(_mm_cmpeq_epi8(least, p)) as u32
            };
            mask |= u64::from(bits) << (16 * i);
        }
        mask
    }

    /// SSE2 kernel with per-pixel thresholds.
    #[inline(always)]
    pub(in super::super) fn dark_mask_each_sse2(pixels: &[u8; 64], thresholds: &[u8; 64]) -> Mask {
        let mut mask = 0;
        let parts = pixels.as_chunks::<16>().0.iter().zip(thresholds.as_chunks::<16>().0);
        for (i, (part, levels)) in (0u32..).zip(parts) {
            // SAFETY: SSE2 belongs to the x86-64 baseline; both hold the 16 bytes that an unaligned load reads.
            #[allow(unsafe_code)]
            let bits = unsafe {
                let p = _mm_loadu_si128(part.as_ptr().cast::<__m128i>());
                let least = _mm_min_epu8(p, _mm_loadu_si128(levels.as_ptr().cast::<__m128i>()));
                _mm_movemask_epi8(_mm_cmpeq_epi8(least, p)) as u32
            };
            mask |= u64::from(bits) << (16 * i);
        }
        mask
    }

    /// AVX2 kernel with per-pixel thresholds.
    #[inline]
    #[target_feature(enable = "avx2")]
    pub(in super::super) fn dark_mask_each_avx2(pixels: &[u8; 64], thresholds: &[u8; 64]) -> Mask {
        let mut mask = 0;
        let (parts, levels) = (pixels.as_chunks::<32>().0, thresholds.as_chunks::<32>().0);
        for i in 0..2 {
            // SAFETY: both hold the 32 bytes that an unaligned load reads.
            #[allow(unsafe_code)]
            let (p, levels) = unsafe {
                (
                    _mm256_loadu_si256(parts[i].as_ptr().cast::<__m256i>()),
                    _mm256_loadu_si256(levels[i].as_ptr().cast::<__m256i>()),
                )
            };
            let bits = _mm256_movemask_epi8(_mm256_cmpeq_epi8(_mm256_min_epu8(p, levels), p)) as u32;
            mask |= u64::from(bits) << (32 * i);
        }
        mask
    }

    /// AVX2 kernel.
    #[inline]
    #[target_feature(enable = "avx2")]
    pub(in super::super) fn dark_mask_avx2(pixels: &[u8; 64], threshold: u8) -> Mask {
        let mut mask = 0;
        for (i, part) in (0u32..).zip(pixels.as_chunks::<32>().0) {
            // SAFETY: `part` holds the 32 bytes that an unaligned load reads.
            #[allow(unsafe_code)]
            let p = unsafe { _mm256_loadu_si256(part.as_ptr().cast::<__m256i>()) };
            let least = _mm256_min_epu8(p, _mm256_set1_epi8(threshold as i8));
            let bits = _mm256_movemask_epi8(_mm256_cmpeq_epi8(least, p)) as u32;
            mask |= u64::from(bits) << (32 * i);
        }
        mask
    }
}

#[cfg(all(test, target_arch = "x86_64"))]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn kernels_agree(pixels in prop::collection::vec(any::<u8>(), 64), threshold in any::<u8>()) {
            let pixels: &[u8; 64] = pixels.first_chunk().unwrap();
            let wanted = dark_mask_portable(pixels, threshold);
            for (i, &p) in pixels.iter().enumerate() {
                prop_assert_eq!(wanted >> i & 1 == 1, p <= threshold);
            }
            prop_assert_eq!(x86::dark_mask_sse2(pixels, threshold), wanted);
            prop_assert_eq!(x86::dark_mask_each_sse2(pixels, &[threshold; 64]), wanted);
            let mut levels = *pixels;
            levels.rotate_left(usize::from(threshold % 64));
            let each = dark_mask_each_portable(pixels, &levels);
            prop_assert_eq!(x86::dark_mask_each_sse2(pixels, &levels), each);
            if std::arch::is_x86_feature_detected!("avx2") {
                // SAFETY: the feature was just detected.
                #[allow(unsafe_code)]
                let (wide, wide_each) = unsafe {
                    (x86::dark_mask_avx2(pixels, threshold), x86::dark_mask_each_avx2(pixels, &levels))
                };
                prop_assert_eq!((wide, wide_each), (wanted, each));
            }
        }
    }
}
