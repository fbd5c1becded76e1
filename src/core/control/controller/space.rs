//! Limits in space as the controller watches them: the gate's last word, and how far a motion along a path got.

use super::Controller;
use crate::control::gate::SpaceBound;
use crate::control::lifecycle::State;
use crate::control::safety::Fault;
use crate::drive::DriveState;
use crate::motion::{Reference, Workspace, WorkspaceSettings};
use crate::robot::Robot;

/// The reference of `robot` within its limits in space, where there are some, and the gate's bound on them.
pub(super) fn within<const N: usize>(
    reference: Reference<N>,
    robot: &Robot<N>,
    space: Option<WorkspaceSettings>,
) -> (Reference<N>, Option<SpaceBound<N>>) {
    let Some(space) = space else { return (reference, None) };
    let bound = SpaceBound::new(robot.clone(), &space);
    (reference.within(Workspace::new(robot.clone(), space)), Some(bound))
}

impl<const N: usize> Controller<N> {
    /// The part of the requested motion that the limits in space left at the last tick, 0 to 1, and a reduced speed leaves.
    pub(super) fn pace(&self) -> f64 {
        self.reference.space().map_or(1.0, Workspace::pace) * self.speed_share
    }

    /// The arm is about to move from where it is: beyond a plane only by a motion that was asked for, which may lead back.
    pub(super) fn begin_in_space(&mut self, state: &DriveState<N>) {
        let Some(space) = &mut self.space else { return };
        let is_inside = space.begin(&state.q);
        if !is_inside && self.state != State::Moving {
            self.fail(Fault::LeavesWorkspace);
        }
    }

    /// The fault of an arm that moves, and whose command or measured state is beyond a limit in space.
    pub(super) fn watch_space(&mut self, measured: &DriveState<N>) -> Option<Fault> {
        let moves = self.state.moves() && self.fault.is_none();
        let q_r = self.gate.passed().q_r;
        self.space.as_mut()?.watch(&q_r, &measured.q, moves)
    }
}
