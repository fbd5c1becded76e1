//! What a run of `vservo calibrate load` was for.

use crate::calibration::load::{LoadRecording, fit_load};
use crate::config::Config;
use crate::control::outcome::Outcome;
use crate::mission::LockstepRun;
use crate::report::summary::{LoadCalibration, Summary};
use tracing::debug_span;

/// Works it out. Without a result the run counts as one that did not reach its goal.
pub(super) fn find<const N: usize>(
    config: &Config,
    run: &LockstepRun<N>,
    recording: &LoadRecording<N>,
    summary: &mut Summary,
) {
    let robot = &run.controller().arm().robot;
    match debug_span!("stage", name = "fit").in_scope(|| fit_load(robot, &config.tool, recording)) {
        Ok(found) => {
            summary.load = Some(LoadCalibration::new(&found, &config.tool, &config.robot.joint_names()))
        }
        Err(error) => {
            summary.outcome = Outcome::NotConverged;
            summary.reason = error.to_string();
        }
    }
}
