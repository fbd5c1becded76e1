//! Lens, mount, stamps and size of the target refined from what a run has seen anyway: `vservo calibrate from RUN`.
//!
//! ```text
//! recording or report ─► [`RunViews`]: joints, points of the target ─► problem: joint least squares with priors ─► [`RunRefinement`]
//! ```
//! ```text
//! px_ij = K( X_WC(q(t_i + tau))^-1 X_WO (size P_j) )        view i with stamp t_i, point j of a target that rests
//! ```
//! Unknown are focal lengths, principal point and first radial coefficient of the lens, the mount of the camera, the pose of the target, the offset of
//! the stamps and the size of the target. A run is no calibration: it goes from a start to a goal, and shows some of them and mixtures of others. So each has a
//! prior, the run file with a standard deviation that is stated, and what a run has not made at least twice as certain as that is told
//! as not seen, with the motion that would show it. What is left uncertain makes the pose in which the run has ended uncertain ([`EndPose`]). The size of the target shows because the joints are metric.

mod end_pose;
mod odd_point;
mod problem;
mod refinement;
mod unknowns;
mod views;

pub use end_pose::{CONFIDENCE, DescribedPart, EndPose};
pub(crate) use odd_point::odd_point;
pub use problem::{RunFit, fit_run};
pub use refinement::{RefinedNumber, RunRefinement, RunRefinementError};
pub(crate) use views::NEW_PX;
pub use views::{RunCell, RunViews, SeenPoint, SeenView};

#[cfg(test)]
mod tests;
