//! Eigenvalues and eigenvectors of a symmetric 3 x 3 matrix by Jacobi's rotations.
//!
//! Exact to rounding for repeated eigenvalues too, where closed formulas lose half of the digits.

use nalgebra::{Matrix3, Vector3};

/// Eigenvalues in decreasing order and the orthonormal eigenvectors as columns, right-handed.
///
/// `None` when `a` is not finite.
#[must_use]
pub(crate) fn symmetric_eigen(a: &Matrix3<f64>) -> Option<(Vector3<f64>, Matrix3<f64>)> {
    let size = a.norm_squared();
    if !size.is_finite() {
        return None;
    }
    let (mut d, mut v) = ([a.m11, a.m22, a.m33], Matrix3::identity());
    // Off-diagonal entries, named by the index that they lack.
    let mut o = [a.m32, a.m31, a.m21];
    for _ in 0..12 {
        if o[0] * o[0] + o[1] * o[1] + o[2] * o[2] <= 1e-34 * size {
            break;
        }
        for (p, q, r) in [(0, 1, 2), (0, 2, 1), (1, 2, 0)] {
            let x = o[r];
            if x * x <= 1e-36 * size {
                continue;
            }
            let theta = (d[q] - d[p]) / (2.0 * x);
            let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
            let c = 1.0 / (t * t + 1.0).sqrt();
            let s = t * c;
            d[p] -= t * x;
            d[q] += t * x;
            o[r] = 0.0;
            // Entries (r, p) and (r, q) are named q and p.
            let (rp, rq) = (o[q], o[p]);
            o[q] = c * rp - s * rq;
            o[p] = s * rp + c * rq;
            for k in 0..3 {
                let (vp, vq) = (v[(k, p)], v[(k, q)]);
                v[(k, p)] = c * vp - s * vq;
                v[(k, q)] = s * vp + c * vq;
            }
        }
    }
    let mut order = [0, 1, 2];
    order.sort_unstable_by(|&i, &j| d[j].total_cmp(&d[i]));
    let (v1, v2) = (v.column(order[0]).into_owned(), v.column(order[1]).into_owned());
    let values = Vector3::new(d[order[0]], d[order[1]], d[order[2]]);
    Some((values, Matrix3::from_columns(&[v1, v2, v1.cross(&v2)])))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn check(A: &Matrix3<f64>) {
        let (d, V) = symmetric_eigen(A).unwrap();
        assert!(d.x >= d.y && d.y >= d.z);
        assert!((V.transpose() * V - Matrix3::identity()).norm() < 1e-13);
        assert!((V.determinant() - 1.0).abs() < 1e-13);
        assert!((V * Matrix3::from_diagonal(&d) * V.transpose() - A).norm() <= 1e-13 * A.norm());
    }

    proptest! {
        #[test]
        fn rebuilds_the_matrix(a in prop::array::uniform9(-5.0..5.0f64)) {
            let G = Matrix3::from_row_slice(&a);
            check(&(G.transpose() * G));
            check(&(G.transpose() + G));
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
        assert!(symmetric_eigen(&Matrix3::from_element(f64::NAN)).is_none());
    }
}
