//! Distinguishes samples taken in motion from those taken at rest: by the joints' velocities, by poses that follow each other, or by what the
//! corners do from one image to the next.
//!
//! An image and a robot pose are never of the same moment; what the image moves in the meantime is an error of the sample.

use super::HandEyeView;
use crate::camera_model::CameraModel;
use crate::detect::Detection;
use crate::geometry::{Pose, Twist};

/// Assumed difference between the clocks' stamps of robot and camera where they are not calibrated, s. Chosen by hand: half a frame at 25 Hz.
const STAMPS_S: f64 = 0.02;
/// Largest motion of the image in that time that counts as rest, px. Chosen by hand: the error of corners with an inexact lens.
const SETTLED_PX: f64 = 0.3;

/// Whether an image that moves at this speed, px/s, counts as taken at rest: within 20 ms, by which stamps of robot and camera may
/// lie apart, it moves by no more than 0.3 px. NaN is no rest.
#[must_use]
pub fn is_settled(speed_px_s: f64) -> bool {
    speed_px_s * STAMPS_S <= SETTLED_PX
}

/// Speed of the image at most, px/s, of a flange that moves at `V_BE_E` with the board at the distance `distance_m` from the camera:
/// `f (|v| / z + |w|)`, the lever between camera and flange left aside.
#[must_use]
pub fn flange_speed_px_s(camera: &CameraModel, V_BE_E: &Twist, distance_m: f64) -> f64 {
    let i = camera.intrinsics();
    let f_px = i.fx_px.max(i.fy_px);
    let (v, w) = (V_BE_E.fixed_rows::<3>(0).norm(), V_BE_E.fixed_rows::<3>(3).norm());
    f_px * (v / distance_m + w)
}

/// How fast the corners move from one image to the next, `dt_s` later: root mean square over the corners seen in both, less what their
/// own deviations explain, px/s. `None` without common corners or time.
#[must_use]
pub fn corner_speed_px_s(before: &[Detection], now: &[Detection], dt_s: f64) -> Option<f64> {
    let (mut squares, mut noise, mut count) = (0.0, 0.0, 0.0);
    for point in now {
        let Some(was) = before.iter().find(|was| was.id == point.id) else { continue };
        squares += (point.px - was.px).norm_squared();
        noise += 2.0 * (point.sd_px.powi(2) + was.sd_px.powi(2));
        count += 1.0;
    }
    (count > 0.0 && dt_s > 0.0).then(|| ((squares - noise).max(0.0) / count).sqrt() / dt_s)
}

/// Speed of a view's image by the flange's stated twist, px/s; `None` where none is stated.
pub(super) fn view_speed_px_s(view: &HandEyeView, camera: &CameraModel, X_CO: &Pose) -> Option<f64> {
    // nearer no lens is in focus; at 0 the speed would be infinite
    let distance_m = X_CO.translation.z.max(1e-3);
    view.V_BE_E.map(|V| flange_speed_px_s(camera, &V, distance_m))
}
