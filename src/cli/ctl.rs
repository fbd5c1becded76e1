//! `vservo ctl`: one request to a running instance, and its answer.

mod reach;

use super::arguments::{CtlArguments, Order};
use super::{json, shown};
use crate::control::lifecycle::{Refusal, Request};
use crate::control::outcome::Outcome;
use crate::control::safety::Fault;
use crate::input::printable;
use crate::ipc::{Halt, Instance};
use crate::messages::{CameraState, ControlAnswer, ControlCommand, ControlState, TargetStatus, answer_flag};
use crate::process::ProcessError;
use crate::rt::tell;
use reach::AnswerTimeout;
use serde::Serialize;
use std::fmt::Write as _;

/// The longest wait for an answer, s. Chosen by hand: longer than any calibration takes, and a slip of the unit is refused.
const LONGEST_S: f64 = 3600.0;

/// An answer, for programs; `null` where unknown.
#[derive(Debug, Serialize)]
struct CtlAnswer {
    instance: String,
    request: &'static str,
    accepted: bool,
    reason: Option<&'static str>,
    state: &'static str,
    fault: Option<&'static str>,
    target: Option<&'static str>,
    camera: Option<&'static str>,
    camera_state_s: Option<f64>,
    served: Option<bool>,
    tick: Option<u64>,
    time_s: Option<f64>,
    feature_error_px: Option<f64>,
    position_error_m: Option<f64>,
    orientation_error_rad: Option<f64>,
    q_rad_or_m: Vec<f64>,
    qd_rad_s_or_m_s: Vec<f64>,
}

impl Order {
    fn request(self) -> Option<Request> {
        match self {
            Self::Status => None,
            Self::Start => Some(Request::Start),
            Self::Hold => Some(Request::Hold),
            Self::Teach => Some(Request::Teach),
            Self::Reset => Some(Request::Reset),
            Self::Stop => Some(Request::Stop),
            Self::Shutdown => Some(Request::Shutdown),
        }
    }
}

/// Asks, and tells the answer. The exit code: 5 where control refuses.
pub(super) fn ctl(arguments: &CtlArguments) -> Result<u8, ProcessError> {
    let instance: Instance = arguments.instance.parse()?;
    let timeout_s = arguments.timeout_s;
    if !(timeout_s > 0.0 && timeout_s <= LONGEST_S) {
        return Err(ProcessError::Timeout(timeout_s));
    }
    let patience = AnswerTimeout::begin(timeout_s)?;
    reach::find(&instance)?;
    let request = arguments.what.request();
    let halt = match request {
        Some(Request::Stop) => Some(Halt::Stop),
        Some(Request::Shutdown) => Some(Halt::Shutdown),
        _ => None,
    };
    let answer = if let (Some(halt), Some(request)) = (halt, request) {
        halted(&instance, request, reach::halt(&instance, halt, &patience)?)
    } else {
        let command = ControlCommand { request: request.map_or(0, |request| request as u32), arm: 0 };
        told(&instance, request, &reach::ask(&instance, command, &patience)?)
    };
    let exit_code = if answer.accepted { 0 } else { Outcome::NotConverged.exit_code() };
    if let Some(reason) = answer.reason {
        tell(format_args!("vservo: {} was refused: {reason}", answer.request));
    }
    Ok(if arguments.json {
        shown(&json(&answer), exit_code)
    } else if answer.accepted {
        shown(&answer.line(), exit_code)
    } else {
        exit_code
    })
}

fn told(instance: &Instance, request: Option<Request>, a: &ControlAnswer) -> CtlAnswer {
    let known = |x: f64| Some(x).filter(|x| x.is_finite());
    let joints = a.joints as usize;
    let reason = (a.refusal != 0)
        .then(|| Refusal::from_code(a.refusal).map_or("for a reason of another version", Refusal::describe));
    CtlAnswer {
        instance: instance.to_string(),
        request: request.map_or("status", Request::as_str),
        accepted: a.refusal == 0,
        reason,
        state: ControlState::from_code(a.state).as_str(),
        fault: Fault::from_code(a.fault).map(Fault::describe),
        target: Some(TargetStatus::from_code(a.target).as_str()),
        camera: Some(CameraState::from_code(a.camera_state))
            .filter(|state| *state != CameraState::Unknown)
            .map(CameraState::as_str),
        camera_state_s: known(a.camera_state_s),
        served: Some(a.flags & answer_flag::SERVED != 0),
        tick: Some(a.tick),
        time_s: Some(a.time_s),
        feature_error_px: known(a.feature_error_px),
        position_error_m: known(a.position_error_m),
        orientation_error_rad: known(a.orientation_error_rad),
        q_rad_or_m: a.q.iter().take(joints).copied().collect(),
        qd_rad_s_or_m_s: a.qd.iter().take(joints).copied().collect(),
    }
}

/// What the stop word tells: no more than the state, and no less to whoever wants the arm to stand.
fn halted(instance: &Instance, request: Request, state: ControlState) -> CtlAnswer {
    CtlAnswer {
        instance: instance.to_string(),
        request: request.as_str(),
        accepted: true,
        reason: None,
        state: state.as_str(),
        fault: None,
        target: None,
        camera: None,
        camera_state_s: None,
        served: None,
        tick: None,
        time_s: None,
        feature_error_px: None,
        position_error_m: None,
        orientation_error_rad: None,
        q_rad_or_m: Vec::new(),
        qd_rad_s_or_m_s: Vec::new(),
    }
}

impl CtlAnswer {
    fn line(&self) -> String {
        let mut line = format!("{}: {}", printable(&self.instance), self.state);
        if let Some(fault) = self.fault {
            let _ = write!(line, " ({fault}; see to its cause, then `vservo ctl reset`)");
        }
        if let Some(time_s) = self.time_s {
            let _ = write!(line, ", {time_s:.1} s");
        }
        if let Some((camera, s)) = self.camera.zip(self.camera_state_s) {
            let _ = write!(line, ", camera {camera} for {s:.1} s");
        }
        if let Some(error) = self.feature_error_px {
            let _ = write!(line, ", feature error {error:.3} px");
        }
        if let Some((m, rad)) = self.position_error_m.zip(self.orientation_error_rad) {
            let _ = write!(line, ", camera {:.2} mm {:.3} deg from the goal", m * 1e3, rad.to_degrees());
        }
        line + "\n"
    }
}
