//! Arms of Franka (FR3) over the interface that their controllers speak, FCI, in version 10.
//!
//! ```text
//! TCP 1337   requests and replies: a motion begins and ends, errors are cleared, load and collision thresholds       wire, client
//! UDP        a state in every millisecond, and the command that answers it                                           wire, client
//!            positions, velocities or torques within the robot's limits of velocity, acceleration, jerk              limits, shaping
//! ```
//! [`Arm`] puts these together: it looks whether the robot may move, begins a motion, and answers each state. [`emulator`] is the other end of the wire, for
//! tests and for whoever has no robot.
//!
//! Nothing here reads a clock on behalf of a caller: [`Clock`] is handed in, so that stamps are those of the caller's own clock.

#![allow(non_snake_case)] // frames: com_F is a point in the frame of the flange

pub mod arm;
pub mod client;
pub mod emulator;
pub mod error;
pub mod limits;
pub mod robot;
pub mod shaping;
pub mod wire;

pub use arm::{Arm, ArmSettings, Command, CommandKind};
pub use error::FrankaError;
pub use limits::{JointLimits, MAX_TORQUE_RATE};
pub use robot::{RobotMode, first_error, name_errors};

/// Joints of every arm of this maker.
pub const JOINTS: usize = 7;

/// Values of the joints, rad, rad/s, rad/s2 or N m.
pub type Joints = [f64; JOINTS];

/// Reads a monotonic clock, ns.
pub type Clock = fn() -> i64;

/// Length of a cycle of the robot, s.
pub const CYCLE_S: f64 = 1e-3;
