//! What the second of two cameras that control the arm saw, and how near to its goal it ended.

use crate::mission::measurement_log::VerdictCounts;
use crate::mission::{FinalErrors, MeasurementLog};
use serde::{Deserialize, Serialize};

/// The second camera in the summary of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SecondCameraReport {
    /// Its name.
    pub name: String,
    /// Frames that its vision received.
    pub frames: u64,
    /// Frames that it sent and its vision skipped.
    pub frames_dropped: u64,
    /// How often it lost its target.
    pub target_lost: u64,
    /// What became of its measurements.
    pub intake: VerdictCounts,
    /// Errors at the end, of its goal.
    #[serde(rename = "final")]
    pub final_errors: FinalErrors,
}

impl SecondCameraReport {
    /// Of the camera `name` with these `measurements` and errors.
    #[must_use]
    pub fn new(name: &str, measurements: &MeasurementLog, final_errors: FinalErrors) -> Self {
        let vision = measurements.vision_counts();
        Self {
            name: name.to_owned(),
            frames: vision.frames,
            frames_dropped: vision.frames_dropped,
            target_lost: vision.target_lost,
            intake: *measurements.verdicts(),
            final_errors,
        }
    }

    /// It in words.
    #[must_use]
    pub fn to_text(&self) -> String {
        let known = |value: Option<f64>, scale: f64, unit: &str| {
            value.map_or_else(|| "unknown".to_owned(), |value| format!("{:.4} {unit}", value * scale))
        };
        let of = &self.final_errors;
        format!(
            "`{}`: {} frames, {} measurements used, target lost {} times; final error: features {}, position {}, orientation {}",
            self.name,
            self.frames,
            self.intake.used + self.intake.used_from_future,
            self.target_lost,
            known(of.feature_error_px, 1.0, "px"),
            known(of.position_error_m, 1e3, "mm"),
            known(of.orientation_error_rad.map(f64::to_degrees), 1.0, "deg")
        )
    }
}
