//! Factorisation `A = L D L^T` of small symmetric positive definite matrices, without square roots or heap.
//!
//! The pivot `d_i` divided by `a_ii` is `1 - R_i^2`, the part of column i that the columns before it do not
//! explain. It does not change when rows and columns are scaled, so one threshold serves metres and radians.

#![allow(clippy::needless_range_loop)] // matrix indices read better

use nalgebra::SMatrix;

/// Smallest `d_i / a_ii` that still counts as full rank: singular values in a ratio of about 1e-6. A pivot is a difference that rounds to
/// some 1e-16 of `a_ii`, so that four digits of the smallest that counts are its own.
const RANK_TOLERANCE: f64 = 1e-12;

/// The factors of an `N x N` matrix.
#[derive(Debug, Clone, Copy)]
pub struct Ldlt<const N: usize> {
    /// Unit lower triangle; the diagonal is implied.
    lower: [[f64; N]; N],
    inverse_pivots: [f64; N],
    min_ratio: f64,
}

impl<const N: usize> Ldlt<N> {
    /// Factors `a`, of which only the lower triangle is read, with `damping` added to the diagonal.
    ///
    /// `None` when some pivot is not above 1e-12 of its diagonal entry, or not finite.
    #[inline(always)]
    pub fn new(a: &[[f64; N]; N], damping: &[f64; N]) -> Option<Self> {
        let mut lower = [[0.0; N]; N];
        let mut scaled = [[0.0; N]; N]; // rows of L D
        let mut inverse_pivots = [0.0; N];
        let mut min_ratio = f64::INFINITY;
        let mut regular = true;
        for j in 0..N {
            let diagonal = a[j][j] + damping[j];
            let mut pivot = diagonal;
            for k in 0..j {
                pivot -= scaled[j][k] * lower[j][k];
            }
            // The negated comparison also catches NaN.
            regular &= pivot > RANK_TOLERANCE * diagonal && pivot < f64::INFINITY;
            let inverse = 1.0 / pivot;
            inverse_pivots[j] = inverse;
            let ratio = pivot / diagonal;
            if ratio < min_ratio {
                min_ratio = ratio;
            }
            for i in j + 1..N {
                let mut x = a[i][j];
                for k in 0..j {
                    x -= scaled[i][k] * lower[j][k];
                }
                scaled[i][j] = x;
                lower[i][j] = x * inverse;
            }
        }
        regular.then_some(Self { lower, inverse_pivots, min_ratio })
    }

    /// Factors the symmetric matrix `A`; `None` as [`Self::new`].
    #[inline(always)]
    pub fn of(A: &SMatrix<f64, N, N>) -> Option<Self> {
        Self::new(&A.data.0, &[0.0; N])
    }

    /// The least pivot, in the units of `A`.
    pub fn min_pivot(&self) -> f64 {
        self.inverse_pivots.iter().copied().fold(0.0, f64::max).recip()
    }

    /// The least `d_i / a_ii`, in (0, 1].
    #[inline]
    pub fn min_ratio(&self) -> f64 {
        self.min_ratio
    }

    /// Solves `A x = b`.
    #[inline(always)]
    pub fn solve(&self, b: &[f64; N]) -> [f64; N] {
        let mut x = *b;
        for i in 0..N {
            for k in 0..i {
                x[i] -= self.lower[i][k] * x[k];
            }
        }
        for i in 0..N {
            x[i] *= self.inverse_pivots[i];
        }
        for i in (0..N).rev() {
            for k in i + 1..N {
                x[i] -= self.lower[k][i] * x[k];
            }
        }
        x
    }

    /// The inverse of `A`, symmetric to the last bit.
    #[inline]
    pub fn inverse(&self) -> [[f64; N]; N] {
        // A^-1 = M^T D^-1 M with M = L^-1.
        let m = self.inverse_of_lower();
        let mut inverse = [[0.0; N]; N];
        for i in 0..N {
            for j in 0..=i {
                let mut x = 0.0;
                for k in i..N {
                    x += m[k][i] * self.inverse_pivots[k] * m[k][j];
                }
                inverse[i][j] = x;
                inverse[j][i] = x;
            }
        }
        inverse
    }

    /// The trace of the inverse of `A`.
    #[inline]
    pub fn inverse_trace(&self) -> f64 {
        let m = self.inverse_of_lower();
        let mut trace = 0.0;
        for k in 0..N {
            let mut squares = 0.0;
            for j in 0..=k {
                squares += m[k][j] * m[k][j];
            }
            trace += self.inverse_pivots[k] * squares;
        }
        trace
    }

    /// L^-1, unit lower triangular.
    #[inline(always)]
    fn inverse_of_lower(&self) -> [[f64; N]; N] {
        let mut m = [[0.0; N]; N];
        for j in 0..N {
            m[j][j] = 1.0;
            for i in j + 1..N {
                let mut x = -self.lower[i][j];
                for k in j + 1..i {
                    x -= self.lower[i][k] * m[k][j];
                }
                m[i][j] = x;
            }
        }
        m
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{SMatrix, SVector};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn solves_and_inverts(entries in prop::array::uniform32(-1.0..1.0f64), b in prop::array::uniform4(-1.0..1.0f64)) {
            let G = SMatrix::<f64, 8, 4>::from_row_slice(&entries);
            let A = G.transpose() * G + SMatrix::<f64, 4, 4>::identity() * 0.01;
            let a = std::array::from_fn(|i| std::array::from_fn(|j| A[(i, j)]));
            let factors = Ldlt::new(&a, &[0.0; 4]).unwrap();
            let x = SVector::<f64, 4>::from(factors.solve(&b));
            prop_assert!((A * x - SVector::from(b)).norm() < 1e-9);
            let inverse = SMatrix::<f64, 4, 4>::from_fn(|i, j| factors.inverse()[i][j]);
            prop_assert!((A * inverse - SMatrix::<f64, 4, 4>::identity()).norm() < 1e-8);
            prop_assert!((factors.inverse_trace() - inverse.trace()).abs() < 1e-9 * inverse.trace());
            let D = SVector::<f64, 4>::from(factors.inverse_pivots).map(f64::recip);
            prop_assert!((D.product() - A.determinant()).abs() < 1e-9 * D.product() && factors.min_pivot() == D.min());
            prop_assert!(factors.min_ratio() > 0.0 && factors.min_ratio() <= 1.0);
        }
    }

    #[test]
    fn rank_deficiency_and_nan_are_seen_at_any_scale() {
        for scale in [1e-9, 1.0, 1e9] {
            let a = [[scale, scale], [scale, scale]];
            assert!(Ldlt::new(&a, &[0.0; 2]).is_none());
            assert!(Ldlt::new(&a, &[0.1 * scale; 2]).is_some());
        }
        assert!(Ldlt::new(&[[f64::NAN]], &[0.0]).is_none());
        assert!(Ldlt::new(&[[0.0]], &[0.0]).is_none());
    }
}
