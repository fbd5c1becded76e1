//! Whether an image-based law with an estimate of L_s is stable, after (10.91): with K_s = k I the error obeys
//! `e_s' = -k L_s Lhat_s^+ e_s`, L_s the true matrix, Lhat_s the law's.
//!
//! The text requires the product to be positive definite: then the norm of the error falls at all times. That is sufficient, and far from necessary:
//! L_s of a small target is ill-conditioned, and an estimate that rotates its weak directions slightly towards the strong ones lets the norm
//! rise before it falls. Necessary for stability at the goal is that the eigenvalues of the product have positive real parts.
//! [`StabilityMargin`] has both numbers.
//!
//! With more numbers than motions (k > 6) the product is singular. Both conditions are therefore applied to its restriction to the range of L_s, the
//! errors that motions of the camera change. For studies and checks: nothing of it runs in a tick.

use nalgebra::{DMatrix, DVector, Schur};
use serde::Serialize;

/// Singular values below this share of the largest one count as zero: the square root of what a double resolves, which is what derivatives by differences
/// leave.
const RANK_SHARE: f64 = 1e-8;
/// An entry below the diagonal of this share of its neighbours is none; where eigenvalues lie together, of the next one. Chosen:
/// all are below the reported digits.
const DEFLATION: [f64; 3] = [1e-12, 1e-9, 1e-6];
/// Most iterations. Chosen: two or three an eigenvalue are usual.
const MAX_ITERATIONS: usize = 1000;

/// `-de/dx` at x = 0 by central differences, one column for each of the `numbers` elements of x. `error(j, step)` is the error for element j of x at
/// `step` and all others at 0. With the error of a true camera this is the true matrix L_s or J_L. `None` where `error` is `None`.
#[must_use]
pub fn error_motion(
    numbers: usize,
    step: f64,
    error: impl Fn(usize, f64) -> Option<DVector<f64>>,
) -> Option<DMatrix<f64>> {
    let column = |j| Some((error(j, -step)? - error(j, step)?) / (2.0 * step));
    let columns: Option<Vec<_>> = (0..numbers).map(column).collect();
    Some(DMatrix::from_columns(&columns?))
}

/// Stability of the product `L_s Lhat_s^+`; both numbers are 1 for an exact estimate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct StabilityMargin {
    /// Smallest eigenvalue of the symmetric part: above 0 the norm of every error falls, the condition of the text.
    pub definite: f64,
    /// Smallest real part of an eigenvalue, the share of the gain at which the slowest error near the goal falls; 0 or less: unstable.
    pub slowest: f64,
}

impl StabilityMargin {
    /// Of `L estimate^+` on the range of L, for matrices of as many rows, both with the features' weights; `None` where they do not fit, have
    /// no finite numbers, or no motion changes an error; and where the eigenvalues are not found.
    ///
    /// With L_s and its estimate (k x 6) it is the condition of the text. With `J_L = L_s J` and the law's estimate of that (k x n) it is that of
    /// the joints, where errors of the mount and of the arm count too.
    #[must_use]
    pub fn of(L: &DMatrix<f64>, estimate: &DMatrix<f64>) -> Option<Self> {
        let finite = |M: &DMatrix<f64>| M.iter().all(|x| x.is_finite());
        if L.shape() != estimate.shape() || L.is_empty() || !finite(L) || !finite(estimate) {
            return None;
        }
        let svd = L.clone().svd(true, false);
        let least = RANK_SHARE * svd.singular_values.max();
        let kept: Vec<usize> =
            svd.singular_values.iter().enumerate().filter(|(_, s)| **s > least).map(|(i, _)| i).collect();
        if kept.is_empty() {
            return None;
        }
        let range = svd.u?.select_columns(&kept);
        let largest = estimate.singular_values().max();
        let inverse = estimate.clone().pseudo_inverse(RANK_SHARE * largest).ok()?;
        let product = range.transpose() * L * inverse * range;
        let symmetric = (&product + product.transpose()) * 0.5;
        Some(Self {
            definite: symmetric.symmetric_eigenvalues().min(),
            slowest: smallest_real_part(&product)?,
        })
    }
}

/// The smallest real part of an eigenvalue; `None` where they are not found.
///
/// It is sought about the mean of the eigenvalues and in units of what is left: of a matrix that is nearly the identity the iteration for
/// the eigenvalues themselves has no end.
fn smallest_real_part(M: &DMatrix<f64>) -> Option<f64> {
    let mean = M.trace() / M.nrows() as f64;
    let rest = M - DMatrix::identity(M.nrows(), M.ncols()) * mean;
    let scale = rest.amax();
    if scale == 0.0 {
        return Some(mean);
    }
    let rest = rest / scale;
    let schur = DEFLATION.iter().find_map(|share| Schur::try_new(rest.clone(), *share, MAX_ITERATIONS))?;
    Some(
        mean + scale * schur.complex_eigenvalues().iter().map(|value| value.re).fold(f64::INFINITY, f64::min),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DVector;

    fn tall() -> DMatrix<f64> {
        DMatrix::from_fn(8, 6, |i, j| ((i * 7 + j * 3) as f64).sin() + if i == j { 2.0 } else { 0.0 })
    }

    #[test]
    fn an_exact_estimate_is_one_and_a_scaled_one_its_ratio() {
        let L = tall();
        let missing = L.columns(0, 4).into_owned();
        for (L, estimate, wanted) in
            [(&L, L.clone(), 1.0), (&L, &L * 4.0, 0.25), (&L, -&L, -1.0), (&missing, missing.clone(), 1.0)]
        {
            let StabilityMargin { definite, slowest } = StabilityMargin::of(L, &estimate).unwrap();
            assert!(
                (definite - wanted).abs() < 1e-12 && (slowest - wanted).abs() < 1e-12,
                "{definite} {slowest}"
            );
        }
        assert_eq!(StabilityMargin::of(&L, &missing), None);
        assert_eq!(StabilityMargin::of(&(&L * f64::NAN), &L), None);
        assert_eq!(StabilityMargin::of(&DMatrix::zeros(8, 6), &L), None);
    }

    /// For a rotated square matrix the result is known: the cosine of the angle.
    #[test]
    fn a_turn_leaves_its_cosine() {
        for angle in [0.3_f64, 1.2, 1.9] {
            let R = DMatrix::from_row_slice(2, 2, &[angle.cos(), -angle.sin(), angle.sin(), angle.cos()]);
            let margin = StabilityMargin::of(&R, &DMatrix::identity(2, 2)).unwrap();
            let off = (margin.definite - angle.cos()).abs().max((margin.slowest - angle.cos()).abs());
            assert!(off < 1e-12, "{angle}");
        }
        // rates 1 and 2, and yet a norm that may rise
        let skewed = DMatrix::from_row_slice(2, 2, &[1.0, 10.0, 0.0, 2.0]);
        let margin = StabilityMargin::of(&skewed, &DMatrix::identity(2, 2)).unwrap();
        assert!((margin.slowest - 1.0).abs() < 1e-12 && margin.definite < -3.0, "{margin:?}");
    }

    /// The square of no error in the range of L falls at a smaller share of it, and one falls just so.
    #[test]
    fn it_is_the_least_share_of_all_errors() {
        let L = tall();
        let estimate = DMatrix::from_fn(8, 6, |i, j| L[(i, j)] + 0.4 * ((i * j + i) as f64).cos());
        let margin = StabilityMargin::of(&L, &estimate).unwrap().definite;
        let inverse = (estimate.transpose() * &estimate).try_inverse().unwrap() * estimate.transpose();
        let rate = |x: &DVector<f64>| {
            let e = &L * x;
            e.dot(&(&L * (&inverse * &e))) / e.norm_squared()
        };
        let mut least = f64::INFINITY;
        let mut random = crate::linalg::Random::new(3);
        let mut best = DVector::zeros(6);
        for step in 0..200_000 {
            let width = if step < 1000 { 1.0 } else { 0.3 * 0.9999_f64.powi(step - 1000) };
            let x = &best + DVector::from_fn(6, |_, _| random.between(-width, width));
            let found = rate(&x);
            assert!(found > margin - 1e-9);
            if found < least {
                (least, best) = (found, x.normalize());
            }
        }
        assert!(least < margin + 1e-3, "{least} {margin}");
    }
}
