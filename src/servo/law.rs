//! The family of servo laws behind one interface: a view becomes a task, a task and the arm become a wish.

use super::{DepthSource, ImageTask, SetPoint, View, joint_velocity};
use nalgebra::{SMatrix, SVector};

/// The arm at the moment for which a wish is made.
#[derive(Debug, Clone, Copy)]
pub struct Arm<const N: usize> {
    /// The camera's Jacobian: `V_BC_C = J_C qd`.
    pub J_C: SMatrix<f64, 6, N>,
}

/// A servo law with its gains.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Law {
    /// Scheme D, image-based resolved velocity, (10.89)-(10.91).
    ImageVelocity {
        /// K_s = gain I, 1/s.
        gain_1_s: f64,
        /// Depth in the interaction matrix.
        depth: DepthSource,
    },
}

/// What a law makes of a view: the error, and all that does not depend on the arm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Task {
    /// Of an image-based law.
    Image(ImageTask),
}

/// What a law asks of the joints.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Wish<const N: usize> {
    /// A joint velocity for the reference, rad/s or m/s.
    Velocity(SVector<f64, N>),
}

impl Law {
    /// The task that `view` poses. `None` when the view does not have what the law needs.
    #[must_use]
    pub fn task(&self, set_point: &SetPoint, view: &View) -> Option<Task> {
        match self {
            Self::ImageVelocity { depth, .. } => ImageTask::new(set_point, view, *depth).map(Task::Image),
        }
    }

    /// What the joints shall do about `task`. `None` where there is no finite answer.
    #[must_use]
    pub fn wish<const N: usize>(&self, task: &Task, arm: &Arm<N>) -> Option<Wish<N>> {
        match (self, task) {
            (Self::ImageVelocity { gain_1_s, .. }, Task::Image(task)) => {
                joint_velocity(task, *gain_1_s, &arm.J_C).map(Wish::Velocity)
            }
        }
    }
}
