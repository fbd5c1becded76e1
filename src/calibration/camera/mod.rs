//! Calibration of one camera from pictures of a board, Sect. 10.5, and how good it is.
//!
//! ```text
//! corners ─► start (10.64)-(10.67) ─► joint least squares, outliers named ─► CameraCalibration: camera, covariance, poses
//!                                                                                 │
//!         ProjectionUncertainty: px, anywhere in the image, at a distance ◄───────┤
//!         cross_validation: halves of the pictures against each other     ◄───────┤
//!         ImageCoverage: where corners were seen                          ◄───────┤
//!         next_view: the picture that lowers the worst uncertainty most   ◄───────┘
//!         CalibrationVerdict: all of that in words
//! ```

mod board_view;
mod calibrate;
mod error;
mod settings;
mod start;

pub use board_view::{BoardPoint, BoardView};
pub(crate) use board_view::{BoardExtent, usable};
pub use calibrate::{CameraCalibration, PointFit, ViewFit, calibrate_camera};
pub use error::{CameraCalibrationError, Unused};
pub use settings::CalibrationSettings;
pub(crate) use calibrate::{board_pose, fits};

/// Fewest corners of a picture: its pose takes six of their equations.
pub const LEAST_POINTS: usize = 6;
