//! Cross-validation: the images in two halves, a camera from each, and how far these differ in pixels, against what the noise
//! alone predicts.
//!
//! ```text
//! halves A, B ─► px_B(x p) - px_A(p)   over the image, x: the pose fitted again (see `uncertainty`)
//! predicted:     M (Sigma_A + Sigma_B) M'
//! ```
//! What was left out of the fit is left out of both halves, so that it makes no difference between them.
//!
//! A ratio near one says that the noise explains all; a greater one that the lens model, the board or single images are not as they
//! are thought to be: then the uncertainty is greater by about that factor. Several ways to halve the images are tried: one alone is
//! a sample of few numbers.

use super::uncertainty::{carried, grid, refitted};
use super::{BoardExtent, BoardView, CameraCalibration, ProjectionUncertainty};
use crate::calibration::bundle::{BoardObservation, BundleProblem, BundleState, Optics, PointImage, adjust};
use crate::linalg::Random;
use crate::pose::Loss;
use nalgebra::{DMatrix, Translation3, Vector2};
use std::collections::HashSet;

/// Fewest images of a half, because three views of a plane are what fixes four intrinsic parameters and leaves something over.
const MIN_VIEWS: usize = 3;
/// Ways to halve.
const SPLITS: u64 = 8;

/// How halves of the images agree.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CrossValidation {
    /// Root mean square over the image of the difference between two halves, px.
    pub difference_px: f64,
    /// What the noise of the corners predicts for it, px.
    pub predicted_px: f64,
    /// Difference over prediction, pixel by pixel, root mean square: about 1 where the noise explains all.
    pub ratio: f64,
    /// Ways to halve that could be calibrated.
    pub splits: usize,
}

/// Halves of the images that took part, against each other. `None` with fewer than six, or where no half can be calibrated.
#[must_use]
pub fn cross_validation(
    views: &[BoardView],
    calibration: &CameraCalibration,
    uncertainty: &ProjectionUncertainty,
) -> Option<CrossValidation> {
    let whole = FullSolution::new(views, calibration)?;
    let count = whole.problem.views.len();
    if count < 2 * MIN_VIEWS {
        return None;
    }
    let i = calibration.camera.intrinsics();
    let pixels: Vec<_> = grid((i.width_px, i.height_px), 0.98, (12, 9)).collect();
    let points: Vec<_> = calibration.points_used().map(|p| p.p_C).collect();
    let (mut difference, mut predicted, mut ratio, mut number, mut splits) = (0.0, 0.0, 0.0, 0.0, 0);
    for split in 0..SPLITS {
        let mut order: Vec<usize> = (0..count).collect();
        let mut random = Random::new(split);
        for k in (1..count).rev() {
            order.swap(k, (random.uniform() * (k + 1) as f64) as usize);
        }
        let (a, b) = order.split_at(count / 2);
        let (Some((optics_a, cov_a)), Some((optics_b, cov_b))) = (whole.half(a), whole.half(b)) else {
            continue;
        };
        let Some(X) = refitted(&optics_a, &optics_b, &points) else { continue };
        let covariance = calibration.freedom.covariance_within(&calibration.unknown, &(cov_a + cov_b));
        let mut sums = [0.0; 4];
        for px in &pixels {
            let p = calibration.camera.normalized_of(px).push(1.0) * uncertainty.distance_m();
            let at_b = PointImage::new(&optics_b, &(X * nalgebra::Point3::from(p)).coords);
            let (Some(a), Some(b), Some(M)) = (PointImage::new(&optics_a, &p), at_b, uncertainty.map(px))
            else {
                continue;
            };
            let (apart, expected) = ((a.px - b.px).norm_squared(), carried(&M, &covariance).trace());
            sums = [sums[0] + apart, sums[1] + expected, sums[2] + apart / expected, sums[3] + 1.0];
        }
        if sums.iter().all(|x| x.is_finite()) && sums[3] > 0.0 {
            difference += sums[0];
            predicted += sums[1];
            ratio += sums[2];
            number += sums[3];
            splits += 1;
        }
    }
    (splits > 0).then(|| CrossValidation {
        difference_px: (difference / number).sqrt(),
        predicted_px: (predicted / number).sqrt(),
        ratio: (ratio / number).sqrt(),
        splits,
    })
}

/// The problem of all that took part, at its solution.
pub(super) struct FullSolution {
    pub(super) problem: BundleProblem,
    pub(super) state: BundleState,
}

impl FullSolution {
    pub(super) fn new(views: &[BoardView], calibration: &CameraCalibration) -> Option<Self> {
        let extent = BoardExtent::of(views.iter().flatten());
        let to_middle = Translation3::from(extent.middle.push(0.0));
        let (mut observations, mut poses) = (Vec::new(), Vec::new());
        for (view, fit) in views.iter().zip(&calibration.views).filter(|(_, fit)| fit.unused.is_none()) {
            let used: HashSet<u32> = fit.points.iter().filter(|p| p.used).map(|p| p.id).collect();
            let points = view
                .iter()
                .filter(|p| used.contains(&p.id))
                .map(|p| extent.point(p, calibration.model_sd_px))
                .collect();
            observations.push(vec![BoardObservation { camera: 0, points }]);
            poses.push(fit.X_CO? * to_middle);
        }
        let problem = BundleProblem {
            freedom: vec![calibration.freedom],
            warp: calibration.warp_m.is_some(),
            views: observations,
        };
        let state = BundleState {
            optics: vec![Optics::from(&calibration.camera)],
            X_j0: Vec::new(),
            warp_m: calibration.warp_m.map_or(Vector2::zeros(), |(warp_m, _)| warp_m),
            poses,
        };
        Some(Self { problem, state })
    }

    /// The camera of some of the views, with the covariance of its free parameters.
    fn half(&self, which: &[usize]) -> Option<(Optics, DMatrix<f64>)> {
        let of = |i: &usize| Some((self.problem.views.get(*i)?.clone(), *self.state.poses.get(*i)?));
        let (views, poses) = which.iter().filter_map(of).unzip();
        let problem = BundleProblem { views, ..self.problem.clone() };
        let end = adjust(&problem, BundleState { poses, ..self.state.clone() }, Loss::Squares).ok()?;
        let factor = end.sums.chi_square / problem.degrees_of_freedom().max(1) as f64;
        let n = problem.freedom.first()?.count();
        let covariance = end.sums.covariance()?.view((0, 0), (n, n)) * factor;
        Some((*end.state.optics.first()?, covariance))
    }
}
