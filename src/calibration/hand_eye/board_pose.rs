//! Where the board is in the camera, from one picture: the output of Sect. 10.3, refined in pixels.

use super::{HandEyeError, HandEyeView};
use crate::camera_model::CameraModel;
use crate::pose::{Correspondence3, Loss, PixelCorrespondence, RefinedPixelPose, pnp, refine_pixels};
use nalgebra::Matrix2;

/// The loss of single corners, in standard deviations: beyond it they pull no more than there.
pub(super) const CORNER_LOSS: Loss = Loss::Huber(4.0);

/// The board's pose in the camera.
pub(super) fn board_pose(view: &HandEyeView, camera: &CameraModel) -> Result<RefinedPixelPose, HandEyeError> {
    let named = |cause| HandEyeError::BoardPose { view: view.name.clone(), cause };
    let points: Vec<_> = view
        .corners
        .iter()
        .map(|corner| Correspondence3 { r: corner.p_O, s: camera.normalized_of(&corner.px) })
        .collect();
    let pixels: Vec<_> = view
        .corners
        .iter()
        .map(|corner| PixelCorrespondence {
            r: corner.p_O,
            px: corner.px,
            covariance_px2: Matrix2::identity() * (corner.sd_px * corner.sd_px),
        })
        .collect();
    let start = pnp(&points).map_err(named)?.best().X_CO;
    refine_pixels(&start, &pixels, camera, CORNER_LOSS).map_err(named)
}
