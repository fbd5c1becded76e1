//! The drive of an arm of Universal Robots, over RTDE, the dashboard, and a program on the robot.
//!
//! ```text
//! commands ─► registers ─► program on the robot: servoj, speedj, direct_torque          states ◄─ RTDE, 500 or 125 Hz
//! ```

use super::drive_payload::moments;
use super::drive_robot::{self, DriveJoining, RobotArm, joints};
use super::drive_weights::Weights;
use super::{ProcessError, StopFlag};
use crate::config::Config;
use crate::drive::{CommandMode, DriveProperties};
use crate::ipc::Instance;
use crate::messages::{DriveCommandMsg, DriveStateMsg, RobotState, drive_flag};
use crate::rt::{ClockEstimate, tell};
use crate::time::{MonoNs, SpanNs};
use std::time::Duration;
use vservo_ur::arm::{ArmState, CommandKind, Recovered};
use vservo_ur::program::state as program_state;
use vservo_ur::{Arm, ArmSettings, Command, JOINTS, Payload, RobotMode, SafetyMode, UrError};

/// The joints, as the maker's own description of its arms names them.
pub const JOINT_NAMES: [&str; JOINTS] = [
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
];

/// An arm, whether it may be powered and its brakes be opened, what it carries, and what torques hold of its weight.
struct UrArm<'a> {
    arm: Arm,
    enable: bool,
    joining: &'a DriveJoining,
    weights: Weights<JOINTS>,
}

impl RobotArm for UrArm<'_> {
    type State = ArmState;
    type Command = Command;
    type Error = ProcessError;
    const PROGRAM: &'static str = "vservo-drive-ur";
    const BACK: &'static str = "the robot's program runs again";
    const JOINTS: usize = JOINTS;
    const MODES: u32 = (1 << CommandMode::Torque as u32)
        | (1 << CommandMode::Velocity as u32)
        | (1 << CommandMode::Position as u32);
    const HOLD: Command = Command::Hold;

    fn next(&mut self, wait: Duration) -> Result<Option<ArmState>, ProcessError> {
        Ok(self.arm.next(wait)?)
    }

    fn last(&self) -> Option<ArmState> {
        self.arm.last().copied()
    }

    fn missed(&self) -> (u64, i64) {
        self.arm.missed()
    }

    fn clock(&self) -> Option<ClockEstimate> {
        self.arm.clock()
    }

    fn properties(&self, mode: u32) -> DriveProperties {
        let ArmSettings { watchdog, torque_watchdog, .. } = *self.arm.settings();
        let watchdog = if mode == CommandMode::Torque as u32 { torque_watchdog } else { watchdog };
        DriveProperties {
            period: Some(SpanNs::from_s(1.0 / self.arm.rate_hz())),
            watchdog: Some(SpanNs::from_s(watchdog.as_secs_f64())),
            lag: Some(SpanNs::from_s(self.arm.lag_s(kind(mode)))),
            effort_rate: Vec::new(),
        }
    }

    fn begin(&mut self, mode: u32, stop: &dyn Fn() -> bool) -> Result<bool, ProcessError> {
        if mode == CommandMode::Torque as u32 {
            self.arm.takes_torques()?;
            self.weights = Weights::of_run(&self.joining.instance)?;
        }
        let DriveJoining { instance, payload, .. } = self.joining;
        if let Some(limits) = accelerations_of_run(instance)? {
            self.arm.set_acceleration(limits);
        }
        let body = payload.of_run(Self::PROGRAM, instance)?;
        self.arm.set_payload(body.map(|body| Payload {
            mass_kg: body.mass,
            com_m: body.com.into(),
            inertia_kg_m2: moments(&body),
        }));
        Ok(self.arm.make_ready(self.enable, stop)? && self.arm.start().map(|()| true)?)
    }

    fn command(&mut self, what: Command) -> Result<(), ProcessError> {
        Ok(self.arm.command(what)?)
    }

    fn heard(&mut self) -> Option<String> {
        self.arm.heard().map(|message| message.to_string())
    }

    fn notice(&mut self) -> Option<String> {
        self.arm.notice().map(|notice| notice.to_string()).or_else(|| self.arm.slider_notice())
    }

    fn is_of_the_robot(error: &ProcessError) -> bool {
        matches!(error, ProcessError::Ur(error) if error.is_of_the_robot())
    }

    fn is_of_the_connection(error: &ProcessError) -> bool {
        !matches!(error, ProcessError::Ur(error) if !matches!(error, UrError::Lost { .. } | UrError::Wire { .. }))
    }

    fn halt(&mut self) {
        self.arm.halt();
    }

    fn is_halted(&self) -> bool {
        self.arm.is_halted()
    }

    fn recover(&mut self, asked: bool) -> Result<bool, ProcessError> {
        Ok(self.arm.recover(asked)? == Recovered::Ready)
    }

    fn come_to_rest(&mut self) -> Result<(), ProcessError> {
        Ok(self.arm.come_to_rest()?)
    }

    fn abandon(&mut self) {
        self.arm.abandon();
    }

    fn of_message(&self, message: &DriveCommandMsg) -> Command {
        let (qd, qdd, at) = (joints(&message.qd_r), joints(&message.qdd_r), Some(message.stamp.0));
        match (message.mode, self.arm.last()) {
            (mode, Some(state)) if mode == CommandMode::Torque as u32 => Command::Torque {
                tau: self.weights.without(message, &state.q),
                contain_friction: message.flags & drive_flag::FRICTION != 0,
            },
            (mode, _) if mode == CommandMode::Velocity as u32 => Command::Velocity { qd, qdd, at },
            (mode, _) if mode == CommandMode::Position as u32 => {
                Command::Position { q: joints(&message.q_r), qd, qdd, at }
            }
            // Control asks for no mode that the first state does not name.
            _ => Command::Hold,
        }
    }

    fn describe(&self, state: &ArmState, message: &mut DriveStateMsg) {
        message.stamp = MonoNs(state.stamp);
        message.robot_state = robot_state(state, self.arm.is_halted()) as u32;
        message.robot_code = robot_code(state);
        for (to, from) in message.q.iter_mut().zip(&state.q) {
            *to = *from;
        }
        for (to, from) in message.qd.iter_mut().zip(&state.qd) {
            *to = *from;
        }
    }
}

/// Runs the drive until the run ends, whatever ends it; what it leaves is an arm at rest. Powers the arm and releases its brakes only with `enable`.
///
/// # Errors
/// When the robot cannot be moved, or no longer, and when the run cannot be joined.
pub fn run(
    settings: ArmSettings,
    enable: bool,
    joining: &DriveJoining,
    stop: &StopFlag,
) -> Result<u8, ProcessError> {
    let connect = || {
        let arm = Arm::connect(settings)?;
        let (host, version, rate_hz) = (settings.host, arm.version(), arm.rate_hz());
        let about = format!("robot at {host}, software {version}, {rate_hz:.0} Hz");
        Ok((UrArm { arm, enable, joining, weights: Weights::default() }, about))
    };
    drive_robot::run(connect, joining, stop)
}

/// What it is commanded in a mode.
fn kind(mode: u32) -> CommandKind {
    match mode {
        mode if mode == CommandMode::Torque as u32 => CommandKind::Torque,
        mode if mode == CommandMode::Velocity as u32 => CommandKind::Velocity,
        _ => CommandKind::Position,
    }
}

/// The limits that the commands of the run keep, which are those for late ones too, rad/s2; none without a run file, as of a control that was started by hand.
fn accelerations_of_run(instance: &Instance) -> Result<Option<[f64; JOINTS]>, ProcessError> {
    let path = instance.config_path();
    if !path.exists() {
        return Ok(None);
    }
    Ok(Config::load(Some(&path), &[])?.motion.max_acceleration.try_into().ok())
}

/// What the robot is beside its joints.
fn robot_state(s: &ArmState, halted: bool) -> RobotState {
    match (s.safety, s.mode) {
        (SafetyMode::RobotEmergencyStop | SafetyMode::SystemEmergencyStop, _) => RobotState::EmergencyStop,
        (
            SafetyMode::ProtectiveStop
            | SafetyMode::SafeguardStop
            | SafetyMode::AutomaticModeSafeguardStop
            | SafetyMode::ThreePositionEnablingStop,
            _,
        ) => RobotState::ProtectiveStop,
        (safety, _) if !safety.lets_move() => RobotState::Fault,
        (_, RobotMode::PowerOn) => RobotState::Enabling,
        (_, RobotMode::Idle) => RobotState::Braked,
        (_, RobotMode::Running) if halted => RobotState::Halted,
        (SafetyMode::Reduced, RobotMode::Running) => RobotState::Reduced,
        (_, RobotMode::Running) if s.program[0] == program_state::MOVES && !s.rests() => RobotState::Moving,
        (_, RobotMode::Running) => RobotState::Ready,
        (_, RobotMode::Backdrive | RobotMode::UpdatingFirmware | RobotMode::Unknown(_)) => RobotState::Fault,
        _ => RobotState::Off,
    }
}

/// The maker's numbers of the robot's and the safety system's mode: 703 is a running robot in a protective stop.
fn robot_code(s: &ArmState) -> u32 {
    let number = |n: i32| u32::try_from(n).unwrap_or(0);
    100 * number(s.mode.number()) + number(s.safety.number())
}

/// Unlocks a protective stop, because somebody asks for it by name.
///
/// # Errors
/// When the robot's dashboard does not.
pub fn unlock(settings: &ArmSettings) -> Result<u8, ProcessError> {
    let patience = settings.patience;
    let mut dashboard = vservo_ur::dashboard::Dashboard::connect(settings.host, patience, settings.clock)?;
    dashboard.unlock_protective_stop()?;
    let safety = dashboard.safety_status()?;
    tell(format_args!("vservo-drive-ur: unlocked; safety status {safety}"));
    Ok(0)
}
