//! The mounts of a camera that turn each law away from its goal, and how the image moves before each.

use crate::geometry::Pose;
use nalgebra::Vector3;
use std::f64::consts::{FRAC_PI_2, TAU};

/// Turns that are tried, in a whole one. Chosen by hand: 5 degrees beside the true turn leave 0.8 % of the displacement's square.
const TURNS: u16 = 36;
/// Least turn that turns a law away, rad. Measured: with 50 degrees UR5, Panda, xArm7 and two of four SCARAs converge, with 90 none does.
const TURNED: f64 = 1.2;

/// How a camera is not as it is told, such that a law leads away from its goal, or to another one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CameraError {
    /// The camera is turned about its optical axis against `camera.mount`, by so many quarters, 1 to 3.
    Turned(u8),
    /// Its axes are others, or have other signs, or its images are mirrored.
    OtherAxes,
    /// Its focal length is more than half as long again as `camera.lens` says.
    LongerLens,
    /// The same, shorter by as much.
    ShorterLens,
}

/// A mount that is wrong, or images that are.
#[derive(Debug, Clone, Copy)]
pub(super) enum WrongMount {
    /// The true camera is turned by this against the believed one.
    Turned(Pose),
    /// This axis of the images is reversed.
    Mirrored(usize),
}

impl WrongMount {
    /// The motion that is seen where the believed camera goes by `X_CB`.
    pub(super) fn motion(&self, X_CB: &Pose) -> Pose {
        match self {
            Self::Turned(R) => R.inv_mul(X_CB) * *R,
            Self::Mirrored(axis) => mirrored(X_CB, *axis),
        }
    }
}

/// The mounts that are tried: turned about the optical axis, all others by right angles, and mirrors. Those by which a law still finds its goal are no error.
pub(super) fn wrong_mounts() -> impl Iterator<Item = (WrongMount, Option<CameraError>)> {
    let turned = |axis: Vector3<f64>| Pose::new(Vector3::zeros(), axis);
    let about_z = (1..TURNS).map(move |k| {
        let turn = TAU * f64::from(k) / f64::from(TURNS);
        let quarters = ((turn / FRAC_PI_2).round() as u8).clamp(1, 3);
        let is_wrong = (TURNED..=TAU - TURNED).contains(&turn);
        (WrongMount::Turned(turned(Vector3::z() * turn)), is_wrong.then_some(CameraError::Turned(quarters)))
    });
    let tilts = [Vector3::x(), -Vector3::x(), Vector3::y(), -Vector3::y(), Vector3::x() * 2.0];
    let others = tilts.into_iter().flat_map(move |tilt| {
        let tilt = turned(tilt * FRAC_PI_2);
        (0..4).map(move |k| WrongMount::Turned(tilt * turned(Vector3::z() * (FRAC_PI_2 * f64::from(k)))))
    });
    let mirrors = [0, 1].map(WrongMount::Mirrored);
    about_z.chain(others.chain(mirrors).map(|mount| (mount, Some(CameraError::OtherAxes))))
}

/// The motion that is seen in images in which this axis, 0 for x and 1 for y, is reversed: a reflection about it on both sides.
fn mirrored(X: &Pose, axis: usize) -> Pose {
    let (mut t, mut r) = (X.translation.vector, X.rotation.scaled_axis());
    // A rotation vector is an axial one: a reflection keeps its component along the axis, and reverses the others.
    t[axis] = -t[axis];
    r = -r;
    r[axis] = -r[axis];
    Pose::new(t, r)
}
