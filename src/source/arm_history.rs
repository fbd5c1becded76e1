//! Where the arm was: its last states, and the flange's pose at any time among them.

use crate::geometry::Pose;
use crate::messages::{JointState, joint_flag};
use crate::robot::Robot;
use crate::time::{MonoNs, SpanNs};
use nalgebra::SVector;
use std::collections::VecDeque;

/// States kept: more than a second at 1 kHz.
const CAPACITY: usize = 1024;
/// How far a motion is carried on beyond its last state; after that the arm counts as standing.
const LONGEST_EXTRAPOLATION: SpanNs = SpanNs(20_000_000);

/// The last states of an arm with `N` joints.
#[derive(Debug, Clone)]
pub struct ArmHistory<const N: usize> {
    robot: Robot<N>,
    q_start: SVector<f64, N>,
    states: VecDeque<State<N>>,
}

#[derive(Debug, Clone, Copy)]
struct State<const N: usize> {
    stamp: MonoNs,
    q: SVector<f64, N>,
    qd: SVector<f64, N>,
}

impl<const N: usize> ArmHistory<N> {
    /// A history of an arm that stands in `q_start` until it says otherwise.
    #[must_use]
    pub fn new(robot: Robot<N>, q_start: SVector<f64, N>) -> Self {
        Self { robot, q_start, states: VecDeque::with_capacity(CAPACITY) }
    }

    /// Appends a state; the true one where the arm is simulated. A state that is not newer than the last one starts
    /// the history anew: the control process was restarted.
    pub fn push(&mut self, state: &JointState) {
        let (q, qd) = if state.flags & joint_flag::TRUTH != 0 {
            (&state.q_true, &state.qd_true)
        } else {
            (&state.q, &state.qd)
        };
        if self.states.back().is_some_and(|last| state.stamp <= last.stamp) {
            self.states.clear();
        }
        if self.states.len() == CAPACITY {
            self.states.pop_front();
        }
        let vector =
            |v: &[f64]| SVector::from_iterator(v.iter().copied().chain(std::iter::repeat(0.0)).take(N));
        self.states.push_back(State { stamp: state.stamp, q: vector(q), qd: vector(qd) });
    }

    /// The flange's pose `X_BE` at `time`.
    #[must_use]
    pub fn flange(&self, time: MonoNs) -> Pose {
        self.robot.forward(&self.joints(time))
    }

    /// Joint positions at `time`, rad or m: linear between neighbouring states, which at 1 kHz is true to 2 um at
    /// 10 m/s^2; carried on with the last velocity beyond the last one.
    #[must_use]
    pub fn joints(&self, time: MonoNs) -> SVector<f64, N> {
        let after = self.states.partition_point(|s| s.stamp < time);
        match (after.checked_sub(1).and_then(|i| self.states.get(i)), self.states.get(after)) {
            (Some(a), Some(b)) => {
                let share = (time - a.stamp).as_s() / (b.stamp - a.stamp).as_s();
                a.q + (b.q - a.q) * share
            }
            (Some(last), None) => last.q + last.qd * (time - last.stamp).min(LONGEST_EXTRAPOLATION).as_s(),
            (None, Some(first)) => {
                first.q - first.qd * (first.stamp - time).min(LONGEST_EXTRAPOLATION).as_s()
            }
            (None, None) => self.q_start,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn history() -> ArmHistory<4> {
        let robot = crate::robot::load("scara").unwrap().build::<4>().unwrap();
        ArmHistory::new(robot, SVector::from_column_slice(&[0.0, 1.0, 0.5, 0.0]))
    }

    fn state(ms: i64, q0: f64) -> JointState {
        let mut s = JointState { stamp: MonoNs(ms * 1_000_000), joints: 4, ..JointState::default() };
        s.flags = joint_flag::TRUTH;
        s.q_true[0] = q0;
        s.qd_true[0] = 2.0;
        s.q[0] = 99.0;
        s
    }

    #[test]
    fn interpolates_extrapolates_and_starts_at_rest() {
        let mut h = history();
        assert_eq!(h.joints(MonoNs(5))[1], 1.0);
        h.push(&state(10, 0.5));
        h.push(&state(11, 0.7));
        assert!((h.joints(MonoNs(10_250_000))[0] - 0.55).abs() < 1e-12);
        assert!((h.joints(MonoNs(12_000_000))[0] - 0.702).abs() < 1e-12);
        assert!((h.joints(MonoNs(9_000_000))[0] - 0.498).abs() < 1e-12);
        assert!((h.joints(MonoNs(900_000_000))[0] - 0.74).abs() < 1e-12, "motion is not carried on for ever");
    }

    #[test]
    fn a_restarted_control_starts_the_history_anew() {
        let mut h = history();
        h.push(&state(1000, 0.5));
        h.push(&state(1, 0.1));
        assert!((h.joints(MonoNs(1_000_000))[0] - 0.1).abs() < 1e-12);
        assert_eq!(h.states.len(), 1);
    }

    #[test]
    fn memory_is_bounded() {
        let mut h = history();
        for i in 0..3000 {
            h.push(&state(i, 0.0));
        }
        assert_eq!(h.states.len(), CAPACITY);
    }
}
