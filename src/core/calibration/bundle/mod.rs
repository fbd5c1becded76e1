//! Joint least squares over all that images of one board tell: lenses, poses of the cameras to each other, shape of the
//! board, and where the board was in each image.
//!
//! ```text
//! minimise  sum rho(e^T C^-1 e),   e = px seen - px(optics_j, X_j0 X_0O_i p_O),   C: covariance of the corner
//!
//! | U    W_1  W_2 .. | |shared |   |g  |     U: shared unknowns (optics of each camera, X_j0, warp)
//! | W_1' V_1         | |pose 1 | = |h_1|     V_i: 6 x 6, pose of the board in view i
//! | W_2'      V_2    | |pose 2 |   |h_2|
//!
//! (U - sum W_i V_i^-1 W_i') shared = g - sum W_i V_i^-1 h_i          the views are eliminated: a bordered block matrix
//! ```
//! One camera is a rig of one, a stereo pair one of two. Steps are damped by Levenberg and Marquardt's rule. Units: px, m, rad.

mod adjust;
mod dropped;
mod equations;
mod optics;
mod problem;
mod rows;
mod select;

pub(crate) use adjust::{BundleFailure, adjust};
pub(crate) use dropped::{covariance_with_dropped, expected_coefficient};
pub(crate) use equations::{BundleSums, covariance_of};
pub(crate) use optics::PointImage;
pub use optics::{Freedom, Optics};
pub(crate) use problem::{BoardObservation, BundlePoint, BundleProblem, BundleState};
pub(crate) use select::{Misfit, Selected, adjust_selected, median};

#[cfg(test)]
mod tests;
