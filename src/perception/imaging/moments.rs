//! Moments of a region: sums from pixels, runs or borders, and what does not depend on where the region lies.
//!
//! ```text
//! m_ij  = sum of I(x, y) x^i y^j over the region, I = 1 for a binary image     (10.1), before it with I
//! x_c   = m10 / m00,  y_c = m01 / m00                                          centroid
//! mu_ij = sum of I(x, y) (x - x_c)^i (y - y_c)^j                               central moments
//! ```
//! [`MomentSums`] are exact integers, so that the ways to them agree to the last bit; [`Moments`] are centroid and central moments.
//! By Green's theorem a sum over a region is one over its border. In its discrete form, with `S_i(x)` the sum of `k^i` for
//! `k < x`, a row's part of the region is `S_i(x1) - S_i(x0)`, so only the vertical pixel sides of the outline count:
//!
//! ```text
//! m_ij = sum over the outline's right sides of S_i(x) y^j - sum over its left sides of S_i(x) y^j
//! ```
//!
//! Pixels are points at integer coordinates, px.

mod border;
mod central;
mod grey;
mod power_sums;

pub use central::{Moments, PrincipalMoments};
pub(super) use power_sums::power_sums;

use super::Run;
use std::ops::{AddAssign, SubAssign};

/// Sums `m_ij` to third order: exact, so that regions can be put together and holes taken out. Exact for images of up to 2^20
/// columns and rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct MomentSums {
    /// Area, px^2, or sum of levels.
    pub m00: i128,
    /// Sum of `x`.
    pub m10: i128,
    /// Sum of `y`.
    pub m01: i128,
    /// Sum of `x^2`.
    pub m20: i128,
    /// Sum of `x y`.
    pub m11: i128,
    /// Sum of `y^2`.
    pub m02: i128,
    /// Sum of `x^3`.
    pub m30: i128,
    /// Sum of `x^2 y`.
    pub m21: i128,
    /// Sum of `x y^2`.
    pub m12: i128,
    /// Sum of `y^3`.
    pub m03: i128,
}

impl MomentSums {
    /// Sums over the pixels of one run, each of weight one.
    #[must_use]
    pub fn of_run(run: &Run) -> Self {
        let (n, s1, s2, s3) = power_sums(run.x0, run.x1);
        Self::of_row([n.into(), s1.into(), s2.into(), s3 as i128], i64::from(run.y))
    }

    /// Sums over the pixels of row `y` with the given sums of `1, x, x^2, x^3`.
    #[inline]
    fn of_row([n, s1, s2, s3]: [i128; 4], y: i64) -> Self {
        let y = i128::from(y);
        Self {
            m00: n,
            m10: s1,
            m01: n.wrapping_mul(y),
            m20: s2,
            m11: s1.wrapping_mul(y),
            m02: n.wrapping_mul(y * y),
            m30: s3,
            m21: s2.wrapping_mul(y),
            m12: s1.wrapping_mul(y * y),
            m03: n.wrapping_mul(y * y * y),
        }
    }

    /// All sums times a factor: the sums for levels `255 - I` are `binary.times(255)` less those for `I`.
    #[must_use]
    pub fn times(mut self, factor: i64) -> Self {
        for m in self.each_mut() {
            *m = m.wrapping_mul(factor.into());
        }
        self
    }

    /// Sums of the region moved by `(dx, dy)` px.
    #[must_use]
    pub fn shifted(&self, dx: i64, dy: i64) -> Self {
        let Self { m00, m10, m01, m20, m11, m02, m30, m21, m12, m03 } = *self;
        let (u, v) = (i128::from(dx), i128::from(dy));
        // wrong beyond the range that the type states, but never a panic
        let mul = |a: i128, b: i128| a.wrapping_mul(b);
        let sum = |terms: &[i128]| terms.iter().fold(0_i128, |s, t| s.wrapping_add(*t));
        let (uu, uv, vv) = (u * u, u * v, v * v);
        Self {
            m00,
            m10: sum(&[m10, mul(u, m00)]),
            m01: sum(&[m01, mul(v, m00)]),
            m20: sum(&[m20, mul(2 * u, m10), mul(uu, m00)]),
            m11: sum(&[m11, mul(u, m01), mul(v, m10), mul(uv, m00)]),
            m02: sum(&[m02, mul(2 * v, m01), mul(vv, m00)]),
            m30: sum(&[m30, mul(3 * u, m20), mul(mul(3, uu), m10), mul(mul(uu, u), m00)]),
            m21: sum(&[
                m21,
                mul(v, m20),
                mul(2 * u, m11),
                mul(mul(2, uv), m10),
                mul(uu, m01),
                mul(mul(uu, v), m00),
            ]),
            m12: sum(&[
                m12,
                mul(u, m02),
                mul(2 * v, m11),
                mul(mul(2, uv), m01),
                mul(vv, m10),
                mul(mul(u, vv), m00),
            ]),
            m03: sum(&[m03, mul(3 * v, m02), mul(mul(3, vv), m01), mul(mul(vv, v), m00)]),
        }
    }

    /// Centroid and central moments. `None` without area (or mass): nothing, or more taken out than there was.
    #[must_use]
    pub fn central(&self) -> Option<Moments> {
        if self.m00 <= 0 {
            return None;
        }
        // to whole pixels in integers, so that what remains for floating point is small
        let origin = |m: i128| i64::try_from(m.div_euclid(self.m00)).ok();
        let (x, y) = (origin(self.m10)?, origin(self.m01)?);
        let near = self.shifted(x.checked_neg()?, y.checked_neg()?);
        let raw = Moments {
            m00: near.m00 as f64,
            x: x as f64,
            y: y as f64,
            mu20: near.m20 as f64,
            mu11: near.m11 as f64,
            mu02: near.m02 as f64,
            mu30: near.m30 as f64,
            mu21: near.m21 as f64,
            mu12: near.m12 as f64,
            mu03: near.m03 as f64,
        };
        Some(raw.centred(near.m10 as f64, near.m01 as f64))
    }

    fn each_mut(&mut self) -> [&mut i128; 10] {
        let Self { m00, m10, m01, m20, m11, m02, m30, m21, m12, m03 } = self;
        [m00, m10, m01, m20, m11, m02, m30, m21, m12, m03]
    }
}

impl AddAssign for MomentSums {
    #[inline]
    fn add_assign(&mut self, mut other: Self) {
        for (a, b) in self.each_mut().into_iter().zip(other.each_mut()) {
            *a = a.wrapping_add(*b);
        }
    }
}

impl SubAssign for MomentSums {
    #[inline]
    fn sub_assign(&mut self, mut other: Self) {
        for (a, b) in self.each_mut().into_iter().zip(other.each_mut()) {
            *a = a.wrapping_sub(*b);
        }
    }
}

#[cfg(test)]
mod tests;
