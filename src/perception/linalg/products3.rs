//! Products of 3-vectors and 3x3 matrices written out.
//!
//! The general matrix product of the linear algebra crate costs a call per product; recursions over the links of an arm
//! consist of such products, so they are spelled out once here and inlined.

use nalgebra::{Matrix3, Vector3};

/// `M v`.
#[inline(always)]
pub fn mul(M: &Matrix3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(
        M.m11 * v.x + M.m12 * v.y + M.m13 * v.z,
        M.m21 * v.x + M.m22 * v.y + M.m23 * v.z,
        M.m31 * v.x + M.m32 * v.y + M.m33 * v.z,
    )
}

/// `M^T v`.
#[inline(always)]
pub fn tr_mul(M: &Matrix3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(
        M.m11 * v.x + M.m21 * v.y + M.m31 * v.z,
        M.m12 * v.x + M.m22 * v.y + M.m32 * v.z,
        M.m13 * v.x + M.m23 * v.y + M.m33 * v.z,
    )
}

/// `A B`.
#[inline(always)]
pub fn mul_mat(A: &Matrix3<f64>, B: &Matrix3<f64>) -> Matrix3<f64> {
    Matrix3::from_columns(&[
        mul(A, &Vector3::new(B.m11, B.m21, B.m31)),
        mul(A, &Vector3::new(B.m12, B.m22, B.m32)),
        mul(A, &Vector3::new(B.m13, B.m23, B.m33)),
    ])
}

/// `a x b`.
#[inline(always)]
pub fn cross(a: &Vector3<f64>, b: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)
}

/// `a . b`.
#[inline(always)]
pub fn dot(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.x * b.x + a.y * b.y + a.z * b.z
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn written_out_products_are_products(a in prop::array::uniform9(-2.0..2.0f64), b in prop::array::uniform9(-2.0..2.0f64)) {
            let (A, B) = (Matrix3::from_row_slice(&a), Matrix3::from_row_slice(&b));
            let v = Vector3::new(b[0], b[3], b[7]);
            let w = Vector3::new(a[1], a[2], a[8]);
            prop_assert!((mul(&A, &v) - A * v).norm() < 1e-13);
            prop_assert!((tr_mul(&A, &v) - A.transpose() * v).norm() < 1e-13);
            prop_assert!((mul_mat(&A, &B) - A * B).norm() < 1e-12);
            prop_assert!((cross(&v, &w) - v.cross(&w)).norm() < 1e-13);
            prop_assert!((dot(&v, &w) - v.dot(&w)).abs() < 1e-13);
        }
    }
}
