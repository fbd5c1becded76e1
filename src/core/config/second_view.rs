//! `[second_view]`: the second of two cameras controls the arm beside the first one, by a target and a goal of its own.
//!
//! | where | what |
//! |---|---|
//! | `cameras[0]`, `[target]`, `[scene.object]`, `[servo.desired]` | the first view |
//! | `cameras[1]`, `[second_view]` | the second one: camera, target, where that is, desired pose, weight |
//!
//! The second view is a cell by itself: the run file with those tables in the places of the first camera's. It passes the same checks, and the processes of the
//! second camera run it as if it were alone.

use super::check::Validation;
use super::raw::{RawConfig, RawScene, RawServo, SetPointKind, Task};
use super::validate::{START, validate};
use super::{Config, Document, Problem};
use std::ops::RangeInclusive;

/// Weights wider than any use. Chosen by hand: of a camera with less than a thousandth nothing is left but noise.
const WEIGHT: RangeInclusive<f64> = 1e-3..=1e3;
/// Most frames of one camera in a second. Derived: a tick takes in one measurement, and at 1 kHz each camera then has every second tick.
const MOST_HZ: f64 = 500.0;

/// The second of two cameras that control the arm together.
#[derive(Debug, Clone)]
pub struct SecondView {
    /// The run as this camera alone would have it: camera, target, goal and law, and where it is simulated what is true of them.
    pub cell: Box<Config>,
    /// Weight of what it asks for; that of the first one is 1.
    pub weight: f64,
}

/// Adds the second view to a configuration that is valid without it.
pub(super) fn add(config: &mut Config, document: &Document, views: bool, problems: &mut Vec<Problem>) {
    let raw = &config.effective;
    let Some(view) = &raw.second_view else { return };
    let mut check = Validation::new(document, problems);
    let weight = check.range("second_view.weight", view.weight, WEIGHT);
    of_the_run(config, &mut check);
    let ([_, own], [camera]) = (raw.cameras.as_slice(), config.further_cameras.as_slice()) else {
        let given = raw.cameras.len().max(1);
        return check.wrong("second_view", format!("needs two [[cameras]]; the run file has {given}"));
    };
    if check.count_problems() > 0 {
        return;
    }
    let alone = RawConfig {
        camera: own.clone(),
        cameras: Vec::new(),
        target: view.target.clone(),
        // Of the scene the second camera has what concerns no target and no camera.
        scene: RawScene {
            object: view.object.clone(),
            arm: raw.scene.arm.clone(),
            background_level: raw.scene.background_level,
            plate_level: raw.scene.plate_level,
            dot_level: raw.scene.dot_level,
            ..RawScene::default()
        },
        servo: RawServo { desired: view.desired.clone(), ..raw.servo.clone() },
        ..raw.clone()
    };
    let mut found = Vec::new();
    let cell = validate(alone, document, views, &mut found);
    for problem in found {
        check.wrong(&own_key(&problem.key), problem.message);
    }
    let Some(mut cell) = cell.filter(|_| check.count_problems() == 0) else { return };
    let warnings = std::mem::take(&mut cell.warnings);
    let is_unseen = |warnings: &[Problem]| warnings.iter().any(|warning| warning.key == START);
    if is_unseen(&config.warnings) && is_unseen(&warnings) {
        check.wrong(
            START,
            "neither camera has its target in view at the start: move the start, scene.object or second_view.object (vservo view)",
        );
        return;
    }
    // What concerns both is told once.
    let news = warnings.into_iter().filter(|warning| !config.warnings.contains(warning));
    for warning in news.collect::<Vec<_>>() {
        check.doubtful(&own_key(&warning.key), warning.message);
    }
    config.warnings.append(&mut check.take_warnings());
    // Its number, and with it noise and faults of its own.
    cell.camera = camera.clone();
    cell.effective.clone_from(raw);
    config.second_view = Some(SecondView { cell: Box::new(cell), weight });
}

/// Where in the run file stands what the second view has under `key`.
fn own_key(key: &str) -> String {
    let places = [
        ("camera", "cameras[1]"),
        ("target", "second_view.target"),
        ("scene.object", "second_view.object"),
        ("servo.desired", "second_view.desired"),
    ];
    let place = places.iter().find_map(|(first, second)| {
        let rest = key.strip_prefix(first)?;
        (rest.is_empty() || rest.starts_with(['.', '['])).then(|| format!("{second}{rest}"))
    });
    place.unwrap_or_else(|| key.to_owned())
}

/// Refuses what control by two cameras does not have.
fn of_the_run(config: &Config, check: &mut Validation<'_>) {
    let raw = &config.effective;
    let is_servo = raw.run.task == Task::Servo;
    for (key, is_wrong, why) in [
        (
            "stereo",
            raw.stereo.is_some(),
            "makes one view of two cameras, and [second_view] two: leave out one of them",
        ),
        (
            "targets",
            !raw.targets.is_empty(),
            "further targets do not go with [second_view], where each camera has one",
        ),
        ("run.task", !is_servo, "must be `servo` with [second_view]: calibrate each camera by itself"),
        (
            "servo.scheme",
            config.servo.law.is_torque(),
            "position_pd and image_pd command torques, and do not go with [second_view]: use a resolved-velocity scheme (B, D, hybrid)",
        ),
        (
            "servo.scheme",
            is_servo && config.looks_and_moves(),
            "look_and_move goes by one camera, and does not go with [second_view]",
        ),
        (
            "servo.interaction",
            config.servo.estimation.is_some(),
            "is `estimated`, which learns by one camera: with [second_view] let the Jacobian be computed",
        ),
        (
            "servo.set_point.kind",
            raw.servo.set_point.kind != SetPointKind::Pose,
            "must be `pose` with [second_view], where each camera has a desired pose",
        ),
        ("servo.path", config.servo.path.is_some(), "a goal that moves does not go with [second_view]"),
        (
            "servo.object.moves",
            config.servo.object.is_some(),
            "does not go with [second_view]: both targets rest",
        ),
        (
            "second_view",
            !config.closes_the_loop(),
            "needs an arm that moves, and cameras that see its motion",
        ),
    ] {
        if is_wrong {
            check.wrong(key, why);
        }
    }
    for camera in config.cameras().filter(|camera| camera.rate_hz > MOST_HZ) {
        let message =
            format!("is {} Hz: with [second_view] a camera has {MOST_HZ} Hz at most", camera.rate_hz);
        check.wrong(&format!("cameras[{}].rate_hz", camera.id), message);
    }
}

#[cfg(test)]
mod tests;
