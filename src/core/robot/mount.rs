//! Where the camera is mounted, and how the joints move it relative to the object.
//!
//! Every law works in the frame W in which the object rests. In the hand (eye-in-hand) the camera moves and the object
//! rests in the base: W = B. Beside the arm (eye-to-hand) the flange carries the object: W = E, and from there
//! it is the camera that moves, the opposite way. [`CameraJacobian`] can only be made from one or the other, so that no
//! law can take the wrong sign.

use crate::geometry::Pose;
use crate::robot::{ExpressedIn, Robot};
use nalgebra::{SMatrix, SVector};

/// Where the camera sits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Mount {
    /// On the flange; the object rests in the base frame.
    EyeInHand {
        /// Camera in the flange frame.
        X_EC: Pose,
    },
    /// Fixed beside the arm; the object rests on the flange.
    EyeToHand {
        /// Camera in the base frame.
        X_BC: Pose,
    },
}

/// The Jacobian of the camera relative to the frame W of the object at rest: `V_WC_C = J qd`, 6 x N.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraJacobian<const N: usize>(SMatrix<f64, 6, N>);

impl<const N: usize> CameraJacobian<N> {
    /// For a camera in the hand: `J_BC_C` gives `V_BC_C = J_BC_C qd`, the camera's twist expressed in C.
    #[must_use]
    pub fn of_moving_camera(J_BC_C: SMatrix<f64, 6, N>) -> Self {
        Self(J_BC_C)
    }

    /// For a camera beside the arm: `J_BO_C` gives the twist of the flange and the object on it, taken at the camera's
    /// origin and expressed in C.
    #[must_use]
    pub fn of_moving_object(J_BO_C: SMatrix<f64, 6, N>) -> Self {
        Self(-J_BO_C)
    }

    /// The matrix J of `V_WC_C = J qd`.
    #[must_use]
    pub fn matrix(&self) -> &SMatrix<f64, 6, N> {
        &self.0
    }
}

impl Mount {
    /// The camera in the frame W of the object, for a flange at `X_BE`.
    #[must_use]
    pub fn X_WC(&self, X_BE: &Pose) -> Pose {
        match self {
            Self::EyeInHand { X_EC } => X_BE * X_EC,
            Self::EyeToHand { X_BC } => X_BE.inv_mul(X_BC),
        }
    }

    /// [`Mount::X_WC`] and the camera's Jacobian for an arm in `q`.
    #[must_use]
    pub fn camera<const N: usize>(&self, robot: &Robot<N>, q: &SVector<f64, N>) -> (Pose, CameraJacobian<N>) {
        match self {
            Self::EyeInHand { X_EC } => {
                let (X_BC, J) = robot.forward_and_jacobian_of_frame(q, X_EC, ExpressedIn::Moving);
                (X_BC, CameraJacobian::of_moving_camera(J))
            }
            Self::EyeToHand { X_BC } => {
                // A frame fixed to the flange that coincides with the camera's at this moment.
                let X_EC = robot.forward(q).inv_mul(X_BC);
                let J = robot.jacobian_of_frame(q, &X_EC, ExpressedIn::Moving);
                (X_EC, CameraJacobian::of_moving_object(J))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::integrate_body_twist;
    use nalgebra::{Vector4, Vector6};
    use proptest::prelude::*;

    fn pose(a: [f64; 6]) -> Pose {
        Pose::new([a[0], a[1], a[2]].into(), [a[3], a[4], a[5]].into())
    }

    proptest! {
        /// The Jacobian against the motion that the camera makes in the object's frame.
        #[test]
        fn jacobian_is_the_motion_in_the_frame_of_the_object(
            q in prop::array::uniform4(-1.0..1.0f64), qd in prop::array::uniform4(-1.0..1.0f64),
            mounted in prop::array::uniform6(-1.0..1.0f64)
        ) {
            let robot = crate::robot::load("scara").unwrap().build::<4>().unwrap();
            let (q, qd) = (Vector4::from(q), Vector4::from(qd));
            for mount in [Mount::EyeInHand { X_EC: pose(mounted) }, Mount::EyeToHand { X_BC: pose(mounted) }] {
                let (X_WC, J) = mount.camera(&robot, &q);
                prop_assert!((X_WC.to_homogeneous() - mount.X_WC(&robot.forward(&q)).to_homogeneous()).norm() < 1e-12);
                let h = 1e-6;
                let V: Vector6<f64> = J.matrix() * qd;
                let moved = integrate_body_twist(&X_WC, &V, h);
                let there = mount.X_WC(&robot.forward(&(q + qd * h)));
                prop_assert!((moved.to_homogeneous() - there.to_homogeneous()).norm() < 1e-10);
            }
        }
    }
}
