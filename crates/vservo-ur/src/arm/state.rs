//! What an arm is told to be, and what it tells: settings, commands, states.

use crate::ClockMap;
use crate::program::{Payload, command, state as program_state};
use crate::robot::{RobotMode, RuntimeState, SafetyMode};
use crate::rtde::Recipe;
use crate::{Clock, JOINTS, Joints, UrError};
use std::net::IpAddr;
use std::time::Duration;

/// Fastest that a joint of any of these arms turns, rad/s: twice the 360 degrees a second of a UR3's wrist, by the maker's data sheets, so that a
/// disturbed reading of time is none.
const FASTEST_RAD_S: f64 = 4.0 * std::f64::consts::PI;
/// What a reading may jump by beside that, rad. Chosen by hand: far more than an encoder's noise, far less than a lost turn.
const JUMP_RAD: f64 = 0.05;
/// A command that is farther away in time than this is not carried on any farther by the driver, ns. Chosen by hand: five cycles of 500 Hz, in which a joint at 2 rad/s turns by 0.02 rad.
const CARRIED_NS: i64 = 10_000_000;
/// A joint slower than this rests, rad/s. Chosen by hand: above the noise of velocities, and a hundredth of a degree in 0.1 s.
const REST_RAD_S: f64 = 2e-3;

/// Which robot, and how it is moved.
#[derive(Debug, Clone, Copy)]
pub struct ArmSettings {
    /// The controller's address.
    pub host: IpAddr,
    /// Reads the caller's clock.
    pub clock: Clock,
    /// The first register, 24 or 0.
    pub registers: u8,
    /// `lookahead_time` of `servoj`, s.
    pub lookahead_s: f64,
    /// `gain` of `servoj`.
    pub gain: f64,
    /// Acceleration of `speedj`, rad/s2.
    pub speed_acceleration_rad_s2: f64,
    /// Deceleration of `stopj`, rad/s2.
    pub stop_deceleration_rad_s2: f64,
    /// States and commands in a second, a whole part of those of the robot; none: as many.
    pub rate_hz: Option<f64>,
    /// Largest acceleration of each joint with which the robot's program makes up for late commands, rad/s2: the limit that commands keep.
    pub acceleration_rad_s2: Joints,
    /// Fastest that commanded positions move, rad/s: where commands were late, the robot's program approaches the next one so fast instead of at once.
    pub fastest_rad_s: f64,
    /// How long the robot goes on without a new command.
    pub watchdog: Duration,
    /// The same while torques are commanded.
    pub torque_watchdog: Duration,
    /// What hangs on the flange; none: as it is set on the robot.
    pub payload: Option<Payload>,
    /// Longest wait for an answer.
    pub patience: Duration,
    /// Longest time without a state.
    pub silence: Duration,
}

impl ArmSettings {
    /// A robot with the usual settings: the quickest `servoj` that the maker's documentation allows; 40 rad/s2 are the most that it allows `speedj`, because control
    /// limits accelerations itself; the robot's program takes the same for late ones where nobody tells less; 180 degrees a second are the speed of most joints by the maker's data sheets; `stopj` with the 4 rad/s2 that the maker's own client has; the times are chosen by hand: 0.1 s without a command are
    /// fifty lost cycles, and 0.1 rad at 1 rad/s; a torque is given up after the twenty cycles of 1 kHz after which a Franka robot does so by its maker's documentation: 1 rad/s2 that was meant to end then adds
    /// 0.02 rad/s.
    #[must_use]
    pub fn new(host: IpAddr, clock: Clock) -> Self {
        Self {
            host,
            clock,
            registers: 24,
            lookahead_s: 0.03,
            gain: 2000.0,
            speed_acceleration_rad_s2: 40.0,
            stop_deceleration_rad_s2: 4.0,
            rate_hz: None,
            acceleration_rad_s2: [40.0; JOINTS],
            fastest_rad_s: std::f64::consts::PI,
            watchdog: Duration::from_millis(100),
            torque_watchdog: Duration::from_millis(20),
            payload: None,
            patience: Duration::from_secs(5),
            silence: Duration::from_millis(100),
        }
    }
}

/// Ways to move the arm.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CommandKind {
    /// `servoj`.
    Position,
    /// `speedj`.
    Velocity,
    /// `direct_torque`.
    Torque,
}

/// What the arm shall do until the next command.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Command {
    /// Brake, and stay.
    Hold,
    /// Be at these positions, moving so, at a time; at others they are carried on.
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
    /// Push with these torques beside the weight, which the robot holds, N m.
    Torque {
        /// Of each joint.
        tau: Joints,
        /// Whether they contain what friction takes; else the robot compensates its own.
        contain_friction: bool,
    },
    /// Brake, and end the program.
    End,
}

impl Command {
    /// Go to the positions `q`, rad, and stay there.
    #[must_use]
    pub fn stand_at(q: Joints) -> Self {
        Self::Position { q, qd: [0.0; JOINTS], qdd: [0.0; JOINTS], at: None }
    }

    /// Keep the velocities `qd`, rad/s.
    #[must_use]
    pub fn keep(qd: Joints) -> Self {
        Self::Velocity { qd, qdd: [0.0; JOINTS], at: None }
    }
}

/// What goes into the registers of a command.
pub(super) struct Registers {
    pub(super) code: i32,
    /// Cycles of the robot by which the numbers are older than its newest state, or younger where that is below zero.
    pub(super) older: i32,
    /// q or torques, qd, qdd.
    pub(super) values: [Joints; 3],
}

impl Command {
    /// The registers, of the instant `now`, ns, of the newest state: the robot's cycles and the caller's drift against each other, and the newest command is now one, now three of the
    /// caller's cycles on from the one before, which the robot would take for accelerations. What is older than [`CARRIED_NS`] is carried on by whole cycles less than that: the rest is the program's.
    pub(super) fn registers(self, now: i64, cycle_s: f64) -> Registers {
        let none = [0.0; JOINTS];
        let still = |code, first| Registers { code, older: 0, values: [first, none, none] };
        match self {
            Self::Hold => still(command::HOLD, none),
            Self::End => still(command::END, none),
            Self::Torque { tau, contain_friction: false } => still(command::TORQUE, tau),
            Self::Torque { tau, contain_friction: true } => still(command::TORQUE_WITH_FRICTION, tau),
            Self::Position { q, qd, qdd, at } => {
                let (t, older) = carried(at, now, cycle_s);
                let q = std::array::from_fn(|i| q[i] + t * (qd[i] + 0.5 * t * qdd[i]));
                let qd = std::array::from_fn(|i| qd[i] + t * qdd[i]);
                Registers { code: command::POSITION, older, values: [q, qd, qdd] }
            }
            Self::Velocity { qd, qdd, at } => {
                let (t, older) = carried(at, now, cycle_s);
                let qd = std::array::from_fn(|i| qd[i] + t * qdd[i]);
                Registers { code: command::VELOCITY, older, values: [none, qd, qdd] }
            }
        }
    }
}

/// How far what was commanded for the instant `at` is carried on, s, and how many cycles are left to `now`.
fn carried(at: Option<i64>, now: i64, cycle_s: f64) -> (f64, i32) {
    let Some(at) = at else { return (0.0, 0) };
    let (age_s, most_s) = ((now - at) as f64 * 1e-9, CARRIED_NS as f64 * 1e-9);
    // States that a network holds up are older than the command is. Of a command from days ago nothing is left to be carried on.
    let whole = ((age_s.abs() - most_s) / cycle_s).ceil().clamp(0.0, 1e6).copysign(age_s);
    ((age_s - whole * cycle_s).clamp(-most_s, most_s), whole as i32)
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
    /// Mode of its safety system.
    pub safety: SafetyMode,
    /// What its program does, by the controller.
    pub runtime: RuntimeState,
    /// The speed slider, 0 to 1.
    pub slider: f64,
    /// Registers of the program: what it does, the count that it obeys, its session.
    pub program: [i32; 3],
}

impl ArmState {
    /// Whether no joint moves.
    #[must_use]
    pub fn rests(&self) -> bool {
        self.qd.iter().all(|v| v.abs() < REST_RAD_S)
    }

    /// Whether the program of this session runs, and holds the arm.
    #[must_use]
    pub fn holds_for(&self, session: i32) -> bool {
        let [does, _, of] = self.program;
        self.runtime == RuntimeState::Playing && does == program_state::HOLDS && of == session
    }
}

/// Places of what is read, in the payload of a state.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Places {
    pub(super) time: usize,
    pub(super) q: usize,
    pub(super) qd: usize,
    pub(super) mode: usize,
    pub(super) safety: usize,
    pub(super) runtime: usize,
    pub(super) slider: usize,
    pub(super) program: [usize; 3],
}

/// A state of the payload of a package that came at `arrival`, ns.
pub(super) fn read(payload: &[u8], at: &Places, map: &mut ClockMap, arrival: i64) -> ArmState {
    let robot_s = Recipe::double(payload, at.time);
    ArmState {
        stamp: map.stamp(robot_s, arrival),
        robot_s,
        q: Recipe::joints(payload, at.q),
        qd: Recipe::joints(payload, at.qd),
        mode: RobotMode::of(Recipe::int(payload, at.mode)),
        safety: SafetyMode::of(Recipe::int(payload, at.safety)),
        runtime: RuntimeState::of(Recipe::int(payload, at.runtime)),
        slider: Recipe::double(payload, at.slider),
        program: at.program.map(|place| Recipe::int(payload, place)),
    }
}

/// That an arm can have moved so.
pub(super) fn plausible(last: &ArmState, state: &ArmState, passed_s: f64) -> Result<(), UrError> {
    let furthest = FASTEST_RAD_S * passed_s + JUMP_RAD;
    match last.q.iter().zip(&state.q).enumerate().find(|(_, (a, b))| (*a - *b).abs() > furthest) {
        Some((joint, (from, to))) => Err(UrError::Nonsense {
            what: format!("joint {} from {from:.3} to {to:.3} rad in {passed_s:.4} s", joint + 1),
        }),
        None => Ok(()),
    }
}
