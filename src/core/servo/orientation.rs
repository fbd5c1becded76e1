//! Representations of an orientation error by three numbers, and the matrices that relate their rates to angular velocities (Sect. 10.7).
//!
//! For a rotation R of a frame 2 in a frame 1 with the angular velocity w of 2 relative to 1 expressed in 1:
//! `w = T(phi) phi_dot`. Angles in rad.
//!
//! Position-based laws use phi as the orientation part of x~, the hybrid law as its orientation error.

use crate::features::euler_zyx_rate;
use crate::geometry::skew;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Least |cos| of the middle Euler angle, of the angle for `r sin`, and of half the angle for a quaternion, at which what relates rates and angular
/// velocity is inverted: the inverse grows as 1 / cos, so that a thousandth of the angular velocity, which no measurement has right, would be all
/// of the rate. 0.06 degrees from the singularity.
const GIMBAL_LOCK: f64 = 1e-3;
/// Angle, rad, below which the coefficients of a rotation vector's rate come from two terms of their series: there the third, at most
/// angle^4 / 720, is below the precision of a double, and the rounding of the closed forms, 1e-16 / angle^2, would be 1e-10.
const SMALL_ANGLE_RAD: f64 = 1e-3;

/// How an orientation error is written as three numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OrientationError {
    /// Angles about z, y and x of `R = Rz Ry Rx`, in this order, as in the text.
    EulerZyx,
    /// Angles about x, y and z of `R = Rx Ry Rz`, in this order: another of the twelve sets. Those that turn about one axis twice, as z, y, z, tell nothing near the goal.
    EulerXyz,
    /// Rotation vector: axis r times angle theta, up to half a turn.
    AngleAxis,
    /// `r sin(theta)`, (3.86): half the sum of the cross products of the axes. Below a quarter of a turn only, beyond which it shrinks again.
    RSin,
    /// `2 r sin(theta / 2)`: twice the vector part of the unit quaternion of Sect. 3.7.3, so that gains mean what they mean for the others.
    /// Below half a turn.
    Quaternion,
}

impl OrientationError {
    /// All of them.
    pub const ALL: [Self; 5] =
        [Self::EulerZyx, Self::EulerXyz, Self::AngleAxis, Self::RSin, Self::Quaternion];

    /// phi of the rotation `R`, rad.
    #[must_use]
    pub fn of(self, R: &Rotation3<f64>) -> Vector3<f64> {
        match self {
            Self::EulerZyx => euler_zyx(R),
            Self::EulerXyz => euler_xyz(R),
            Self::AngleAxis => UnitQuaternion::from_rotation_matrix(R).scaled_axis(),
            Self::RSin => {
                let m = R.matrix();
                Vector3::new(m.m32 - m.m23, m.m13 - m.m31, m.m21 - m.m12) * 0.5
            }
            Self::Quaternion => {
                let (_, epsilon) = quaternion(R);
                epsilon * 2.0
            }
        }
    }

    /// T with `w = T phi_dot`, for the rotation `R` whose error is `phi`. `None` where it does not exist: from a quarter of a turn on for `r sin`, at
    /// half a turn for a quaternion.
    #[must_use]
    pub fn rate(self, phi: &Vector3<f64>, R: &Rotation3<f64>) -> Option<Matrix3<f64>> {
        Some(match self {
            Self::EulerZyx => euler_zyx_rate(phi),
            Self::EulerXyz => {
                let ((sx, cx), (sy, cy)) = (phi.x.sin_cos(), phi.y.sin_cos());
                Matrix3::new(1.0, 0.0, sy, 0.0, cx, -sx * cy, 0.0, sx, cx * cy)
            }
            Self::AngleAxis => {
                let (angle2, S) = (phi.norm_squared(), skew(phi));
                let angle = angle2.sqrt();
                let (a, b) = if angle < SMALL_ANGLE_RAD {
                    (0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0)
                } else {
                    ((1.0 - angle.cos()) / angle2, (angle - angle.sin()) / (angle2 * angle))
                };
                Matrix3::identity() + S * a + S * S * b
            }
            Self::RSin => self.inverse_rate(phi, R)?.try_inverse()?,
            Self::Quaternion => {
                // (eta I - S)(eta^2 I + eta S + epsilon epsilon^T) = eta I, for a unit quaternion
                let (eta, epsilon) = quaternion(R);
                (eta >= GIMBAL_LOCK).then(|| {
                    Matrix3::identity() * eta + skew(&epsilon) + epsilon * epsilon.transpose() / eta
                })?
            }
        })
    }

    /// T^-1 with `phi_dot = T^-1 w`. `None` where the middle Euler angle is at +-pi/2, and from a quarter of a turn on for `r sin`.
    #[must_use]
    pub fn inverse_rate(self, phi: &Vector3<f64>, R: &Rotation3<f64>) -> Option<Matrix3<f64>> {
        match self {
            Self::EulerZyx => {
                let ((sz, cz), (sy, cy)) = (phi.x.sin_cos(), phi.y.sin_cos());
                (cy.abs() >= GIMBAL_LOCK).then(|| {
                    Matrix3::new(cz * sy / cy, sz * sy / cy, 1.0, -sz, cz, 0.0, cz / cy, sz / cy, 0.0)
                })
            }
            Self::EulerXyz => {
                let ((sx, cx), (sy, cy)) = (phi.x.sin_cos(), phi.y.sin_cos());
                (cy.abs() >= GIMBAL_LOCK).then(|| {
                    Matrix3::new(1.0, sy * sx / cy, -sy * cx / cy, 0.0, cx, sx, 0.0, -sx / cy, cx / cy)
                })
            }
            Self::AngleAxis => {
                let (angle2, S) = (phi.norm_squared(), skew(phi));
                let angle = angle2.sqrt();
                let b = if angle < SMALL_ANGLE_RAD {
                    1.0 / 12.0 + angle2 / 720.0
                } else {
                    (1.0 - 0.5 * angle / (0.5 * angle).tan()) / angle2
                };
                Some(Matrix3::identity() - S * 0.5 + S * S * b)
            }
            Self::RSin => {
                // of L in (3.91), for a frame 1 that does not turn; its smallest singular value is cos(theta)
                let trace = R.matrix().trace();
                let cos = 0.5 * (trace - 1.0);
                (cos >= GIMBAL_LOCK).then(|| (Matrix3::identity() * trace - R.matrix()) * 0.5)
            }
            Self::Quaternion => {
                let (eta, epsilon) = quaternion(R);
                Some(Matrix3::identity() * eta - skew(&epsilon))
            }
        }
    }
}

/// Scalar and vector part of the unit quaternion of `R`, the scalar part not negative.
fn quaternion(R: &Rotation3<f64>) -> (f64, Vector3<f64>) {
    let q = UnitQuaternion::from_rotation_matrix(R);
    let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
    (sign * q.w, Vector3::new(q.i, q.j, q.k) * sign)
}

/// The angles (about z, y, x) of `R = Rz Ry Rx`, rad; the middle one in [-pi/2, pi/2].
#[must_use]
pub fn euler_zyx(R: &Rotation3<f64>) -> Vector3<f64> {
    let m = R.matrix();
    Vector3::new(m.m21.atan2(m.m11), (-m.m31).atan2(m.m32.hypot(m.m33)), m.m32.atan2(m.m33))
}

/// The angles (about x, y, z) of `R = Rx Ry Rz`, rad; the middle one in [-pi/2, pi/2].
fn euler_xyz(R: &Rotation3<f64>) -> Vector3<f64> {
    let m = R.matrix();
    Vector3::new((-m.m23).atan2(m.m33), m.m13.atan2(m.m11.hypot(m.m12)), (-m.m12).atan2(m.m11))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pose::euler_zyx_rotation;
    use proptest::prelude::*;

    const ALL: [OrientationError; 5] = OrientationError::ALL;

    proptest! {
        #[test]
        fn euler_angles_come_back(z in -3.1..3.1f64, y in -1.5..1.5f64, x in -3.1..3.1f64) {
            let phi = Vector3::new(z, y, x);
            prop_assert!((euler_zyx(&euler_zyx_rotation(&phi)) - phi).norm() < 1e-9);
            let about = |axis, angle| Rotation3::from_axis_angle(&axis, angle);
            let R = about(Vector3::x_axis(), x) * about(Vector3::y_axis(), y) * about(Vector3::z_axis(), z);
            prop_assert!((euler_xyz(&R) - Vector3::new(x, y, z)).norm() < 1e-9);
        }

        #[test]
        fn rates_agree_with_finite_differences(
            axis in prop::array::uniform3(-1.2..1.2f64), w in prop::array::uniform3(-1.0..1.0f64)
        ) {
            let (R, w) = (Rotation3::from_scaled_axis(Vector3::from(axis)), Vector3::from(w));
            for kind in ALL {
                let phi = kind.of(&R);
                let is_euler = matches!(kind, OrientationError::EulerZyx | OrientationError::EulerXyz);
                if is_euler && phi.y.cos() < 0.1 { continue; }
                let h = 1e-6;
                let at = |t: f64| kind.of(&(Rotation3::from_scaled_axis(w * t) * R));
                let difference = (at(h) - at(-h)) / (2.0 * h);
                if difference.norm() > 100.0 { continue; } // a jump by 2 pi
                let Some(rate) = kind.inverse_rate(&phi, &R) else {
                    // only r sin ends here, and Euler angles have been left out
                    prop_assert!(kind == OrientationError::RSin && R.angle().cos() < 1e-3);
                    continue;
                };
                prop_assert!((rate * w - difference).norm() < 1e-5, "{kind:?} {} {}", rate * w, difference);
                let product = kind.rate(&phi, &R).unwrap() * rate;
                prop_assert!((product - Matrix3::identity()).norm() < 1e-9);
            }
        }
    }

    /// (3.86), (3.88): r sin(theta) is half the sum of the cross products of the axes of both frames, and the quaternion's error twice
    /// `r sin(theta / 2)`.
    #[test]
    fn they_are_those_of_the_text() {
        let r = Vector3::new(0.6, -0.48, 0.64);
        for angle in [1e-6, 0.4, 1.5, 2.5] {
            let R = Rotation3::from_scaled_axis(r * angle);
            let of_axes: Vector3<f64> =
                (0..3).map(|i| Vector3::ith(i, 1.0).cross(&R.matrix().column(i)) * 0.5).sum();
            assert!((OrientationError::RSin.of(&R) - of_axes).norm() < 1e-15);
            assert!((of_axes - r * angle.sin()).norm() < 1e-15);
            assert!((OrientationError::Quaternion.of(&R) - r * 2.0 * (0.5 * angle).sin()).norm() < 1e-15);
        }
    }

    #[test]
    fn gimbal_lock_quarter_and_half_turns() {
        let up = Vector3::new(0.3, std::f64::consts::FRAC_PI_2, 0.0);
        let R = euler_zyx_rotation(&up);
        assert!(OrientationError::EulerZyx.inverse_rate(&up, &R).is_none());
        let about = |angle: f64| Rotation3::from_scaled_axis(Vector3::new(0.0, 0.0, angle));
        let half = about(std::f64::consts::PI);
        let half_turn = Vector3::new(0.0, 0.0, std::f64::consts::PI);
        let rate = OrientationError::AngleAxis.inverse_rate(&half_turn, &half).unwrap();
        assert!(rate.iter().all(|x| x.is_finite()));
        assert!((rate * half_turn - half_turn).norm() < 1e-12, "the axis keeps its direction");
        for (kind, end) in [(OrientationError::RSin, 0.5), (OrientationError::Quaternion, 1.0)] {
            let rate = |share: f64| {
                let R = about(share * end * std::f64::consts::PI);
                kind.rate(&kind.of(&R), &R)
            };
            assert!(rate(0.99).is_some() && rate(1.0).is_none(), "{kind:?}");
        }
        let beyond = about(2.0);
        assert!(OrientationError::RSin.rate(&OrientationError::RSin.of(&beyond), &beyond).is_none());
        for kind in ALL {
            let (none, R) = (Vector3::zeros(), Rotation3::identity());
            assert!((kind.rate(&none, &R).unwrap() - kind.inverse_rate(&none, &R).unwrap()).norm() < 1.5);
        }
    }
}
