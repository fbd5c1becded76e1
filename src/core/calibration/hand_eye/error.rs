//! Why there is no hand-eye calibration.

use super::MAX_VIEWS;
use crate::pose::PoseError;
use thiserror::Error;

/// Why there is none.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum HandEyeError {
    /// Two motions are the least, or one view of a board whose pose is known.
    #[error(
        "hand-eye: {given} usable views, at least {needed} are needed (better 10 to 20): take more images"
    )]
    TooFewViews {
        /// How many there are.
        given: usize,
        /// How many there would have to be.
        needed: usize,
    },
    /// More than are taken.
    #[error("hand-eye: {given} views, at most {MAX_VIEWS} are taken: leave some out")]
    TooManyViews {
        /// How many there are.
        given: usize,
    },
    /// A number that is none.
    #[error("hand-eye: view `{view}`: {what} is not a finite number: see to the poses file")]
    NotFinite {
        /// Which.
        view: String,
        /// What.
        what: &'static str,
    },
    /// A setting that cannot be.
    #[error("hand-eye: {what} must be a number that is not negative (a deviation of corners: positive)")]
    Setting {
        /// Which.
        what: &'static str,
    },
    /// An image does not tell where the board is.
    #[error("hand-eye: view `{view}` does not tell the board's pose ({cause}): leave it out")]
    BoardPose {
        /// Which.
        view: String,
        /// Why.
        cause: PoseError,
    },
    /// The arm only shifted the camera: anything would fit the camera's position.
    #[error(
        "hand-eye: the arm has hardly turned between the views (by {largest_deg:.2} deg at most), so that the position of the \
         camera does not show: turn the flange by 30 deg and more, about two axes at least"
    )]
    NoRotation {
        /// Largest angle between any two views, degrees.
        largest_deg: f64,
    },
    /// All motions turn about one axis: the camera's position along it is not determined.
    #[error(
        "hand-eye: all views turn about one axis, ({:.2}, {:.2}, {:.2}) in the frame of the {bearer} (about others by {across_deg:.2} \
         deg only), so that the position of the camera along it does not show: tilt the flange about another axis too",
        .axis[0], .axis[1], .axis[2]
    )]
    OneAxis {
        /// Unit vector in M.
        axis: [f64; 3],
        /// What bears the camera.
        bearer: &'static str,
        /// How far the views turn about other axes, root mean square, degrees.
        across_deg: f64,
    },
    /// The arm turns by other angles than the camera.
    #[error(
        "hand-eye: between the views the arm turns by other angles than the camera ({difference_deg:.1} deg apart, root mean \
         square): the poses are those of other images, in another order, or their rotations are written in another way"
    )]
    Contradiction {
        /// Root mean square over all pairs, degrees.
        difference_deg: f64,
    },
    /// A closed form has no solution.
    #[error(
        "hand-eye: the views contradict each other so much that no start is found: check the pairing of poses and images"
    )]
    NoStart,
    /// The other place of the eye explains the views far better.
    #[error(
        "hand-eye: the views do not fit an eye {here} (the board's places scatter by {here_mm:.1} mm), but one {there} \
         ({there_mm:.1} mm): {}", if *.there == super::CameraMount::EyeToHand.words() { "--eye-to-hand" } else { "leave --eye-to-hand out" }
    )]
    OtherPlace {
        /// As it was said.
        here: &'static str,
        /// The other.
        there: &'static str,
        /// Scatter, mm.
        here_mm: f64,
        /// Scatter for the other, mm.
        there_mm: f64,
    },
    /// The refinement has some point behind the camera.
    #[error(
        "hand-eye: view `{view}` would have the board behind the camera: its pose does not belong to its image, or the eye's \
         place (in hand, beside the arm) is the other one"
    )]
    Behind {
        /// Which.
        view: String,
    },
    /// The normal equations have no solution.
    #[error(
        "hand-eye: the views do not determine {what}: add views with other rotations and, for the time offset, velocities"
    )]
    Undetermined {
        /// What.
        what: &'static str,
    },
    /// No end.
    #[error("hand-eye: no convergence in {iterations} steps: the views contradict each other")]
    NotConverged {
        /// Steps taken.
        iterations: u32,
    },
}
