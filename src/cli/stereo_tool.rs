//! `vservo stereo`: two views of one scene, Sect. 10.4 and the homography of Sect. 10.4.4, on points and images in files.

mod hints;
mod look;
mod matching;
mod motion;
mod motion_answer;
mod pairs;
mod recorded;
mod rectify;
mod structure;
mod triangulate;

use super::StereoCommand;
use crate::process::ProcessError;
use nalgebra::{Matrix3, Vector3};

/// Does what was asked; the exit code.
pub(super) fn stereo(command: &StereoCommand) -> Result<u8, ProcessError> {
    match command {
        StereoCommand::Match(arguments) => matching::find(arguments),
        StereoCommand::Rectify(arguments) => rectify::rectify(arguments),
        StereoCommand::Triangulate(arguments) => triangulate::triangulate(arguments),
        StereoCommand::Motion(arguments) => motion::motion(arguments),
    }
}

/// Why there is no answer, with the exit code.
type Refused = (String, u8);

/// Rows of a matrix.
fn rows(m: &Matrix3<f64>) -> [[f64; 3]; 3] {
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| m[(i, j)]))
}

/// A homogeneous point as coordinates; `None` at infinity.
fn finite(p: &Vector3<f64>) -> Option<[f64; 2]> {
    // Otherwise the point is at infinity, up to rounding.
    (p.z.abs() > 1e-12 * p.norm()).then(|| [p.x / p.z, p.y / p.z])
}
