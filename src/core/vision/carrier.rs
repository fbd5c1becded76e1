//! Pose of the camera at an exposure, from the joint states.
//!
//! Data flow: joint states are noted as they arrive; for the exposure stamp of a frame the joint positions are interpolated and forward kinematics
//! gives `X_WC`. Vision then predicts the target by the known motion of the arm, also where it has moved by hundreds of pixels since the last frame.

use crate::geometry::Pose;
use crate::messages::JointState;
use crate::robot::{JointHistory, Mount, Robot};
use crate::time::MonoNs;
use nalgebra::SVector;

/// An arm of any number of joints with an eye-in-hand or eye-to-hand camera.
pub trait Carrier: Send {
    /// Adds a joint state to the history.
    fn note(&mut self, state: &JointState);

    /// Stamp of the newest state.
    fn newest(&self) -> Option<MonoNs>;

    /// Pose of the camera at `time` in the frame W to which the object is fixed: the base for eye-in-hand, the flange for eye-to-hand. `None` before
    /// the first state.
    fn X_WC(&self, time: MonoNs) -> Option<Pose>;
}

/// An arm of `N` joints with the kinematics and the mount of the run file.
#[derive(Debug, Clone)]
pub struct ArmCarrier<const N: usize> {
    robot: Robot<N>,
    mount: Mount,
    joints: JointHistory<N>,
}

impl<const N: usize> ArmCarrier<N> {
    /// An arm without a known state yet.
    #[must_use]
    pub fn new(robot: Robot<N>, mount: Mount) -> Self {
        Self { robot, mount, joints: JointHistory::new() }
    }
}

impl<const N: usize> Carrier for ArmCarrier<N> {
    fn note(&mut self, state: &JointState) {
        let measured = |v: &[f64]| SVector::from_fn(|i, _| v.get(i).copied().unwrap_or(f64::NAN));
        let (q, qd): (SVector<f64, N>, SVector<f64, N>) = (measured(&state.q), measured(&state.qd));
        if state.joints as usize == N && q.iter().chain(&qd).all(|x| x.is_finite()) {
            self.joints.push(state.stamp, &q, &qd);
        }
    }

    fn newest(&self) -> Option<MonoNs> {
        self.joints.newest()
    }

    fn X_WC(&self, time: MonoNs) -> Option<Pose> {
        Some(self.mount.X_WC(&self.robot, &self.joints.joints(time)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_finite_joint_states_move_the_camera() {
        let robot = crate::robot::load("scara").unwrap().build::<4>().unwrap();
        let X_EC = Pose::translation(0.0, 0.01, 0.05);
        let mut carrier = ArmCarrier::new(robot.clone(), Mount::EyeInHand { X_EC });
        assert!(carrier.X_WC(MonoNs(5)).is_none());
        let state = |ms: i64, q0: f64, joints: u32| {
            let mut state = JointState { stamp: MonoNs(ms * 1_000_000), joints, ..JointState::default() };
            state.q[0] = q0;
            state
        };
        carrier.note(&state(0, 0.0, 4));
        carrier.note(&state(1, 0.002, 4));
        carrier.note(&state(2, f64::NAN, 4));
        carrier.note(&state(2, 0.5, 6));
        assert_eq!(carrier.newest(), Some(MonoNs(1_000_000)));
        let expected = robot.forward(&SVector::from_column_slice(&[0.001, 0.0, 0.0, 0.0])) * X_EC;
        let found = carrier.X_WC(MonoNs(500_000)).unwrap();
        assert!((found.translation.vector - expected.translation.vector).norm() < 1e-12);
        assert!(found.rotation.angle_to(&expected.rotation) < 1e-12);
    }
}
