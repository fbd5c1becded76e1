//! Twists and the matrix Gamma of (10.18).

use super::{Pose, Twist, skew};
use nalgebra::{Matrix3, Matrix6, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Gamma(p) of (10.18): `[[-I, S(p)], [0, -I]]`, with `Gamma(p)^-1 = Gamma(-p)`.
///
/// It maps the camera's twist `V_BC_C` to the part of the object's relative twist that the camera causes.
#[must_use]
pub fn gamma(p: &Vector3<f64>) -> Matrix6<f64> {
    let mut G = -Matrix6::identity();
    G.fixed_view_mut::<3, 3>(0, 3).copy_from(&skew(p));
    G
}

/// The same twist expressed in another frame of the same origin: `[R v; R w]`.
#[must_use]
pub fn rotate_twist(R_AB: &Rotation3<f64>, V_B: &Twist) -> Twist {
    let v = R_AB * V_B.fixed_rows::<3>(0);
    let w = R_AB * V_B.fixed_rows::<3>(3);
    Twist::new(v.x, v.y, v.z, w.x, w.y, w.z)
}

/// The pose reached after `dt_s` seconds at the constant body twist `V_BC_C` (exponential map on SE(3)).
#[must_use]
pub fn integrate_body_twist(X_BC: &Pose, V_BC_C: &Twist, dt_s: f64) -> Pose {
    let v: Vector3<f64> = V_BC_C.fixed_rows::<3>(0) * dt_s;
    let phi: Vector3<f64> = V_BC_C.fixed_rows::<3>(3) * dt_s;
    let theta2 = phi.norm_squared();
    let theta = theta2.sqrt();
    // Series below 1e-3 rad: the closed forms lose their digits there. Derived: the next terms are below theta^4 / 720 = 1.4e-15, and
    // rounding leaves `1 - cos(theta)` off by 2e-10 of itself.
    let (a, b) = if theta < 1e-3 {
        (0.5 - theta2 / 24.0, 1.0 / 6.0 - theta2 / 120.0)
    } else {
        ((1.0 - theta.cos()) / theta2, (theta - theta.sin()) / (theta2 * theta))
    };
    let S = skew(&phi);
    let V: Matrix3<f64> = Matrix3::identity() + S * a + S * S * b;
    X_BC * Pose::from_parts(Translation3::from(V * v), UnitQuaternion::from_scaled_axis(phi))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn twist() -> impl Strategy<Value = Twist> {
        prop::array::uniform6(-2.0..2.0f64).prop_map(|a| Twist::from_row_slice(&a))
    }

    fn pose() -> impl Strategy<Value = Pose> {
        prop::array::uniform6(-1.5..1.5f64)
            .prop_map(|a| Pose::new(Vector3::new(a[0], a[1], a[2]), Vector3::new(a[3], a[4], a[5])))
    }

    proptest! {
        #[test]
        fn gamma_of_minus_p_is_its_inverse(p in prop::array::uniform3(-2.0..2.0f64)) {
            let p = Vector3::from_row_slice(&p);
            prop_assert!((gamma(&p) * gamma(&-p) - Matrix6::identity()).norm() < 1e-12);
        }

        #[test]
        fn gamma_gives_the_relative_twist_of_a_fixed_object(X_BC in pose(), X_BO in pose(), V in twist()) {
            // Central difference of p_CO_C while the camera moves and the object stands still, (10.16).
            let h = 1e-6;
            let at = |t: f64| (integrate_body_twist(&X_BC, &V, t).inverse() * X_BO).translation.vector;
            let p_dot = (at(h) - at(-h)) / (2.0 * h);
            let relative = gamma(&at(0.0)) * V;
            prop_assert!((relative.fixed_rows::<3>(0) - p_dot).norm() < 1e-6);
            prop_assert!((relative.fixed_rows::<3>(3) + V.fixed_rows::<3>(3)).norm() < 1e-12);
        }

        #[test]
        fn integration_adds_up(X in pose(), V in twist()) {
            let once = integrate_body_twist(&X, &V, 0.02);
            let twice = integrate_body_twist(&integrate_body_twist(&X, &V, 0.01), &V, 0.01);
            prop_assert!((once.to_homogeneous() - twice.to_homogeneous()).norm() < 1e-12);
        }

        #[test]
        fn rotating_there_and_back(X in pose(), V in twist()) {
            let R = X.rotation.to_rotation_matrix();
            prop_assert!((rotate_twist(&R.inverse(), &rotate_twist(&R, &V)) - V).norm() < 1e-12);
        }
    }
}
