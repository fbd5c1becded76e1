//! Whether the robot's rotations are quaternions in the order w x y z that were read as x y z w.

use super::{HandEyeError, HandEyeReport, HandEyeSettings, HandEyeView, calibrate_hand_eye};
use crate::camera_model::CameraModel;
use crate::geometry::{Pose, rotate_twist};
use nalgebra::{Quaternion, UnitQuaternion};

/// Rotations of camera and robot that agree to this belong together, rad: 1 degree. Chosen, since those of other images or another order
/// differ by tens of degrees.
const ALIKE_RAD: f64 = 0.017;

/// The views with the four numbers of each rotation, which were taken as x y z w, taken as w x y z.
fn reordered(views: &[HandEyeView]) -> Vec<HandEyeView> {
    let one = |view: &HandEyeView| {
        let [w, x, y, z]: [f64; 4] = view.X_BE.rotation.coords.into();
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        // the file has velocities along the axes of the base: those stay
        let R_new_old = rotation.inverse().to_rotation_matrix() * view.X_BE.rotation.to_rotation_matrix();
        HandEyeView {
            X_BE: Pose::from_parts(view.X_BE.translation, rotation),
            V_BE_E: view.V_BE_E.map(|V| rotate_twist(&R_new_old, &V)),
            ..view.clone()
        }
    };
    views.iter().map(one).collect()
}

/// Whether views of which `as_x_y_z_w` came fit once their quaternions are read as w x y z: then without contradicting the robot or, where
/// they could not be calibrated at all, within `ALIKE_RAD`.
#[must_use]
pub fn fits_as_w_x_y_z(
    views: &[HandEyeView],
    camera: &CameraModel,
    settings: &HandEyeSettings,
    as_x_y_z_w: &Result<HandEyeReport, HandEyeError>,
) -> bool {
    let failed = as_x_y_z_w.is_err();
    if !as_x_y_z_w.as_ref().is_ok_and(|report| !report.is_contradicted()) {
        return calibrate_hand_eye(&reordered(views), camera, settings).is_ok_and(|other| {
            !other.is_contradicted() || (failed && other.robot_seen.rotation_rad < ALIKE_RAD)
        });
    }
    false
}
