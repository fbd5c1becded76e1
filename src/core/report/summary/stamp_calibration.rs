//! What `vservo calibrate latency` found, for people, programs and run files.

use crate::calibration::StampOffset;
use serde::{Deserialize, Serialize};

/// How the camera's stamps lie against the encoders'.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct StampCalibration {
    /// What `camera.stamp_offset_ms` is to be: the value of the run file and what was found beside it.
    pub stamp_offset_ms: f64,
    /// What was found beside the value of the run file.
    pub change_ms: f64,
    /// Standard deviation of both.
    pub sd_ms: f64,
    /// Frames that it rests on.
    pub measurements: u64,
    /// Distance of the points from where they should be, root mean square, px: with the value of the run file.
    pub residual_before_px: f64,
    /// The same with the new value.
    pub residual_after_px: f64,
}

impl StampCalibration {
    /// What was found in a run with the offset `configured_ms`.
    #[must_use]
    pub fn new(found: &StampOffset, configured_ms: f64) -> Self {
        // To a nanosecond, as stamps are.
        let change_ms = (found.offset_s * 1e9).round() * 1e-6;
        Self {
            stamp_offset_ms: configured_ms + change_ms,
            change_ms,
            sd_ms: found.sd_s * 1e3,
            measurements: found.frames as u64,
            residual_before_px: found.rms_before_px,
            residual_after_px: found.rms_after_px,
        }
    }

    /// A line for people.
    #[must_use]
    pub fn describe(&self) -> String {
        let late_ms = -self.stamp_offset_ms;
        format!(
            "camera stamps are {:.2} ms {} (sd {:.4} ms, {} measurements, residual {:.3} px -> {:.3} px)",
            late_ms.abs(),
            if late_ms < 0.0 { "early" } else { "late" },
            self.sd_ms,
            self.measurements,
            self.residual_before_px,
            self.residual_after_px,
        )
    }

    /// The lines for a run file.
    #[must_use]
    pub fn to_toml(&self) -> String {
        // A thousandth of a millisecond is less than any camera's stamps are worth.
        let rounded_ms = (self.stamp_offset_ms * 1e3).round() * 1e-3 + 0.0; // no minus before a zero
        format!("[camera]\nstamp_offset_ms = {rounded_ms:.3}\n")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::summary::Summary;
    use crate::time::SpanNs;

    #[test]
    fn a_calibration_says_early_or_late_and_gives_the_total() {
        let found =
            StampOffset { offset_s: -2e-3, sd_s: 1e-5, frames: 200, rms_before_px: 1.0, rms_after_px: 0.1 };
        let late = StampCalibration::new(&found, -8.0);
        assert!((late.stamp_offset_ms + 10.0).abs() < 1e-9 && (late.change_ms + 2.0).abs() < 1e-9);
        assert!(late.describe().starts_with("camera stamps are 10.00 ms late (sd 0.0100 ms, 200 "));
        assert_eq!(late.to_toml(), "[camera]\nstamp_offset_ms = -10.000\n");
        let early = StampCalibration::new(&found, 5.0);
        assert!(early.describe().starts_with("camera stamps are 3.00 ms early"), "{}", early.describe());
        let none = StampCalibration::new(&StampOffset { offset_s: -1e-9, ..found }, 0.0);
        assert_eq!(none.to_toml(), "[camera]\nstamp_offset_ms = 0.000\n");

        let config = crate::config::Config::load(None, &[]).unwrap();
        let mut summary = Summary::without_control(&config, SpanNs(0));
        assert!(!serde_json::to_string(&summary).unwrap().contains("calibration"), "left out in other runs");
        summary.calibration = Some(late);
        let text = serde_json::to_string(&summary).unwrap();
        assert_eq!(serde_json::from_str::<Summary>(&text).unwrap().calibration, Some(late));
        assert!(summary.to_text().contains("calibration   camera stamps are 10.00 ms late"));
    }
}
