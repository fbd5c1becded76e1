//! The `plumb_bob` distortion polynomial and its derivative, in normalized coordinates.

use super::roots::first_not_positive;
use nalgebra::{Matrix2, Vector2};

/// Radial (`k1`, `k2`, `k3`) and tangential (`p1`, `p2`) lens distortion of ROS and OpenCV; no units.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Distortion {
    /// Factor of r^2.
    pub k1: f64,
    /// Factor of r^4.
    pub k2: f64,
    /// First tangential factor.
    pub p1: f64,
    /// Second tangential factor.
    pub p2: f64,
    /// Factor of r^6.
    pub k3: f64,
}

impl Distortion {
    /// Whether the lens is an ideal one.
    #[must_use]
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Distorted normalized coordinates of `s`.
    #[must_use]
    #[inline]
    pub fn apply(&self, s: &Vector2<f64>) -> Vector2<f64> {
        let (x, y) = (s.x, s.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        Vector2::new(
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        )
    }

    /// Derivative of [`Self::apply`] with respect to `s`.
    #[must_use]
    #[inline]
    pub fn jacobian(&self, s: &Vector2<f64>) -> Matrix2<f64> {
        let (x, y) = (s.x, s.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        // d radial / d(r^2), times 2: the chain rule brings 2x or 2y
        let slope = 2.0 * (self.k1 + r2 * (2.0 * self.k2 + r2 * 3.0 * self.k3));
        let mixed = x * y * slope + 2.0 * (self.p1 * x + self.p2 * y);
        Matrix2::new(
            radial + x * x * slope + 2.0 * self.p1 * y + 6.0 * self.p2 * x,
            mixed,
            mixed,
            radial + y * y * slope + 6.0 * self.p1 * y + 2.0 * self.p2 * x,
        )
    }

    /// Derivative of [`Self::apply`] with respect to each coefficient, in the order k1 k2 p1 p2 k3.
    #[must_use]
    #[inline]
    pub fn by_coefficients(s: &Vector2<f64>) -> [Vector2<f64>; 5] {
        let r2 = s.norm_squared();
        let (mixed, twice) = (2.0 * s.x * s.y, s.component_mul(s) * 2.0);
        let second = s * (r2 * r2);
        [s * r2, second, Vector2::new(mixed, r2 + twice.y), Vector2::new(r2 + twice.x, mixed), second * r2]
    }

    /// Distorted radius of the radial part alone.
    pub(super) fn radius(&self, r: f64) -> f64 {
        let r2 = r * r;
        r * (1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3)))
    }

    /// Derivative of [`Self::radius`].
    pub(super) fn radius_slope(&self, r: f64) -> f64 {
        let r2 = r * r;
        1.0 + r2 * (3.0 * self.k1 + r2 * (5.0 * self.k2 + r2 * 7.0 * self.k3))
    }

    /// The first radius at which the radial part stops growing, or infinity.
    pub(super) fn fold_radius(&self) -> f64 {
        let slope = [1.0, 3.0 * self.k1, 5.0 * self.k2, 7.0 * self.k3];
        first_not_positive(&slope).map_or(f64::INFINITY, f64::sqrt)
    }
}
