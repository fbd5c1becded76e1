//! Bytes side by side: the few operations that the ring detector needs, for what the processor offers.
//!
//! Averages round up, as the processors do it; the portable version gives the same bits.

/// Unsigned bytes that are worked on at once.
pub(super) trait Lane: Copy {
    /// How many.
    const COUNT: usize;
    /// The first [`Self::COUNT`] bytes of `bytes`, which holds them.
    fn load(bytes: &[u8]) -> Self;
    /// Into the first [`Self::COUNT`] bytes of `bytes`, which has room for them.
    fn store(self, bytes: &mut [u8]);
    /// The same byte everywhere.
    fn splat(byte: u8) -> Self;
    /// `(a + b + 1) / 2`
    fn average(self, other: Self) -> Self;
    /// `|a - b|`
    fn distance(self, other: Self) -> Self;
    /// `a - b`, 0 where that is negative.
    fn minus(self, other: Self) -> Self;
    /// Whether any is not 0.
    fn any(self) -> bool;
}

/// The definition: one byte at a time.
#[derive(Clone, Copy)]
pub(super) struct PortableBytes<const N: usize>([u8; N]);

impl<const N: usize> PortableBytes<N> {
    #[inline(always)]
    fn each(self, other: Self, operation: impl Fn(u8, u8) -> u8) -> Self {
        let mut out = self.0;
        out.iter_mut().zip(&other.0).for_each(|(a, &b)| *a = operation(*a, b));
        Self(out)
    }
}

impl<const N: usize> Lane for PortableBytes<N> {
    const COUNT: usize = N;

    #[inline(always)]
    fn load(bytes: &[u8]) -> Self {
        Self(bytes.first_chunk().copied().unwrap_or([0; N]))
    }

    #[inline(always)]
    fn store(self, bytes: &mut [u8]) {
        if let Some(out) = bytes.first_chunk_mut() {
            *out = self.0;
        }
    }

    #[inline(always)]
    fn splat(byte: u8) -> Self {
        Self([byte; N])
    }

    #[inline(always)]
    fn average(self, other: Self) -> Self {
        self.each(other, |a, b| (u16::from(a) + u16::from(b)).div_ceil(2) as u8)
    }

    #[inline(always)]
    fn distance(self, other: Self) -> Self {
        self.each(other, u8::abs_diff)
    }

    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        self.each(other, u8::saturating_sub)
    }

    #[inline(always)]
    fn any(self) -> bool {
        self.0.iter().fold(0, |a, &b| a | b) != 0
    }
}

#[cfg(target_arch = "x86_64")]
pub(super) mod x86 {
    use super::Lane;
    use std::arch::x86_64::{
        __m128i, __m256i, _mm_avg_epu8, _mm_cmpeq_epi8, _mm_loadu_si128, _mm_movemask_epi8, _mm_or_si128,
        _mm_set1_epi8, _mm_setzero_si128, _mm_storeu_si128, _mm_subs_epu8, _mm256_avg_epu8,
        _mm256_loadu_si256, _mm256_or_si256, _mm256_set1_epi8, _mm256_storeu_si256, _mm256_subs_epu8,
        _mm256_testz_si256,
    };

    /// SSE2: part of every x86-64.
    #[derive(Clone, Copy)]
    pub(in super::super) struct Sse2Bytes(__m128i);

    impl Lane for Sse2Bytes {
        // Bytes of the register: 128 bits by the instruction set's specification.
        const COUNT: usize = 16;

        #[inline(always)]
        fn load(bytes: &[u8]) -> Self {
            let bytes: &[u8; 16] = bytes.first_chunk().unwrap_or(&[0; 16]);
            // SAFETY: SSE2 belongs to the x86-64 baseline; `bytes` holds the 16 that an unaligned load reads.
            #[allow(unsafe_code)]
            Self(unsafe { _mm_loadu_si128(bytes.as_ptr().cast()) })
        }

        #[inline(always)]
        fn store(self, bytes: &mut [u8]) {
            if let Some(out) = bytes.first_chunk_mut::<16>() {
                // SAFETY: SSE2 belongs to the x86-64 baseline; `out` holds the 16 bytes that are written.
                #[allow(unsafe_code)]
                unsafe {
                    _mm_storeu_si128(out.as_mut_ptr().cast(), self.0);
                }
            }
        }

        #[inline(always)]
        fn splat(byte: u8) -> Self {
            // SAFETY: SSE2 belongs to the x86-64 baseline.
            #[allow(unsafe_code)]
            Self(unsafe { _mm_set1_epi8(byte as i8) })
        }

        #[inline(always)]
        fn average(self, other: Self) -> Self {
            // SAFETY: SSE2 belongs to the x86-64 baseline.
            #[allow(unsafe_code)]
            Self(unsafe { _mm_avg_epu8(self.0, other.0) })
        }

        #[inline(always)]
        fn distance(self, other: Self) -> Self {
            // SAFETY: SSE2 belongs to the x86-64 baseline.
            #[allow(unsafe_code)]
            Self(unsafe { _mm_or_si128(_mm_subs_epu8(self.0, other.0), _mm_subs_epu8(other.0, self.0)) })
        }

        #[inline(always)]
        fn minus(self, other: Self) -> Self {
            // SAFETY: SSE2 belongs to the x86-64 baseline.
            #[allow(unsafe_code)]
            Self(unsafe { _mm_subs_epu8(self.0, other.0) })
        }

        #[inline(always)]
        fn any(self) -> bool {
            // SAFETY: SSE2 belongs to the x86-64 baseline.
            #[allow(unsafe_code)]
            unsafe {
                _mm_movemask_epi8(_mm_cmpeq_epi8(self.0, _mm_setzero_si128())) != 0xffff
            }
        }
    }

    /// AVX2. Only for code that is reached after a test for it, and inlined there.
    #[derive(Clone, Copy)]
    pub(in super::super) struct Avx2(__m256i);

    // All methods are inlined into a function with the feature, which is called only where the processor has it.
    impl Lane for Avx2 {
        // Bytes of the register: 256 bits by the instruction set's specification.
        const COUNT: usize = 32;

        #[inline(always)]
        fn load(bytes: &[u8]) -> Self {
            let bytes: &[u8; 32] = bytes.first_chunk().unwrap_or(&[0; 32]);
            // SAFETY: the caller has tested for AVX2; `bytes` holds the 32 that an unaligned load reads.
            #[allow(unsafe_code)]
            Self(unsafe { _mm256_loadu_si256(bytes.as_ptr().cast()) })
        }

        #[inline(always)]
        fn store(self, bytes: &mut [u8]) {
            if let Some(out) = bytes.first_chunk_mut::<32>() {
                // SAFETY: the caller has tested for AVX2; `out` holds the 32 bytes that are written.
                #[allow(unsafe_code)]
                unsafe {
                    _mm256_storeu_si256(out.as_mut_ptr().cast(), self.0);
                }
            }
        }

        #[inline(always)]
        fn splat(byte: u8) -> Self {
            // SAFETY: the caller has tested for AVX2.
            #[allow(unsafe_code)]
            Self(unsafe { _mm256_set1_epi8(byte as i8) })
        }

        #[inline(always)]
        fn average(self, other: Self) -> Self {
            // SAFETY: the caller has tested for AVX2.
            #[allow(unsafe_code)]
            Self(unsafe { _mm256_avg_epu8(self.0, other.0) })
        }

        #[inline(always)]
        fn distance(self, other: Self) -> Self {
            // SAFETY: the caller has tested for AVX2.
            #[allow(unsafe_code)]
            Self(unsafe {
                _mm256_or_si256(_mm256_subs_epu8(self.0, other.0), _mm256_subs_epu8(other.0, self.0))
            })
        }

        #[inline(always)]
        fn minus(self, other: Self) -> Self {
            // SAFETY: the caller has tested for AVX2.
            #[allow(unsafe_code)]
            Self(unsafe { _mm256_subs_epu8(self.0, other.0) })
        }

        #[inline(always)]
        fn any(self) -> bool {
            // SAFETY: the caller has tested for AVX2.
            #[allow(unsafe_code)]
            unsafe {
                _mm256_testz_si256(self.0, self.0) == 0
            }
        }
    }
}
