//! Slows the arm down near singular postures and near the ends of joint ranges, for every law.
//!
//! The camera twist `V = J_C qd` of a motion command is mapped back to joint velocities by damped least squares
//! (`Robot::damped_velocity`). Away from singular postures and ends of ranges this returns the motion command itself: with six
//! joints the solution is unique, with fewer the least-squares solution is, and with more the minimum-norm solution is the
//! law's own. A null-space motion, such as the one away from the ends of ranges, is the preferred
//! velocity `qd_p` of the least squares and is kept. Near a singular posture the damping bounds the joint speeds, so that the arm slows
//! down. Near the end of a range a joint is limited to the speed from which it can stop, and the other joints compensate where they can.

use super::limits::{ActingLimits, Limit};
use crate::robot::{InverseOptions, Robot};
use nalgebra::{SMatrix, SVector};

/// The motion command `qd` (rad/s or m/s) as the arm can follow it at the posture `q`, and what held it back. `J_C` is the
/// camera's Jacobian there; `free` is the part of the motion command that moves joints and not the camera.
#[must_use]
pub fn damp_singularity<const N: usize>(
    robot: &Robot<N>,
    q: &SVector<f64, N>,
    J_C: &SMatrix<f64, 6, N>,
    qd: &SVector<f64, N>,
    free: &SVector<f64, N>,
) -> (SVector<f64, N>, ActingLimits) {
    let mut acting = ActingLimits::default();
    let V = J_C * qd;
    let out = robot.damped_velocity(q, J_C, &V, free, &InverseOptions::default());
    for (joint, held) in out.at_limit.iter().enumerate() {
        if *held {
            acting.set(Limit::Position, joint);
        }
    }
    if out.damping > 0.0 {
        acting.add(Limit::Singularity, u8::MAX >> 8usize.saturating_sub(N).min(7));
    }
    if out.scale < 1.0 {
        for (joint, limit) in robot.limits().iter().enumerate() {
            if out.qd.get(joint).is_some_and(|qd| qd.abs() >= limit.velocity * (1.0 - 1e-9)) {
                acting.set(Limit::Velocity, joint);
            }
        }
    }
    (out.qd, acting)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use crate::robot::{ExpressedIn, load};
    use nalgebra::{Vector4, Vector6};
    use proptest::prelude::*;

    fn camera_jacobian<const N: usize>(robot: &Robot<N>, q: &SVector<f64, N>) -> SMatrix<f64, 6, N> {
        robot.jacobian_of_frame(q, &Pose::translation(0.0, 0.0, 0.05), ExpressedIn::Moving)
    }

    proptest! {
        #[test]
        fn an_easy_request_is_left_alone(qd in prop::array::uniform6(-0.3..0.3f64)) {
            let robot = load("ur5").unwrap().build::<6>().unwrap();
            let q = Vector6::new(0.4, -1.7, 1.5, -1.3, -1.8, 0.9);
            let (got, acting) = damp_singularity(&robot, &q, &camera_jacobian(&robot, &q), &Vector6::from(qd), &Vector6::zeros());
            prop_assert!((got - Vector6::from(qd)).amax() < 1e-9, "{got}");
            prop_assert!(!acting.any());
        }

        #[test]
        fn fewer_joints_keep_their_least_squares(qd in prop::array::uniform4(-0.5..0.5f64)) {
            let robot = load("scara").unwrap().build::<4>().unwrap();
            let q = Vector4::new(0.0, 1.5, 0.5, -0.8);
            let (got, acting) = damp_singularity(&robot, &q, &camera_jacobian(&robot, &q), &Vector4::from(qd), &Vector4::zeros());
            prop_assert!((got - Vector4::from(qd)).amax() < 1e-9, "{got}");
            prop_assert!(!acting.any());
        }
    }

    /// The motion that the camera does not feel stays in the motion command of an arm with more joints than the task needs.
    #[test]
    fn a_seventh_joint_keeps_the_motion_that_only_joints_feel() {
        let robot = load("panda").unwrap().build::<7>().unwrap();
        let q = SVector::<f64, 7>::from([-0.16, -0.52, -0.14, -2.11, 0.09, 1.79, 0.21]);
        let J = camera_jacobian(&robot, &q);
        let least = J.transpose() * (J * J.transpose()).try_inverse().unwrap();
        let any = SVector::<f64, 7>::from([0.1, -0.2, 0.3, 0.1, -0.1, 0.2, -0.3]);
        let free = any - least * (J * any);
        assert!(free.norm() > 0.05);
        let task = least * Vector6::new(0.05, -0.02, 0.03, 0.1, 0.0, -0.1);
        let (got, acting) = damp_singularity(&robot, &q, &J, &(task + free), &free);
        assert!((got - task - free).amax() < 1e-9 && !acting.any(), "{got}");
    }

    #[test]
    fn a_stretched_arm_is_slowed_down_and_says_so() {
        let robot = load("ur5").unwrap().build::<6>().unwrap();
        let q = Vector6::new(0.0, -1.0, 1e-4, -1.0, -1.5, 0.0);
        let J = camera_jacobian(&robot, &q);
        // Straight along the arm: only the elbow could do it, faster and faster.
        let V = crate::geometry::Twist::new(0.0, 0.05, 0.05, 0.0, 0.0, 0.0);
        let requested_qd = J.lu().solve(&V).unwrap();
        let (got, acting) = damp_singularity(&robot, &q, &J, &requested_qd, &Vector6::zeros());
        assert!(requested_qd.amax() > 100.0 && got.amax() < 3.0, "{requested_qd} {got}");
        assert_eq!(acting.joints(Limit::Singularity), 0b11_1111);
    }
}
