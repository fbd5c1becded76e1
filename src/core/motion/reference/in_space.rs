//! The reference within limits in space: motion commands are bent before, and steps held after the limits of the joints.

use super::{ActingLimits, HALVINGS, Limit, Reference, ReferenceState};
use crate::motion::braking::{JointMotionState, braked, breach};
use crate::motion::workspace::ReferenceJoints;
use nalgebra::SVector;

/// Time after which an acceleration is judged by the velocity that it leads to, s. Chosen by hand: a few times what the jerk limit needs to change an acceleration; half of
/// it lets an arm under a law that outputs torques come so near to a limit that its steps are held, twice of it slows it down from twice as far.
const AHEAD_S: f64 = 0.1;

impl<const N: usize> Reference<N> {
    /// The motion command within the limits in space, where they change it.
    pub(super) fn bent(
        &mut self,
        requested_qd: &SVector<f64, N>,
        acting: &mut ActingLimits,
    ) -> Option<SVector<f64, N>> {
        let space = self.space.as_mut()?;
        let ReferenceState { q, qd, a, .. } = &self.state;
        let (qd, acts) = space.bend(&ReferenceJoints { q, qd, a }, requested_qd, &self.limits);
        if acts {
            (0..N).for_each(|i| acting.set(Limit::Workspace, i));
        }
        acts.then_some(qd)
    }

    /// The acceleration that leads to such a command.
    pub(super) fn bent_acceleration(
        &mut self,
        qdd: &SVector<f64, N>,
        acting: &mut ActingLimits,
    ) -> Option<SVector<f64, N>> {
        let qd = self.state.qd;
        let bent = self.bent(&(qd + qdd * AHEAD_S), acting)?;
        Some((bent - qd) / AHEAD_S)
    }

    /// Takes back so much of the step from `before` that the arm can brake from it within its limits in space. Whether that was needed.
    pub(super) fn is_held_in_space(
        &mut self,
        before: &ReferenceState<N>,
        dt_s: f64,
        acting: &mut ActingLimits,
    ) -> bool {
        let Some(space) = &self.space else { return false };
        let of = |s: &ReferenceState<N>, i: usize| JointMotionState { q: s.q[i], v: s.qd[i], a: s.a[i] };
        let step: [_; N] = std::array::from_fn(|i| of(&self.state, i));
        if space.can_stop(&step, &self.limits, &before.q) {
            return false;
        }
        let brake: [_; N] = std::array::from_fn(|i| braked(of(before, i), &self.limits.bounds(i), dt_s));
        let (mut best, mut low, mut high) = (brake, 0.0, 1.0);
        for _ in 0..HALVINGS {
            let share = 0.5 * (low + high);
            let part: [_; N] = std::array::from_fn(|i| brake[i].towards(step[i], share));
            let within = (0..N).all(|i| breach(part[i], &self.limits.bounds(i), before.q[i]).is_none());
            if within && space.can_stop(&part, &self.limits, &before.q) {
                (best, low) = (part, share);
            } else {
                high = share;
            }
        }
        for (i, state) in best.iter().enumerate() {
            (self.state.q[i], self.state.qd[i], self.state.a[i]) = (state.q, state.v, state.a);
            acting.set(Limit::Workspace, i);
        }
        true
    }
}
