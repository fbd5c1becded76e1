//! The arm of a replay: it was where the recording says, whatever it is told.

use crate::control::safety::Fault;
use crate::drive::{CommandMode, Drive, DriveCommand, DriveHealth, DriveState};
use crate::messages::{MAX_JOINTS, RobotState, TraceMsg, trace_flag};
use crate::time::MonoNs;
use nalgebra::SVector;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// What the drive said at one tick.
#[derive(Debug, Clone, Copy)]
struct Then<const N: usize> {
    state: DriveState<N>,
    health: DriveHealth,
    /// The torques that the state carried, N m or N.
    measured: Option<SVector<f64, N>>,
    /// Whether the state came late.
    late: bool,
    /// Whether it was the last one of an arm that was recorded then.
    over: bool,
}

/// A drive that gives back what was recorded; a copy is the other end of the same one.
#[derive(Debug, Clone)]
pub(super) struct RecordedArm<const N: usize>(Arc<Mutex<Then<N>>>);

impl<const N: usize> RecordedArm<N> {
    pub(super) fn new() -> Self {
        let zero = SVector::zeros();
        let state = DriveState { q: zero, qd: zero, truth: None };
        let health = DriveHealth::default();
        Self(Arc::new(Mutex::new(Then { state, health, measured: None, late: false, over: false })))
    }

    /// The next state and fault are those of the tick of `trace`.
    pub(super) fn set(&self, trace: &TraceMsg) {
        let mut then = self.then();
        let truth = trace.flags & trace_flag::TRUTH != 0;
        then.state = DriveState {
            q: vector(&trace.q),
            qd: vector(&trace.qd),
            truth: truth.then(|| (vector(&trace.q_true), vector(&trace.qd_true))),
        };
        let measured: SVector<f64, N> = vector(&trace.measured_torque);
        then.measured = measured.iter().all(|tau| !tau.is_nan()).then_some(measured);
        then.over = trace.flags & trace_flag::MOTION_OVER != 0;
        then.late = trace.flags & trace_flag::LATE_STATE != 0;
        then.health.robot.state = RobotState::from_code(TraceMsg::robot_state_of(trace.flags));
        then.health.fault = match reported_fault(trace) {
            Some(Fault::Drive(fault)) => Some(fault),
            _ => None,
        };
    }

    fn then(&self) -> MutexGuard<'_, Then<N>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The fault that was reported to control at a tick.
pub(super) fn reported_fault(trace: &TraceMsg) -> Option<Fault> {
    Fault::from_code(TraceMsg::reported_fault_of(trace.flags))
}

impl<const N: usize> Drive<N> for RecordedArm<N> {
    fn read(&mut self, _now: MonoNs) -> DriveState<N> {
        let mut then = self.then();
        then.health.is_old = std::mem::take(&mut then.late);
        then.state
    }

    fn measured_torque(&self) -> Option<SVector<f64, N>> {
        self.then().measured
    }

    fn write(&mut self, _command: &DriveCommand<N>) {}

    fn modes(&self) -> &'static [CommandMode] {
        &CommandMode::ALL
    }

    fn health(&self) -> DriveHealth {
        self.then().health
    }

    fn is_over(&self) -> bool {
        self.then().over
    }
}

fn vector<const N: usize>(v: &[f64; MAX_JOINTS]) -> SVector<f64, N> {
    SVector::from_fn(|i, _| v.get(i).copied().unwrap_or_default())
}
