//! Rotation matrices and angles; (10.11), (10.12) for the closest rotation.

use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};

/// How far a quaternion's norm may be from 1. Derived: three decimals are off by 5e-4 each, and four of them by up to 2e-3 in the norm's square.
const NORM_ERROR: f64 = 2e-3;

/// The rotation of the numbers x, y, z, w that somebody wrote. `None` where their norm is not 1, to three decimals: they are then something else, or in another place.
#[must_use]
pub fn unit_quaternion([x, y, z, w]: [f64; 4]) -> Option<UnitQuaternion<f64>> {
    let q = Quaternion::new(w, x, y, z);
    ((q.norm() - 1.0).abs() <= NORM_ERROR).then(|| UnitQuaternion::from_quaternion(q))
}

/// The skew-symmetric matrix S(v) with `S(v) w = v x w`.
#[must_use]
pub fn skew(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

/// Elementary rotation about x by `angle` rad.
#[must_use]
pub fn rotation_x(angle: f64) -> Rotation3<f64> {
    Rotation3::from_axis_angle(&Vector3::x_axis(), angle)
}

/// Elementary rotation about y by `angle` rad.
#[must_use]
pub fn rotation_y(angle: f64) -> Rotation3<f64> {
    Rotation3::from_axis_angle(&Vector3::y_axis(), angle)
}

/// Elementary rotation about z by `angle` rad.
#[must_use]
pub fn rotation_z(angle: f64) -> Rotation3<f64> {
    Rotation3::from_axis_angle(&Vector3::z_axis(), angle)
}

/// The rotation vector (axis times angle, rad) of `R`; its norm is in `[0, pi]`.
#[must_use]
pub fn angle_axis(R: &Rotation3<f64>) -> Vector3<f64> {
    nalgebra::UnitQuaternion::from_rotation_matrix(R).scaled_axis()
}

/// The angle of `R` in `[0, pi]` rad.
#[must_use]
pub fn rotation_angle(R: &Rotation3<f64>) -> f64 {
    angle_axis(R).norm()
}

/// Roll, pitch, yaw, rad, of `R = Rz(yaw) Ry(pitch) Rx(roll)`, pitch in `[-pi/2, pi/2]`: exact to rounding also near the poles of
/// pitch, where only the sum or difference of the other two is fixed.
#[must_use]
pub fn roll_pitch_yaw(R: &Rotation3<f64>) -> [f64; 3] {
    let R = R.matrix();
    let yaw = R.m21.atan2(R.m11);
    let pitch = (-R.m31).atan2(R.m11.hypot(R.m21));
    // what is left when yaw is taken off: the middle row of Ry Rx is [0, cos(roll), -sin(roll)]
    let (sin, cos) = yaw.sin_cos();
    let roll = (sin * R.m13 - cos * R.m23).atan2(cos * R.m22 - sin * R.m12);
    [roll, pitch, yaw]
}

/// The rotation closest to `Q` in the Frobenius norm, (10.12): `U diag(1, 1, sigma) V^T`.
///
/// Returns `None` when the decomposition does not converge or `Q` is not finite.
#[must_use]
pub fn closest_rotation(Q: &Matrix3<f64>) -> Option<Rotation3<f64>> {
    if !Q.iter().all(|x| x.is_finite()) {
        return None;
    }
    let svd = Q.try_svd(true, true, f64::EPSILON, 100)?;
    let (mut U, V_t) = (svd.u?, svd.v_t?);
    if (U * V_t).determinant() < 0.0 {
        // The least singular value takes the reflection; nalgebra sorts the values in decreasing order.
        let flipped = -U.column(2);
        U.set_column(2, &flipped);
    }
    Some(Rotation3::from_matrix_unchecked(U * V_t))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn vector() -> impl Strategy<Value = Vector3<f64>> {
        (-3.0..3.0, -3.0..3.0, -3.0..3.0).prop_map(|(x, y, z)| Vector3::new(x, y, z))
    }

    proptest! {
        #[test]
        fn skew_is_the_cross_product(v in vector(), w in vector()) {
            prop_assert!((skew(&v) * w - v.cross(&w)).norm() < 1e-12);
        }

        #[test]
        fn roll_pitch_and_yaw_make_the_rotation_again(
            rpy in prop::array::uniform3(-3.1..3.1f64), pole in -1e-7..1e-7f64, upright in any::<bool>()
        ) {
            let pitch = if upright { std::f64::consts::FRAC_PI_2 + pole } else { rpy[1] };
            let R = rotation_z(rpy[2]) * rotation_y(pitch) * rotation_x(rpy[0]);
            let [roll, pitch, yaw] = roll_pitch_yaw(&R);
            let again = rotation_z(yaw) * rotation_y(pitch) * rotation_x(roll);
            prop_assert!((again.matrix() - R.matrix()).norm() < 1e-14);
        }

        #[test]
        fn closest_rotation_beats_its_neighbours(
            axis in vector(), noise in prop::array::uniform9(-0.3..0.3f64), step in vector()
        ) {
            let R = Rotation3::from_scaled_axis(axis);
            let Q = R.matrix() + Matrix3::from_row_slice(&noise);
            let best = closest_rotation(&Q).unwrap();
            prop_assert!((best.matrix().determinant() - 1.0).abs() < 1e-9);
            let neighbour = Rotation3::from_scaled_axis(0.01 * step) * best;
            prop_assert!((best.matrix() - Q).norm() <= (neighbour.matrix() - Q).norm() + 1e-12);
        }
    }

    #[test]
    fn closest_rotation_of_a_reflection_is_proper() {
        let R = closest_rotation(&Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -0.2))).unwrap();
        assert!((R.matrix() - Matrix3::identity()).norm() < 1e-12);
    }

    #[test]
    fn not_finite_input_is_refused() {
        assert!(closest_rotation(&Matrix3::from_element(f64::NAN)).is_none());
    }

    #[test]
    fn angle_axis_reaches_pi() {
        let R = rotation_z(std::f64::consts::PI - 1e-9);
        assert!((rotation_angle(&R) - std::f64::consts::PI).abs() < 1e-6);
        assert!((rotation_angle(&(rotation_x(0.3) * rotation_x(-0.1))) - 0.2).abs() < 1e-12);
        assert!((rotation_angle(&rotation_y(-0.4)) - 0.4).abs() < 1e-12);
    }
}
