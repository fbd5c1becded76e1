//! Arms of Universal Robots (e-Series and CB3) over the wire that their controllers speak.
//!
//! ```text
//! 30004  RTDE: binary, 500 Hz (e-Series) or 125 Hz (CB3): states out, registers in      rtde/, client
//! 30002  secondary interface: a program as text, which the controller runs              program
//! 29999  dashboard: one line asks, one line answers: power, brakes, stops               dashboard
//! ```
//! [`Arm`] puts the three together: it looks whether the robot may move, sends the [program], and passes commands by registers that the
//! program reads in every cycle. [`emulator`] is the other end of the wire, for tests and for whoever has no robot.
//!
//! Nothing here reads a clock on behalf of a caller: [`Clock`] is handed in, so that stamps are those of the caller's own clock.

pub mod arm;

pub mod dashboard;
pub mod emulator;
pub mod error;
pub mod primary;
pub mod program;
pub mod robot;
pub mod rtde;
mod socket;

pub use arm::{Arm, ArmSettings, Command};
pub use error::UrError;
pub use program::Payload;
pub use robot::{RobotMode, RuntimeState, SafetyMode, Series, Version};
pub use vservo_clock::{ClockEstimate, ClockMap};

/// Joints of every arm of this maker.
pub const JOINTS: usize = 6;

/// Values of the joints, rad, rad/s or rad/s2.
pub type Joints = [f64; JOINTS];

/// Reads a monotonic clock, ns.
pub type Clock = fn() -> i64;
