//! State of the arm's joints at each tick: `control/joint_state`.

use super::MAX_JOINTS;
use super::layout::{named_codes, record};
use crate::time::MonoNs;
#[cfg(feature = "transport")]
use iceoryx2::prelude::ZeroCopySend;

record! {
    "vservo.JointState.v3",
    /// State of the joints at one tick.
    #[derive(Debug, Clone, Copy, Default, PartialEq)]
    pub struct JointState {
        /// Number of the control tick.
        pub tick: u64,
        /// Counts what its sender has sent, from 0: a gap is a record that was lost on the way.
        pub sequence: u64,
        /// When the drive was read.
        pub stamp: MonoNs,
        /// Joints in use.
        pub joints: u32,
        /// Bits of [`joint_flag`].
        pub flags: u32,
        /// Which arm.
        pub arm: u32,
        /// Number of the target that control wants measured: 0 is `[target]` of the run file, `[targets.NAME]` follow in the order of their names.
        pub target_number: u32,
        /// Measured positions, rad or m.
        pub q: [f64; MAX_JOINTS],
        /// Measured velocities, rad/s or m/s.
        pub qd: [f64; MAX_JOINTS],
        /// Torques or forces applied at the previous tick, N m or N.
        pub tau: [f64; MAX_JOINTS],
        /// Reference positions, rad or m.
        pub q_r: [f64; MAX_JOINTS],
        /// Reference velocities, rad/s or m/s.
        pub qd_r: [f64; MAX_JOINTS],
        /// True positions of a simulated arm, rad or m, which a synthetic camera renders.
        pub q_true: [f64; MAX_JOINTS],
        /// True velocities of a simulated arm, rad/s or m/s.
        pub qd_true: [f64; MAX_JOINTS],
    }
}

named_codes! {
    /// Bits of [`JointState::flags`].
    pub mod joint_flag {
        /// `q_true` and `qd_true` are valid.
        pub const TRUTH: u32 = 1;
    }
}
