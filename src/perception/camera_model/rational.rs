//! The `rational_polynomial` lens of ROS, OpenCV's model of eight coefficients, and its derivative, in normalized coordinates.

use super::Distortion;
use super::roots::first_not_positive;
use nalgebra::{Matrix2, Vector2};

/// As [`Distortion`], with the radial part divided by `1 + k4 r^2 + k5 r^4 + k6 r^6`: for lenses too wide for a polynomial.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RationalPolynomial {
    /// Factor of r^2 above the line.
    pub k1: f64,
    /// Factor of r^4 above the line.
    pub k2: f64,
    /// First tangential factor.
    pub p1: f64,
    /// Second tangential factor.
    pub p2: f64,
    /// Factor of r^6 above the line.
    pub k3: f64,
    /// Factor of r^2 below the line.
    pub k4: f64,
    /// Factor of r^4 below the line.
    pub k5: f64,
    /// Factor of r^6 below the line.
    pub k6: f64,
}

impl RationalPolynomial {
    /// The radial factor, and its derivative by r^2.
    #[inline]
    fn radial(&self, r2: f64) -> (f64, f64) {
        let above = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        let below = 1.0 + r2 * (self.k4 + r2 * (self.k5 + r2 * self.k6));
        let above_slope = self.k1 + r2 * (2.0 * self.k2 + r2 * 3.0 * self.k3);
        let below_slope = self.k4 + r2 * (2.0 * self.k5 + r2 * 3.0 * self.k6);
        let factor = above / below;
        (factor, (above_slope - factor * below_slope) / below)
    }

    /// The tangential part alone is that of the plumb-bob lens.
    #[inline]
    fn tangential(&self) -> Distortion {
        Distortion { p1: self.p1, p2: self.p2, ..Distortion::default() }
    }

    /// Distorted normalized coordinates of `s`.
    #[must_use]
    #[inline]
    pub fn apply(&self, s: &Vector2<f64>) -> Vector2<f64> {
        let (factor, _) = self.radial(s.norm_squared());
        s * (factor - 1.0) + self.tangential().apply(s)
    }

    /// Derivative of [`Self::apply`] with respect to `s`.
    #[must_use]
    #[inline]
    pub fn jacobian(&self, s: &Vector2<f64>) -> Matrix2<f64> {
        let (factor, slope) = self.radial(s.norm_squared());
        Matrix2::identity() * (factor - 1.0)
            + s * s.transpose() * (2.0 * slope)
            + self.tangential().jacobian(s)
    }

    /// Derivative of [`Self::apply`] with respect to each coefficient, in the order k1 k2 p1 p2 k3 k4 k5 k6.
    #[must_use]
    #[inline]
    pub fn by_coefficients(&self, s: &Vector2<f64>) -> [Vector2<f64>; 8] {
        let r2 = s.norm_squared();
        let inverse = 1.0 / (1.0 + r2 * (self.k4 + r2 * (self.k5 + r2 * self.k6)));
        let [a1, a2, p1, p2, a3] = Distortion::by_coefficients(s).map(|column| column * inverse);
        let factor = -self.radial(r2).0;
        let below = 1.0 / inverse;
        [a1, a2, p1 * below, p2 * below, a3, a1 * factor, a2 * factor, a3 * factor]
    }

    /// Distorted radius of the radial part alone.
    pub(super) fn radius(&self, r: f64) -> f64 {
        r * self.radial(r * r).0
    }

    /// Derivative of [`Self::radius`].
    pub(super) fn radius_slope(&self, r: f64) -> f64 {
        let (factor, slope) = self.radial(r * r);
        factor + 2.0 * r * r * slope
    }

    /// The first radius at which the radial part stops growing, or has its pole; or infinity. With N above and D below the line
    /// and t = r^2 the slope is (N D + 2 t (N' D - N D')) / D^2.
    pub(super) fn fold_radius(&self) -> f64 {
        let above = [1.0, self.k1, self.k2, self.k3];
        let below = [1.0, self.k4, self.k5, self.k6];
        let mut slope = [0.0; 7];
        for (i, (a, n)) in (0..).zip(above.iter().zip(0i32..)) {
            for (j, (b, m)) in (0..).zip(below.iter().zip(0i32..)) {
                if let Some(sum) = slope.get_mut(i + j) {
                    *sum += a * b * f64::from(1 + 2 * (n - m));
                }
            }
        }
        let first = [first_not_positive(&slope), first_not_positive(&below)];
        first.into_iter().flatten().fold(f64::INFINITY, |least, t| t.sqrt().min(least))
    }
}
