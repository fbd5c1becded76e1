//! `vservo ctl`: one request to a running instance, and its answer.

use super::ctl_arguments::{CtlArguments, CtlCommand, FixedNumbers, NumberList, SettingArgument};
use super::do_program::do_program;
use super::{check_writable, json, shown, write_result};
use crate::client::{Client, RunAnswer, Setting, USUAL_WAIT_S, WaitEnd, WaitFor};
use crate::config::{ANGLES_DEG, GoalFile};
use crate::control::outcome::Outcome;
use crate::geometry::Pose;
use crate::input::printable;
use crate::process::{ProcessError, StopFlag};
use crate::rt::tell;
use nalgebra::{Quaternion, Unit, UnitQuaternion};
use std::path::Path;

/// The exit code of what was refused, or was not reached.
fn in_vain() -> u8 {
    Outcome::NotConverged.exit_code()
}

/// Asks, and tells the answer. The exit code: 5 where control refuses, and where a wait ends in vain.
pub(super) fn ctl(arguments: &CtlArguments) -> Result<u8, ProcessError> {
    let common = &arguments.common;
    if let Some(timeout_s) = common.timeout_s {
        Client::check_timeout_s(timeout_s)?;
    }
    if let CtlCommand::Run { program } = &arguments.what {
        return do_program(program, &common.instance);
    }
    let client = Client::connect(&common.instance)?.interrupted_by(StopFlag::on_signals()?);
    if let CtlCommand::Wait { what } = &arguments.what {
        let end = client.wait(*what, common.timeout_s.unwrap_or(USUAL_WAIT_S))?;
        return Ok(told_wait(*what, &end, common.json));
    }
    let client = match common.timeout_s {
        Some(timeout_s) => client.with_timeout_s(timeout_s)?,
        None => client,
    };
    let answer = match &arguments.what {
        CtlCommand::Status | CtlCommand::Wait { .. } | CtlCommand::Run { .. } => client.status(),
        CtlCommand::Start => client.start(),
        CtlCommand::Hold => client.hold(),
        CtlCommand::Teach { save: None } => client.teach(),
        CtlCommand::Teach { save: Some(path) } => {
            return save(&client, path, common.timeout_s.unwrap_or(USUAL_WAIT_S));
        }
        CtlCommand::Goal { file, position_m, rotation_rpy_deg, rotation_xyzw, target } => {
            if rotation_rpy_deg.is_some_and(|FixedNumbers(rpy)| rpy.iter().any(|a| !ANGLES_DEG.contains(a))) {
                let (low, high) = (ANGLES_DEG.start(), ANGLES_DEG.end());
                let message = format!("--rotation-rpy-deg: is out of range, allowed is {low} to {high}");
                return Err(ProcessError::NoCommand(message));
            }
            let client = match target {
                Some(name) => client.clone().of_target(name)?,
                None => client.clone(),
            };
            match (file, position_m, target) {
                (Some(file), ..) => client.goal_at(file),
                (None, None, Some(name)) => client.look_for(name),
                (None, position_m, _) => {
                    let FixedNumbers(position_m) = position_m.unwrap_or(FixedNumbers([0.0; 3]));
                    client.goal_pose(&Pose::from_parts(
                        position_m.into(),
                        rotation(*rotation_rpy_deg, *rotation_xyzw),
                    ))
                }
            }
        }
        CtlCommand::Target { name } => client.look_for(name),
        CtlCommand::Goto { file, q } => match (file, q) {
            (Some(file), _) => client.goto_at(file),
            (None, q) => client.goto(q.as_ref().map_or(&[][..], |NumberList(q)| q)),
        },
        CtlCommand::Jog { q: Some(NumberList(dq)), .. } => client.jog_joints(dq),
        CtlCommand::Jog { q: None, position_m, rotation_rpy_deg } => {
            let FixedNumbers(position_m) = position_m.unwrap_or(FixedNumbers([0.0; 3]));
            // A turn by 358 degrees would be one by -2.
            if rotation_rpy_deg.is_some_and(|FixedNumbers(rpy)| rpy.iter().any(|angle| angle.abs() > 180.0)) {
                let message = "--rotation-rpy-deg: a jog turns the camera by 0.2 rad (11 degrees) at most";
                return Err(ProcessError::NoCommand(message.into()));
            }
            client.jog_camera(&position_m.into(), &rotation(*rotation_rpy_deg, None).scaled_axis())
        }
        CtlCommand::Velocity { q, camera, hold_s } => {
            let velocities = client.velocities(*hold_s)?;
            match (q, camera) {
                (_, Some(FixedNumbers(V_C))) => velocities.camera(V_C),
                (q, None) => velocities.joints(q.as_ref().map_or(&[][..], |NumberList(q)| q)),
            }
        }
        CtlCommand::Set { what, value } => {
            let setting = match what {
                SettingArgument::Gain => Setting::Gain,
                SettingArgument::Tolerance => Setting::Tolerance,
                SettingArgument::Hold => Setting::Hold,
            };
            client.set(setting, *value)
        }
        CtlCommand::Reset => client.reset(),
        CtlCommand::Stop { latched: false } => client.stop(),
        CtlCommand::Stop { latched: true } => client.latch_stop(),
        CtlCommand::Shutdown => client.shutdown(),
    }?;
    Ok(told(&answer, common.json))
}

fn rotation(rpy_deg: Option<FixedNumbers<3>>, xyzw: Option<FixedNumbers<4>>) -> UnitQuaternion<f64> {
    match (xyzw, rpy_deg) {
        // What is no unit quaternion is refused by control, as its numbers tell.
        (Some(FixedNumbers([x, y, z, w])), _) => Unit::new_unchecked(Quaternion::new(w, x, y, z)),
        (None, Some(FixedNumbers(rpy_deg))) => {
            let [roll, pitch, yaw] = rpy_deg.map(f64::to_radians);
            UnitQuaternion::from_euler_angles(roll, pitch, yaw)
        }
        (None, None) => UnitQuaternion::identity(),
    }
}

/// Teaches, and writes the goal into a file.
fn save(client: &Client, path: &Path, timeout_s: f64) -> Result<u8, ProcessError> {
    check_writable(path)?;
    // It may be the daemon's own run file, of which this command knows nothing.
    let is_other = |text: String| !text.trim().is_empty() && !GoalFile::is_one(&text);
    if path.is_file() && std::fs::read_to_string(path).is_ok_and(is_other) {
        let path = printable(&path.display().to_string());
        tell(format_args!("vservo: {path} is there and no taught goal, so that it is not overwritten"));
        return Ok(2);
    }
    match client.taught(timeout_s)? {
        Ok(goal) => Ok(write_result(path, goal.to_toml(), 0)),
        Err(why) => {
            tell(format_args!("vservo: the goal was not taught: {}", printable(&why)));
            Ok(in_vain())
        }
    }
}

fn told(answer: &RunAnswer, as_json: bool) -> u8 {
    let exit_code = if answer.accepted { 0 } else { in_vain() };
    if let Some(reason) = &answer.reason {
        tell(format_args!("vservo: {} was refused: {reason}", answer.request));
    }
    if as_json {
        shown(&json(answer), exit_code)
    } else if answer.accepted {
        shown(&answer.line(), exit_code)
    } else {
        exit_code
    }
}

fn told_wait(what: WaitFor, end: &WaitEnd, as_json: bool) -> u8 {
    let exit_code = if end.is_reached { 0 } else { in_vain() };
    if !end.is_reached {
        tell(format_args!("vservo: {}", printable(&end.in_vain(what))));
    }
    match &end.status {
        _ if as_json => shown(&json(end), exit_code),
        Some(status) if end.is_reached => shown(&status.line(), exit_code),
        _ => exit_code,
    }
}
