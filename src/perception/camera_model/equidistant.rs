//! The `equidistant` lens of ROS, OpenCV's fisheye (Kannala and Brandt), and its derivative, in normalized coordinates.
//!
//! ```text
//! theta = atan r,  theta' = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8),  s' = s theta' / r,  r = |s|
//! ```

use super::roots::first_not_positive;
use nalgebra::{Matrix2, Vector2};

/// Largest angle from the axis at which neighbouring directions can be distinguished, 89 degrees: normalized coordinates end at 90, so that a degree
/// there is as long as all before.
const FARTHEST_RAD: f64 = 89.0 / 180.0 * std::f64::consts::PI;
/// Below this r^2 two terms of the series of atan are exact, since the third, r^4 / 5, is 2e-17 there.
const NEAR: f64 = 1e-8;

/// The angle from the axis becomes a distance from the image's centre, by an odd polynomial.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Equidistant {
    /// Factor of theta^2.
    pub k1: f64,
    /// Factor of theta^4.
    pub k2: f64,
    /// Factor of theta^6.
    pub k3: f64,
    /// Factor of theta^8.
    pub k4: f64,
}

impl Equidistant {
    /// Distorted radius of the angle `theta`.
    #[inline]
    fn distance(&self, theta: f64) -> f64 {
        let t = theta * theta;
        theta * (1.0 + t * (self.k1 + t * (self.k2 + t * (self.k3 + t * self.k4))))
    }

    /// Derivative of [`Self::distance`].
    #[inline]
    fn distance_slope(&self, theta: f64) -> f64 {
        let t = theta * theta;
        1.0 + t * (3.0 * self.k1 + t * (5.0 * self.k2 + t * (7.0 * self.k3 + t * 9.0 * self.k4)))
    }

    /// Distorted normalized coordinates of `s`.
    #[must_use]
    #[inline]
    pub fn apply(&self, s: &Vector2<f64>) -> Vector2<f64> {
        s * self.scale(s.norm_squared()).0
    }

    /// The factor on `s`, and twice its derivative by r^2.
    #[inline]
    fn scale(&self, r2: f64) -> (f64, f64) {
        if r2 < NEAR {
            let first = self.k1 - 1.0 / 3.0;
            return (1.0 + first * r2, 2.0 * first);
        }
        let r = r2.sqrt();
        let theta = r.atan();
        let scale = self.distance(theta) / r;
        (scale, (self.distance_slope(theta) / (1.0 + r2) - scale) / r2)
    }

    /// Derivative of [`Self::apply`] with respect to `s`.
    #[must_use]
    #[inline]
    pub fn jacobian(&self, s: &Vector2<f64>) -> Matrix2<f64> {
        let (scale, slope) = self.scale(s.norm_squared());
        Matrix2::identity() * scale + s * s.transpose() * slope
    }

    /// Derivative of [`Self::apply`] with respect to each coefficient, in the order k1 k2 k3 k4.
    #[must_use]
    #[inline]
    pub fn by_coefficients(s: &Vector2<f64>) -> [Vector2<f64>; 4] {
        let r2 = s.norm_squared();
        if r2 < NEAR {
            return [s * r2, s * (r2 * r2), s * (r2 * r2 * r2), s * (r2 * r2 * r2 * r2)];
        }
        let r = r2.sqrt();
        let theta = r.atan();
        let t = theta * theta;
        let first = s * (theta * t / r);
        [first, first * t, first * (t * t), first * (t * t * t)]
    }

    /// Distorted radius of `r`.
    pub(super) fn radius(&self, r: f64) -> f64 {
        self.distance(r.atan())
    }

    /// How far pixels are apart for the angle between them: the slope that must not vanish. The slope by `r` itself does, where the
    /// view nears a right angle.
    pub(super) fn slope_by_angle(&self, r: f64) -> f64 {
        self.distance_slope(r.atan())
    }

    /// The first radius at which the distance stops growing, at most that of 89 degrees.
    pub(super) fn fold_radius(&self) -> f64 {
        let slope = [1.0, 3.0 * self.k1, 5.0 * self.k2, 7.0 * self.k3, 9.0 * self.k4];
        let fold = first_not_positive(&slope).map_or(f64::INFINITY, f64::sqrt);
        fold.min(FARTHEST_RAD).tan()
    }

    /// The direction whose distorted one is `d`, and by how much it fails. The angle is found by Newton's method between
    /// bounds, for the distance grows with it up to the fold.
    pub(super) fn undistort(&self, d: &Vector2<f64>, fold_radius: f64) -> (Vector2<f64>, f64) {
        let wanted = d.norm();
        let (mut low, mut high) = (0.0, fold_radius.atan());
        let mut theta = wanted.min(high);
        for _ in 0..60 {
            let rest = self.distance(theta) - wanted;
            if rest > 0.0 {
                high = theta
            } else {
                low = theta
            }
            let next = theta - rest / self.distance_slope(theta);
            let next = if next >= low && next <= high { next } else { 0.5 * (low + high) };
            // (less than the last digit of any angle that matters to a pixel, so that rounding alone ends it)
            let done = (next - theta).abs() < 1e-16;
            theta = next;
            if done {
                break;
            }
        }
        let s = if wanted * wanted < NEAR { *d } else { d * (theta.tan() / wanted) };
        // so near the axis the series gives the rest
        let s = if wanted * wanted < NEAR { s / self.scale(wanted * wanted).0 } else { s };
        (s, (self.apply(&s) - d).norm())
    }
}
