//! The unknowns of a refinement, their prior, and what they make of lens and mount.

use crate::calibration::lens_check::lens_at;
use crate::camera_model::CameraModel;
use crate::geometry::{Twist, integrate_body_twist};
use crate::robot::Mount;
use nalgebra::{SVector, Vector5};

/// Logarithms of focal length and of its vertical to its horizontal part; principal point over focal length, x and y; first radial coefficient; twist of the mount in
/// C; twist of the target in O; offset of the stamps, s; logarithm of the target's size: 2 + 2 + 1 + 6 + 6 + 1 + 1, from which each place follows.
pub(super) const UNKNOWNS: usize = 19;
pub(super) const MOUNT: usize = 5;
pub(super) const OBJECT: usize = 11;
pub(super) const STAMPS: usize = 17;
pub(super) const SIZE: usize = 18;
/// Standard deviations of the prior. Chosen by hand, what a data sheet, a ruler and a driver are wrong by: focal length 10 %, its ratio 1 %, principal point 5 % of the focal length,
/// k1 0.1, mount 20 mm and 3 degrees, stamps 30 ms, size 5 %. Of the target's pose nothing is known: 10 m and rad.
pub(super) const PRIOR: [f64; UNKNOWNS] = [
    0.1, 0.01, 0.05, 0.05, 0.1, 0.02, 0.02, 0.02, 0.0524, 0.0524, 0.0524, 10.0, 10.0, 10.0, 10.0, 10.0, 10.0,
    0.03, 0.05,
];
pub(super) type RunUnknowns = SVector<f64, UNKNOWNS>;

/// The lens of the unknowns.
pub(super) fn lens_of(camera: &CameraModel, at: &RunUnknowns) -> Option<CameraModel> {
    lens_at(camera, &Vector5::from(at.fixed_rows::<5>(0)))
}

/// The mount of the unknowns.
pub(super) fn mount_of(mount: &Mount, at: &RunUnknowns) -> Mount {
    let xi: Twist = at.fixed_rows::<6>(MOUNT).into();
    mount.with_pose(integrate_body_twist(mount.pose(), &xi, 1.0))
}
