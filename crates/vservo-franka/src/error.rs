//! What can go wrong between here and a robot, in words that say where, what, and how to mend it.

use crate::robot::{RobotMode, name_errors};
use crate::wire::{MoveStatus, VERSION, WireError};
use thiserror::Error;

/// Why a robot cannot be used, or no longer.
#[derive(Debug, Error)]
#[allow(missing_docs)] // the words are the documentation
pub enum FrankaError {
    #[error(
        "cannot reach the robot's interface (FCI) at {address}: {cause}; is the robot switched on, is FCI activated in Desk, and is this its address?"
    )]
    Connect { address: String, cause: std::io::Error },
    #[error(
        "{address} has closed the connection ({cause}): the robot was switched off, FCI was deactivated in Desk, or another client has the robot"
    )]
    Lost { address: String, cause: String },
    #[error("{address} does not answer within {seconds:.1} s ({awaited})")]
    Silent { address: String, awaited: &'static str, seconds: f64 },
    #[error("{address} does not speak FCI as its maker's client does: {error}")]
    Wire { address: String, error: WireError },
    #[error(
        "the robot speaks version {version} of its interface, this driver version {VERSION}: it needs a system image of 5.9 or later ({})",
        if *version < VERSION { "update the robot" } else { "update vservo" }
    )]
    Version { version: u16 },
    #[error(
        "no state comes from the robot within {seconds:.1} s: does a firewall keep UDP from {address} away?"
    )]
    NoStates { address: String, seconds: f64 },
    #[error("{mode}: {}", what_to_do(*mode))]
    NotReady { mode: RobotMode },
    #[error(
        "the robot has stopped by a reflex ({}): find its cause, then clear it in Desk or by `vservo-drive-franka --recover`; \
         it is never cleared by itself",
        name_errors(*.errors)
    )]
    Stopped { errors: u64 },
    #[error(
        "the robot has stopped by a reflex while the arm moved ({}){}. Find the cause; `vservo ctl reset` clears it where the run is served",
        name_errors(*.errors),
        communication(*.errors, *.success_rate)
    )]
    StoppedInMotion { errors: u64, success_rate: f64 },
    #[error("{mode} while the arm moved: {}", what_to_do(*mode))]
    ModeInMotion { mode: RobotMode },
    #[error("the motion was ended: {}", .status.words())]
    MotionEnded { status: MoveStatus },
    #[error("the motion did not begin: {}", .status.words())]
    MotionRefused { status: MoveStatus },
    #[error("the motion did not begin within {seconds:.1} s")]
    MotionNotStarted { seconds: f64 },
    #[error("the robot refuses {what}: {why}")]
    Refused { what: &'static str, why: &'static str },
    #[error(
        "no state came from the robot for {milliseconds} ms: the network or the controller has failed; the robot stops the arm by itself"
    )]
    StatesStopped { milliseconds: i64 },
    #[error("the states of the robot are not finite, or jump by more than a joint can move: {what}")]
    Nonsense { what: String },
    #[error(
        "the time of the robot's states does not go on: the controller repeats an old one, or was started anew"
    )]
    TimeStands,
    #[error("the arm did not come to rest within {seconds:.1} s")]
    NotAtRest { seconds: f64 },
    #[error(
        "the robot has stopped by a reflex once more after that was cleared ({}): find the cause; it is not cleared again before somebody asks for that",
        name_errors(*.errors)
    )]
    StoppedAgain { errors: u64 },
}

impl FrankaError {
    /// Whether the robot itself has stopped the arm or the motion, and still says how it is: states go on, and it may come back.
    #[must_use]
    pub fn is_of_the_robot(&self) -> bool {
        matches!(self, Self::StoppedInMotion { .. } | Self::ModeInMotion { .. } | Self::MotionEnded { .. })
    }

    /// Whether the robot is gone, or is none.
    #[must_use]
    pub fn is_of_the_connection(&self) -> bool {
        matches!(self, Self::Lost { .. } | Self::Wire { .. })
    }
}

fn what_to_do(mode: RobotMode) -> &'static str {
    match mode {
        RobotMode::Other => "open its brakes in Desk",
        RobotMode::Guiding => "let go of its guiding button",
        RobotMode::UserStopped => "release the button, then open the brakes in Desk where they are closed",
        RobotMode::Move => "another client or a task of Desk moves it: end that",
        RobotMode::AutomaticErrorRecovery => "wait until it has done so",
        RobotMode::Idle => "something has ended the motion",
        RobotMode::Reflex => "find its cause, and clear it in Desk",
        RobotMode::Unknown(_) => "this driver does not know it",
    }
}

/// The hint that belongs to commands that came too late.
fn communication(errors: u64, rate: f64) -> String {
    if errors & crate::robot::RobotError::Communication.bit() == 0 {
        return String::new();
    }
    format!(
        "; of the last hundred commands {:.0} % came in time: commands are late, look with `vservo doctor`, and connect the robot by a cable of its own",
        100.0 * rate
    )
}
