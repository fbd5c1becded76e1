//! Eight single-precision numbers side by side, written so that compilers make vectors of them; and the error function on them.

use std::array::from_fn;
use std::ops::{Add, Mul, Neg, Sub};

/// Eight numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
#[repr(align(32))]
pub(crate) struct Eight(pub(crate) [f32; 8]);

impl Eight {
    /// All zero; eight, since a register of AVX holds as many.
    pub(crate) const ZERO: Self = Self([0.0; 8]);

    /// Of each number.
    #[inline(always)]
    pub(crate) fn each(self, operation: impl Fn(f32) -> f32) -> Self {
        let mut out = self.0;
        out.iter_mut().for_each(|a| *a = operation(*a));
        Self(out)
    }

    /// Of each number and its counterpart.
    #[inline(always)]
    #[allow(clippy::indexing_slicing)] // 0..8 of eight
    pub(crate) fn with(self, other: Self, operation: impl Fn(f32, f32) -> f32) -> Self {
        Self(from_fn(|i| operation(self.0[i], other.0[i])))
    }

    #[inline(always)]
    pub(crate) fn sum(self) -> f32 {
        let [a, b, c, d, e, f, g, h] = self.0;
        ((a + e) + (c + g)) + ((b + f) + (d + h))
    }

    /// `e^x` for `x <= 0`, within 2e-7; below `-40 ln 2` = -27 about 2^-40 = 1e-12, so that products of several do not become subnormal, which costs
    /// processors a hundredfold.
    #[inline(always)]
    fn exp_of_negative(self) -> Self {
        // otherwise products of several would become subnormal, see above
        self.each(|x| (x * std::f32::consts::LOG2_E).max(-40.0)).two_to()
    }

    /// `2^t` for `t` from -100 to 100, within 2e-7 of it.
    #[inline(always)]
    pub(crate) fn two_to(self) -> Self {
        // 2^t with t = whole + part. Adding 1.5 * 2^23 rounds to the nearest whole number, because a float of that size has no fraction bits
        const MAGIC: f32 = 12_582_912.0;
        self.each(|t| {
            let shifted = t + MAGIC;
            let part = t - (shifted - MAGIC);
            let p = 1.535_336_2e-4;
            let p = p * part + 1.339_887_4e-3;
            let p = p * part + 9.618_437e-3;
            let p = p * part + 5.550_332_5e-2;
            let p = p * part + 2.402_264_8e-1;
            let p = p * part + 6.931_472e-1;
            let p = p * part + 1.0;
            p * f32::from_bits((shifted.to_bits() << 23).wrapping_add(0x3f80_0000))
        })
    }

    /// Logarithms to the base 2 of normal positive numbers, within 3e-7 or that share of them.
    #[inline(always)]
    pub(crate) fn log2(self) -> Self {
        // chosen so that the mantissa lies about 1, where the series is shortest: the bits of the square root of 1/2
        const LEAST: u32 = 0x3f35_04f3;
        self.each(|x| {
            let whole = (x.to_bits().wrapping_sub(LEAST) as i32) >> 23;
            let mantissa = f32::from_bits(x.to_bits().wrapping_sub((whole as u32) << 23));
            // ln m = 2 artanh s, of which the series ends where the next term is below a rounding
            let s = (mantissa - 1.0) / (mantissa + 1.0);
            let square = s * s;
            let series = ((square * (1.0 / 7.0) + 0.2) * square + (1.0 / 3.0)) * square + 1.0;
            whole as f32 + 2.0 * std::f32::consts::LOG2_E * s * series
        })
    }

    /// `erf(z / sqrt(2))`, the share of a normal deviate within `z` deviations less the share outside on that side, within 1e-6;
    /// and its derivative by `z`.
    #[inline(always)]
    pub(crate) fn step_and_slope(self) -> (Self, Self) {
        let x = self.each(|z| z.abs() * std::f32::consts::FRAC_1_SQRT_2);
        let e = (-(x * x)).exp_of_negative();
        // Abramowitz and Stegun 7.1.26
        let t = x.each(|x| 1.0 / (1.0 + 0.327_591_1 * x));
        let p = t.each(|t| {
            ((((1.061_405_4 * t - 1.453_152) * t + 1.421_413_7) * t - 0.284_496_74) * t + 0.254_829_6) * t
        });
        let size = p.with(e, |p, e| 1.0 - p * e);
        let step = size.with(self, f32::copysign);
        (step, e.each(|e| 0.797_884_6 * e))
    }
}

impl Add for Eight {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.with(other, |a, b| a + b)
    }
}

impl Sub for Eight {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.with(other, |a, b| a - b)
    }
}

impl Mul for Eight {
    type Output = Self;
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.with(other, |a, b| a * b)
    }
}

impl Mul<f32> for Eight {
    type Output = Self;
    #[inline(always)]
    fn mul(self, factor: f32) -> Self {
        self.each(|a| a * factor)
    }
}

impl Add<f32> for Eight {
    type Output = Self;
    #[inline(always)]
    fn add(self, summand: f32) -> Self {
        self.each(|a| a + summand)
    }
}

impl Neg for Eight {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.each(|a| -a)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_and_logarithms_of_two_are_exact() {
        for i in 0..20_000 {
            let t = f64::from(i) * 1e-2 - 100.0;
            let power = f64::from(Eight([t as f32; 8]).two_to().0[2]);
            // of the argument's own rounding the power has ln 2 times as much
            let exact = f64::from(t as f32).exp2();
            assert!((power / exact - 1.0).abs() < 4e-7, "{t}");
            let x = (0.5 * t).exp2() as f32;
            let off = f64::from(Eight([x; 8]).log2().0[6]) - f64::from(x).log2();
            assert!(off.abs() < 3e-7 * f64::from(x).log2().abs().max(1.0), "{x}: {off}");
        }
    }

    #[test]
    fn step_is_the_integral_of_its_slope() {
        // Simpson's rule over the exact density, in double precision
        let density = |z: f64| (-0.5 * z * z).exp() * (2.0 / std::f64::consts::PI).sqrt();
        let (mut integral, h) = (0.0, 0.005);
        for i in 0..1600 {
            let z = f64::from(i) * h;
            let (step, slope) = Eight([z as f32; 8]).step_and_slope();
            let (back, _) = Eight([-z as f32; 8]).step_and_slope();
            assert!((f64::from(step.0[3]) - integral).abs() < 1.5e-6, "{z}");
            assert!((f64::from(slope.0[5]) - density(z)).abs() < 1e-6, "{z}");
            assert_eq!(back.0[0], -step.0[0]);
            integral += h / 6.0 * (density(z) + 4.0 * density(z + 0.5 * h) + density(z + h));
        }
        let (step, slope) = Eight([f32::MAX, 1e3, -1e3, 50.0, -50.0, 9.0, 8.0, -9.0]).step_and_slope();
        assert!(step.0.iter().all(|s| s.abs() == 1.0) && slope.0.iter().all(|s| *s >= 0.0 && *s < 1e-6));
    }
}
