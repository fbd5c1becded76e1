//! From the minimum of the least squares to the result of one camera of the rig.

use super::calibration::{CameraCalibration, DroppedCoefficient, PointFit, ViewFit};
use super::start::{self, PlaneView};
use super::{BoardExtent, BoardPoint, BoardView, CalibrationSettings, CameraCalibrationError, Unused};
use crate::calibration::bundle::{Freedom, Selected, covariance_with_dropped};
use crate::camera_model::CameraModel;
use crate::geometry::Pose;
use crate::pose::{Loss, PixelCorrespondence, refine_pixels};
use nalgebra::{Matrix2, Point3, Translation3, Vector2};

/// What one camera of a rig is found to be; `all`: which parameters of each camera are unknown, also where they were left out of
/// the fit.
pub(crate) fn result(
    camera_index: usize,
    end: &Selected,
    all: &[Freedom],
    camera: CameraModel,
    views: Vec<ViewFit>,
    dropped: Vec<DroppedCoefficient>,
    settings: &CalibrationSettings,
) -> Result<CameraCalibration, CameraCalibrationError> {
    let variance_factor = end.variance_factor();
    let freedom = *end.problem.freedom.get(camera_index).ok_or(CameraCalibrationError::NoStart)?;
    let (problem, covariance) =
        covariance_with_dropped(end, all).ok_or(CameraCalibrationError::Degenerate)?;
    let unknown = *problem.freedom.get(camera_index).ok_or(CameraCalibrationError::NoStart)?;
    let (from, warp, n) = (problem.optics_from(camera_index), problem.warp_from(), unknown.count());
    let warp_m = end.problem.warp.then(|| {
        let sd = |i: usize| covariance.get((warp + i, warp + i)).map_or(0.0, |x| x.max(0.0).sqrt());
        (end.end.state.warp_m, Vector2::new(sd(0), sd(1)))
    });
    Ok(CameraCalibration {
        camera,
        freedom,
        unknown,
        covariance: covariance.view((from, from), (n, n)).into_owned(),
        warp_m,
        rms_px: rms_px(end, Some(camera_index)),
        noise_px: (variance_factor * mean_variance(end)).sqrt(),
        variance_factor,
        dropped,
        model_sd_px: settings.model_sd_px,
        iterations: end.end.iterations,
        views,
    })
}

/// Root mean square of the distances of corners from where they are predicted, px; of one camera or all.
pub(crate) fn rms_px(end: &Selected, camera: Option<usize>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for (i, view) in end.problem.views.iter().enumerate() {
        for (observation, point) in view.iter().flat_map(|s| s.points.iter().map(move |p| (s, p))) {
            if camera.is_some_and(|camera| camera != observation.camera) {
                continue;
            }
            let image = end.end.state.image(observation.camera, i, point);
            count += 1.0;
            sum += image.map_or(0.0, |image| (point.px - image.px).norm_squared());
        }
    }
    (sum / f64::max(count, 1.0)).sqrt()
}

/// Mean variance of a coordinate as it was given, with the floor, px^2.
fn mean_variance(end: &Selected) -> f64 {
    let points = || end.problem.views.iter().flatten().flat_map(|s| &s.points);
    let variance = |W: &Matrix2<f64>| {
        // C = (W^T W)^-1
        let square = W.tr_mul(W);
        0.5 * square.trace() / square.determinant()
    };
    points().map(|p| variance(&p.whitening)).sum::<f64>() / points().count().max(1) as f64
}

/// How the images of one camera of the rig fit.
pub(crate) fn fits(
    camera_index: usize,
    camera: &CameraModel,
    views: &[BoardView],
    posed: &[usize],
    unused: Vec<Option<Unused>>,
    end: &Selected,
    extent: &BoardExtent,
) -> Vec<ViewFit> {
    let state = &end.end.state;
    let to_corner = Translation3::from(-extent.middle.push(0.0));
    let fit = |(i, (view, unused)): (usize, (&BoardView, Option<Unused>))| {
        let place = posed.iter().position(|p| *p == i);
        let at = place.and_then(|place| end.views.iter().position(|v| *v == place));
        let X_0O = at.and_then(|at| state.poses.get(at)).map(|X| X * to_corner);
        let X_j0 = camera_index.checked_sub(1).and_then(|j| state.X_j0.get(j)).copied().unwrap_or_default();
        let X_CO = match X_0O {
            Some(X) => Some(X_j0 * X),
            // an image that took no part still shows the board somewhere
            None if place.is_some() => board_pose(camera, view),
            None => None,
        };
        let Some(X) = X_CO else { return ViewFit { unused, X_CO: None, rms_px: None, points: Vec::new() } };
        let kept = place.and_then(|place| end.kept.get(place)).and_then(|observations| {
            observations.get(camera_index.min(observations.len().saturating_sub(1)))
        });
        let point = |(k, p): (usize, &BoardPoint)| {
            let (r, lift) = extent.centred(&p.p_O);
            let lifted = p.p_O.coords.xy().push(r.z + state.warp_m.dot(&lift));
            let p_C = X * Point3::from(lifted);
            let predicted = camera.project(&p_C)?;
            let kept = kept.and_then(|kept| kept.get(k)).copied().unwrap_or(false);
            Some(PointFit {
                id: p.id,
                p_C,
                px: p.px,
                error_px: p.px - predicted,
                used: kept && unused.is_none(),
            })
        };
        let points: Vec<PointFit> = view.iter().enumerate().filter_map(point).collect();
        let counted = || points.iter().filter(|p| p.used || unused.is_some());
        let sum: f64 = counted().map(|p| p.error_px.norm_squared()).sum();
        let rms_px = (counted().count() > 0).then(|| (sum / counted().count() as f64).sqrt());
        ViewFit { unused, X_CO, rms_px, points }
    };
    views.iter().zip(unused).enumerate().map(fit).collect()
}

/// Pose of a board in a camera that is known.
fn board_pose(camera: &CameraModel, view: &BoardView) -> Option<Pose> {
    let flat: PlaneView = view.iter().map(|p| (p.p_O.coords.xy(), p.px)).collect();
    let start = start::pose(camera, &flat).0?;
    let points: Vec<_> = (view.iter())
        .map(|p| PixelCorrespondence { r: p.p_O, px: p.px, covariance_px2: Matrix2::identity() })
        .collect();
    Some(refine_pixels(&start, &points, camera, Loss::Squares).map_or(start, |end| end.X_CO))
}
