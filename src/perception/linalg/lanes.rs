//! Numbers that formulas are written for once: f64, and two f64 side by side, SSE2 on x86-64 (part of its baseline), a
//! plain array elsewhere.
//!
//! Both kinds of lanes do the same IEEE operations in the same order, hence give the same bits.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// What formulas compute with: f64, or lanes of them.
pub(crate) trait Number:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> + Neg<Output = Self>
{
    /// The same value in all lanes.
    fn splat(x: f64) -> Self;
}

impl Number for f64 {
    #[inline(always)]
    fn splat(x: f64) -> Self {
        x
    }
}

/// Two numbers, with arithmetic lane by lane.
pub(crate) trait Lanes: Number {
    /// From the two lanes.
    fn new(a: f64, b: f64) -> Self;
    /// The two lanes.
    fn get(self) -> [f64; 2];
    /// Sum of the two lanes.
    #[inline(always)]
    fn sum(self) -> f64 {
        let [a, b] = self.get();
        a + b
    }
}

/// The lanes without processor-specific instructions.
#[derive(Debug, Clone, Copy)]
#[cfg_attr(all(target_arch = "x86_64", not(test)), allow(dead_code))]
pub(crate) struct Portable([f64; 2]);

impl Lanes for Portable {
    #[inline(always)]
    fn new(a: f64, b: f64) -> Self {
        Self([a, b])
    }
    #[inline(always)]
    fn get(self) -> [f64; 2] {
        self.0
    }
}

macro_rules! operator {
    ($type:ty, $trait:ident, $method:ident, |$a:ident, $b:ident| $body:expr) => {
        impl $trait for $type {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                let ($a, $b) = (self.0, other.0);
                Self($body)
            }
        }
    };
}

operator!(Portable, Add, add, |a, b| [a[0] + b[0], a[1] + b[1]]);
operator!(Portable, Sub, sub, |a, b| [a[0] - b[0], a[1] - b[1]]);
operator!(Portable, Mul, mul, |a, b| [a[0] * b[0], a[1] * b[1]]);
operator!(Portable, Div, div, |a, b| [a[0] / b[0], a[1] / b[1]]);

impl Neg for Portable {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self(self.0.map(|x| -x))
    }
}

impl Number for Portable {
    #[inline(always)]
    fn splat(x: f64) -> Self {
        Self([x; 2])
    }
}

// SAFETY of all blocks in this module: the intrinsics ask for SSE2 alone, which every x86-64 processor has, and touch
// registers only.
#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)]
mod sse2 {
    use super::{Add, Div, Lanes, Mul, Neg, Number, Sub};
    use std::arch::x86_64::{
        __m128d, _mm_add_pd, _mm_cvtsd_f64, _mm_div_pd, _mm_mul_pd, _mm_set_pd, _mm_set1_pd, _mm_sub_pd,
        _mm_unpackhi_pd, _mm_xor_pd,
    };

    /// The lanes in one SSE2 register.
    #[derive(Debug, Clone, Copy)]
    pub(crate) struct Sse2(__m128d);

    impl Lanes for Sse2 {
        #[inline(always)]
        fn new(a: f64, b: f64) -> Self {
            // SAFETY: SSE2, see above.
            Self(unsafe { _mm_set_pd(b, a) })
        }
        #[inline(always)]
        fn get(self) -> [f64; 2] {
            // SAFETY: SSE2, see above.
            unsafe { [_mm_cvtsd_f64(self.0), _mm_cvtsd_f64(_mm_unpackhi_pd(self.0, self.0))] }
        }
    }

    // SAFETY: SSE2, see above.
    operator!(Sse2, Add, add, |a, b| unsafe { _mm_add_pd(a, b) });
    operator!(Sse2, Sub, sub, |a, b| unsafe { _mm_sub_pd(a, b) });
    operator!(Sse2, Mul, mul, |a, b| unsafe { _mm_mul_pd(a, b) });
    operator!(Sse2, Div, div, |a, b| unsafe { _mm_div_pd(a, b) });

    impl Neg for Sse2 {
        type Output = Self;
        #[inline(always)]
        fn neg(self) -> Self {
            // SAFETY: SSE2, see above.
            Self(unsafe { _mm_xor_pd(self.0, _mm_set1_pd(-0.0)) })
        }
    }

    impl Number for Sse2 {
        #[inline(always)]
        fn splat(x: f64) -> Self {
            // SAFETY: SSE2, see above.
            Self(unsafe { _mm_set1_pd(x) })
        }
    }
}

/// The fastest lanes that every processor of this architecture has.
#[cfg(not(target_arch = "x86_64"))]
pub(crate) use Portable as F2;
/// The fastest lanes that every processor of this architecture has.
#[cfg(target_arch = "x86_64")]
pub(crate) use sse2::Sse2 as F2;

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn native_and_portable_agree_to_the_bit(x in prop::array::uniform4(-1e3..1e3f64)) {
            fn all<L: Lanes>(x: [f64; 4]) -> [[u64; 2]; 5] {
                let (a, b) = (L::new(x[0], x[1]), L::new(x[2], x[3]));
                [a + b, a - b, a * b, a / b, -a].map(|l| l.get().map(f64::to_bits))
            }
            prop_assert_eq!(all::<F2>(x), all::<Portable>(x));
            prop_assert_eq!(F2::new(x[0], x[1]).sum(), x[0] + x[1]);
            prop_assert_eq!(F2::splat(x[0]).get(), [x[0]; 2]);
        }
    }
}
