//! Whether the residuals show a board that is not flat.

use super::halves::FullSolution;
use super::{BoardView, CameraCalibration};
use crate::calibration::bundle::adjust;
use crate::pose::Loss;
use nalgebra::{Matrix2, Vector2};

/// Chi-square with two degrees of freedom exceeds this once in 10^6: a flat board is not called bent.
const BENT: f64 = 27.6;

/// A bend that a calibration with a flat board leaves in the residuals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BoardBend {
    /// Height of the board's middle over its edges by its shape along x_O and y_O (towards z_O), m.
    pub bend_m: Vector2<f64>,
    /// Standard deviations of these, m.
    pub sd_m: Vector2<f64>,
}

/// The bend of the board, estimated with everything else from the corners that took part. `None` where it was estimated already, where
/// the corners do not tell it, and where it is not told from none.
#[must_use]
pub fn board_bend(views: &[BoardView], calibration: &CameraCalibration) -> Option<BoardBend> {
    if calibration.warp_m.is_some() {
        return None;
    }
    let mut whole = FullSolution::new(views, calibration)?;
    whole.problem.warp = true;
    let end = adjust(&whole.problem, whole.state, Loss::Squares).ok()?;
    let factor = end.sums.chi_square / whole.problem.degrees_of_freedom().max(1) as f64;
    let from = whole.problem.warp_from();
    let covariance: Matrix2<f64> = end.sums.covariance()?.fixed_view::<2, 2>(from, from) * factor;
    let bend_m = end.state.warp_m;
    let distance2 = bend_m.dot(&(covariance.try_inverse()? * bend_m));
    (distance2 > BENT).then(|| BoardBend { bend_m, sd_m: covariance.diagonal().map(f64::sqrt) })
}
