//! `vservo calibrate hand-eye --drive`: the arm of a run file visits views of its target by itself. In simulated time, in one process.

use super::answer::{Driven, HandEyeAnswer};
use super::{CalibrateError, HandEyeArguments, one_look};
use crate::calibration::hand_eye::{CameraMount, HandEyeSettings, calibrate_hand_eye};
use crate::config::Config;
use crate::control::outcome::Outcome;
use crate::geometry::Pose;
use crate::process::ProcessError;
use crate::robot::Mount;
use crate::rt::tell;
use crate::sim::look_around;
use crate::target::Kind;
use std::path::Path;

/// What the command itself sets in the run file: time enough, unless somebody says otherwise; and what it is about.
const DURATION: &str = "run.duration_s=600";
const SETTINGS: [&str; 2] = ["run.task=calibrate_hand_eye", "run.clock=lockstep"];

fn place_of(mount: &Mount) -> (CameraMount, Pose) {
    match mount {
        Mount::EyeInHand { .. } | Mount::EyeOnLink { .. } => (CameraMount::EyeInHand, *mount.pose()),
        Mount::EyeToHand { .. } => (CameraMount::EyeToHand, *mount.pose()),
    }
}

/// The answer of a session with the run file `path`; the default one where it is `None`.
pub(super) fn driven(
    arguments: &HandEyeArguments,
    path: Option<&Path>,
) -> Result<Result<HandEyeAnswer, CalibrateError>, ProcessError> {
    let known = match arguments.settings() {
        Ok(known) => known,
        Err(refusal) => return Ok(Err(refusal)),
    };
    let mut set = vec![DURATION.to_owned()];
    set.extend(arguments.set.iter().cloned());
    set.extend(SETTINGS.map(String::from));
    let config = Config::load(path, &set)?;
    if let Err(refusal) = one_look(Kind { target: config.target.clone(), any_tag: false }) {
        return Ok(Err(refusal));
    }
    tell(format_args!("vservo: the simulated arm of {} visits views of its target", config.robot.name));
    let (run, views) = match look_around(&config) {
        Ok(looked) => looked,
        Err(e) => {
            return Ok(Err(CalibrateError::with_code(
                3,
                format!("--drive: {e}; arms of real cells are not driven by this command yet"),
            )));
        }
    };
    if run.finish.outcome != Outcome::Finished {
        return Ok(Err(CalibrateError::with_code(run.finish.outcome.exit_code(), run.finish.reason)));
    }
    let (place, believed) = place_of(&config.camera.mount);
    let settings = HandEyeSettings { place, ..known };
    let report = match calibrate_hand_eye(&views, &config.camera.model, &settings) {
        Ok(report) => report,
        Err(e) => {
            return Ok(Err(CalibrateError::with_code(Outcome::NotConverged.exit_code(), e.to_string())));
        }
    };
    let truth = config.scene.as_ref().map(|scene| place_of(&scene.mount).1);
    let driven = Driven::new(&report.X_MC(), &believed, truth.as_ref());
    Ok(Ok(HandEyeAnswer::new(report, &views, Vec::new()).driven(driven)))
}
