//! Converts vectors with one entry for each joint into records with room for any arm.

use super::controller::ControlOutput;
use super::trace::CommandTrace;
use crate::drive::{DriveCommand, DriveState};
use crate::messages::{JointState, MAX_JOINTS, joint_flag};
use crate::time::MonoNs;
use nalgebra::SVector;

/// What a tick commanded.
pub(super) fn command_trace<const N: usize>(output: &ControlOutput<N>) -> CommandTrace {
    CommandTrace {
        requested_qd: padded(&output.requested_qd),
        tau: padded(&output.command.tau),
        q_r: padded(&output.command.q_r),
        qd_r: padded(&output.command.qd_r),
    }
}

/// The arm at one tick, and the command of the tick before.
pub(super) fn joint_state<const N: usize>(
    tick: u64,
    sequence: u64,
    now: MonoNs,
    state: &DriveState<N>,
    command: &DriveCommand<N>,
    target_number: u32,
) -> JointState {
    let (q_true, qd_true) = state.truth.unwrap_or((SVector::zeros(), SVector::zeros()));
    JointState {
        tick,
        sequence,
        stamp: now,
        joints: N as u32,
        flags: if state.truth.is_some() { joint_flag::TRUTH } else { 0 },
        arm: 0,
        target_number,
        q: padded(&state.q),
        qd: padded(&state.qd),
        tau: padded(&command.tau),
        q_r: padded(&command.q_r),
        qd_r: padded(&command.qd_r),
        q_true: padded(&q_true),
        qd_true: padded(&qd_true),
    }
}

pub(super) fn padded<const N: usize>(v: &SVector<f64, N>) -> [f64; MAX_JOINTS] {
    let mut out = [0.0; MAX_JOINTS];
    for (to, from) in out.iter_mut().zip(v.iter()) {
        *to = *from;
    }
    out
}
