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

use super::image::rows_by;
use super::{FeatureMatrix, Interaction, InteractionAt, Law, SetPoint, View, weighted_rows};
use nalgebra::{DMatrix, DVector, Schur, Vector6};
use serde::{Deserialize, Serialize};

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

/// What the product of L_s and the inverse of its estimate tells; both numbers are 1 for an exact estimate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
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
        let range = range(L)?;
        let inverse = pseudo_inverse(estimate)?;
        let product = range.transpose() * L * inverse * range;
        let symmetric = (&product + product.transpose()) * 0.5;
        Some(Self {
            definite: symmetric.symmetric_eigenvalues().min(),
            slowest: smallest_real_part(&product)?,
        })
    }
}

/// The margins of a law at the start and at the goal.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Stability {
    /// At the start.
    pub start: Margins,
    /// In the posture that shows the goal; `None` where none is known.
    pub goal: Option<Margins>,
}

/// The margins in one posture.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Margins {
    /// Of L_s times the inverse of its estimate: errors of depth, lens and target.
    pub camera: StabilityMargin,
    /// Of J_L times the inverse of its estimate: of mount and arm as well.
    pub joints: StabilityMargin,
}

impl Stability {
    /// The share of the gain at which the slowest error falls, with the joints: at the goal, or at the start where no posture of the goal is known.
    #[must_use]
    pub fn slowest(&self) -> f64 {
        self.goal.unwrap_or(self.start).joints.slowest
    }

    /// Whether errors near the goal do not all fall.
    #[must_use]
    pub fn is_doubtful(&self) -> bool {
        self.goal.is_some_and(|margins| !(margins.joints.slowest > 0.0))
    }
}

/// An orthonormal basis of the range of L, k x rank; `None` for a matrix of zeros.
fn range(L: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let svd = L.clone().svd(true, false);
    let least = RANK_SHARE * svd.singular_values.max();
    let kept: Vec<usize> =
        svd.singular_values.iter().enumerate().filter(|(_, s)| **s > least).map(|(i, _)| i).collect();
    if kept.is_empty() { None } else { Some(svd.u?.select_columns(&kept)) }
}

fn pseudo_inverse(L: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    L.clone().pseudo_inverse(RANK_SHARE * L.singular_values().max()).ok()
}

/// Share, 0 to 1, of the norm of `K_s e_s` that motions of the camera change, in the `view` and with L_s as the law takes it. Where it is 0, K_s e_s
/// is in the null space of L_s^T: the law asks for no motion, whatever the error is.
///
/// `None` for laws that are not image-based, for a view that poses them no task, and where there is no error. It allocates.
#[must_use]
pub fn felt_share(law: &Law, set_point: &SetPoint, view: &View) -> Option<f64> {
    let (L, y) = match law {
        Law::ImageVelocity { K_s, interaction, .. } => rows_by(set_point, view, *interaction, K_s, true)?,
        Law::ImageTorque { K_Ps, interaction, .. } => {
            let weighted = matches!(K_Ps, FeatureMatrix::Scalar(_));
            rows_by(set_point, view, *interaction, K_Ps, weighted)?
        }
        Law::PreconditionedTorque { K_Ps, interaction, .. } => {
            let at_goal = Interaction { at: InteractionAt::Desired, ..*interaction };
            let (L, e) = weighted_rows(set_point, view, *interaction)?;
            let (L_D, _) = weighted_rows(set_point, view, at_goal)?;
            let inverse = pseudo_inverse(&L_D)?;
            let twist = &inverse * &e;
            let stiff = K_Ps.K_P.times(&Vector6::from_column_slice(twist.as_slice()));
            let y = inverse.transpose() * stiff + (e - L_D * twist) * K_Ps.rest;
            (L, y)
        }
        Law::PositionTorque { .. } | Law::PositionVelocity { .. } | Law::Hybrid { .. } => return None,
    };
    let share = (range(&L)?.transpose() * &y).norm() / y.norm();
    share.is_finite().then_some(share)
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
