//! The factorisation of small symmetric matrices.

use nalgebra::{SMatrix, SVector};

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
