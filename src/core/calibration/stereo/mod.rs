//! Calibration of a stereo pair: both cameras and the pose between them, from images of one board taken at the same instants.
//!
//! ```text
//! each camera alone ─► poses of the board ─► X_RL = X_RO X_LO^-1 of each pair (as (10.62)) ─► the one nearest to all
//!                                              └─► joint least squares over both lenses, X_RL, the board's shape and its poses
//! ```
//! `X_LR` is the pose of the right camera in the left one. m, rad, px. The corner of an id must be the same one in both images of a
//! pair: boards that look the same after half a turn do not serve.

use super::bundle::{
    BoardObservation, BundleProblem, BundleState, Freedom, Optics, Selected, adjust_selected,
    covariance_with_dropped,
};
use super::camera::{
    BoardExtent, BoardView, CalibrationSettings, CameraCalibration, CameraCalibrationError, PointFit, Unused,
    calibrate_keeping, fits, result, rms_px,
};
use crate::camera_model::{CameraModel, CameraModelError};
use crate::geometry::{Pose, skew};
use crate::stereo::Rectification;
use nalgebra::{Matrix6, Translation3, Vector2};
use std::collections::HashMap;

/// A base line whose squared distance from none, in standard deviations, is less is none: chi-square with three degrees of freedom
/// exceeds this once in 10^5.
const NO_BASELINE: f64 = 25.9;
/// Longest base line with which two images may be suspected to be of one camera, m. Chosen by hand: longer ones are those of two cameras, however uncertain.
const SURE_BASELINE_M: f64 = 0.01;

/// How far the right camera may be from where the other pairs put it, rad plus its displacement by the distance of the board. Chosen by hand: one view of a camera that is calibrated from ten boards is off by
/// a tenth of that, and boards of neighbouring pairs differ by several times as much.
const ASTRAY: f64 = 0.1;

/// Two cameras, and where they are to each other.
#[derive(Debug, Clone)]
pub struct StereoCalibration {
    /// The left camera as the pair tells it; its images are those of the pairs.
    pub left: CameraCalibration,
    /// The right camera.
    pub right: CameraCalibration,
    /// Pose of the right camera in the left one.
    pub X_LR: Pose,
    /// Covariance of `[v; w]`: the right camera's centre moves by v and its orientation turns by w, `R_LR -> exp(w) R_LR`, both in the left
    /// camera's frame, m and rad. It is that of a position and a left rotation, and not of a spatial twist.
    pub covariance: Matrix6<f64>,
    /// Root mean square of the distances of corners from where they are predicted, over both cameras, px: OpenCV's figure.
    pub rms_px: f64,
    /// Root mean square of the difference of rows of the same corner in the rectified images, px; none where the pair cannot be
    /// rectified.
    pub rows_rms_px: Option<f64>,
}

impl StereoCalibration {
    /// Standard deviation of the length of the base line, m.
    #[must_use]
    pub fn baseline_sd_m(&self) -> f64 {
        let along = self.X_LR.translation.vector.normalize();
        (along.dot(&(self.covariance.fixed_view::<3, 3>(0, 0) * along))).max(0.0).sqrt()
    }
}

/// The pair that took these images, the same number of each, `left[i]` and `right[i]` at one instant; sizes in columns and rows.
///
/// # Errors
/// [`CameraCalibrationError`]; unusable pairs are listed in the result.
pub fn calibrate_stereo(
    left: &[BoardView],
    right: &[BoardView],
    sizes: ((u32, u32), (u32, u32)),
    settings: &CalibrationSettings,
) -> Result<StereoCalibration, CameraCalibrationError> {
    match calibrate_pair(left, right, sizes, settings, true) {
        // a coefficient that is hardly told may fold a lens in the pair that it does not fold alone
        Err(CameraCalibrationError::Camera(CameraModelError::Folded { .. })) if settings.drop_untold => {
            calibrate_pair(left, right, sizes, settings, false)
        }
        pair => pair,
    }
}

/// `keep`: coefficients that are not told from zero stay where zero is no better guess.
fn calibrate_pair(
    left: &[BoardView],
    right: &[BoardView],
    (size_left, size_right): ((u32, u32), (u32, u32)),
    settings: &CalibrationSettings,
    keep: bool,
) -> Result<StereoCalibration, CameraCalibrationError> {
    if left.len() != right.len() {
        return Err(CameraCalibrationError::Pairs { left: left.len(), right: right.len() });
    }
    let alone = [
        calibrate_keeping(left, size_left, settings, keep)?,
        calibrate_keeping(right, size_right, settings, keep)?,
    ];
    let [alone_left, alone_right] = &alone;
    let both = |i: &usize| {
        let fit =
            |one: &CameraCalibration| one.views.get(*i).and_then(|v| v.X_CO.filter(|_| v.unused.is_none()));
        Some((fit(alone_left)?, fit(alone_right)?))
    };
    let paired: Vec<usize> = (0..left.len()).filter(|i| both(i).is_some()).collect();
    let poses: Vec<(Pose, Pose)> = paired.iter().filter_map(both).collect();
    let X_RL = nearest_to_all(poses.iter().map(|(X_LO, X_RO)| X_RO * X_LO.inverse()).collect())
        .ok_or(CameraCalibrationError::TooFewViews { usable: 0, needed: 1 })?;
    let is_astray = |(X_LO, X_RO): &&(Pose, Pose)| {
        let off = X_RL.inv_mul(&(X_RO * X_LO.inverse()));
        off.rotation.angle() + off.translation.vector.norm() / X_LO.translation.vector.norm() > ASTRAY
    };
    let astray = poses.iter().filter(is_astray).count();
    if 2 * astray > poses.len() {
        return Err(CameraCalibrationError::Astray { astray, pairs: poses.len() });
    }
    let extent = BoardExtent::of(left.iter().chain(right).flatten());
    let observation = |camera: usize, view: &BoardView| BoardObservation {
        camera,
        points: view.iter().map(|p| extent.point(p, settings.model_sd_px)).collect(),
    };
    let pair = |i: &usize| Some(vec![observation(0, left.get(*i)?), observation(1, right.get(*i)?)]);
    let problem = BundleProblem {
        freedom: alone.iter().map(|one| one.freedom).collect(),
        warp: settings.warp,
        views: paired.iter().filter_map(pair).collect(),
    };
    let to_middle = Translation3::from(extent.middle.push(0.0));
    let state = BundleState {
        optics: alone.iter().map(|one| Optics::from(&one.camera)).collect(),
        X_j0: vec![X_RL],
        warp_m: alone_left.warp_m.map_or(Vector2::zeros(), |(warp_m, _)| warp_m),
        poses: poses.iter().map(|(X_LO, _)| X_LO * to_middle).collect(),
    };
    let end = adjust_selected(&problem, &state, settings.outlier_sd)?;
    let unused = |one: &CameraCalibration, other: &CameraCalibration| -> Vec<Option<Unused>> {
        let of = |(i, (own, other)): (usize, (Option<Unused>, Option<Unused>))| {
            let place = paired.iter().position(|p| *p == i);
            let misfit = place.and_then(|place| end.misfits.get(place).copied().flatten());
            own.or(other.map(|_| Unused::Other)).or(misfit.map(Unused::from))
        };
        let own = one.views.iter().map(|v| v.unused);
        own.zip(other.views.iter().map(|v| v.unused)).enumerate().map(of).collect()
    };
    let (unused_left, unused_right) = (unused(alone_left, alone_right), unused(alone_right, alone_left));
    let unknown: Vec<_> = alone.iter().map(|one| one.unknown).collect();
    let one = |index: usize, views: &[BoardView], unused, alone: &CameraCalibration| {
        let optics = end.end.state.optics.get(index).ok_or(CameraCalibrationError::NoStart)?;
        let camera =
            CameraModel::new(optics.intrinsics, optics.lens).map_err(CameraCalibrationError::Camera)?;
        let fitted = fits(index, &camera, views, &paired, unused, &end, &extent);
        result(index, &end, &unknown, camera, fitted, alone.dropped.clone(), settings)
    };
    let left = one(0, left, unused_left, alone_left)?;
    let right = one(1, right, unused_right, alone_right)?;
    let (X_LR, covariance) = pose_between(&end, &unknown)?;
    let (t, C) = (X_LR.translation.vector, covariance.fixed_view::<3, 3>(0, 0).into_owned());
    let distance2 = C.cholesky().map_or(0.0, |factor| t.dot(&factor.solve(&t)));
    if !(distance2 > NO_BASELINE || t.norm() > SURE_BASELINE_M) {
        let (baseline_mm, sd_mm) = (t.norm() * 1e3, C.symmetric_eigenvalues().max().max(0.0).sqrt() * 1e3);
        return Err(CameraCalibrationError::NoBaseline { baseline_mm, sd_mm });
    }
    let rows_rms_px = rows_rms_px(&left, &right, &X_LR);
    Ok(StereoCalibration { left, right, X_LR, covariance, rms_px: rms_px(&end, None), rows_rms_px })
}

/// The pose with the least sum of distances to all; lengths count by their mean.
fn nearest_to_all(poses: Vec<Pose>) -> Option<Pose> {
    let mean_m = poses.iter().map(|X| X.translation.vector.norm()).sum::<f64>() / poses.len().max(1) as f64;
    let apart = |a: &Pose, b: &Pose| {
        a.rotation.angle_to(&b.rotation)
            // cameras that all stand in one place have a mean of 0, and would divide by it
            + (a.translation.vector - b.translation.vector).norm() / mean_m.max(1e-12)
    };
    let sum = |a: &Pose| poses.iter().map(|b| apart(a, b)).sum::<f64>();
    poses.iter().min_by(|a, b| sum(a).total_cmp(&sum(b))).copied()
}

/// X_LR and the covariance of its position and left rotation, from those of X_RL: with `R -> exp(w) R`, `t -> t + v` of X_RL the position of the right
/// camera moves by `-R' (v + S(t) w)` and it turns by `-R' w`.
fn pose_between(end: &Selected, all: &[Freedom]) -> Result<(Pose, Matrix6<f64>), CameraCalibrationError> {
    let X_RL = end.end.state.X_j0.first().ok_or(CameraCalibrationError::NoStart)?;
    let (problem, shared) = covariance_with_dropped(end, all).ok_or(CameraCalibrationError::Degenerate)?;
    let from = problem.pose_from(1);
    let C: Matrix6<f64> = shared.fixed_view::<6, 6>(from, from).into_owned();
    let R_LR = X_RL.rotation.inverse().to_rotation_matrix().into_inner();
    let mut T = Matrix6::zeros();
    T.fixed_view_mut::<3, 3>(0, 0).copy_from(&-R_LR);
    T.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-R_LR * skew(&X_RL.translation.vector)));
    T.fixed_view_mut::<3, 3>(3, 3).copy_from(&-R_LR);
    Ok((X_RL.inverse(), T * C * T.transpose()))
}

/// How far the same corner lies apart in the rows of the rectified images.
fn rows_rms_px(left: &CameraCalibration, right: &CameraCalibration, X_LR: &Pose) -> Option<f64> {
    let rectified = Rectification::new(&left.camera, &right.camera, X_LR).ok()?;
    let focal_px = rectified.camera.intrinsics().fy_px;
    let (mut sum, mut count) = (0.0, 0.0);
    for (l, r) in left.views.iter().zip(&right.views).filter(|(l, _)| l.unused.is_none()) {
        let by_id: HashMap<u32, &PointFit> = r.points.iter().filter(|p| p.used).map(|p| (p.id, p)).collect();
        for a in l.points.iter().filter(|p| p.used) {
            let Some(b) = by_id.get(&a.id) else { continue };
            let (s_l, s_r) = (left.camera.normalized_of(&a.px), right.camera.normalized_of(&b.px));
            let (Some(a), Some(b)) = (rectified.rectified_1(&s_l), rectified.rectified_2(&s_r)) else {
                continue;
            };
            sum += (focal_px * (a.y - b.y)).powi(2);
            count += 1.0;
        }
    }
    (count > 0.0).then(|| f64::sqrt(sum / count))
}

#[cfg(test)]
mod tests;
