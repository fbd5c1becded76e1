//! Eight whole numbers of 16 bits side by side: SSE2 on x86-64 (part of its baseline), a plain array elsewhere. Both give the same bits.

/// Eight numbers, without processor-specific instructions.
#[derive(Debug, Clone, Copy)]
#[cfg_attr(all(target_arch = "x86_64", not(test)), allow(dead_code))]
pub(crate) struct PortableWords([i16; 8]);

#[cfg_attr(all(target_arch = "x86_64", not(test)), allow(dead_code))]
impl PortableWords {
    /// All zero: eight, since a register of 128 bits holds as many.
    pub(crate) const ZERO: Self = Self([0; 8]);

    /// From unsigned bytes.
    #[inline(always)]
    pub(crate) fn from_bytes(bytes: [u8; 8]) -> Self {
        Self(bytes.map(i16::from))
    }

    /// Sum of each and its counterpart, which has to fit.
    #[inline(always)]
    pub(crate) fn plus(mut self, other: Self) -> Self {
        self.0.iter_mut().zip(other.0).for_each(|(a, b)| *a = a.wrapping_add(b));
        self
    }

    /// Each less its counterpart, which has to fit.
    #[inline(always)]
    pub(crate) fn minus(mut self, other: Self) -> Self {
        self.0.iter_mut().zip(other.0).for_each(|(a, b)| *a = a.wrapping_sub(b));
        self
    }

    /// Amount of each, which has to fit.
    #[inline(always)]
    pub(crate) fn abs(self) -> Self {
        Self(self.0.map(i16::wrapping_abs))
    }

    /// Whether any is more than `least`.
    #[inline(always)]
    pub(crate) fn any_above(self, least: i16) -> bool {
        self.0.iter().any(|word| *word > least)
    }

    /// One after the other.
    #[inline(always)]
    pub(crate) fn to_array(self) -> [i16; 8] {
        self.0
    }
}

#[cfg(not(target_arch = "x86_64"))]
pub(crate) use PortableWords as EightWords;

#[cfg(target_arch = "x86_64")]
pub(crate) use x86::EightWords;

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::{
        __m128i, _mm_add_epi16, _mm_cmpgt_epi16, _mm_cvtsi64_si128, _mm_cvtsi128_si64, _mm_max_epi16,
        _mm_movemask_epi8, _mm_set1_epi16, _mm_sub_epi16, _mm_unpackhi_epi64, _mm_unpacklo_epi8,
    };

    /// Eight numbers.
    #[derive(Debug, Clone, Copy)]
    pub(crate) struct EightWords(__m128i);

    impl EightWords {
        /// All zero: eight, since a register of 128 bits holds as many.
        // SAFETY: any bits are whole numbers.
        #[allow(unsafe_code)]
        pub(crate) const ZERO: Self = Self(unsafe { std::mem::transmute::<[u8; 16], __m128i>([0; 16]) });

        /// From unsigned bytes.
        #[inline(always)]
        pub(crate) fn from_bytes(bytes: [u8; 8]) -> Self {
            // SAFETY: SSE2 belongs to the x86-64 baseline.
            #[allow(unsafe_code)]
            Self(unsafe { _mm_unpacklo_epi8(_mm_cvtsi64_si128(i64::from_le_bytes(bytes)), Self::ZERO.0) })
        }

        /// Sum of each and its counterpart, which has to fit.
        #[inline(always)]
        pub(crate) fn plus(self, other: Self) -> Self {
            // SAFETY: SSE2 belongs to the x86-64 baseline.
            #[allow(unsafe_code)]
            Self(unsafe { _mm_add_epi16(self.0, other.0) })
        }

        /// Each less its counterpart, which has to fit.
        #[inline(always)]
        pub(crate) fn minus(self, other: Self) -> Self {
            // SAFETY: SSE2 belongs to the x86-64 baseline.
            #[allow(unsafe_code)]
            Self(unsafe { _mm_sub_epi16(self.0, other.0) })
        }

        /// Amount of each, which has to fit.
        #[inline(always)]
        pub(crate) fn abs(self) -> Self {
            // SAFETY: SSE2 belongs to the x86-64 baseline.
            #[allow(unsafe_code)]
            Self(unsafe { _mm_max_epi16(self.0, _mm_sub_epi16(Self::ZERO.0, self.0)) })
        }

        /// Whether any is more than `least`.
        #[inline(always)]
        pub(crate) fn any_above(self, least: i16) -> bool {
            // SAFETY: SSE2 belongs to the x86-64 baseline.
            #[allow(unsafe_code)]
            unsafe {
                _mm_movemask_epi8(_mm_cmpgt_epi16(self.0, _mm_set1_epi16(least))) != 0
            }
        }

        /// One after the other.
        #[inline(always)]
        pub(crate) fn to_array(self) -> [i16; 8] {
            // SAFETY: SSE2 belongs to the x86-64 baseline.
            #[allow(unsafe_code)]
            let halves =
                unsafe { [_mm_cvtsi128_si64(self.0), _mm_cvtsi128_si64(_mm_unpackhi_epi64(self.0, self.0))] };
            let [[a, b, c, d], [e, f, g, h]] = halves.map(|half| [half, half >> 16, half >> 32, half >> 48]);
            [a, b, c, d, e, f, g, h].map(|word| word as i16)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{EightWords, PortableWords};

    macro_rules! check {
        ($Words:ty) => {
            let (a, b) = ([0, 1, 2, 127, 128, 200, 254, 255], [255, 254, 1, 128, 128, 7, 0, 255]);
            let of = |f: fn(i16, i16) -> i16| {
                let mut out = [0; 8];
                (0..8).for_each(|i| out[i] = f(i16::from(a[i]), i16::from(b[i])));
                out
            };
            let (p, q) = (<$Words>::from_bytes(a), <$Words>::from_bytes(b));
            assert_eq!(p.plus(q).to_array(), of(|a, b| a + b));
            assert_eq!(p.minus(q).to_array(), of(|a, b| a - b));
            assert_eq!(p.minus(q).abs().to_array(), of(|a, b| (a - b).abs()));
            assert_eq!(<$Words>::ZERO.minus(p).to_array(), of(|a, _| -a));
            assert!(p.any_above(254) && !p.any_above(255) && p.minus(q).any_above(-1));
        };
    }

    #[test]
    fn words_are_those_of_arithmetic() {
        check!(EightWords);
        check!(PortableWords);
    }
}
