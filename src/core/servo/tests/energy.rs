//! Lyapunov functions: those of the torque laws with the arm's dynamics, those of the velocity laws along their motion.

use super::{goal, pose, seen, square};
use crate::geometry::{Pose, integrate_body_twist};
use crate::robot::{CameraJacobian, Mount, Robot};
use crate::servo::*;
use nalgebra::{Matrix6, Vector3, Vector4, Vector6};
use proptest::prelude::*;

const STEP_S: f64 = 2.5e-4;

fn scara() -> Robot<4> {
    crate::robot::load("scara").unwrap().build::<4>().unwrap()
}

/// Moves the SCARA for two seconds under a torque law that is computed at every step of the integration; the error at the
/// start and at the end, after checking that `1/2 qd^T B qd + potential` falls all the way.
fn falls(
    law: Law,
    mount: Mount,
    X_WO: Pose,
    X_DO: Pose,
    q: Vector4<f64>,
    potential: impl Fn(&Pose) -> f64,
) -> (f64, f64) {
    let robot = scara();
    let set_point = goal(&X_DO);
    let (mut q, mut qd) = (q, Vector4::zeros());
    let view_at = |q: &Vector4<f64>| mount.X_WC(&robot, q).inv_mul(&X_WO);
    let accelerate = |q: &Vector4<f64>, qd: &Vector4<f64>| {
        let X_CO = view_at(q);
        let view = seen(&X_CO, &square()).with_known(Some(X_CO));
        let arm = Arm { J: mount.camera(&robot, q).1, qd: *qd, gravity: robot.gravity(q) };
        match law.output(&law.task(&set_point, &view).unwrap(), &arm) {
            Some(LawOutput::Torque(tau)) => robot.forward_dynamics(q, qd, &tau),
            other => panic!("{other:?}"),
        }
    };
    let energy = |q: &Vector4<f64>, qd: &Vector4<f64>| robot.kinetic_energy(q, qd) + potential(&view_at(q));
    let first = energy(&q, &qd);
    let mut last = first;
    for _ in 0..8000 {
        // Midpoint rule.
        let a = accelerate(&q, &qd);
        let (q_half, qd_half) = (q + qd * (0.5 * STEP_S), qd + a * (0.5 * STEP_S));
        let a = accelerate(&q_half, &qd_half);
        q += qd_half * STEP_S;
        qd += a * STEP_S;
        let now = energy(&q, &qd);
        assert!(now <= last + 1e-6 * first, "{now} > {last} of {first}");
        last = now;
    }
    (first, last)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(8))]

    #[test]
    fn energy_falls_under_a_and_c(dq in prop::array::uniform4(-0.15..0.15f64), hand in any::<bool>()) {
        let robot = scara();
        let q_d = Vector4::new(0.1, 1.5, 0.4, -0.7);
        let X_DO = Pose::new([-0.05, -0.04, 0.6].into(), [0.0, 0.0, -0.5].into());
        let mount = if hand {
            Mount::EyeInHand { X_EC: Pose::identity() }
        } else {
            Mount::EyeToHand { X_BC: robot.forward(&q_d) * Pose::translation(0.1, 0.0, -0.2) }
        };
        let X_WO = mount.X_WC(&robot, &q_d) * X_DO;
        let q = q_d + Vector4::from(dq);
        let K = pose_gains_4(&[500.0, 500.0, 10.0, 10.0]);
        for orientation in OrientationError::ALL {
            let (damping, space) = (Damping::Task(K), OperationalSpace::Six);
            let a = Law::PositionTorque { K_P: K, damping, orientation, space };
            let (first, last) = falls(a, mount, X_WO, X_DO, q, |X_CO| {
                let x = OperationalSpaceError::new(&X_DO, X_CO, orientation).x;
                0.5 * x.dot(&K.times(&x))
            });
            prop_assert!(last < 0.5 * first + 1e-9);
        }
        let interaction = Interaction { at: InteractionAt::Current, depth: DepthSource::Known };
        let c = Law::ImageTorque { K_Ps: 300.0.into(), damping: Damping::Task(330.0.into()), interaction };
        let (first, last) = falls(c, mount, X_WO, X_DO, q, |X_CO| {
            let (e, _) = image_error(&goal(&X_DO), &seen(X_CO, &square())).unwrap();
            0.5 * 300.0 * e.norm_squared()
        });
        prop_assert!(last < 0.5 * first + 1e-9, "{first} {last}");
    }
}

proptest! {
    /// An Euler step along each law brings its own error closer, whatever the pose.
    #[test]
    fn every_velocity_law_lessens_its_error(X_DO in pose(), d in prop::array::uniform6(-0.1..0.1f64)) {
        let now = Pose::new([d[0] * 0.3, d[1] * 0.3, d[2] * 0.3].into(), [d[3], d[4], d[5]].into()) * X_DO;
        prop_assume!(Vector3::new(d[0], d[1], d[2]).norm() > 0.03);
        let camera = CameraJacobian::of_moving_camera(Matrix6::identity());
        let arm = Arm { J: camera, qd: Vector6::zeros(), gravity: Vector6::zeros() };
        let set_point = goal(&X_DO);
        let gain = Gain::Constant(1.0);
        let gains = HybridGains { K_p: Vector3::repeat(1.0).into(), K_o: Vector3::repeat(1.0).into() };
        let (orientation, space) = (OrientationError::EulerZyx, OperationalSpace::Six);
        let interaction = Interaction { at: InteractionAt::Current, depth: DepthSource::Estimated };
        for law in [
            Law::PositionVelocity { K: Vector6::repeat(1.0).into(), gain, orientation, space, weights: TwistWeights::Unit },
            Law::ImageVelocity { K_s: 1.0.into(), gain, interaction },
            Law::Hybrid { gains, gain, orientation, space, depth: DepthSource::Desired },
        ] {
            let error_at = |X_CO: &Pose| match law.task(&set_point, &seen(X_CO, &square())).unwrap() {
                Task::Twist(task) => task.error,
                Task::Wrench(_) => unreachable!("a velocity law"),
            };
            let task = law.task(&set_point, &seen(&now, &square())).unwrap();
            let Some(LawOutput::Velocity(V)) = law.output(&task, &arm) else { panic!("no velocity") };
            let h = 1e-3;
            let next = integrate_body_twist(&Pose::identity(), &V, h).inverse() * now;
            let (before, after) = (error_at(&now), error_at(&next));
            prop_assert!(after < before * (1.0 - 0.5 * h) + 1e-12, "{law:?}: {before} -> {after}");
        }
    }
}
