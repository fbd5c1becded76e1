//! Eigenvalues and eigenvectors of a symmetric matrix by Jacobi's rotations.
//!
//! Exact to rounding for repeated eigenvalues too, where closed formulas lose half of the digits.

#![allow(clippy::needless_range_loop)] // matrix indices read better

use nalgebra::{SMatrix, SVector};

/// Each sweep squares what is left off the diagonal, so six or seven reach the last digit, and thirty are there so that the loop is bounded.
const MAX_SWEEPS: usize = 30;
/// The sum of the squares off the diagonal, as share of the matrix's squared norm, that ends the sweeps: what is left, 1e-17 of the norm,
/// is less than the rounding of one entry.
const DIAGONAL: f64 = 1e-34;
/// Share of the squared norm up to which an entry's square is not worth a rotation: the 91 of a 14 x 14 matrix together stay below
/// [`DIAGONAL`], so that the sweeps still end by it.
const NEGLIGIBLE: f64 = 1e-36;

/// Eigenvalues in decreasing order and the orthonormal eigenvectors as columns, of a matrix of which only the lower
/// triangle and the norm are looked at.
///
/// `None` when `A` is not finite, or its squared norm is not.
#[must_use]
pub fn symmetric_eigen<const N: usize>(
    A: &SMatrix<f64, N, N>,
) -> Option<(SVector<f64, N>, SMatrix<f64, N, N>)> {
    let size = A.norm_squared();
    if !size.is_finite() {
        return None;
    }
    let mut d: [f64; N] = std::array::from_fn(|i| A[(i, i)]);
    let mut off: [[f64; N]; N] = std::array::from_fn(|i| std::array::from_fn(|j| A[(i.max(j), i.min(j))]));
    let mut V = SMatrix::<f64, N, N>::identity();
    for _ in 0..MAX_SWEEPS {
        let left: f64 =
            (0..N).flat_map(|i| (0..i).map(move |j| (i, j))).map(|(i, j)| off[i][j] * off[i][j]).sum();
        if left <= DIAGONAL * size {
            break;
        }
        for p in 0..N {
            for q in p + 1..N {
                let x = off[p][q];
                if x * x <= NEGLIGIBLE * size {
                    continue;
                }
                let theta = (d[q] - d[p]) / (2.0 * x);
                let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
                let c = 1.0 / (t * t + 1.0).sqrt();
                let s = t * c;
                d[p] -= t * x;
                d[q] += t * x;
                (off[p][q], off[q][p]) = (0.0, 0.0);
                for r in 0..N {
                    if r != p && r != q {
                        let (rp, rq) = (off[r][p], off[r][q]);
                        let (rp, rq) = (c * rp - s * rq, s * rp + c * rq);
                        (off[r][p], off[p][r]) = (rp, rp);
                        (off[r][q], off[q][r]) = (rq, rq);
                    }
                    let (vp, vq) = (V[(r, p)], V[(r, q)]);
                    V[(r, p)] = c * vp - s * vq;
                    V[(r, q)] = s * vp + c * vq;
                }
            }
        }
    }
    let mut order: [usize; N] = std::array::from_fn(|i| i);
    order.sort_unstable_by(|&i, &j| d[j].total_cmp(&d[i]));
    Some((SVector::from_fn(|i, _| d[order[i]]), SMatrix::from_fn(|i, j| V[(i, order[j])])))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Vector3};
    use proptest::prelude::*;

    fn check<const N: usize>(A: &SMatrix<f64, N, N>) {
        let (d, V) = symmetric_eigen(A).unwrap();
        assert!(d.as_slice().is_sorted_by(|a, b| a >= b), "{d}");
        assert!((V.transpose() * V - SMatrix::<f64, N, N>::identity()).norm() < 1e-13);
        let back = V * SMatrix::<f64, N, N>::from_diagonal(&d) * V.transpose();
        assert!((back - A).norm() <= 1e-13 * A.norm());
    }

    fn both_kinds<const N: usize>(entries: &[f64]) {
        let G = SMatrix::<f64, N, N>::from_column_slice(&entries[..N * N]);
        check(&(G.transpose() * G));
        check(&(G.transpose() + G));
        // Rank one: all but one eigenvalue vanish.
        let g = G.column(0);
        check(&(g * g.transpose()));
    }

    proptest! {
        #[test]
        fn rebuilds_the_matrix(a in prop::collection::vec(-5.0..5.0f64, 49)) {
            both_kinds::<1>(&a);
            both_kinds::<2>(&a);
            both_kinds::<3>(&a);
            both_kinds::<4>(&a);
            both_kinds::<7>(&a);
        }

        #[test]
        fn repeated_eigenvalues_keep_all_digits(w in prop::array::uniform3(-3.0..3.0f64), x in 0.1..3.0f64) {
            let R = nalgebra::Rotation3::from_scaled_axis(Vector3::from(w));
            let A = R.matrix() * Matrix3::from_diagonal(&Vector3::new(x, x, 1.0)) * R.matrix().transpose();
            check(&((A + A.transpose()) * 0.5));
        }
    }

    #[test]
    fn special_matrices() {
        check(&Matrix3::identity());
        check(&Matrix3::zeros());
        check(&Matrix3::new(0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0));
        check(&Matrix3::from_diagonal(&Vector3::new(-1.0, 3.0, 2.0)));
        assert!(symmetric_eigen(&Matrix3::from_element(f64::NAN)).is_none());
    }
}
