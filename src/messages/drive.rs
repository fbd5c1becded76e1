//! Commands to, and states from, an external drive: `drive/command` and `drive/state`.
//!
//! ```text
//! control ── START (q_r: start position) ──► drive     the arm stands there, held by its brakes
//! control ◄─ INITIAL, tick 0 ─────────────── drive     its joints and the command modes that it supports
//! control ── command k ────────────────────► drive     lockstep: integrate 1 ms ...
//! control ◄─ state k+1 ───────────────────── drive     ... and answer exactly once
//! control ── LAST ─────────────────────────► drive     hold the arm; no command follows
//! ```
//! In real time the drive sends states by its own clock, 1 kHz or faster, and obeys the newest command. The numbers here are bits of the
//! protocol, which every drive's program must share.

use super::MAX_JOINTS;
use super::layout::record;
use crate::time::MonoNs;
#[cfg(feature = "transport")]
use iceoryx2::prelude::ZeroCopySend;

record! {
    "vservo.DriveCommand.v2",
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
        /// Torques or forces, N m or N.
        pub tau: [f64; MAX_JOINTS],
    }
}

record! {
    "vservo.DriveState.v2",
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::mem::{align_of, offset_of, size_of};

    #[test]
    fn layouts_are_fixed() {
        assert_eq!((size_of::<DriveCommandMsg>(), align_of::<DriveCommandMsg>()), (208, 8));
        assert_eq!(offset_of!(DriveCommandMsg, joints), 24);
        assert_eq!(offset_of!(DriveCommandMsg, q_r), 40);
        assert_eq!(offset_of!(DriveCommandMsg, tau), 152);
        assert_eq!((size_of::<DriveStateMsg>(), align_of::<DriveStateMsg>()), (320, 8));
        assert_eq!(offset_of!(DriveStateMsg, modes), 28);
        assert_eq!(offset_of!(DriveStateMsg, q), 40);
        assert_eq!(offset_of!(DriveStateMsg, q_true), 208);
    }

    #[test]
    #[allow(unsafe_code)]
    fn type_names_carry_their_version() {
        // SAFETY: the names are only read.
        let names = unsafe { (DriveCommandMsg::type_name(), DriveStateMsg::type_name()) };
        assert_eq!(names, ("vservo.DriveCommand.v2", "vservo.DriveState.v2"));
    }
}
