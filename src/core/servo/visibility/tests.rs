use super::*;
use crate::camera_model::{Distortion, Intrinsics};
use crate::geometry::Pose;
use crate::servo::{Gain, Interaction, Law, PoseGains};
use nalgebra::{Point3, Vector4};
use proptest::prelude::*;

fn square() -> [Point3<f64>; 4] {
    [(0.0, 0.0), (0.1, 0.0), (0.1, 0.1), (0.0, 0.1)].map(|(x, y)| Point3::new(x, y, 0.0))
}

fn guard() -> VisibilityGuard {
    let lens =
        Intrinsics { fx_px: 800.0, fy_px: 800.0, cx_px: 319.5, cy_px: 239.5, width_px: 640, height_px: 480 };
    let distortion = Distortion { k1: -0.15, k2: 0.05, ..Distortion::default() };
    let camera = CameraModel::new(lens, distortion).unwrap();
    VisibilityGuard {
        camera,
        margin_px: 10.0,
        mark_radius_m: 0.01,
        rate_1_s: 4.0,
        acceleration: [f64::INFINITY; MAX_JOINTS],
    }
}

fn goal() -> SetPoint {
    SetPoint::from_pose(&Pose::translation(-0.05, -0.05, 0.6), &square()).unwrap()
}

fn seen(X_CO: &Pose) -> View {
    View::new(square().iter().map(|p| (X_CO * p).coords).map(|p| p.xy() / p.z), Some(*X_CO)).unwrap()
}

fn law() -> Law {
    Law::ImageVelocity { K_s: 1.0.into(), gain: Gain::Constant(1.0), interaction: Interaction::TEXTBOOK }
}

/// Pixel distances of the four points from the nearest borders, less their radius in the image.
fn nearest_px(X_CO: &Pose) -> f64 {
    let guard = guard();
    let i = guard.camera.intrinsics();
    let of = |p: &Point3<f64>| {
        let p = X_CO * p;
        let px = guard.camera.pixel_of(&(p.coords.xy() / p.z));
        let sides = [px.x + 0.5, 639.5 - px.x, px.y + 0.5, 479.5 - px.y];
        sides.into_iter().fold(f64::INFINITY, f64::min) - guard.mark_radius_m * i.fx_px / p.z
    };
    square().iter().map(of).fold(f64::INFINITY, f64::min)
}

fn hold<const N: usize>(X_CO: &Pose, arm: &Arm<N>, qd: &SVector<f64, N>) -> SVector<f64, N> {
    hold_with(&guard(), X_CO, arm, qd)
}

fn hold_with<const N: usize>(
    guard: &VisibilityGuard,
    X_CO: &Pose,
    arm: &Arm<N>,
    qd: &SVector<f64, N>,
) -> SVector<f64, N> {
    let (set_point, view, law) = (goal(), seen(X_CO), law());
    let task = law.task(&set_point, &view).unwrap();
    let law_output = LawOutput::Velocity(*qd);
    match guard.hold(&set_point, &view, (&task, &law.joint_damping()), arm, law_output) {
        LawOutput::Velocity(qd) => qd,
        LawOutput::Torque(_) => panic!("a velocity"),
    }
}

fn flier(qd: Vector6<f64>) -> Arm<6> {
    Arm { J: CameraJacobian::of_moving_camera(Matrix6::identity()), qd, gravity: Vector6::zeros() }
}

fn anywhere() -> impl Strategy<Value = Pose> {
    (prop::array::uniform3(-0.5..0.5f64), -0.4..0.4f64, -0.3..0.3f64, 0.3..1.2f64)
        .prop_map(|(turn, x, y, z)| {
            Pose::new([x, y, z].into(), turn.into()) * Pose::translation(-0.05, -0.05, 0.0)
        })
        .prop_filter("in the image", |X_CO| nearest_px(X_CO) > 0.0)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Whatever is requested, no mark comes nearer to the border than the margin, and what is within it no nearer.
    #[test]
    fn nothing_is_carried_out(start in anywhere(), V in prop::array::uniform6(-1.0..1.0f64)) {
        let V = Vector6::from(V);
        let kept = nearest_px(&start).min(10.0);
        let mut X_CO = start;
        for _ in 0..800 {
            let held = hold(&X_CO, &flier(Vector6::zeros()), &V);
            prop_assert!(held.iter().all(|x| x.is_finite()));
            X_CO = crate::geometry::integrate_body_twist(&Pose::identity(), &held, 1e-3).inverse() * X_CO;
            let least = square().iter().map(|p| (X_CO * p).z).fold(f64::INFINITY, f64::min);
            if !(least > 0.02 && least < 50.0) { break; }
            // What a step of 1 ms bends is not in the bound.
            prop_assert!(nearest_px(&X_CO) > kept - 3.0, "{} of {kept} px: {held}", nearest_px(&X_CO));
        }
    }

    /// What the limits leave of a motion keeps all in view: it is not bent, however much is asked for.
    #[test]
    fn what_the_arm_cannot_do_yet_is_not_bent(X_CO in anywhere(), V in prop::array::uniform6(-20.0..20.0f64)) {
        prop_assume!(nearest_px(&X_CO) > 15.0);
        let V = Vector6::from(V);
        // After 0.025 s: 2.5 mm/s and 2.5 mrad/s, at 800 px and 0.3 m less than the 20 px/s that are free 5 px before the margin.
        let slow = VisibilityGuard { acceleration: [0.1; MAX_JOINTS], ..guard() };
        prop_assert_eq!(hold_with(&slow, &X_CO, &flier(Vector6::zeros()), &V), V);
    }

    #[test]
    fn motion_that_keeps_all_in_view_is_unchanged(
        X_CO in anywhere(), V in prop::array::uniform6(-1.0..1.0f64)
    ) {
        let V = Vector6::from(V);
        let slow = V * 1e-9;
        if nearest_px(&X_CO) > 11.0 {
            prop_assert_eq!(hold(&X_CO, &flier(Vector6::zeros()), &slow), slow);
        }
        let weigh = |V: &Vector6<f64>| V.fixed_rows::<3>(0).norm_squared() + (TURN_M * V.fixed_rows::<3>(3)).norm_squared();
        let held = hold(&X_CO, &flier(Vector6::zeros()), &V);
        prop_assert!(weigh(&held) <= weigh(&V) * (1.0 + 1e-6));
    }
}

#[test]
fn arms_with_fewer_joints_bend_within_their_motions() {
    let robot = crate::robot::load("scara").unwrap().build::<4>().unwrap();
    let q = Vector4::new(0.0, 1.57, 0.5, -0.79);
    let J = robot.jacobian_of_frame(&q, &Pose::identity(), crate::robot::ExpressedIn::Moving);
    let arm = Arm { J: CameraJacobian::of_moving_camera(J), qd: Vector4::zeros(), gravity: Vector4::zeros() };
    // The square is near the right border, and the camera shall move to the left.
    let X_CO = Pose::translation(0.1, -0.05, 0.6);
    let view = seen(&X_CO);
    let qd = joint_velocity(
        &TwistTask {
            matrix: Matrix6::identity(),
            vector: Vector6::new(-1.0, 0.1, 0.0, 0.0, 0.0, 0.0),
            error: 1.0,
        },
        1.0,
        &arm.J,
    )
    .unwrap();
    let held = hold(&X_CO, &arm, &qd);
    // The two points at the right.
    let outward =
        |qd: &Vector4<f64>| [1, 2].map(|i| (point_rows(view.feature(i).unwrap(), 0.6) * (J * qd)).x * 800.0);
    let to_go = 4.0 * (nearest_px(&X_CO) - 10.0);
    assert!(outward(&qd).iter().all(|v| *v > 3.0 * to_go), "{:?} {to_go}", outward(&qd));
    assert!(outward(&held).iter().all(|v| *v < 1.1 * to_go), "{:?} {to_go}", outward(&held));
    assert!(held.norm() > 0.01, "it goes on where it can: {held}");
}

#[test]
fn a_torque_law_is_braked_when_the_arm_is_too_fast() {
    let K = PoseGains::repeat(4.0);
    let law = Law::PositionTorque {
        K_P: K,
        damping: crate::servo::Damping::Task(K),
        orientation: crate::servo::OrientationError::AngleAxis,
        space: crate::servo::OperationalSpace::Six,
    };
    let away = Pose::translation(-0.6, -0.05, 0.6); // a goal far to the side
    let set_point = SetPoint::from_pose(&away, &square()).unwrap();
    let X_CO = Pose::translation(-0.2, -0.05, 0.6);
    let view = seen(&X_CO);
    let task = law.task(&set_point, &view).unwrap();
    // What the law wants and what is left of it, as speeds towards the left border of the nearest points, px/s: the
    // terminal velocity of a wrench is a quarter of it.
    let speeds = |V: Vector6<f64>| {
        let arm = flier(V);
        let law_output = law.output(&task, &arm).unwrap();
        let held = guard().hold(&goal(), &view, (&task, &law.joint_damping()), &arm, law_output);
        [law_output, held].map(|law_output| {
            let LawOutput::Torque(wrench) = law_output else { panic!("a torque law") };
            let of = |i: usize| -(point_rows(view.feature(i).unwrap(), 0.6) * (wrench / 4.0 + V)).x * 800.0;
            of(0).max(of(3))
        })
    };
    let to_go = 4.0 * (nearest_px(&X_CO) - 10.0);
    let [requested, held] = speeds(Vector6::zeros());
    assert!(requested > 2.0 * to_go && held < 1.1 * to_go, "{requested} {held} {to_go}");
    let [_, braked] = speeds(Vector6::x() * 0.3);
    assert!(braked < held - 200.0, "{braked} {held} {to_go}");
}
