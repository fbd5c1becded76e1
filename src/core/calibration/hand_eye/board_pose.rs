//! Where the board is in the camera, from one image: the output of Sect. 10.3, refined in pixels; and how far lens and board are from
//! their description, which no deviation of a corner tells.

use super::{BoardCorner, HandEyeError, HandEyeView};
use crate::camera_model::CameraModel;
use crate::geometry::Pose;
use crate::pose::{Correspondence3, Loss, PixelCorrespondence, pnp, refine_pixels};
use nalgebra::Matrix2;

/// Robust loss of single corners: beyond this many standard deviations the influence no longer grows. Chosen by hand: by noise alone one corner in
/// 3000 lies beyond 4 (`exp(-8)`), so that good corners keep their weight.
pub(super) const CORNER_LOSS: Loss = Loss::Huber(4.0);
/// Corners deviate more than stated where chi-square is this many of its own standard deviations above its mean.
const SURE: f64 = 3.0;

/// The board's pose in the camera, `near` a guess where there is one; and the sum of `|e|^2 / sd^2` of its corners.
pub(super) fn board_pose(
    view: &HandEyeView,
    camera: &CameraModel,
    near: Option<&Pose>,
    loss: Loss,
) -> Result<(Pose, f64), HandEyeError> {
    let named = |cause| HandEyeError::BoardPose { view: view.name.clone(), cause };
    let start = match near {
        Some(near) => *near,
        None => {
            let normalized =
                |corner: &BoardCorner| Correspondence3 { r: corner.p_O, s: camera.normalized_of(&corner.px) };
            let points: Vec<_> = view.corners.iter().map(normalized).collect();
            pnp(&points).map_err(named)?.best().X_CO
        }
    };
    let pixel = |corner: &BoardCorner| PixelCorrespondence {
        r: corner.p_O,
        px: corner.px,
        covariance_px2: Matrix2::identity() * corner.sd_px.powi(2),
    };
    let pixels: Vec<_> = view.corners.iter().map(pixel).collect();
    let pose = refine_pixels(&start, &pixels, camera, loss).map_err(named)?;
    Ok((pose.X_CO, pose.chi_square))
}

/// How far corners lie from where lens and board have them, beyond their own deviations, of one standard deviation, px: 0 where the
/// deviations explain everything. `chi_square`: of all views' board poses.
pub(super) fn model_sd_px(views: &[HandEyeView], chi_square: f64) -> f64 {
    let corners: Vec<_> = views.iter().flat_map(|view| &view.corners).collect();
    let freedom = (2.0 * corners.len() as f64 - 6.0 * views.len() as f64).max(1.0);
    let mean = chi_square / freedom;
    if !(mean > 1.0 + SURE * (2.0 / freedom).sqrt()) {
        return 0.0;
    }
    // of all corners alike: what scales them is the harmonic mean of their variances
    let weight = corners.iter().map(|c| c.sd_px.powi(-2)).sum::<f64>() / corners.len().max(1) as f64;
    ((mean - 1.0) / weight).sqrt()
}
