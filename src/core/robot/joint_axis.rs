//! A link frame's z axis, about or along which its joint moves.

use nalgebra::{Matrix3, Vector3};

/// The third column of `M`: the joint axis of a link frame.
#[inline(always)]
pub(super) fn z_axis(M: &Matrix3<f64>) -> Vector3<f64> {
    Vector3::new(M.m13, M.m23, M.m33)
}

/// `M Rz(angle)`, given the angle's sine and cosine.
#[inline(always)]
pub(super) fn turn_about_z(M: &Matrix3<f64>, (sin, cos): (f64, f64)) -> Matrix3<f64> {
    Matrix3::new(
        M.m11 * cos + M.m12 * sin,
        M.m12 * cos - M.m11 * sin,
        M.m13,
        M.m21 * cos + M.m22 * sin,
        M.m22 * cos - M.m21 * sin,
        M.m23,
        M.m31 * cos + M.m32 * sin,
        M.m32 * cos - M.m31 * sin,
        M.m33,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn turning_is_the_product_with_a_rotation(a in prop::array::uniform9(-2.0..2.0f64), angle in -4.0..4.0f64) {
            let A = Matrix3::from_row_slice(&a);
            let Rz = crate::geometry::rotation_z(angle);
            prop_assert!((turn_about_z(&A, angle.sin_cos()) - A * Rz.matrix()).norm() < 1e-13);
            prop_assert!((z_axis(&A) - A * Vector3::z()).norm() == 0.0);
        }
    }
}
