//! An answer of control in words and numbers.

use super::targets::targets_of;
use crate::control::lifecycle::{Refusal, Request};
use crate::control::safety::Fault;
use crate::input::printable;
use crate::ipc::{Instance, Role};
use crate::messages::{
    CameraState, ControlAnswer, ControlState, RobotState, Status, TargetStatus, answer_flag,
};
use crate::report::summary::ContactReport;
use serde::Serialize;
use std::borrow::Cow;
use std::fmt::Write as _;

/// What control holds the arm for by itself.
const LOST: &str = "camera or vision was lost, and safety.resume is \"manual\"";

/// An answer; what is unknown is `None`, `null` in JSON.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunAnswer {
    /// Name of the run.
    pub instance: String,
    /// What was asked for.
    pub request: &'static str,
    /// Whether it was accepted.
    pub accepted: bool,
    /// Why it was refused.
    pub reason: Option<Cow<'static, str>>,
    /// The state of control.
    pub state: &'static str,
    /// The fault.
    pub fault: Option<&'static str>,
    /// What the robot of an external drive is beside its joints, where the drive tells.
    pub robot_state: Option<&'static str>,
    /// The maker's own code for that.
    pub robot_code: Option<u32>,
    /// What the maker says of it, as the drive tells it.
    pub robot_text: Option<String>,
    /// What a reset that was accepted waits for.
    pub waits_for: Option<&'static str>,
    /// What control itself holds the arm for, where no client has asked for that.
    pub held_for: Option<&'static str>,
    /// What touches the arm, or stopped it where that fault stands.
    pub contact: Option<ContactReport>,
    /// What the last measurement showed of the target.
    pub target: Option<&'static str>,
    /// The state of a real camera.
    pub camera: Option<&'static str>,
    /// For how long it has been in that state, s.
    pub camera_state_s: Option<f64>,
    /// How often the supervisor has started a camera process anew.
    pub camera_restarts: Option<u32>,
    /// How often it has started vision anew.
    pub vision_restarts: Option<u32>,
    /// Whether the run serves requests and ends on request.
    pub served: Option<bool>,
    /// Number of the control tick.
    pub tick: Option<u64>,
    /// Number of the last accepted request that decides what the arm does, all but `goal` and `set`: another one than in the answer to an own request is
    /// of another client.
    pub motion_request: Option<u64>,
    /// Time since the first tick, s.
    pub time_s: Option<f64>,
    /// Number of the goal: 0 is that of the run file.
    pub goal: Option<u32>,
    /// Number of the target of the goal: 0 is `[target]` of the run file.
    pub target_number: Option<u32>,
    /// Its name in the run file, where that has several.
    pub target_name: Option<String>,
    /// Whether the goal is reached and held.
    pub at_goal: Option<bool>,
    /// For how long, s.
    pub at_goal_s: Option<f64>,
    /// The stability condition of scheme D at the goal of the run file, which `vservo check` tells too: unstable at 0 or less. `None` for other laws, and where nothing
    /// says what is true.
    pub stability: Option<f64>,
    /// Root mean square feature error of the last frame that has one, px: an old one where `target` is not `found`.
    pub feature_error_px: Option<f64>,
    /// Distance of the camera from its desired position, m.
    pub position_error_m: Option<f64>,
    /// Angle of the camera from its desired orientation, rad.
    pub orientation_error_rad: Option<f64>,
    /// Measured joint positions.
    pub q_rad_or_m: Vec<f64>,
    /// Measured joint velocities.
    pub qd_rad_s_or_m_s: Vec<f64>,
    /// The points of the goal, each with its desired normalized image coordinates.
    #[serde(skip)]
    pub goal_points: Vec<(u32, [f64; 2])>,
}

impl RunAnswer {
    pub(super) fn of(instance: &Instance, request: Option<Request>, a: &ControlAnswer) -> Self {
        let known = |x: f64| Some(x).filter(|x| x.is_finite());
        let joints = a.joints as usize;
        // A run that is asked for something else is at its goal no more, before it has told so itself.
        let at_goal_s = known(a.at_goal_s).filter(|_| a.state == ControlState::Servoing as u32);
        let describe = |code| match (Refusal::from_code(code), request) {
            (Some(refusal), Some(request)) => refusal.describe_for(request),
            (Some(refusal), None) => refusal.describe(),
            (None, _) => "for a reason of another version",
        };
        Self {
            instance: instance.to_string(),
            request: request.map_or("status", Request::as_str),
            accepted: a.refusal == 0,
            reason: (a.refusal != 0).then(|| describe(a.refusal).into()),
            state: ControlState::from_code(a.state).as_str(),
            fault: Fault::from_code(a.fault).map(Fault::describe),
            robot_state: (a.robot_state != 0).then(|| RobotState::from_code(a.robot_state).as_str()),
            robot_code: Some(a.robot_code).filter(|code| *code != 0),
            robot_text: Some(a.robot_text()).filter(|words| !words.is_empty()),
            waits_for: (a.flags & answer_flag::CLEARING != 0)
                .then(|| waits_for(RobotState::from_code(a.robot_state))),
            held_for: (a.flags & answer_flag::HELD_BY_CONTROL != 0 && a.state == ControlState::Held as u32)
                .then_some(LOST),
            contact: contact_of(instance, a),
            target: Some(TargetStatus::from_code(a.target).as_str()),
            camera: Some(CameraState::from_code(a.camera_state))
                .filter(|state| *state != CameraState::Unknown)
                .map(CameraState::as_str),
            camera_state_s: known(a.camera_state_s),
            camera_restarts: Some(a.camera_restarts),
            vision_restarts: Some(a.vision_restarts),
            served: Some(a.flags & answer_flag::SERVED != 0),
            tick: Some(a.tick),
            motion_request: Some(a.motion_request),
            time_s: Some(a.time_s),
            goal: Some(a.goal),
            target_number: Some(a.target_number),
            target_name: name_of(instance, a.target_number),
            at_goal: Some(at_goal_s.is_some()),
            at_goal_s,
            stability: known(a.stability),
            feature_error_px: known(a.feature_error_px),
            position_error_m: known(a.position_error_m),
            orientation_error_rad: known(a.orientation_error_rad),
            q_rad_or_m: a.q.iter().take(joints).copied().collect(),
            qd_rad_s_or_m_s: a.qd.iter().take(joints).copied().collect(),
            goal_points: goal_points(a).take(a.goal_points as usize).collect(),
        }
    }

    /// What the stop word tells: no more than the state, and no less to whoever wants the arm to stand.
    pub(super) fn of_halt(instance: &Instance, request: Request, state: ControlState) -> Self {
        Self {
            instance: instance.to_string(),
            request: request.as_str(),
            accepted: true,
            reason: None,
            state: state.as_str(),
            fault: None,
            robot_state: None,
            robot_code: None,
            robot_text: None,
            waits_for: None,
            held_for: None,
            contact: None,
            target: None,
            camera: None,
            camera_state_s: None,
            camera_restarts: None,
            vision_restarts: None,
            served: None,
            tick: None,
            motion_request: None,
            time_s: None,
            goal: None,
            target_number: None,
            target_name: None,
            at_goal: None,
            at_goal_s: None,
            stability: None,
            feature_error_px: None,
            position_error_m: None,
            orientation_error_rad: None,
            q_rad_or_m: Vec::new(),
            qd_rad_s_or_m_s: Vec::new(),
            goal_points: Vec::new(),
        }
    }

    /// The same with a later status of the run, which has no words for a fault.
    pub(super) fn with(self, told: &Status) -> Self {
        let known = |x: f64| Some(x).filter(|x| x.is_finite());
        let state = ControlState::from_code(told.state);
        let at_goal_s = known(told.at_goal_s).filter(|_| state == ControlState::Servoing);
        Self {
            state: state.as_str(),
            target: Some(TargetStatus::from_code(told.target).as_str()),
            tick: Some(told.tick),
            time_s: Some(told.time_s),
            goal: Some(told.goal),
            at_goal: Some(at_goal_s.is_some()),
            at_goal_s,
            stability: known(told.stability),
            feature_error_px: known(told.feature_error_px),
            position_error_m: known(told.position_error_m),
            orientation_error_rad: known(told.orientation_error_rad),
            ..self
        }
    }

    /// The state with the fault in words.
    #[must_use]
    pub fn state_in_words(&self) -> String {
        if let Some(why) = self.held_for {
            return format!("{} ({why}; `vservo ctl start` goes on)", self.state);
        }
        match (self.fault, self.waits_for) {
            (None, _) => match self.unseen() {
                Some(target) if self.state == ControlState::Teaching.as_str() => {
                    format!("{}, which waits for the target: {target}", self.state)
                }
                _ => self.state.to_owned(),
            },
            (Some(fault), Some(waits_for)) => {
                format!("{} ({fault}; the reset waits: {waits_for})", self.state)
            }
            // Whoever says what to do at the robot says when to reset.
            (Some(fault), None) if fault.contains("`vservo ctl reset`") => {
                format!("{} ({fault})", self.state)
            }
            (Some(fault), None) => {
                format!("{} ({fault}; see to its cause, then `vservo ctl reset`)", self.state)
            }
        }
    }

    /// The feature error, or why the last frame has none: that of an earlier one is not told.
    pub(super) fn view_in_words(&self) -> String {
        // A state that waits for the target says so itself.
        let is_told = self.state == ControlState::Teaching.as_str();
        match (self.unseen(), self.feature_error_px) {
            (Some(why), _) if !is_told => format!(", no view of the target: {why}"),
            (None, Some(error)) => format!(", feature error {error:.3} px"),
            _ => String::new(),
        }
    }

    /// Why the target is not seen; `None` where it is.
    fn unseen(&self) -> Option<&'static str> {
        self.target.filter(|target| *target != TargetStatus::Found.as_str())
    }

    /// A line for people.
    #[must_use]
    pub fn line(&self) -> String {
        let mut line = format!("{}: {}", printable(&self.instance), self.state_in_words());
        if let Some(robot) = self.robot_state {
            let _ = write!(line, ", robot {robot}");
        }
        if let Some(code) = self.robot_code {
            let _ = write!(line, " ({code})");
        }
        if let Some(words) = &self.robot_text {
            let _ = write!(line, ": {}", printable(words));
        }
        if let Some(contact) = &self.contact {
            let _ = write!(line, ", touched: {}", contact.to_text());
        }
        if let Some(target) = &self.target_name {
            let _ = write!(line, ", target {}", printable(target));
        }
        if let Some(s) = self.at_goal_s {
            let _ = write!(line, ", at the goal for {s:.1} s");
        }
        if let Some(time_s) = self.time_s {
            let _ = write!(line, ", {time_s:.1} s");
        }
        if let Some((camera, s)) = self.camera.zip(self.camera_state_s) {
            let _ = write!(line, ", camera {camera} for {s:.1} s");
        }
        for (what, count) in [("camera", self.camera_restarts), ("vision", self.vision_restarts)] {
            if let Some(count) = count.filter(|count| *count > 0) {
                let _ = write!(line, ", {what} started anew {count} times");
            }
        }
        line += &self.view_in_words();
        if let Some((m, rad)) = self.position_error_m.zip(self.orientation_error_rad) {
            let _ = write!(line, ", camera {:.2} mm {:.3} deg from the goal", m * 1e3, rad.to_degrees());
        }
        line + "\n"
    }
}

/// What touches the arm, by an answer.
fn contact_of(instance: &Instance, a: &ControlAnswer) -> Option<ContactReport> {
    let joint = a.contact_joint.checked_sub(1)? as usize;
    let agreement = instance.agreement_of(Role::Control).unwrap_or_default();
    let names: Vec<String> =
        agreement.get("robot.joints").and_then(|text| serde_json::from_str(text).ok()).unwrap_or_default();
    Some(ContactReport {
        joint,
        joint_name: names.into_iter().nth(joint),
        torque_n_m_or_n: Some(a.contact_torque).filter(|torque| torque.is_finite()),
        force_n: Some(a.contact_force).filter(|force| force.iter().all(|f| f.is_finite())),
    })
}

/// The name of target `number`, where there are several.
fn name_of(instance: &Instance, number: u32) -> Option<String> {
    let targets = targets_of(instance);
    let several = targets.len() > 1;
    targets.into_iter().nth(number as usize).filter(|_| several).map(|target| target.name)
}

/// What a reset waits for that a robot in this state has to clear first.
fn waits_for(state: RobotState) -> &'static str {
    match state {
        RobotState::ProtectiveStop => {
            "the robot is unlocked, which robots allow some seconds after the stop (5 s, Universal Robots), or its safeguard is closed again"
        }
        RobotState::Halted => "what obeys commands on the robot starts again",
        RobotState::Enabling => "the robot opens its brakes",
        _ => "the robot obeys commands again",
    }
}

fn goal_points(a: &ControlAnswer) -> impl Iterator<Item = (u32, [f64; 2])> {
    let (features, _) = a.goal_features.as_chunks::<2>();
    a.goal_ids.into_iter().zip(features.to_vec())
}

#[cfg(test)]
pub(super) mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// A run that servoes.
    pub(in crate::client) fn answer() -> RunAnswer {
        told(&ControlAnswer { state: ControlState::Servoing as u32, ..ControlAnswer::default() })
    }

    fn told(answer: &ControlAnswer) -> RunAnswer {
        RunAnswer::of(&"answer-test".parse().unwrap(), None, answer)
    }

    #[test]
    fn an_arm_that_moves_elsewhere_is_not_at_the_goal() {
        let of = |state: ControlState| {
            told(&ControlAnswer { state: state as u32, at_goal_s: 6.1, ..ControlAnswer::default() })
        };
        assert!(of(ControlState::Servoing).line().contains("at the goal for 6.1 s"));
        for state in [ControlState::Moving, ControlState::Held, ControlState::Holding] {
            let answer = of(state);
            assert_eq!((answer.at_goal, answer.at_goal_s), (Some(false), None), "{}", answer.line());
            assert!(!answer.line().contains("at the goal"), "{}", answer.line());
        }
    }

    #[test]
    fn a_target_that_is_not_seen_is_told_instead_of_an_old_error() {
        let seen = ControlAnswer {
            state: ControlState::Waiting as u32,
            feature_error_px: 12.0,
            target: TargetStatus::Found as u32,
            ..ControlAnswer::default()
        };
        assert!(told(&seen).line().contains("feature error 12.000 px"));
        for status in [TargetStatus::NoContrast, TargetStatus::NoPair] {
            let line = told(&ControlAnswer { target: status as u32, ..seen }).line();
            assert!(line.contains(&format!("no view of the target: {}", status.as_str())), "{line}");
            assert!(!line.contains("feature error"), "{line}");
        }
    }
}
