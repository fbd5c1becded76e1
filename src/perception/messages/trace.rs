//! Full record of each tick of control, for replay and analysis: `control/trace`, 1 kHz. The numbers here are those of the protocol.

use super::MAX_JOINTS;
use super::layout::{named_codes, record};
use crate::time::MonoNs;
#[cfg(feature = "transport")]
use iceoryx2::prelude::ZeroCopySend;

/// Kinds of limits, in the order of [`TraceMsg::limits`]: a part of the protocol, which must change its version with it.
pub const TRACE_LIMITS: usize = 16;

record! {
    "vservo.Trace.v5",
    /// One tick: the inputs of control, its command, and the reasons. A code of 0 means none; codes of control's enumerations count
    /// from 1 in the order of their variants.
    #[derive(Debug, Clone, Copy, Default, PartialEq)]
    pub struct TraceMsg {
        /// Number of the control tick; in real time a gap is a tick that was skipped.
        pub tick: u64,
        /// Counts the ticks that were served, from 0: a gap is a record that was lost on the way.
        pub sequence: u64,
        /// Records that control itself had to drop before this one.
        pub lost: u64,
        /// Time of the tick.
        pub stamp: MonoNs,
        /// When its command was written.
        pub commanded: MonoNs,
        /// Frame of the measurement that arrived; valid with [`trace_flag::MEASUREMENT`], like the next five.
        pub frame_id: u64,
        /// Middle of its exposure.
        pub exposure: MonoNs,
        /// When the camera sent it.
        pub frame_sent: MonoNs,
        /// When vision began to process it.
        pub vision_start: MonoNs,
        /// When vision had processed it.
        pub vision_end: MonoNs,
        /// Root mean square feature error, px; NaN where the measurement has no feature error.
        pub feature_error_px: f64,
        /// Which arm.
        pub arm: u32,
        /// Which camera.
        pub camera: u32,
        /// Joints in use.
        pub joints: u32,
        /// Bits of [`trace_flag`].
        pub flags: u32,
        /// Code of a [`super::ControlState`], from 0.
        pub state: u32,
        /// Whether the measurement was used, and if not why: code of a `servo::MeasurementVerdict`.
        pub verdict: u32,
        /// Code of a `control::safety::Fault`; those of an external drive from 17 on, in the order of
        /// `drive::DriveFault`.
        pub fault: u32,
        /// With the last record, how the run ended: code of a `control::outcome::Outcome`.
        pub outcome: u32,
        /// Events of the tick: bit n is the n-th of `control::trace::Event`, from 0.
        pub events: u32,
        /// Orders of the mission that control has obeyed up to this tick.
        pub orders: u32,
        /// The joints on which each `motion::Limit` acted: bit 0 is the first joint. Entries beyond the limits that there are are 0.
        pub limits: [u8; TRACE_LIMITS],
        /// Measured positions, rad or m.
        pub q: [f64; MAX_JOINTS],
        /// Measured velocities, rad/s or m/s.
        pub qd: [f64; MAX_JOINTS],
        /// With [`trace_flag::TRUTH`], the true positions of a simulated arm.
        pub q_true: [f64; MAX_JOINTS],
        /// With [`trace_flag::TRUTH`], its true velocities.
        pub qd_true: [f64; MAX_JOINTS],
        /// Joint velocities that the servo law requested, before limits, rad/s or m/s.
        pub requested_qd: [f64; MAX_JOINTS],
        /// The command of this tick: torques or forces, N m or N.
        pub tau: [f64; MAX_JOINTS],
        /// The command of this tick: reference positions.
        pub q_r: [f64; MAX_JOINTS],
        /// The command of this tick: reference velocities.
        pub qd_r: [f64; MAX_JOINTS],
        /// Torques or forces from outside, N m or N; NaN where the joints' torques are not known.
        pub external_torque: [f64; MAX_JOINTS],
        /// Their standard deviations.
        pub external_torque_sd: [f64; MAX_JOINTS],
        /// Torques or forces that the drive's state carries, N m or N; NaN where it measures none.
        pub measured_torque: [f64; MAX_JOINTS],
    }
}

named_codes! {
    /// Bits of [`TraceMsg::flags`].
    pub mod trace_flag {
        /// A measurement arrived with this tick.
        pub const MEASUREMENT: u32 = 1;
        /// `q_true` and `qd_true` are valid.
        pub const TRUTH: u32 = 2;
        /// The run is over: no record follows.
        pub const LAST: u32 = 4;
        /// The drive had no new state in time.
        pub const LATE_STATE: u32 = 8;
        /// A signal, or the process of control itself, asked for the end at the begin of this tick.
        pub const END_ASKED: u32 = 16;
        /// `stop` was asked for at the begin of this tick by the stop word.
        pub const STOP_ASKED: u32 = 32;
        /// `shutdown` was asked for at the begin of this tick by the stop word.
        pub const SHUTDOWN_ASKED: u32 = 64;
        /// The mission gave out its orders when it had seen this record; without this bit it saw the next one first.
        pub const ORDERS_GIVEN: u32 = 128;
        /// Something touches the arm; [`TraceMsg::external_torque`](super::TraceMsg::external_torque) tells what each joint feels of it.
        pub const CONTACT: u32 = 1 << 26;
        /// The drive was an arm that was recorded, and this its last state.
        pub const MOTION_OVER: u32 = 1 << 27;
        /// From this bit on, up to [`CONTACT`]: the code of the fault that was reported to control at this tick from outside, by the drive or the process; 0: none.
        pub const REPORTED_FAULT: u32 = 8;
        /// From this bit on: the code of the [`RobotState`](crate::messages::RobotState) that the drive reported at this tick.
        pub const ROBOT_STATE: u32 = 28;
    }
}

impl TraceMsg {
    /// The code of the reported fault in [`Self::flags`].
    #[must_use]
    pub fn reported_fault_of(flags: u32) -> u32 {
        (flags & (trace_flag::CONTACT - 1)) >> trace_flag::REPORTED_FAULT
    }

    /// The code of the robot's state in [`Self::flags`].
    #[must_use]
    pub fn robot_state_of(flags: u32) -> u32 {
        flags >> trace_flag::ROBOT_STATE
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::mem::{align_of, offset_of, size_of};

    #[test]
    #[allow(unsafe_code)]
    fn the_layout_is_fixed_and_named() {
        assert_eq!((size_of::<TraceMsg>(), align_of::<TraceMsg>()), (760, 8));
        assert_eq!(offset_of!(TraceMsg, arm), 88);
        assert_eq!(offset_of!(TraceMsg, limits), 128);
        assert_eq!(offset_of!(TraceMsg, q), 144);
        assert_eq!(offset_of!(TraceMsg, qd_r), 536);
        // SAFETY: the name is only read.
        assert_eq!(unsafe { TraceMsg::type_name() }, "vservo.Trace.v5");
    }

    #[test]
    fn faults_and_states_of_the_robot_share_the_flags() {
        use trace_flag::*;
        let flags =
            LATE_STATE | ORDERS_GIVEN | MOTION_OVER | CONTACT | 31 << REPORTED_FAULT | 10 << ROBOT_STATE;
        assert_eq!((TraceMsg::reported_fault_of(flags), TraceMsg::robot_state_of(flags)), (31, 10));
        assert_eq!((TraceMsg::reported_fault_of(255), TraceMsg::robot_state_of(255)), (0, 0));
    }
}
