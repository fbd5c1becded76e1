//! Pose of an object from the image of its points, Sect. 10.3 and 10.4.4.
//!
//! | function | equations | for |
//! |---|---|---|
//! | [`homography`] | (10.7)-(10.10) | plane to image, or image to image (10.61) |
//! | [`pose_from_homography`] | (10.8), (10.11), (10.12) | one pose from a homography |
//! | [`planar_pose`] | (10.8)-(10.12) and beyond | both planar solutions, refined and ranked |
//! | [`dlt_pose`], [`dlt_camera`] | (10.13) | six or more points that are not coplanar; in pixels, with the camera's own matrix (5.41) unknown too |
//! | [`p3p`] | (10.6) | three points, all solutions |
//! | [`pnp`] | (10.6) | any three points or more: the global minimum of the reprojection error, and others that are close |
//! | [`PoseConsensus`] | (10.6) | points with outliers |
//! | [`refine`], [`refine_3d`] | least squares on (10.36) | from a start value to the optimum, with covariance |
//! | [`refine_pixels`] | least squares on (10.36) | the same in pixels: lens, covariances of points, outliers |
//! | [`object_in_base`], [`object_in_effector`] | (10.14), (10.15) | the pose in the base or end-effector frame |
//! | [`algorithmic_step`], [`algorithmic_step_4`], [`algorithmic_step_segment`] | (10.28), (10.33)-(10.42) | the textbook's integration |
//! | [`virtual_servoing`], [`virtual_servoing_4`] | (10.40)-(10.42) | the same from points and segments, until convergence |
//! | [`decompose_homography`] | (10.58)-(10.61) | displacement of a camera from two images of a plane |
//!
//! Image coordinates are normalized and free of distortion; lengths are metres. Nothing here allocates up
//! to 64 points ([`PoseConsensus`] once), and the results are the same to the last bit on every machine with IEEE arithmetic
//! (but for the logarithm of [`Loss::Cauchy`]).

mod algorithmic;
mod decompose;
mod dlt;
mod frames;
mod homography;
mod linear;
mod minima;
mod p3p;
mod planar;
mod pnp;
mod points;
mod ransac;
mod refine;
mod refine_pixels;
mod rotation_form;
mod rotation_grid;
#[cfg(test)]
mod testing;
mod virtual_servoing;

pub use algorithmic::{
    AlgorithmicStep, algorithmic_step, algorithmic_step_4, algorithmic_step_segment, euler_zyx_rotation,
};
pub use decompose::{
    HomographySolution, HomographySolutions, decompose_homography, decompose_homography_seen,
};
pub use dlt::{LinearCamera, dlt_camera, dlt_pose};
pub use frames::{chained_covariance, object_in_base, object_in_effector};
pub use homography::{homography, pose_from_homography};
pub use minima::PnpPoses;
pub use p3p::{P3pPoses, p3p};
pub use planar::{PlanarPose, planar_pose};
pub use pnp::pnp;
pub use points::{Correspondence, Correspondence3, PointSource, PoseSolution, reprojection_rms};
pub use ransac::{ConsensusPose, ConsensusResult, ConsensusSettings, PoseConsensus};
pub use refine::{RefinedPose, refine, refine_3d};
pub use refine_pixels::{Loss, PixelCorrespondence, RefinedPixelPose, normalized_error, refine_pixels};
pub use virtual_servoing::{
    ObjectFeature, VirtualPose, VirtualServoing, virtual_servoing, virtual_servoing_4, virtual_step,
    virtual_step_4,
};

use thiserror::Error;

/// Why no pose was computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum PoseError {
    /// The problem has more unknowns than the points give equations.
    #[error("pose: {given} points given, at least {needed} are needed; see more of the target")]
    TooFewPoints {
        /// Points that the method needs.
        needed: usize,
        /// Points given.
        given: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error("pose: point {index} has a coordinate that is not finite; drop it before asking for a pose")]
    NotFinite {
        /// Index of the first such point.
        index: usize,
    },
    /// The start value given to a refinement is NaN or infinite, or the noise is negative or not finite.
    #[error("pose: the start pose or the noise is not finite; start from `planar_pose` or `dlt_pose`")]
    BadGuess,
    /// The points do not determine the pose: collinear, repeated, coplanar where they must not be, or on one visual ray.
    #[error("pose: the points are collinear, repeated or otherwise degenerate; use points that spread more")]
    Degenerate,
    /// No solution has all points in front of the camera.
    #[error("pose: some points would lie behind the camera; check their order and the start pose")]
    BehindCamera,
    /// The refinement did not converge.
    #[error("pose: no convergence in {iterations} iterations; start nearer or use more points")]
    NotConverged {
        /// Iterations spent.
        iterations: u32,
    },
}
