//! Commands to, and states from, an external drive: `drive/command` and `drive/state`.
//!
//! ```text
//! control ── START (q_r: start position) ──► drive     the arm stands there, held by its brakes
//! control ◄─ INITIAL, tick 0 ─────────────── drive     its joints and the command modes that it supports
//! control ── command k ────────────────────► drive     lockstep: integrate 1 ms ...
//! control ◄─ state k+1 ───────────────────── drive     ... and answer exactly once
//! control ── LAST ─────────────────────────► drive     hold the arm; no command follows
//!
//! control ◄─ robot_state: protective stop ── drive     the robot has stopped the arm by itself: a fault
//! control ── CLEAR, after `vservo ctl reset` ► drive   clear the robot's error, and hold the arm ...
//! control ◄─ robot_state: ready ──────────── drive     ... until commands are obeyed again
//! ```
//! In real time the drive sends states by its own clock, 1 kHz or faster, and obeys the newest command. The numbers here are bits of the
//! protocol, which every drive's program must share.

use super::MAX_JOINTS;
use super::layout::{named_codes, record};
use crate::time::MonoNs;
#[cfg(feature = "transport")]
use iceoryx2::prelude::ZeroCopySend;

record! {
    "vservo.DriveCommand.v3",
    /// A command to an external drive.
    #[derive(Debug, Clone, Copy, Default, PartialEq)]
    pub struct DriveCommandMsg {
        /// Number of the control tick, counted in whole milliseconds from the first.
        pub tick: u64,
        /// Counts what control has sent, `START` included, from 0: a gap is a command that was lost on the way.
        pub sequence: u64,
        /// Time of that tick.
        pub stamp: MonoNs,
        /// Joints in use.
        pub joints: u32,
        /// Command mode, which says what to follow: 0 `tau`, 1 `qd_r`, 2 `q_r` and `qd_r`.
        pub mode: u32,
        /// Bits of [`drive_flag`].
        pub flags: u32,
        /// Which arm: 0.
        pub arm: u32,
        /// Reference positions, rad or m; with `START` the start position.
        pub q_r: [f64; MAX_JOINTS],
        /// Reference velocities, rad/s or m/s.
        pub qd_r: [f64; MAX_JOINTS],
        /// Reference accelerations, rad/s^2 or m/s^2: how `qd_r` changes in this tick.
        pub qdd_r: [f64; MAX_JOINTS],
        /// Torques or forces, N m or N; what they contain is told by [`drive_flag::GRAVITY`] and [`drive_flag::FRICTION`].
        pub tau: [f64; MAX_JOINTS],
    }
}

record! {
    "vservo.DriveState.v3",
    /// A state of an external drive.
    #[derive(Debug, Clone, Copy, Default, PartialEq)]
    pub struct DriveStateMsg {
        /// Lockstep: the tick of the command that this answers, plus one. Real time: counts the states.
        pub tick: u64,
        /// Counts what the drive has sent since it joined, from 0.
        pub sequence: u64,
        /// When it was sampled. Lockstep: the stamp of the command that this answers, plus 1 ms. Real time: `CLOCK_MONOTONIC`.
        pub stamp: MonoNs,
        /// Joints in use.
        pub joints: u32,
        /// The command modes that the drive supports: bit 0 torque, bit 1 velocity, bit 2 position.
        pub modes: u32,
        /// Bits of [`drive_flag`].
        pub flags: u32,
        /// Which arm: 0.
        pub arm: u32,
        /// What the robot is beside its joints: code of a [`RobotState`]; 0 where the drive does not tell.
        pub robot_state: u32,
        /// The maker's own code for that; 0 where there is none.
        pub robot_code: u32,
        /// Measured positions, rad or m.
        pub q: [f64; MAX_JOINTS],
        /// Measured velocities, rad/s or m/s.
        pub qd: [f64; MAX_JOINTS],
        /// Measured torques or forces, N m or N; zero where the drive does not measure them.
        pub tau: [f64; MAX_JOINTS],
        /// With `TRUTH`, the true positions, rad or m, which a synthetic camera renders.
        pub q_true: [f64; MAX_JOINTS],
        /// With `TRUTH`, the true velocities, rad/s or m/s.
        pub qd_true: [f64; MAX_JOINTS],
    }
}

named_codes! {
    /// Bits of [`DriveCommandMsg::flags`] and [`DriveStateMsg::flags`].
    pub mod drive_flag {
        /// State: `q_true` and `qd_true` are valid.
        pub const TRUTH: u32 = 1;
        /// Command: a run begins. A simulator puts its arm at rest in `q_r`; every drive holds it there and answers with
        /// an `INITIAL` state.
        pub const START: u32 = 2;
        /// State: the answer to `START`, tick 0.
        pub const INITIAL: u32 = 4;
        /// Command: the run has ended and no command follows; the drive holds its arm by its own means. Not answered.
        pub const LAST: u32 = 8;
        /// Command with `START`: the run is in lockstep, every command is answered with one state.
        pub const LOCKSTEP: u32 = 16;
        /// Command: somebody has asked for a reset while the robot reported a [`RobotState`](super::RobotState) that can be cleared. The drive clears the robot's
        /// error, holds the arm until that is done, and then reports `Ready`. Without this bit it clears nothing.
        pub const CLEAR: u32 = 32;
        /// Command in mode torque: `tau` holds the arm's weight. Without this bit the robot is to add what does (`drive.torque_contains`).
        pub const GRAVITY: u32 = 64;
        /// Command in mode torque: `tau` makes up for the friction of the joints. Without this bit the robot is to do so (`drive.torque_contains`).
        pub const FRICTION: u32 = 128;
    }
}

/// What a robot is beside its joints.
#[repr(u32)]
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash)]
pub enum RobotState {
    /// The drive does not tell.
    #[default]
    Unknown = 0,
    /// Commands are obeyed; the arm is held.
    Ready = 1,
    /// Commands are obeyed, and the arm moves.
    Moving = 2,
    /// The motors have no power.
    Off = 3,
    /// The motors have power, and the brakes are closed.
    Braked = 4,
    /// Power comes, or the brakes are being opened.
    Enabling = 5,
    /// The robot has stopped the arm by itself, and moves on after it was unlocked.
    ProtectiveStop = 6,
    /// An emergency stop, which somebody has to end at the robot.
    EmergencyStop = 7,
    /// Commands are obeyed, within limits of the robot that are lower than usual.
    Reduced = 8,
    /// The robot has a fault that is mended at the robot.
    Fault = 9,
    /// The robot could move, but what obeys commands there was stopped, and has to be started again.
    Halted = 10,
}

impl RobotState {
    /// All states.
    pub const ALL: [Self; 11] = [
        Self::Unknown,
        Self::Ready,
        Self::Moving,
        Self::Off,
        Self::Braked,
        Self::Enabling,
        Self::ProtectiveStop,
        Self::EmergencyStop,
        Self::Reduced,
        Self::Fault,
        Self::Halted,
    ];

    /// The state of a code in a message; an unknown one counts as [`Self::Fault`].
    #[must_use]
    pub fn from_code(code: u32) -> Self {
        Self::ALL.into_iter().find(|state| *state as u32 == code).unwrap_or(Self::Fault)
    }

    /// Its name for messages.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::Ready => "ready",
            Self::Moving => "moving",
            Self::Off => "off",
            Self::Braked => "braked",
            Self::Enabling => "enabling",
            Self::ProtectiveStop => "protective_stop",
            Self::EmergencyStop => "emergency_stop",
            Self::Reduced => "reduced",
            Self::Fault => "fault",
            Self::Halted => "halted",
        }
    }

    /// Whether commands are obeyed, as far as is known.
    #[must_use]
    pub fn obeys(self) -> bool {
        matches!(self, Self::Unknown | Self::Ready | Self::Moving | Self::Reduced)
    }

    /// Whether a drive can clear it when it is asked to.
    #[must_use]
    pub fn can_be_cleared(self) -> bool {
        matches!(self, Self::ProtectiveStop | Self::Halted)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::mem::{align_of, offset_of, size_of};

    #[test]
    fn layouts_are_fixed() {
        assert_eq!((size_of::<DriveCommandMsg>(), align_of::<DriveCommandMsg>()), (264, 8));
        assert_eq!(offset_of!(DriveCommandMsg, joints), 24);
        assert_eq!(offset_of!(DriveCommandMsg, q_r), 40);
        assert_eq!((offset_of!(DriveCommandMsg, qdd_r), offset_of!(DriveCommandMsg, tau)), (152, 208));
        assert_eq!((size_of::<DriveStateMsg>(), align_of::<DriveStateMsg>()), (328, 8));
        assert_eq!(offset_of!(DriveStateMsg, modes), 28);
        assert_eq!((offset_of!(DriveStateMsg, robot_state), offset_of!(DriveStateMsg, robot_code)), (40, 44));
        assert_eq!(offset_of!(DriveStateMsg, q), 48);
        assert_eq!(offset_of!(DriveStateMsg, q_true), 216);
    }

    #[test]
    #[allow(unsafe_code)]
    fn type_names_carry_their_version() {
        // SAFETY: the names are only read.
        let names = unsafe { (DriveCommandMsg::type_name(), DriveStateMsg::type_name()) };
        assert_eq!(names, ("vservo.DriveCommand.v3", "vservo.DriveState.v3"));
    }

    #[test]
    fn codes_of_robots_come_back_and_unknown_ones_are_faults() {
        for (code, state) in (0..).zip(RobotState::ALL) {
            assert_eq!((state as u32, RobotState::from_code(code)), (code, state));
            assert!(!(state.obeys() && state.can_be_cleared()), "{state:?}");
        }
        for code in [11, 99, u32::MAX] {
            assert_eq!(RobotState::from_code(code), RobotState::Fault, "{code}");
        }
    }
}
