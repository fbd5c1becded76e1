//! Where the camera is mounted, and how the joints move it relative to the object.
//!
//! Every law works in the frame W in which the object rests. In the hand (eye-in-hand) the camera moves and the object
//! rests in the base: W = B. Beside the arm (eye-to-hand) the flange carries the object: W = E, and from there
//! it is the camera that moves, the opposite way. [`CameraJacobian`] can only be made from one or the other, so that no
//! law can take the wrong sign.
//!
//! A camera on a link before the wrist is moved by the joints before that link alone: the columns of the others are zero, and whatever they do,
//! the image does not change. The laws leave such joints at rest (`servo/resolve.rs`), unless a secondary task moves them in the null space.

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
    /// On a link before the flange; the object rests in the base frame.
    EyeOnLink {
        /// Number of joints from the base to the link, which move the camera; from 1.
        joints: usize,
        /// Camera in the frame of that link.
        X_LC: Pose,
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

    /// Whether the joint `i`, counted from 0, moves the camera at all: the columns of joints beyond it are zero.
    #[must_use]
    pub fn is_moved_by(&self, i: usize) -> bool {
        i < N && self.0.column(i).iter().any(|x| *x != 0.0)
    }

    /// The number of joints that do.
    #[must_use]
    pub fn moving_joints(&self) -> usize {
        (0..N).filter(|i| self.is_moved_by(*i)).count()
    }
}

impl Mount {
    /// Pose of the camera in the frame to which it is fixed: flange, link or base.
    #[must_use]
    pub fn pose(&self) -> &Pose {
        let (Self::EyeInHand { X_EC: X } | Self::EyeOnLink { X_LC: X, .. } | Self::EyeToHand { X_BC: X }) =
            self;
        X
    }

    /// A camera that is fixed to the same frame at the pose `X`.
    #[must_use]
    pub fn with_pose(mut self, X: Pose) -> Self {
        match &mut self {
            Self::EyeInHand { X_EC: own }
            | Self::EyeOnLink { X_LC: own, .. }
            | Self::EyeToHand { X_BC: own } => *own = X,
        }
        self
    }

    /// Whether the arm carries the camera, so that the object rests in the base frame.
    #[must_use]
    pub fn is_on_arm(&self) -> bool {
        !matches!(self, Self::EyeToHand { .. })
    }

    /// The number of joints, of an arm of `all`, that move the camera relative to the object; from the base on. Those beyond do not change the image.
    #[must_use]
    pub fn moving_joints(&self, all: usize) -> usize {
        match self {
            Self::EyeOnLink { joints, .. } => all.min(*joints),
            Self::EyeInHand { .. } | Self::EyeToHand { .. } => all,
        }
    }

    /// The camera in B, for an arm in `q`.
    #[must_use]
    pub fn X_BC<const N: usize>(&self, robot: &Robot<N>, q: &SVector<f64, N>) -> Pose {
        match self {
            Self::EyeInHand { X_EC } => robot.forward(q) * X_EC,
            Self::EyeOnLink { joints, X_LC } => robot.forward_to_link(q, *joints) * X_LC,
            Self::EyeToHand { X_BC } => *X_BC,
        }
    }

    /// The camera in the frame W of the object, for an arm in `q`.
    #[must_use]
    pub fn X_WC<const N: usize>(&self, robot: &Robot<N>, q: &SVector<f64, N>) -> Pose {
        match self {
            Self::EyeToHand { X_BC } => robot.forward(q).inv_mul(X_BC),
            Self::EyeInHand { .. } | Self::EyeOnLink { .. } => self.X_BC(robot, q),
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
            Self::EyeOnLink { joints, X_LC } => {
                let (X_BC, J) = robot.forward_and_jacobian_on_link(q, *joints, X_LC);
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
            mounted in prop::array::uniform6(-1.0..1.0f64), joints in 1usize..=4
        ) {
            let robot = crate::robot::load("scara").unwrap().build::<4>().unwrap();
            let (q, qd) = (Vector4::from(q), Vector4::from(qd));
            let X = pose(mounted);
            for mount in [Mount::EyeInHand { X_EC: X }, Mount::EyeOnLink { joints, X_LC: X }, Mount::EyeToHand { X_BC: X }] {
                let (X_WC, J) = mount.camera(&robot, &q);
                prop_assert!((X_WC.to_homogeneous() - mount.X_WC(&robot, &q).to_homogeneous()).norm() < 1e-12);
                let h = 1e-6;
                let V: Vector6<f64> = J.matrix() * qd;
                let moved = integrate_body_twist(&X_WC, &V, h);
                let there = mount.X_WC(&robot, &(q + qd * h));
                prop_assert!((moved.to_homogeneous() - there.to_homogeneous()).norm() < 1e-10);
            }
        }
    }

    /// Against the frames of the robot file, multiplied one by one; and the joints beyond the link move nothing.
    #[test]
    fn a_camera_on_a_link_is_where_the_file_places_it() {
        fn of<const N: usize>(arm: &str) {
            let described = crate::robot::load(arm).unwrap();
            let robot = described.build::<N>().unwrap();
            let q = SVector::<f64, N>::from_fn(|i, _| 0.3 + 0.17 * i as f64);
            let X_LC = pose([0.05, -0.02, 0.03, 0.4, -0.3, 0.2]);
            let mut X_BL = Pose::identity();
            for (i, joint) in described.joints.iter().enumerate() {
                X_BL *= joint.X_PL(q[i]);
                let mount = Mount::EyeOnLink { joints: i + 1, X_LC };
                let (X_BC, J) = mount.camera(&robot, &q);
                assert!(((X_BL * X_LC).to_homogeneous() - X_BC.to_homogeneous()).norm() < 1e-12, "{arm} {i}");
                for (k, column) in J.matrix().column_iter().enumerate() {
                    assert_eq!(column.norm() > 0.0, k <= i, "{arm}: column {k} on link {i}");
                }
            }
            let flange = Mount::EyeInHand { X_EC: X_LC };
            let last = Mount::EyeOnLink { joints: N, X_LC: described.X_LE * X_LC };
            let ((X, J), (X_last, J_last)) = (flange.camera(&robot, &q), last.camera(&robot, &q));
            assert!((X.to_homogeneous() - X_last.to_homogeneous()).norm() < 1e-12, "{arm}");
            assert!((J.matrix() - J_last.matrix()).norm() < 1e-12, "{arm}");
        }
        of::<4>("scara");
        of::<6>("ur5");
        of::<7>("panda");
    }
}
