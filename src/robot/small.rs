//! Products of 3-vectors and 3x3 matrices written out, and the factorisation of small symmetric matrices.
//!
//! The general matrix product of the linear algebra crate costs a call per product; the recursions of this module
//! consist of such products, so they are spelled out once here and inlined.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// `M v`.
#[inline(always)]
pub(super) fn mul(M: &Matrix3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(
        M.m11 * v.x + M.m12 * v.y + M.m13 * v.z,
        M.m21 * v.x + M.m22 * v.y + M.m23 * v.z,
        M.m31 * v.x + M.m32 * v.y + M.m33 * v.z,
    )
}

/// `M^T v`.
#[inline(always)]
pub(super) fn tr_mul(M: &Matrix3<f64>, v: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(
        M.m11 * v.x + M.m21 * v.y + M.m31 * v.z,
        M.m12 * v.x + M.m22 * v.y + M.m32 * v.z,
        M.m13 * v.x + M.m23 * v.y + M.m33 * v.z,
    )
}

/// `A B`.
#[inline(always)]
pub(super) fn mul_mat(A: &Matrix3<f64>, B: &Matrix3<f64>) -> Matrix3<f64> {
    Matrix3::from_columns(&[
        mul(A, &Vector3::new(B.m11, B.m21, B.m31)),
        mul(A, &Vector3::new(B.m12, B.m22, B.m32)),
        mul(A, &Vector3::new(B.m13, B.m23, B.m33)),
    ])
}

/// `a x b`.
#[inline(always)]
pub(super) fn cross(a: &Vector3<f64>, b: &Vector3<f64>) -> Vector3<f64> {
    Vector3::new(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)
}

/// `a . b`.
#[inline(always)]
pub(super) fn dot(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.x * b.x + a.y * b.y + a.z * b.z
}

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

/// The lower Cholesky factor of the symmetric matrix `A`, or `None` when `A` is not positive definite or not finite.
pub(super) fn cholesky<const M: usize>(A: &SMatrix<f64, M, M>) -> Option<SMatrix<f64, M, M>> {
    let mut L = SMatrix::<f64, M, M>::zeros();
    for j in 0..M {
        let mut pivot = A[(j, j)];
        for k in 0..j {
            pivot -= L[(j, k)] * L[(j, k)];
        }
        // `!(a > b)` instead of `a <= b`: NaN must end here too.
        if !(pivot > 0.0 && pivot.is_finite()) {
            return None;
        }
        let root = pivot.sqrt();
        L[(j, j)] = root;
        for i in j + 1..M {
            let mut sum = A[(i, j)];
            for k in 0..j {
                sum -= L[(i, k)] * L[(j, k)];
            }
            L[(i, j)] = sum / root;
        }
    }
    Some(L)
}

/// Solves `L L^T x = b`.
pub(super) fn cholesky_solve<const M: usize>(L: &SMatrix<f64, M, M>, b: &SVector<f64, M>) -> SVector<f64, M> {
    let mut x = *b;
    for i in 0..M {
        for k in 0..i {
            x[i] -= L[(i, k)] * x[k];
        }
        x[i] /= L[(i, i)];
    }
    for i in (0..M).rev() {
        for k in i + 1..M {
            x[i] -= L[(k, i)] * x[k];
        }
        x[i] /= L[(i, i)];
    }
    x
}

/// The trace of `(L L^T)^-1`: the sum of the squares of the entries of `L^-1`.
pub(super) fn inverse_trace<const M: usize>(L: &SMatrix<f64, M, M>) -> f64 {
    let mut sum = 0.0;
    for column in 0..M {
        let mut x = [0.0; M];
        x[column] = 1.0 / L[(column, column)];
        sum += x[column] * x[column];
        for i in column + 1..M {
            let mut value = 0.0;
            for k in column..i {
                value -= L[(i, k)] * x[k];
            }
            x[i] = value / L[(i, i)];
            sum += x[i] * x[i];
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix4, Vector4};
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
            let Rz = crate::geometry::rotation_z(a[0]);
            prop_assert!((turn_about_z(&A, a[0].sin_cos()) - A * Rz.matrix()).norm() < 1e-13);
        }

        #[test]
        fn factor_solves_and_gives_the_trace(a in prop::array::uniform16(-1.0..1.0f64), b in prop::array::uniform4(-1.0..1.0f64)) {
            let R = Matrix4::from_row_slice(&a);
            let A = R * R.transpose() + Matrix4::identity() * 0.1;
            let L = cholesky(&A).unwrap();
            prop_assert!((L * L.transpose() - A).norm() < 1e-12);
            let b = Vector4::from_row_slice(&b);
            prop_assert!((A * cholesky_solve(&L, &b) - b).norm() < 1e-11);
            let trace = A.try_inverse().unwrap().trace();
            prop_assert!((inverse_trace(&L) - trace).abs() < 1e-9 * trace);
        }
    }

    #[test]
    fn indefinite_and_not_finite_matrices_are_refused() {
        assert!(cholesky(&Matrix4::from_diagonal(&Vector4::new(1.0, 1.0, -1.0, 1.0))).is_none());
        assert!(cholesky(&Matrix4::from_element(f64::NAN)).is_none());
    }
}
