//! Calibration of one camera from images of a board, Sect. 10.5, and how good it is.
//!
//! ```text
//! corners ─► start (10.64)-(10.67) ─► joint least squares, outliers named ─► CameraCalibration: camera, covariance, poses
//!                                                                                 │
//!         ProjectionUncertainty: px, anywhere in the image, at a distance ◄───────┤
//!         cross_validation: halves of the images against each other     ◄───────┤
//!         ImageCoverage: where corners were seen                          ◄───────┤
//!         board_bend: what the residuals say of the board's shape         ◄───────┤
//!         next_view: the image that lowers the worst uncertainty most   ◄───────┘
//!         CalibrationVerdict: all of that in words
//! ```
//! Points in space that are not in one plane tell a camera in one image: [`calibrate_in_space`].

mod bend;
mod board_view;
mod calibrate;
mod calibration;
mod coverage;
mod error;
mod fits;
mod halves;
mod in_space;
mod next_view;
mod settings;
mod start;
mod uncertainty;
mod verdict;

pub use bend::{BoardBend, board_bend};
pub(crate) use board_view::{BoardExtent, usable};
pub use board_view::{BoardPoint, BoardView};
pub use calibrate::calibrate_camera;
pub(crate) use calibrate::calibrate_keeping;
pub use calibration::{CameraCalibration, DroppedCoefficient, PointFit, ViewFit};
pub use coverage::ImageCoverage;
pub use error::{CameraCalibrationError, Unused};
pub(crate) use fits::{fits, result, rms_px};
pub use halves::{CrossValidation, cross_validation};
pub use in_space::{PointInSpace, PointLens, SpaceCalibration, SpaceCalibrationError, calibrate_in_space};
pub use next_view::{NextView, next_view};
pub use settings::CalibrationSettings;
pub use uncertainty::ProjectionUncertainty;
pub use verdict::CalibrationVerdict;

/// Fewest corners of an image. Chosen by hand: its pose takes six of their twelve equations, so that as many remain for the camera.
pub const MIN_POINTS: usize = 6;

#[cfg(test)]
mod tests;
