//! The past motion of the arm that carries a synthetic camera, from its joint states.

use crate::geometry::Pose;
use crate::messages::{JointState, joint_flag};
use crate::robot::{JointHistory, Mount, Robot};
use crate::time::MonoNs;
use nalgebra::SVector;

/// The last states of an arm with `N` joints.
#[derive(Debug, Clone)]
pub struct ArmHistory<const N: usize> {
    robot: Robot<N>,
    q_start: SVector<f64, N>,
    joints: JointHistory<N>,
}

impl<const N: usize> ArmHistory<N> {
    /// A history of an arm that stands in `q_start` until it says otherwise.
    #[must_use]
    pub fn new(robot: Robot<N>, q_start: SVector<f64, N>) -> Self {
        Self { robot, q_start, joints: JointHistory::new() }
    }

    /// Appends a state; the true one where the arm is simulated.
    pub fn push(&mut self, state: &JointState) {
        let truth = state.flags & joint_flag::TRUTH != 0;
        let (q, qd) = if truth { (&state.q_true, &state.qd_true) } else { (&state.q, &state.qd) };
        let vector =
            |v: &[f64]| SVector::from_iterator(v.iter().copied().chain(std::iter::repeat(0.0)).take(N));
        self.joints.push(state.stamp, &vector(q), &vector(qd));
    }

    /// The pose at `time` of a camera at `mount`, in the frame W in which the object rests.
    #[must_use]
    pub fn X_WC(&self, mount: &Mount, time: MonoNs) -> Pose {
        mount.X_WC(&self.robot, &self.joints.joints(time).unwrap_or(self.q_start))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn starts_at_rest_and_then_shows_the_truth() {
        let robot = crate::robot::load("scara").unwrap().build::<4>().unwrap();
        let q_start = SVector::from_column_slice(&[0.0, 1.0, 0.5, 0.0]);
        let mut h = ArmHistory::new(robot.clone(), q_start);
        let mount = Mount::EyeInHand { X_EC: Pose::translation(0.0, 0.0, 0.1) };
        assert_eq!(h.X_WC(&mount, MonoNs(5)), mount.X_WC(&robot, &q_start));
        let mut s =
            JointState { stamp: MonoNs(10), joints: 4, flags: joint_flag::TRUTH, ..JointState::default() };
        s.q_true[0] = 0.5;
        s.q[0] = 99.0;
        h.push(&s);
        let turned = |q1: f64| mount.X_WC(&robot, &SVector::from_column_slice(&[q1, 0.0, 0.0, 0.0]));
        assert_eq!(h.X_WC(&mount, MonoNs(10)), turned(0.5));
        s.flags = 0;
        s.stamp = MonoNs(20);
        h.push(&s);
        assert_eq!(h.X_WC(&mount, MonoNs(20)), turned(99.0));
    }
}
