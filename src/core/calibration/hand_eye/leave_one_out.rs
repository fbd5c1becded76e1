//! Each view predicted from the others alone: the error that nobody has fitted away.

use super::joint::{JointFit, JointSettings, refine_jointly};
use super::observability::rotation_spread;
use super::rows::{ArmAt, ViewRows, board_in_camera};
use super::scatter::board;
use super::{HandEyeView, LoopSample, MIN_VIEWS};
use crate::camera_model::CameraModel;
use crate::geometry::Twist;

/// A view against the prediction of the others.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HeldOutView {
    /// Where this view has the board in W, turned against where the others have it, rad.
    pub rotation_rad: f64,
    /// The same for the position of the board's origin, m.
    pub position_m: f64,
    /// Distance of its corners from where the others expect them, root mean square, px; infinite where they expect the board behind the
    /// camera.
    pub rms_px: f64,
}

/// All views against the predictions of the others.
#[derive(Debug, Clone, PartialEq)]
pub struct HeldOut {
    /// By view; `None` where the others alone do not determine the camera's pose.
    pub views: Vec<Option<HeldOutView>>,
    /// Root mean square, rad, as [`super::LoopScatter`] counts.
    pub rotation_rad: f64,
    /// The same, m.
    pub position_m: f64,
    /// Root mean square of the views' `rms_px`, px.
    pub rms_px: f64,
}

/// Fits all views but one, for each of them, from the end of the fit of all. `None` where no fit is possible: of three views, two do
/// not determine anything, unless the board's pose is known.
///
/// `samples`: each view's loop, for the poses of the board as its own image has them.
#[must_use]
pub fn leave_one_out(
    views: &[&HandEyeView],
    samples: &[LoopSample],
    camera: &CameraModel,
    settings: &JointSettings,
    all: &JointFit,
) -> Option<HeldOut> {
    let fewest = if settings.known_board { 1 } else { MIN_VIEWS };
    if views.len() <= fewest || samples.len() != views.len() {
        return None;
    }
    let mut held = Vec::with_capacity(views.len());
    for (i, (view, sample)) in views.iter().zip(samples).enumerate() {
        let others: Vec<_> = without(views, i);
        let enough = settings.known_board
            || rotation_spread(&without(samples, i)).is_some_and(|s| s.check(settings.place).is_ok());
        let fit =
            if enough { refine_jointly(&others, camera, settings, &all.X_MC, &all.X_WO).ok() } else { None };
        held.push(fit.map(|fit| against(view, sample, camera, settings, &fit)));
    }
    let sure: Vec<_> = held.iter().flatten().copied().collect();
    if sure.is_empty() {
        return None;
    }
    let count = sure.len() as f64;
    let mean = |of: &dyn Fn(&HeldOutView) -> f64| sure.iter().map(|v| of(v).powi(2)).sum::<f64>() / count;
    Some(HeldOut {
        rotation_rad: mean(&|v| v.rotation_rad).sqrt(),
        position_m: mean(&|v| v.position_m).sqrt(),
        rms_px: mean(&|v| v.rms_px).sqrt(),
        views: held,
    })
}

fn without<T: Copy>(all: &[T], left_out: usize) -> Vec<T> {
    all.iter().enumerate().filter(|(i, _)| *i != left_out).map(|(_, one)| *one).collect()
}

fn against(
    view: &HandEyeView,
    sample: &LoopSample,
    camera: &CameraModel,
    settings: &JointSettings,
    fit: &JointFit,
) -> HeldOutView {
    let V_BE_E = view.V_BE_E.filter(|_| settings.time_offset).unwrap_or_else(Twist::zeros);
    let arm = ArmAt { place: settings.place, X_BE: view.X_BE, V_BE_E };
    // the loop with the flange where it was at the image: X_WM X_MC = X_WO X_CO^-1
    let X_WC = fit.X_WO * board_in_camera(&fit.X_MC, &fit.X_WO, &arm, fit.offset_s).inverse();
    let X_WM = X_WC * fit.X_MC.inverse();
    let place = board(&LoopSample { X_WM, X_CO: sample.X_CO }, &fit.X_MC);
    HeldOutView {
        rotation_rad: place.rotation.angle_to(&fit.X_WO.rotation),
        position_m: (place.translation.vector - fit.X_WO.translation.vector).norm(),
        rms_px: rms_px(view, camera, &ViewRows::new(&fit.X_MC, &fit.X_WO, arm, fit.offset_s)),
    }
}

/// Distance of the view's corners from their predicted images, root mean square, px.
pub(super) fn rms_px(view: &HandEyeView, camera: &CameraModel, rows: &ViewRows) -> f64 {
    let mut squares = 0.0;
    for corner in &view.corners {
        match rows.image(corner, camera) {
            Some(px) => squares += (px - corner.px).norm_squared(),
            None => return f64::INFINITY,
        }
    }
    (squares / view.corners.len().max(1) as f64).sqrt()
}
