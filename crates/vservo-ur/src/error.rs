//! What can go wrong between here and a robot, in words that say where, what, and how to mend it.

use crate::robot::{RobotMode, RuntimeState, SafetyMode, Version};
use crate::rtde::WireError;
use thiserror::Error;

/// Why a robot cannot be used, or no longer.
#[derive(Debug, Error)]
#[allow(missing_docs)] // the words are the documentation
pub enum UrError {
    #[error("cannot reach {what} at {address}: {cause}; is the robot switched on, and is this its address?")]
    Connect { what: &'static str, address: String, cause: std::io::Error },
    #[error(
        "{what} at {address} has closed the connection ({cause}): the robot was switched off, or another program took its place"
    )]
    Lost { what: &'static str, address: String, cause: String },
    #[error("{what} at {address} does not answer within {seconds:.1} s ({awaited})")]
    Silent { what: &'static str, address: String, awaited: &'static str, seconds: f64 },
    #[error("{address} does not speak RTDE as its documentation says: {error}")]
    Wire { address: String, error: WireError },
    #[error("{address} refuses the RTDE protocol version 2: its software is too old")]
    Protocol { address: String },
    #[error(
        "the robot's software {version} is too old for this driver: it needs 3.9 (CB3) or 5.3 (e-Series)"
    )]
    TooOld { version: Version },
    #[error(
        "the robot's software {version} takes no torques: that needs 5.23, or 10.11 on PolyScope X; set drive.mode to `position` or `velocity`"
    )]
    NoTorques { version: Version },
    #[error("the robot's software {version} does not know {}: it is too old, or not one of this maker", .names.join(", "))]
    NotFound { names: Vec<String>, version: Version },
    #[error(
        "another program writes {}: close it, or switch off EtherNet/IP, PROFINET and MODBUS units in the \
         installation of the robot, or use the other registers (--registers)",
        .names.join(", ")
    )]
    InUse { names: Vec<String> },
    #[error("the robot does not start to send states")]
    NotStarted,
    #[error(
        "{mode}: power it on and release its brakes on the pendant, or let the driver do so with --enable"
    )]
    NotRunning { mode: RobotMode },
    #[error("the robot did not come from {from} to {to} within {seconds:.0} s: {mode}, {safety}")]
    NotEnabled { from: &'static str, to: &'static str, seconds: f64, mode: RobotMode, safety: SafetyMode },
    #[error(
        "{safety}: find its cause, then unlock the robot on the pendant (a protective stop also by `vservo-drive-ur --unlock`); \
         it is never unlocked by itself"
    )]
    Stopped { safety: SafetyMode },
    #[error(
        "{safety} while the arm moved; the controller has stopped it. Find the cause, then unlock the robot on the pendant \
         (a protective stop also by `vservo ctl reset`, where the run is served)"
    )]
    StoppedInMotion { safety: SafetyMode },
    #[error("the robot is no longer running ({mode}): the arm is held by its brakes")]
    PoweredDown { mode: RobotMode },
    #[error(
        "the speed slider of the pendant stands at {percent:.0} %: the arm would not follow its commands; set it to 100 %"
    )]
    SpeedSlider { percent: f64 },
    #[error(
        "the robot is not under remote control: choose remote control on the pendant, or programs are not taken over the network"
    )]
    LocalControl,
    #[error(
        "another program has the arm, or somebody moves it by hand (program: {runtime:?}): stop that on the pendant, or where it comes from, and wait until the arm stands"
    )]
    OtherProgram { runtime: RuntimeState },
    #[error(
        "the program did not start within {seconds:.1} s: another one runs, or the controller refuses it (its log tells; is the robot under \
         remote control?)"
    )]
    ProgramNotStarted { seconds: f64 },
    #[error("the program on the robot has ended: {why}")]
    ProgramEnded { why: &'static str },
    #[error(
        "no state came from the robot for {milliseconds} ms: the network or the controller has failed; its program stops the arm by itself"
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
    #[error("the dashboard answers `{answer}` to `{command}`")]
    Dashboard { command: &'static str, answer: String },
    #[error(
        "{safety} once more after it was unlocked: find the cause; it is not unlocked again before somebody asks for that"
    )]
    StoppedAgain { safety: SafetyMode },
    #[error("what was to bring the robot's program back has failed")]
    RecoveryFailed,
}

impl UrError {
    /// Whether the robot itself has stopped the arm or its program, and still says how it is: states go on, and it may come back.
    #[must_use]
    pub fn is_of_the_robot(&self) -> bool {
        matches!(self, Self::StoppedInMotion { .. } | Self::PoweredDown { .. } | Self::ProgramEnded { .. })
    }
}
