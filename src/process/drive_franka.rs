//! The drive of an arm of Franka, over its real-time interface (FCI).
//!
//! ```text
//! commands ─► low-pass, limits ─► UDP, 1 kHz: positions, velocities, or torques less the weights of the links       states ◄─ UDP, 1 kHz
//! ```
//! The robot holds its weight and makes up for its friction by itself. Of torques that contain its weight, which commands tell (`drive.torque_contains`), the weights of the run's robot
//! file are taken away here, with its `[tool]`; friction is control's to leave out.

use super::drive_robot::{self, DriveJoining, RobotArm, joints};
use super::drive_weights::Weights;
use super::{ProcessError, StopFlag};
use crate::drive::{CommandMode, DriveProperties};
use crate::messages::{DriveCommandMsg, DriveStateMsg, RobotState};
use crate::rt::{ClockEstimate, tell};
use crate::time::{MonoNs, SpanNs, TICK};
use std::time::Duration;
use vservo_franka::arm::{ArmState, Recovered};
use vservo_franka::wire::Load;
use vservo_franka::{Arm, ArmSettings, Command, CommandKind, JOINTS, RobotMode, first_error};

/// The joints, as the maker's own descriptions name them behind the name of the arm (`fr3_joint1`).
pub const JOINT_NAMES: [&str; JOINTS] =
    ["joint1", "joint2", "joint3", "joint4", "joint5", "joint6", "joint7"];

/// By how much an arm is behind velocities, which pass a low-pass and limits here. Measured by `vservo drive check` before the emulator; behind positions, which are carried on to the robot's time, it is none.
const VELOCITY_LAG: SpanNs = SpanNs(3 * TICK.0);

/// An arm, and what torques hold of its weight.
struct FrankaArm<'a> {
    arm: Arm,
    joining: &'a DriveJoining,
    weights: Weights<JOINTS>,
}

impl RobotArm for FrankaArm<'_> {
    type State = ArmState;
    type Command = Command;
    type Error = ProcessError;
    const PROGRAM: &'static str = "vservo-drive-franka";
    const BACK: &'static str = "the robot's motion runs again";
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
        DriveProperties {
            period: Some(TICK),
            // Cycles in a row without a command that end a motion, by the maker's documentation.
            watchdog: Some(SpanNs(20 * TICK.0)),
            lag: Some(if mode == CommandMode::Velocity as u32 { VELOCITY_LAG } else { SpanNs::ZERO }),
            effort_rate: vec![vservo_franka::MAX_TORQUE_RATE; JOINTS],
        }
    }

    fn begin(&mut self, mode: u32, stop: &dyn Fn() -> bool) -> Result<bool, ProcessError> {
        self.arm.make_ready()?;
        if stop() {
            return Ok(false);
        }
        let kind = match mode {
            mode if mode == CommandMode::Torque as u32 => CommandKind::Torque,
            mode if mode == CommandMode::Velocity as u32 => CommandKind::Velocity,
            _ => CommandKind::Position,
        };
        if kind == CommandKind::Torque {
            self.weights = Weights::of_run(&self.joining.instance)?;
        }
        let body = self.joining.payload.of_run(Self::PROGRAM, &self.joining.instance)?;
        // The matrix is symmetric: row by row is column by column.
        self.arm.set_load(body.map(|body| Load {
            mass_kg: body.mass,
            com_F: body.com.into(),
            inertia_kg_m2: std::array::from_fn(|i| body.about_com[(i % 3, i / 3)]),
        }));
        self.arm.start(kind)?;
        Ok(true)
    }

    fn command(&mut self, what: Command) -> Result<(), ProcessError> {
        Ok(self.arm.command(what)?)
    }

    fn is_of_the_robot(error: &ProcessError) -> bool {
        matches!(error, ProcessError::Franka(error) if error.is_of_the_robot())
    }

    fn is_of_the_connection(error: &ProcessError) -> bool {
        !matches!(error, ProcessError::Franka(error) if !error.is_of_the_connection())
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
            (mode, Some(state)) if mode == CommandMode::Torque as u32 => {
                Command::Torque(self.weights.without(message, &state.q))
            }
            (mode, ..) if mode == CommandMode::Velocity as u32 => Command::Velocity { qd, qdd, at },
            (mode, ..) if mode == CommandMode::Position as u32 => {
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

/// Runs the drive until the run ends, whatever ends it; what it leaves is an arm at rest.
///
/// # Errors
/// When the robot cannot be moved, or no longer, and when the run cannot be joined.
pub fn run(settings: ArmSettings, joining: &DriveJoining, stop: &StopFlag) -> Result<u8, ProcessError> {
    let connect = || {
        let arm = Arm::connect(settings)?;
        let about = format!("robot at {}, FCI version {}", settings.host, vservo_franka::wire::VERSION);
        Ok((FrankaArm { arm, joining, weights: Weights::default() }, about))
    };
    drive_robot::run(connect, joining, stop)
}

/// What the robot is beside its joints. One that is guided by hand comes back by a reset, as one whose motion was ended.
fn robot_state(s: &ArmState, halted: bool) -> RobotState {
    match s.mode {
        RobotMode::Other => RobotState::Braked,
        RobotMode::UserStopped => RobotState::EmergencyStop,
        RobotMode::Reflex | RobotMode::AutomaticErrorRecovery => RobotState::ProtectiveStop,
        RobotMode::Guiding => RobotState::Halted,
        RobotMode::Idle | RobotMode::Move if halted => RobotState::Halted,
        RobotMode::Move if !s.rests() => RobotState::Moving,
        RobotMode::Idle | RobotMode::Move => RobotState::Ready,
        RobotMode::Unknown(_) => RobotState::Fault,
    }
}

/// The maker's number of the mode, and of the first error, counted from 1: 426 is a reflex because commands came too late.
fn robot_code(s: &ArmState) -> u32 {
    100 * u32::from(s.mode.number()) + first_error(s.errors).map_or(0, |number| number + 1)
}

/// Clears a reflex, because somebody asks for it by name.
///
/// # Errors
/// When the robot does not.
pub fn recover(settings: &ArmSettings) -> Result<u8, ProcessError> {
    let mode = Arm::connect(*settings)?.clear()?;
    tell(format_args!("vservo-drive-franka: cleared; {mode}"));
    Ok(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn modes_and_errors_have_their_state_and_code() {
        let state = |mode, errors| {
            let zero = [0.0; JOINTS];
            ArmState { stamp: 0, robot_s: 0.0, q: zero, qd: zero, mode, errors }
        };
        let late = state(RobotMode::Reflex, 1 << 25);
        assert_eq!((robot_state(&late, true), robot_code(&late)), (RobotState::ProtectiveStop, 426));
        let idle = state(RobotMode::Idle, 0);
        assert_eq!((robot_state(&idle, false), robot_code(&idle)), (RobotState::Ready, 100));
        assert_eq!(robot_state(&idle, true), RobotState::Halted);
        assert_eq!(robot_state(&state(RobotMode::UserStopped, 0), true), RobotState::EmergencyStop);
        assert_eq!(robot_state(&state(RobotMode::of(77), 0), false), RobotState::Fault);
    }
}
