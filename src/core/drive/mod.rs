//! The arm as the controller sees it: states come out, commands go in.
//!
//! ```text
//! read(now) -> DriveState -> Controller::step -> DriveCommand -> write(command), held until the next one
//! ```
//!
//! | drive | takes | what it is |
//! | --- | --- | --- |
//! | [`SimulatedDrive`] | torque, velocity, position | rigid body with friction, limits, encoders, delay |
//! | [`IdealDrive`] | velocity, position | joints that follow the reference exactly |
//! | [`ExternalDrive`] | what the process behind it says | another process, over a [`DriveLink`] |
//! | [`RecordedDrive`] | everything, and obeys nothing | an arm that was recorded, for dry runs |
//! | [`StandstillDrive`] | everything | no arm, or one that does not move: replayed images |

pub mod check;
mod delay;
mod disturbances;
mod elastic_joints;
mod encoder;
mod external;
mod friction;
mod hard_friction;
mod ideal;
mod inner_servo;
mod joint_names;
mod mode;
mod properties;
mod recorded;
mod simulated;
mod standstill;
mod surroundings;
mod timing;
mod torque_contents;

pub use delay::MAX_DELAY;
pub use disturbances::{ShakingBase, TorqueRipple};
pub use encoder::EncoderModel;
pub use external::{DriveLink, ExternalDrive};
pub use hard_friction::HardFriction;
pub use ideal::IdealDrive;
pub use inner_servo::InnerServo;
pub use joint_names::{JointNamesError, check_joint_names, compare_joint_names};
pub use mode::CommandMode;
pub use properties::{DriveProperties, DrivePropertiesError};
pub use recorded::{NextState, RecordedDrive, RecordedMotion};
pub use simulated::{SimulatedDrive, SimulatedDriveError, SimulatedDriveSettings};
pub use standstill::StandstillDrive;
pub use surroundings::{Jam, Push, Surroundings, Wall};
pub use timing::{DriveTiming, RepeatedStates};
pub use torque_contents::TorqueContents;

use crate::messages::RobotState;
use crate::time::MonoNs;
use nalgebra::SVector;

/// What a drive reports.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriveState<const N: usize> {
    /// Measured joint positions, rad or m.
    pub q: SVector<f64, N>,
    /// Measured joint velocities.
    pub qd: SVector<f64, N>,
    /// The true positions and velocities, where the arm is simulated.
    pub truth: Option<(SVector<f64, N>, SVector<f64, N>)>,
}

/// The command of a drive; which part of it the drive obeys is its [`CommandMode`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriveCommand<const N: usize> {
    /// Torques or forces, N m or N.
    pub tau: SVector<f64, N>,
    /// Reference positions, rad or m.
    pub q_r: SVector<f64, N>,
    /// Reference velocities.
    pub qd_r: SVector<f64, N>,
    /// Reference accelerations.
    pub qdd_r: SVector<f64, N>,
}

/// Why a drive's states cannot be used any more.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DriveFault {
    /// The external drive's newest state is too old.
    Stale,
    /// The external drive has left the instance.
    Left,
    /// The external drive did not answer a command.
    Silent,
    /// The external drive answered a command with a state of another tick or arm.
    OutOfStep,
}

impl DriveFault {
    /// What happened, for people.
    #[must_use]
    pub fn describe(self) -> &'static str {
        match self {
            Self::Stale => "the external drive's states stopped for longer than safety.drive_timeout_ms",
            Self::Left => "the external drive has left",
            Self::Silent => {
                "the external drive did not answer a command within drive.external.answer_timeout_s"
            }
            Self::OutOfStep => {
                "the external drive answered with a state of another tick or another number of joints"
            }
        }
    }
}

/// What a drive tells of its robot beside the joints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RobotReport {
    /// What it is.
    pub state: RobotState,
    /// The maker's own code for that; 0 where there is none.
    pub code: u32,
}

/// How a drive fares.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DriveHealth {
    /// Ticks that found no new state although one was due.
    pub late_states: u64,
    /// Whether the state of this tick is an old one: one from before, as drives slower than control have between theirs, or one that came late.
    pub is_old: bool,
    /// Why its states cannot be used any more.
    pub fault: Option<DriveFault>,
    /// What the newest state tells of the robot.
    pub robot: RobotReport,
}

/// An arm.
pub trait Drive<const N: usize> {
    /// The state at `now`, which never runs backwards.
    fn read(&mut self, now: MonoNs) -> DriveState<N>;

    /// Takes a command, which holds until the next one.
    fn write(&mut self, command: &DriveCommand<N>);

    /// The joint torques or forces that the last [`read`](Self::read) state carries, N m or N; `None` where the drive measures none.
    fn measured_torque(&self) -> Option<SVector<f64, N>> {
        None
    }

    /// The commands that it can obey.
    fn modes(&self) -> &'static [CommandMode];

    /// The names of its joints, in its order, which are compared with those of the robot file before the arm moves; empty where it tells none.
    fn joint_names(&self) -> &[&str] {
        &[]
    }

    /// How the last [`read`](Self::read) went.
    fn health(&self) -> DriveHealth {
        DriveHealth::default()
    }

    /// Whether the last [`read`](Self::read) state was its last: of an arm that was recorded.
    fn is_over(&self) -> bool {
        false
    }

    /// Clears the fault of its states, after a reset.
    fn reset(&mut self) {}

    /// Whether the robot is asked to clear its error, from the next command on.
    fn clear_robot(&mut self, _asked: bool) {}

    /// No command follows: the arm stays where it is by its own means, `last` being what it is to hold.
    fn end(&mut self, _last: &DriveCommand<N>) {}
}
