//! Each law against its equation as it is printed.

use super::{goal, pose, seen, square};
use crate::features::{Feature, SegmentFeature, point_rows};
use crate::geometry::{Pose, integrate_body_twist, rotate_twist};
use crate::pose::euler_zyx_rotation;
use crate::robot::{CameraJacobian, Mount, Robot};
use crate::servo::*;
use nalgebra::{DMatrix, DVector, Matrix4, Matrix6, SMatrix, SVector, Vector2, Vector3, Vector4, Vector6};
use proptest::prelude::*;
use std::f64::consts::{FRAC_PI_2, FRAC_PI_3, FRAC_PI_4};

fn scara() -> Robot<4> {
    crate::robot::load("scara").unwrap().build::<4>().unwrap()
}

fn arm<const N: usize>(J: SMatrix<f64, 6, N>, qd: SVector<f64, N>, gravity: SVector<f64, N>) -> Arm<N> {
    Arm { J: CameraJacobian::of_moving_camera(J), qd, gravity }
}

fn velocity<const N: usize>(law: &Law, set_point: &SetPoint, view: &View, arm: &Arm<N>) -> SVector<f64, N> {
    match law.output(&law.task(set_point, view).unwrap(), arm) {
        Some(LawOutput::Velocity(qd)) => qd,
        other => panic!("{other:?}"),
    }
}

fn torque<const N: usize>(law: &Law, set_point: &SetPoint, view: &View, arm: &Arm<N>) -> SVector<f64, N> {
    match law.output(&law.task(set_point, view).unwrap(), arm) {
        Some(LawOutput::Torque(tau)) => tau,
        other => panic!("{other:?}"),
    }
}

/// A well-conditioned Jacobian of six joints.
fn jacobian() -> impl Strategy<Value = Matrix6<f64>> {
    prop::collection::vec(-1.0..1.0f64, 36)
        .prop_map(|j| Matrix6::from_column_slice(&j) * 0.3 + Matrix6::identity() * 2.5)
}

/// L_s of the square's points in the depths of `X_CO`, 8 x 6, and e_s.
fn stacked(set_point: &SetPoint, view: &View, X_CO: &Pose) -> (DMatrix<f64>, DVector<f64>) {
    let mut L = DMatrix::zeros(8, 6);
    let mut e = DVector::zeros(8);
    for (i, s) in view.features().iter().enumerate() {
        L.view_mut((2 * i, 0), (2, 6)).copy_from(&point_rows(s, (X_CO * square()[i]).z));
        e.rows_mut(2 * i, 2).copy_from(&(set_point.features()[i] - s));
    }
    (L, e)
}

fn least_squares(L: &DMatrix<f64>, r: &DVector<f64>) -> Option<DVector<f64>> {
    let (Q, R) = L.clone().qr().unpack();
    // Squaring costs digits; views that are hardly fixed are the damping's business.
    (R.diagonal().amin() > 1e-3 * R.diagonal().amax())
        .then(|| R.solve_upper_triangular(&(Q.transpose() * r)).unwrap())
}

const ESTIMATED: Interaction = Interaction { at: InteractionAt::Current, depth: DepthSource::Estimated };

proptest! {
    /// (10.71), (10.73): x~_dot = -J_Ad qd by finite differences, with J in the base frame as printed.
    #[test]
    fn rate_of_the_pose_error(now in pose(), goal in pose(), V in prop::array::uniform6(-1.0..1.0f64), X_BC in pose()) {
        let V = Vector6::from(V);
        for orientation in OrientationError::ALL {
            let x = |t: f64| {
                let X_CCt = integrate_body_twist(&Pose::identity(), &V, t);
                OperationalSpaceError::new(&goal, &(X_CCt.inverse() * now), orientation).x
            };
            let error = OperationalSpaceError::new(&goal, &now, orientation);
            let Some(E) = error.rate() else { continue };
            let h = 1e-6;
            let difference = (x(h) - x(-h)) / (2.0 * h);
            if difference.norm() > 100.0 { continue; } // an angle jumped by 2 pi
            prop_assert!((E * V + difference).norm() < 1e-5 * (1.0 + difference.norm()), "{orientation:?}");
            // As printed: T_A^-1 diag(R_d^T, R_d^T) v_c with base-frame quantities.
            let R_BC = X_BC.rotation.to_rotation_matrix();
            let X_CD = now * goal.inverse();
            let R_BD = R_BC * X_CD.rotation.to_rotation_matrix();
            let mut printed = rotate_twist(&R_BD.inverse(), &rotate_twist(&R_BC, &V));
            let phi: Vector3<f64> = -error.x.fixed_rows::<3>(3);
            let w = orientation.inverse_rate(&phi, &error.R_DC).unwrap() * printed.fixed_rows::<3>(3);
            printed.fixed_rows_mut::<3>(3).copy_from(&w);
            prop_assert!((E * V - printed).norm() < 1e-9 * (1.0 + printed.norm()));
        }
    }

    /// (10.74) and (10.76) with J_Ad of (10.73).
    #[test]
    fn schemes_a_and_b(
        now in pose(), X_DO in pose(), J in jacobian(), qd in prop::array::uniform6(-1.0..1.0f64),
        k in prop::array::uniform6(0.1..5.0f64), d in prop::array::uniform6(0.1..5.0f64)
    ) {
        let (qd, g) = (Vector6::from(qd), Vector6::new(1.0, 2.0, 3.0, 4.0, 5.0, 6.0));
        let (K_P, K_D) = (Vector6::from(k), Vector6::from(d));
        let (set_point, view, arm) = (goal(&X_DO), seen(&now, &square()), arm(J, qd, g));
        for orientation in OrientationError::ALL {
            let error = OperationalSpaceError::new(&X_DO, &now, orientation);
            let Some(E) = error.rate() else { continue };
            let J_Ad = E * J;
            let space = OperationalSpace::Six;
            let a = Law::PositionTorque { K_P: K_P.into(), damping: Damping::Task(K_D.into()), orientation, space };
            let u = g + J_Ad.transpose() * (K_P.component_mul(&error.x) - K_D.component_mul(&(J_Ad * qd)));
            let got = torque(&a, &set_point, &view, &arm);
            prop_assert!((got - u).norm() < 1e-9 * (1.0 + u.norm()));
            let mut on_joints = [0.0; crate::messages::MAX_JOINTS];
            on_joints[..6].copy_from_slice(&d);
            let a = Law::PositionTorque { K_P: K_P.into(), damping: Damping::Joints(on_joints), orientation, space };
            let u = g + J_Ad.transpose() * K_P.component_mul(&error.x) - K_D.component_mul(&qd);
            prop_assert!((torque(&a, &set_point, &view, &arm) - u).norm() < 1e-9 * (1.0 + u.norm()));

            let b = Law::PositionVelocity { K: K_P.into(), gain: Gain::Constant(1.0), orientation, space, weights: TwistWeights::Unit };
            let qd_r = J_Ad.lu().solve(&K_P.component_mul(&error.x)).unwrap();
            let got = velocity(&b, &set_point, &view, &arm);
            prop_assert!((got - qd_r).norm() < 1e-8 * (1.0 + qd_r.norm()), "{got} {qd_r}");
        }
    }

    /// (10.84) with J_L of (10.83); (10.91) with (10.90).
    #[test]
    fn schemes_c_and_d(now in pose(), X_DO in pose(), J in jacobian(), qd in prop::array::uniform6(-1.0..1.0f64)) {
        let (qd, g) = (Vector6::from(qd), Vector6::new(1.0, 2.0, 3.0, 4.0, 5.0, 6.0));
        let (set_point, view, arm) = (goal(&X_DO), seen(&now, &square()), arm(J, qd, g));
        let (L, e) = stacked(&set_point, &view, &now);
        let J_L = &L * DMatrix::from_column_slice(6, 6, J.as_slice());
        let qd_ = DVector::from_column_slice(qd.as_slice());
        let u = DVector::from_column_slice(g.as_slice())
            + J_L.transpose() * (&e * 300.0 - &J_L * &qd_ * 330.0);
        let c = Law::ImageTorque { K_Ps: 300.0.into(), damping: Damping::Task(330.0.into()), interaction: ESTIMATED };
        let got = torque(&c, &set_point, &view, &arm);
        prop_assert!((&u - DVector::from_column_slice(got.as_slice())).norm() < 1e-9 * (1.0 + u.norm()));

        let Some(V) = least_squares(&L, &(e * 2.0)) else { return Ok(()) };
        let qd_r = J.lu().solve(&Vector6::from_column_slice(V.as_slice())).unwrap();
        let d = Law::ImageVelocity { K_s: 1.0.into(), gain: Gain::Constant(2.0), interaction: ESTIMATED };
        let got = velocity(&d, &set_point, &view, &arm);
        prop_assert!((got - qd_r).norm() < 1e-6 * (1.0 + qd_r.norm()), "{got} {qd_r}");
        let twist = image_task(&set_point, &view, ESTIMATED).unwrap().twist(2.0).unwrap();
        prop_assert!((twist - J * qd_r).norm() < 1e-6 * (1.0 + twist.norm()));
    }

    /// Other places of the interaction matrix, other depths, weights, segments: against dense weighted least squares.
    #[test]
    fn interaction_matrices_weights_and_segments(
        now in pose(), X_DO in pose(), w in prop::array::uniform3(0.2..3.0f64)
    ) {
        let kinds = [FeatureKind::Point(3), FeatureKind::Segment(0, 2), FeatureKind::Point(1)];
        let selection = Selection::new(kinds.into_iter().zip(w)).unwrap();
        let set_point = goal(&X_DO).with_selection(selection).unwrap();
        let view = seen(&now, &square()).with_known(Some(now));
        let z = |X: &Pose, i: usize| (X * square()[i]).z;
        let (s, s_d) = (view.features(), set_point.features());
        let segment = |s: &[Vector2<f64>], X: &Pose| SegmentFeature { s: [s[0], s[2]], z_m: [z(X, 0), z(X, 2)] };
        let L_of = |s: &[Vector2<f64>], X: &Pose| {
            let mut L = SMatrix::<f64, 8, 6>::zeros();
            L.fixed_view_mut::<2, 6>(0, 0).copy_from(&point_rows(&s[3], z(X, 3)));
            L.fixed_view_mut::<4, 6>(2, 0).copy_from(&segment(s, X).interaction().unwrap());
            L.fixed_view_mut::<2, 6>(6, 0).copy_from(&point_rows(&s[1], z(X, 1)));
            L
        };
        let (now_L, goal_L) = (L_of(s, &now), L_of(s_d, &X_DO));
        let mut e = SVector::<f64, 8>::zeros();
        e.fixed_rows_mut::<2>(0).copy_from(&(s_d[3] - s[3]));
        let e_segment = segment(s, &now).error(&segment(s_d, &X_DO).value());
        e.fixed_rows_mut::<4>(2).copy_from(&e_segment);
        e.fixed_rows_mut::<2>(6).copy_from(&(s_d[1] - s[1]));
        let W = SMatrix::<f64, 8, 8>::from_diagonal(&SVector::from([
            w[0], w[0], w[1], w[1], w[1], w[1], w[2], w[2],
        ]));
        for (at, L) in [
            (InteractionAt::Current, now_L),
            (InteractionAt::Desired, goal_L),
            (InteractionAt::Mean, (now_L + goal_L) * 0.5),
        ] {
            for depth in [DepthSource::Estimated, DepthSource::Known] {
                let task = image_task(&set_point, &view, Interaction { at, depth }).unwrap();
                let (A, b) = (L.transpose() * W * L, L.transpose() * W * e);
                prop_assert!((task.matrix - A).norm() < 1e-9 * (1.0 + A.norm()), "{at:?} {depth:?}");
                prop_assert!((task.vector - b).norm() < 1e-9 * (1.0 + b.norm()));
                prop_assert!((task.error - e.norm()).abs() < 1e-12);
            }
        }
        let (all, count) = image_error(&set_point, &view).unwrap();
        prop_assert_eq!(count, 8);
        prop_assert!((all.fixed_rows::<8>(0) - e).norm() < 1e-12);
        let constant = Interaction { at: InteractionAt::Current, depth: DepthSource::Constant(0.6) };
        let points = goal(&X_DO);
        let task = image_task(&points, &view, constant).unwrap();
        let mut A = Matrix6::zeros();
        for s in view.features() {
            let L = point_rows(s, 0.6);
            A += L.transpose() * L;
        }
        prop_assert!((task.matrix - A).norm() < 1e-9 * A.norm());
    }

    /// (10.92) to (10.97) from the true displacement, against the homography's.
    #[test]
    fn hybrid_scheme(
        now in pose(), X_DO in pose(), J in jacobian(), k in prop::array::uniform6(0.1..3.0f64)
    ) {
        let (set_point, view) = (goal(&X_DO), seen(&now, &square()));
        let X_CD = now * X_DO.inverse();
        // A view without displacement tells nothing of the plane; there the two readings are one.
        prop_assume!(X_CD.translation.vector.norm() > 0.02);
        let R_CD = X_CD.rotation.to_rotation_matrix();
        let (K_p, K_o) = (Vector3::new(k[0], k[1], k[2]), Vector3::new(k[3], k[4], k[5]));
        let (s, s_d) = (view.features()[0], set_point.features()[0]);
        let (z_c, z_d) = ((now * square()[0]).z, (X_DO * square()[0]).z);
        let e_p = Vector3::new(s_d.x - s.x, s_d.y - s.y, -(z_c / z_d).ln());
        for orientation in OrientationError::ALL {
            let phi = orientation.of(&R_CD);
            // no law has a rate for r sin beyond a quarter of a turn
            let Some(rate) = orientation.rate(&phi, &R_CD) else { continue };
            let w = rate * K_o.component_mul(&phi);
            let v = J_p(&s, z_c).try_inverse().unwrap() * (K_p.component_mul(&e_p) - J_o(&s) * w);
            let wanted = J.lu().solve(&Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)).unwrap();
            let gains = HybridGains { K_p: K_p.into(), K_o: K_o.into() };
            let (gain, space) = (Gain::Constant(1.0), OperationalSpace::Six);
            let law = |depth| Law::Hybrid { gains, gain, orientation, space, depth };
            let of = |depth| velocity(&law(depth), &set_point, &view, &arm(J, Vector6::zeros(), Vector6::zeros()));
            let got = of(DepthSource::Desired);
            prop_assert!((got - wanted).norm() < 1e-5 * (1.0 + wanted.norm()), "{orientation:?} {got} {wanted}");
            prop_assert_eq!(of(DepthSource::Constant(z_d)), got);
            // a wrong z_d puts z_c wrong by the same ratio, which only J_p^-1 has
            let v = J_p(&s, 1.5 * z_c).try_inverse().unwrap() * (K_p.component_mul(&e_p) - J_o(&s) * w);
            let wanted = J.lu().solve(&Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)).unwrap();
            let got = of(DepthSource::Constant(1.5 * z_d));
            prop_assert!((got - wanted).norm() < 1e-5 * (1.0 + wanted.norm()), "{orientation:?} {got} {wanted}");
        }
    }

    /// J_p and J_o of (10.96) by finite differences, with -ln rho_z.
    #[test]
    fn hybrid_error_equation(now in pose(), V in prop::array::uniform6(-1.0..1.0f64)) {
        let V = Vector6::from(V);
        let e = |t: f64| {
            let p = integrate_body_twist(&Pose::identity(), &V, t).inverse() * (now * square()[2]);
            Vector3::new(-p.x / p.z, -p.y / p.z, -p.z.ln())
        };
        let h = 1e-6;
        let p = now * square()[2];
        let s = p.coords.xy() / p.z;
        let rate = -J_p(&s, p.z) * V.fixed_rows::<3>(0) - J_o(&s) * V.fixed_rows::<3>(3);
        prop_assert!(((e(h) - e(-h)) / (2.0 * h) - rate).norm() < 1e-6);
    }

    /// m = 4: the closed-form pose, and the square systems of the text on the SCARA.
    #[test]
    fn four_dimensions(
        x in prop::array::uniform4(-0.2..0.2f64), d in prop::array::uniform4(-0.2..0.2f64),
        q in prop::array::uniform4(-0.5..0.5f64), qd in prop::array::uniform4(-1.0..1.0f64)
    ) {
        let pose4 = |x: [f64; 4]| Pose::new([x[0], x[1], x[2] + 0.6].into(), [0.0, 0.0, 6.0 * x[3]].into());
        let (now, X_DO) = (pose4(x), pose4(d));
        let points = &square()[..2];
        let set_point = SetPoint::from_pose(&X_DO, points).unwrap();
        let view = View::new(seen(&now, points).features().to_vec().into_iter(), None).unwrap();
        let found = operational_pose(&set_point, &view, OperationalSpace::Four).unwrap();
        prop_assert!((found.to_homogeneous() - now.to_homogeneous()).norm() < 1e-9);

        let robot = scara();
        let q = Vector4::new(q[0], 1.2 + q[1], q[2], q[3]);
        let (mount, qd) = (Mount::EyeInHand { X_EC: Pose::identity() }, Vector4::from(qd));
        let arm = Arm { J: mount.camera(&robot, &q).1, qd, gravity: robot.gravity(&q) };
        let rows = |J: &SMatrix<f64, 6, 4>| Matrix4::from_rows(&[J.row(0), J.row(1), J.row(2), J.row(5)]);
        let J4 = rows(arm.J.matrix());

        // A and B: T_A = I, R_d^T a rotation about z.
        let K = pose_gains_4(&[500.0, 400.0, 300.0, 10.0]);
        let k4 = Vector4::new(500.0, 400.0, 300.0, 10.0);
        let (orientation, space) = (OrientationError::EulerZyx, OperationalSpace::Four);
        let R_DC = (X_DO * now.inverse()).rotation.to_rotation_matrix();
        let p = (X_DO * now.inverse()).translation.vector;
        let alpha = euler_zyx(&R_DC).x;
        let x4 = -Vector4::new(p.x, p.y, p.z, alpha);
        let mut E = Matrix4::identity();
        E.fixed_view_mut::<3, 3>(0, 0).copy_from(R_DC.matrix());
        let J_Ad = E * J4;
        let u = arm.gravity + J_Ad.transpose() * (k4.component_mul(&x4) - k4.component_mul(&(J_Ad * qd)));
        let a = Law::PositionTorque { K_P: K, damping: Damping::Task(K), orientation, space };
        prop_assert!((torque(&a, &set_point, &view, &arm) - u).norm() < 1e-8 * (1.0 + u.norm()));
        let b = Law::PositionVelocity { K, gain: Gain::Constant(0.01), orientation, space, weights: TwistWeights::Unit };
        let qd_r = J_Ad.lu().solve(&(k4.component_mul(&x4) * 0.01)).unwrap();
        prop_assert!((velocity(&b, &set_point, &view, &arm) - qd_r).norm() < 1e-8 * (1.0 + qd_r.norm()));

        // C and D: two points make J_L square.
        let z_d = set_point.depths_m()[0];
        let mut L = SMatrix::<f64, 4, 6>::zeros();
        let mut e = Vector4::zeros();
        for i in 0..2 {
            L.fixed_view_mut::<2, 6>(2 * i, 0).copy_from(&point_rows(&view.features()[i], z_d));
            e.fixed_rows_mut::<2>(2 * i).copy_from(&(set_point.features()[i] - view.features()[i]));
        }
        let J_L = L * arm.J.matrix();
        let c = Law::ImageTorque { K_Ps: 300.0.into(), damping: Damping::Task(330.0.into()), interaction: Interaction::TEXTBOOK };
        let u = arm.gravity + J_L.transpose() * (e * 300.0 - J_L * qd * 330.0);
        prop_assert!((torque(&c, &set_point, &view, &arm) - u).norm() < 1e-9 * (1.0 + u.norm()));
        let d = Law::ImageVelocity { K_s: 1.0.into(), gain: Gain::Constant(1.0), interaction: Interaction::TEXTBOOK };
        let qd_r = J_L.lu().solve(&e).unwrap();
        prop_assert!((velocity(&d, &set_point, &view, &arm) - qd_r).norm() < 1e-7 * (1.0 + qd_r.norm()));

        // Hybrid with the four-dimensional homography.
        let displacement = Displacement::new(&set_point, &view, OperationalSpace::Four).unwrap();
        prop_assert!((displacement.R_CD.matrix() - R_DC.matrix().transpose()).norm() < 1e-9);
        let rho = displacement.depth_ratio(&view.features()[0], &set_point.features()[0]).unwrap();
        prop_assert!((rho - now.translation.z / z_d).abs() < 1e-9);
    }

    #[test]
    fn seven_joints_give_the_twist_with_the_least_motion(
        now in pose(), X_DO in pose(), j in prop::collection::vec(-1.0..1.0f64, 42),
        wanted in prop::array::uniform7(-1.0..1.0f64)
    ) {
        let mut J = SMatrix::<f64, 6, 7>::from_column_slice(&j) * 0.3;
        for i in 0..6 { J[(i, i)] += 2.5; }
        let task = image_task(&goal(&X_DO), &seen(&now, &square()), Interaction::TEXTBOOK).unwrap();
        prop_assume!(task.twist(1.0).is_some_and(|V| V.norm() < 10.0));
        let camera = CameraJacobian::of_moving_camera(J);
        let qd = joint_velocity(&task, 1.0, &camera).unwrap();
        let V = task.twist(1.0).unwrap();
        prop_assert!((J * qd - V).norm() < 1e-6 * (1.0 + V.norm()));
        let free = J.transpose() * (J * J.transpose()).try_inverse().unwrap() * (J * qd) - qd;
        prop_assert!(free.norm() < 1e-6 * (1.0 + qd.norm()));
        // The secondary task moves what the camera does not feel.
        let wanted = SVector::<f64, 7>::from(wanted);
        let null = seek_null_motion(&task, &camera, &wanted).unwrap();
        prop_assert!((J * null).norm() < 1e-3 * (1.0 + wanted.norm()), "{}", (J * null).norm());
        prop_assert!(null.norm() <= wanted.norm() + 1e-9 && null.dot(&wanted) >= -1e-9);
    }
}

/// K_Ps of the preconditioned scheme C: near the goal its wrench is that of scheme A with the same stiffnesses.
#[test]
fn a_preconditioned_scheme_c_is_scheme_a_near_its_goal() {
    let X_DO = Pose::new([-0.04, -0.05, 0.6].into(), [0.2, -0.1, 0.3].into());
    let near = Pose::new([1e-5, -2e-5, 1e-5].into(), [1e-5, 2e-5, -1e-5].into()) * X_DO;
    let K = Vector6::new(500.0, 400.0, 300.0, 20.0, 10.0, 30.0);
    let (set_point, view) = (goal(&X_DO), seen(&near, &square()));
    let K_Ps = FeatureGains { K_P: K.into(), rest: 300.0 };
    let wrench = |at| {
        let interaction = Interaction { at, depth: DepthSource::Estimated };
        preconditioned_wrench(&set_point, &view, &K_Ps, &K.into(), interaction).unwrap()
    };
    let a = OperationalSpaceError::new(&X_DO, &near, OrientationError::AngleAxis)
        .wrench(&K.into(), &K.into())
        .unwrap();
    for at in [InteractionAt::Current, InteractionAt::Desired, InteractionAt::Mean] {
        let c = wrench(at);
        assert!((c.wrench - a.wrench).norm() < 1e-3 * a.wrench.norm(), "{at:?}: {} {}", c.wrench, a.wrench);
        assert_eq!(c.damping, Matrix6::from_diagonal(&K));
    }
}

/// The start of the comparison: the error of (10.69) is that of Sect. 10.9.
#[test]
fn start_of_the_comparison() {
    let robot = scara();
    let q = Vector4::new(0.0, FRAC_PI_2, 0.5, -FRAC_PI_4);
    let X_BO = Pose::new([1.0, 1.0, 1.0].into(), [0.0, 0.0, FRAC_PI_4].into());
    let X_DO = Pose::new([-0.1, 0.1, 0.6].into(), [0.0, 0.0, -FRAC_PI_3].into());
    let X_CO = robot.forward(&q).inverse() * X_BO;
    let x = OperationalSpaceError::new(&X_DO, &X_CO, OrientationError::EulerZyx).x;
    // In the desired frame, which is turned by 7 pi/12 in the base.
    let (dx, dy) = (0.0707107, 0.1224745);
    let (sin, cos) = (7.0 * FRAC_PI_3 / 4.0).sin_cos();
    let wanted = [cos * dx + sin * dy, -sin * dx + cos * dy, -0.1, FRAC_PI_3, 0.0, 0.0];
    assert!((x - Vector6::from(wanted)).norm() < 1e-6, "{x}");
}

#[test]
fn gimbal_lock_has_no_torque_but_a_velocity() {
    let X_DO = Pose::translation(0.0, 0.0, 0.6);
    let R_DC = euler_zyx_rotation(&Vector3::new(0.2, FRAC_PI_2, 0.0));
    let X_CO = Pose::from_parts([0.0, 0.0, 0.0].into(), R_DC.inverse().into()) * X_DO;
    let error = OperationalSpaceError::new(&X_DO, &X_CO, OrientationError::EulerZyx);
    assert!(error.wrench(&PoseGains::repeat(1.0), &PoseGains::repeat(1.0)).is_none());
    assert!(error.twist(&PoseGains::repeat(1.0)).unwrap().iter().all(|v| v.is_finite()));
    let error = OperationalSpaceError::new(&X_DO, &X_CO, OrientationError::AngleAxis);
    assert!(error.wrench(&PoseGains::repeat(1.0), &PoseGains::repeat(1.0)).is_some());
}

#[test]
fn fewer_features_than_joints_leave_motions_free() {
    let (X_DO, now) = (Pose::translation(0.0, 0.0, 0.6), Pose::translation(0.05, 0.02, 0.6));
    let one = Selection::new([(FeatureKind::Point(2), 1.0)]).unwrap();
    let task =
        image_task(&goal(&X_DO).with_selection(one).unwrap(), &seen(&now, &square()), ESTIMATED).unwrap();
    let J = CameraJacobian::of_moving_camera(Matrix6::identity());
    let wanted = Vector6::new(0.3, -0.1, 0.2, 0.1, 0.2, 0.3);
    let null = seek_null_motion(&task, &J, &wanted).unwrap();
    let L = point_rows(&seen(&now, &square()).features()[2], 0.6);
    assert!((L * null).norm() < 1e-9);
    assert!((null - wanted).norm() < wanted.norm(), "most of it remains");
    // What the features ask for is still given, with little motion.
    let qd = joint_velocity(&task, 1.0, &J).unwrap();
    let e = goal(&X_DO).features()[2] - seen(&now, &square()).features()[2];
    assert!((L * qd - e).norm() < 1e-4, "{}", L * qd - e);
    assert!(qd.norm() < 1.0, "{qd}");
    let full = image_task(&goal(&X_DO), &seen(&now, &square()), ESTIMATED).unwrap();
    assert!(seek_null_motion(&full, &J, &wanted).is_none(), "nothing is free");
}

#[test]
fn near_a_singularity_the_velocity_stays_bounded() {
    let X_DO = Pose::translation(0.0, 0.0, 0.6);
    let view = seen(&(Pose::translation(0.02, 0.0, 0.0) * X_DO), &square());
    let task = image_task(&goal(&X_DO), &view, Interaction::TEXTBOOK).unwrap();
    let mut J = Matrix6::identity();
    J[(0, 0)] = 1e-9; // the arm can hardly move along x
    let qd = joint_velocity(&task, 1.0, &CameraJacobian::of_moving_camera(J)).unwrap();
    assert!(qd.norm() < 10.0, "{qd}");
}

#[test]
fn views_of_other_features_and_tasks_of_other_laws_are_refused() {
    let X_DO = Pose::translation(0.0, 0.0, 0.6);
    let few = seen(&X_DO, &square()[..3]);
    let (orientation, space, gain) =
        (OrientationError::EulerZyx, OperationalSpace::Four, Gain::Constant(1.0));
    let one = PoseGains::repeat(1.0);
    let gains = HybridGains { K_p: Vector3::repeat(1.0).into(), K_o: Vector3::repeat(1.0).into() };
    let laws = [
        Law::PositionTorque { K_P: one, damping: Damping::Task(one), orientation, space },
        Law::PositionVelocity { K: one, gain, orientation, space, weights: TwistWeights::Unit },
        Law::ImageTorque {
            K_Ps: 1.0.into(),
            damping: Damping::Task(1.0.into()),
            interaction: Interaction::TEXTBOOK,
        },
        Law::ImageVelocity { K_s: 1.0.into(), gain, interaction: Interaction::TEXTBOOK },
        Law::Hybrid { gains, gain, orientation, space, depth: DepthSource::Desired },
    ];
    let arm = arm(Matrix6::identity(), Vector6::zeros(), Vector6::zeros());
    for law in &laws {
        assert_eq!(law.task(&goal(&X_DO), &few), Err(NoTask::TooFew), "{law:?}");
        let task = law.task(&goal(&X_DO), &seen(&X_DO, &square())).unwrap();
        for other in &laws {
            assert_eq!(other.output(&task, &arm).is_some(), other.is_torque() == law.is_torque());
        }
    }
}
