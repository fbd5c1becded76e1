//! What an arm is told to be, and what it tells: settings, commands, states.

use crate::robot::{Controller, Generator, RobotMode};
use crate::wire::{CollisionBehavior, Load, MoveController, MoveGenerator, RobotState};
use crate::{Clock, FrankaError, Joints};
use std::net::IpAddr;
use std::time::Duration;
use vservo_clock::ClockMap;

/// Fastest that a joint turns, rad/s: twice the fastest joint of an FR3 by the maker's limits, so that a disturbed reading of time is none.
const FASTEST_RAD_S: f64 = 2.0 * 5.26;
/// What a reading may jump by beside that, rad. Chosen by hand: far more than an encoder's noise, far less than a turn.
const JUMP_RAD: f64 = 0.05;
/// A joint slower than this rests, rad/s. Chosen by hand: above the noise of velocities, and a hundredth of a degree in 0.1 s.
const REST_RAD_S: f64 = 2e-3;

/// Which robot, and how it is moved.
#[derive(Debug, Clone, Copy)]
pub struct ArmSettings {
    /// The controller's address.
    pub host: IpAddr,
    /// Reads the caller's clock.
    pub clock: Clock,
    /// Longest wait for an answer.
    pub patience: Duration,
    /// Longest time without a state.
    pub silence: Duration,
    /// Where the robot stops for a contact; none: as it is set there.
    pub collision: Option<CollisionBehavior>,
    /// What hangs on the end effector; none: as it is set there.
    pub load: Option<Load>,
    /// Stiffness of the joints under positions and velocities, N m/rad; none: as it is set there.
    pub stiffness: Option<Joints>,
}

impl ArmSettings {
    /// A robot as it is set. The times are chosen by hand: the robot itself stops after 20 ms without a command, and answers within some.
    #[must_use]
    pub fn new(host: IpAddr, clock: Clock) -> Self {
        Self {
            host,
            clock,
            patience: Duration::from_secs(5),
            silence: Duration::from_millis(100),
            collision: None,
            load: None,
            stiffness: None,
        }
    }
}

/// By what the arm is commanded, from the begin of a motion to its end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CommandKind {
    /// Positions, which the robot follows by its joint impedance.
    Position,
    /// Velocities, likewise.
    Velocity,
    /// Torques without gravity, which the robot adds.
    Torque,
}

impl CommandKind {
    /// As the wire names it in a request.
    pub(super) fn asked(self) -> (MoveController, MoveGenerator) {
        match self {
            Self::Position => (MoveController::JointImpedance, MoveGenerator::JointPosition),
            Self::Velocity => (MoveController::JointImpedance, MoveGenerator::JointVelocity),
            Self::Torque => (MoveController::External, MoveGenerator::None),
        }
    }

    /// As the robot's states name it.
    pub(super) fn told(self) -> (Controller, Generator) {
        match self {
            Self::Position => (Controller::JointImpedance, Generator::JointPosition),
            Self::Velocity => (Controller::JointImpedance, Generator::JointVelocity),
            Self::Torque => (Controller::External, Generator::None),
        }
    }
}

/// What the arm shall do until the next command.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Command {
    /// Brake, and stay.
    Hold,
    /// Be at these positions, moving so, at a time; at others they are carried on by velocity and acceleration.
    Position {
        /// rad.
        q: Joints,
        /// rad/s.
        qd: Joints,
        /// rad/s2.
        qdd: Joints,
        /// When that is, by the caller's clock, ns; none: whenever it comes.
        at: Option<i64>,
    },
    /// Move with these velocities at a time; at others they are carried on.
    Velocity {
        /// rad/s.
        qd: Joints,
        /// rad/s2.
        qdd: Joints,
        /// When that is, by the caller's clock, ns; none: whenever it comes.
        at: Option<i64>,
    },
    /// Push with these torques without gravity, N m; under positions and velocities: hold.
    Torque(Joints),
}

impl Command {
    /// Go to the positions `q`, rad, and stay there.
    #[must_use]
    pub fn stand_at(q: Joints) -> Self {
        Self::Position { q, qd: [0.0; crate::JOINTS], qdd: [0.0; crate::JOINTS], at: None }
    }

    /// Keep the velocities `qd`, rad/s.
    #[must_use]
    pub fn keep(qd: Joints) -> Self {
        Self::Velocity { qd, qdd: [0.0; crate::JOINTS], at: None }
    }
}

/// A state of the robot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ArmState {
    /// When it was sampled, by the caller's clock, ns.
    pub stamp: i64,
    /// The same by the controller's clock, s.
    pub robot_s: f64,
    /// Measured positions, rad.
    pub q: Joints,
    /// Measured velocities, rad/s.
    pub qd: Joints,
    /// Mode of the robot.
    pub mode: RobotMode,
    /// Errors that there are, a bit each.
    pub errors: u64,
}

impl ArmState {
    /// Of a state that came at `arrival`, ns.
    pub(super) fn of(state: &RobotState, map: &mut ClockMap, arrival: i64) -> Self {
        let robot_s = state.message_id as f64 * crate::CYCLE_S;
        Self {
            stamp: map.stamp(robot_s, arrival),
            robot_s,
            q: state.q,
            qd: state.dq,
            mode: state.mode,
            errors: state.errors,
        }
    }

    /// Whether no joint moves.
    #[must_use]
    pub fn rests(&self) -> bool {
        self.qd.iter().all(|v| v.abs() < REST_RAD_S)
    }
}

/// That an arm can have moved so.
pub(super) fn plausible(last: &RobotState, state: &RobotState, passed_s: f64) -> Result<(), FrankaError> {
    let furthest = FASTEST_RAD_S * passed_s + JUMP_RAD;
    match last.q.iter().zip(&state.q).enumerate().find(|(_, (a, b))| (*a - *b).abs() > furthest) {
        Some((joint, (from, to))) => Err(FrankaError::Nonsense {
            what: format!("joint {} from {from:.3} to {to:.3} rad in {passed_s:.4} s", joint + 1),
        }),
        None => Ok(()),
    }
}
