//! `vservo calibrate camera`, `calibrate stereo` and `calibrate hand-eye`: images -> corners -> calibration -> files and answers;
//! `calibrate latency`: an excitation motion of the arm -> the offset of the camera's stamps; `calibrate load`: postures of the arm -> what it carries;
//! `calibrate from`: what a run has seen -> lens, mount, stamps and size of the target.

mod answer;
mod boards;
mod camera;
mod from_run;
mod hand_eye;
mod latency;
mod live;
mod load;
mod stage;
mod stereo;

pub(super) use camera::camera;
pub use from_run::CalibrateFromArguments;
pub(super) use from_run::from_run;
pub use hand_eye::HandEyeArguments;
pub(super) use hand_eye::hand_eye;
pub use latency::LatencyArguments;
pub(super) use latency::latency;
pub use load::LoadArguments;
pub(super) use load::load;
pub(super) use stereo::stereo;

use super::detect::refused;
use crate::calibration::camera::CameraCalibrationError;

/// Why a command ends before it has a result, with its exit code.
struct CalibrateError {
    message: String,
    exit_code: u8,
}

impl CalibrateError {
    /// What was asked for makes no sense.
    fn usage(message: impl Into<String>) -> Self {
        Self { message: message.into(), exit_code: 2 }
    }

    /// A file that is of no use.
    fn input(message: impl Into<String>) -> Self {
        Self { message: message.into(), exit_code: 3 }
    }

    /// With an exit code of its own.
    fn with_code(exit_code: u8, message: impl Into<String>) -> Self {
        Self { message: message.into(), exit_code }
    }

    /// Tells it; the exit code.
    fn tell(&self) -> u8 {
        refused(&self.message, self.exit_code)
    }
}

impl From<CameraCalibrationError> for CalibrateError {
    fn from(error: CameraCalibrationError) -> Self {
        let exit_code = match error {
            CameraCalibrationError::Setting { .. } | CameraCalibrationError::Pairs { .. } => 2,
            _ => 5,
        };
        Self { message: error.to_string(), exit_code }
    }
}
