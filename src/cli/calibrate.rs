//! `vservo calibrate camera`, `calibrate stereo` and `calibrate hand-eye`: images -> corners -> calibration -> files and answers;
//! `calibrate points`: points in space -> the same;
//! `calibrate latency`: an excitation motion of the arm -> the offset of the camera's stamps; `calibrate load`: postures of the arm -> what it carries;
//! `calibrate from`: what a run has seen -> lens, mount, stamps and size of the target.

mod answer;
mod boards;
mod by_motion;
mod camera;
mod from_run;
mod hand_eye;
mod live;
mod points;
mod stage;
mod stereo;

pub use by_motion::MotionArguments;
use by_motion::{Sought, by_motion};
use camera::camera;
pub use from_run::CalibrateFromArguments;
use from_run::from_run;
pub use hand_eye::HandEyeArguments;
use hand_eye::hand_eye;
pub use points::{CalibratePointsArguments, PointLensArgument};
use stereo::stereo;

use super::calibrate_arguments::{CalibrateCameraArguments, CalibrateStereoArguments};
use super::detect::refused;
use crate::calibration::camera::CameraCalibrationError;
use crate::process::ProcessError;
use clap::Subcommand;

/// What can be calibrated.
#[derive(Debug, Subcommand)]
pub enum Calibration {
    /// Move the arm gently before the target for 8 s and find the offset between the stamps of camera and encoders
    Latency(MotionArguments),
    /// Move the arm gently through some postures and find what its flange carries, from the torques
    Load(MotionArguments),
    /// Refine lens, mount, stamps and size of the target by what a run has seen: its recording, or its report
    From(CalibrateFromArguments),
    /// The lens of a camera from images of a chessboard, how good it is, and which image is missing
    Camera(CalibrateCameraArguments),
    /// The lens of a camera from points in space whose places are known, and where one image shows them
    Points(CalibratePointsArguments),
    /// A stereo pair from images of a chessboard taken by both cameras at the same instants
    Stereo(CalibrateStereoArguments),
    /// Find where the camera sits on the arm, or beside it, from images of a board and the robot's poses
    HandEye(HandEyeArguments),
}

/// Calibrates; the exit code.
pub(super) fn calibrate(what: &Calibration) -> Result<u8, ProcessError> {
    match what {
        Calibration::Latency(arguments) => by_motion(Sought::Latency, arguments),
        Calibration::Load(arguments) => by_motion(Sought::Load, arguments),
        Calibration::From(arguments) => from_run(arguments),
        Calibration::HandEye(arguments) => hand_eye(arguments),
        Calibration::Camera(arguments) => camera(arguments),
        Calibration::Points(arguments) => points::points(arguments),
        Calibration::Stereo(arguments) => stereo(arguments),
    }
}

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
