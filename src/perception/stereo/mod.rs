//! Two views of one scene, Sect. 10.4: epipolar geometry, triangulation, and the motion between the views.
//!
//! | function | equations | for |
//! |---|---|---|
//! | [`essential_matrix`], [`fundamental_matrix`], [`epipoles`], [`epipolar_line_1`], [`epipolar_line_2`] | (10.43)-(10.46) | known poses |
//! | [`fundamental_8_point`], [`essential_8_point`], [`essential_5_point`] | (10.46) | from conjugate points |
//! | [`relative_pose`], [`refine_relative`], [`RelativeConsensus`] | (10.46) | displacement of the camera |
//! | [`degenerate_motion`] | Sect. 10.4.3 | whether one displacement is the answer: points of a plane, a camera that turned alone |
//! | [`triangulate_linear`], [`triangulate_parallel`], [`Triangulator`] | (10.47)-(10.53) | depth |
//! | [`absolute_orientation`], [`absolute_orientation_weighted`] | (10.54)-(10.57) | displacement of a triangulated object |
//! | [`plane_motion`] | (10.58)-(10.61) | displacement from a plane, both solutions |
//! | [`Rectification`] | before (10.51) | parallel and aligned image planes |
//! | [`ConjugateSearch`] | Sect. 10.4.1 | the conjugate of a point along its epipolar line |
//!
//! `X_12` is the pose of camera 2 in camera 1 (T_2^1 of the textbook). Image coordinates are normalized and free of distortion
//! unless called px; lengths are metres, or the base line's where only images are given.

mod absolute_orientation;
mod conjugate;
mod consensus;
mod degenerate;
mod eight_point;
mod epipolar;
mod five_point;
mod plane_motion;
mod rectification;
mod relative_pose;
mod root_finding;
#[cfg(test)]
mod testing;
mod triangulation;

pub use absolute_orientation::{
    AbsoluteOrientation, MeasuredPair, absolute_orientation, absolute_orientation_weighted,
};
pub use conjugate::{Conjugate, ConjugateSearch, ConjugateSettings, NoConjugate};
pub use consensus::{RelativeConsensus, RelativeConsensusPose};
pub use degenerate::{DegenerateMotion, degenerate_motion, turn_beside_plane};
pub use eight_point::{essential_8_point, fundamental_8_point};
pub use epipolar::{
    Conjugates, epipolar_line_1, epipolar_line_2, epipoles, essential_matrix, fundamental_matrix,
    line_distance, sampson_error2,
};
pub use five_point::{EssentialMatrices, essential_5_point};
pub use plane_motion::{PlaneMotion, plane_motion, plane_motion_consistent};
pub use rectification::{Rectification, RectificationMap};
pub use relative_pose::{RefinedRelativePose, refine_relative, relative_pose, relative_poses};
pub use triangulation::{TriangulatedPoint, Triangulator, triangulate_linear, triangulate_parallel};

use crate::pose::PoseError;
use thiserror::Error;

/// Why two views do not tell what was asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum StereoError {
    /// Fewer points than the method needs.
    #[error("stereo: {given} points given, at least {needed} are needed; match more of the scene")]
    TooFewPoints {
        /// Points that the method needs.
        needed: usize,
        /// Points given, or those that agree.
        given: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error("stereo: point {index} has a coordinate that is not finite; drop it")]
    NotFinite {
        /// Index of the first such point.
        index: usize,
    },
    /// A pose, a setting or a noise that cannot be.
    #[error("stereo: the start, a setting or the noise is not a usable number")]
    BadGuess,
    /// The points or poses do not fix what is asked for: one plane, one line, no base line, parallel rays.
    #[error(
        "stereo: the points, or the base line, do not fix the answer; spread the points or move the camera more"
    )]
    Degenerate,
    /// The answer would have a point behind a camera.
    #[error("stereo: a point would lie behind a camera; check the matches and the order of the views")]
    BehindCamera,
    /// The refinement did not settle.
    #[error("stereo: no convergence in {iterations} iterations; start nearer or use more points")]
    NotConverged {
        /// Iterations spent.
        iterations: u32,
    },
}

impl From<PoseError> for StereoError {
    fn from(error: PoseError) -> Self {
        match error {
            PoseError::TooFewPoints { needed, given } => Self::TooFewPoints { needed, given },
            PoseError::NotFinite { index } => Self::NotFinite { index },
            PoseError::BadGuess => Self::BadGuess,
            PoseError::Degenerate => Self::Degenerate,
            PoseError::BehindCamera => Self::BehindCamera,
            PoseError::NotConverged { iterations } => Self::NotConverged { iterations },
        }
    }
}
