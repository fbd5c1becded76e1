//! Moving along with an object that moves, and with a goal that moves on its path.

use super::{MovingGoal, ObjectMotion, TwistTask, VisualServo, joint_velocity};
use crate::geometry::{Pose, rotate_twist};
use crate::robot::CameraJacobian;
use crate::time::MonoNs;
use nalgebra::{Matrix6, SVector, Vector6};

impl<const N: usize> VisualServo<N> {
    /// When the path of the goal began; `None` before the first law output, and for a goal at rest.
    #[must_use]
    pub fn path_began(&self) -> Option<MonoNs> {
        self.path_began
    }

    /// The path of the goal begins anew with the next law output.
    pub fn restart_path(&mut self) {
        self.path_began = None;
    }

    /// Moves the goal along its path to where it is when the arm acts, and returns its motion there, where the arm is moved along with it.
    pub(super) fn move_goal(&mut self) -> Option<MovingGoal> {
        let path = self.settings.path.as_ref().filter(|_| self.follows_path)?;
        let now = self.history.newest()?;
        let began = *self.path_began.get_or_insert(now);
        let moving = path.at((now + self.settings.lead - began).as_s());
        let moved = self.goal.move_to(&moving.X_DO);
        Some(moving).filter(|_| moved && path.feed_forward)
    }
}

/// Feed-forward: the joint velocity, rad/s or m/s, that keeps the camera's pose relative to a moving object; zero where
/// the arm cannot follow.
pub(super) fn follow<const N: usize>(
    object: &ObjectMotion,
    now: MonoNs,
    X_WC: &Pose,
    J: &CameraJacobian<N>,
) -> SVector<f64, N> {
    let V_W = object.twist_at(now, &X_WC.translation.vector);
    follow_twist(&rotate_twist(&X_WC.rotation.inverse().to_rotation_matrix(), &V_W), J)
}

/// The joint velocity, rad/s or m/s, that gives the camera the twist `V_C` as well as the arm can; zero where there is none.
pub(super) fn follow_twist<const N: usize>(V_C: &Vector6<f64>, J: &CameraJacobian<N>) -> SVector<f64, N> {
    let task = TwistTask { matrix: Matrix6::identity(), vector: *V_C, error: V_C.norm() };
    joint_velocity(&task, 1.0, J).unwrap_or_else(SVector::zeros)
}
