//! The law on arms that follow it exactly, before cameras whose lens, mount and target it does not know.

#![allow(clippy::unwrap_used, clippy::panic)] // helpers of tests

use crate::geometry::Pose;
use crate::linalg::Random;
use crate::messages::Measurement;
use crate::robot::{JointHistory, Mount, Robot};
use crate::servo::{
    EstimationSettings, Gain, Interaction, Law, LawOutput, ServoSettings, SetPoint, UpdatePolicy, VisualServo,
};
use crate::sim::perfect_measurement;
use crate::time::{MonoNs, TICK};
use nalgebra::{Point3, SVector, UnitQuaternion, Vector2, Vector3};

/// Focal length of the lens as it is believed, px: that of the shipped run files.
const F_PX: f64 = 800.0;

fn square(side_m: f64) -> [Point3<f64>; 4] {
    [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(|(x, y)| Point3::new(x * side_m, y * side_m, 0.0))
}

/// What is seen through a lens of `zoom` times the believed focal length, of a target whose pose is told wrong.
fn seen(side_m: f64, zoom: f64, X_CO: &Pose, at: MonoNs, random: &mut Random) -> Measurement {
    let mut m = perfect_measurement(&square(side_m), X_CO, at).unwrap();
    let count = m.feature_count as usize;
    for f in m.features.iter_mut().take(count) {
        let noise = || random.between(-5e-5, 5e-5);
        (f.x, f.y) = [f.x, f.y].map(|s| s * zoom).into();
        let mut noise = noise;
        (f.x, f.y, f.sd_px) = (f.x + noise(), f.y + noise(), 0.03);
        (f.u_px, f.v_px) = (F_PX * f.x + 319.5, F_PX * f.y + 239.5);
    }
    m.set_pose(&Pose::translation(0.3, 0.2, 2.0));
    m
}

/// Servoes from a posture about `q` to the view in `q`; the largest error of the image at rest, px, and how far it moved at first.
fn flown<const N: usize>(model: &str, q: [f64; N], seed: u64) -> f64 {
    let robot: Robot<N> = crate::robot::load(model).unwrap().build().unwrap();
    let random = &mut Random::new(seed);
    let q_goal = SVector::from(q);
    let axis = Vector3::from_fn(|_, _| random.between(-1.8, 1.8));
    let X_EC = Pose::from_parts(
        Vector3::from_fn(|_, _| random.between(-0.05, 0.05)).into(),
        UnitQuaternion::from_scaled_axis(axis),
    );
    let (side_m, zoom) = (random.between(0.05, 0.2), 2f64.powf(random.between(-1.0, 1.0)));
    let tilt = Vector3::new(random.between(-0.5, 0.5), random.between(-0.5, 0.5), random.between(-3.0, 3.0));
    let z_m = side_m * zoom * F_PX / 120.0;
    let X_CO = Pose::new(Vector3::new(-0.3 * side_m, -0.4 * side_m, z_m), tilt);
    let X_WO = robot.forward(&q_goal) * X_EC * X_CO;
    let goal = seen(side_m, zoom, &X_CO, MonoNs(0), &mut Random::new(1));
    let s_d: Vec<_> = goal.features().iter().map(|f| Vector2::new(f.x, f.y)).collect();
    let goal = SetPoint::from_features(&s_d, &square(0.1), 0.6).unwrap();
    let law =
        Law::ImageVelocity { K_s: 1.0.into(), gain: Gain::Constant(2.0), interaction: Interaction::TEXTBOOK };
    let estimation = EstimationSettings {
        f_px: Vector2::repeat(F_PX),
        size_px: Vector2::new(640.0, 480.0),
        tolerance_px: 0.1,
    };
    let mount = Mount::EyeInHand { X_EC: Pose::identity() };
    let settings = ServoSettings {
        estimation: Some(estimation),
        ..ServoSettings::new(law, UpdatePolicy::Predict, mount)
    };
    let mut servo = VisualServo::<N>::new(settings, goal.clone());
    let mut arm = q_goal + SVector::<f64, N>::from_fn(|_, _| random.between(-0.06, 0.06));
    let (mut qd, mut true_arm) = (SVector::<f64, N>::zeros(), JointHistory::<N>::new());
    for tick in 0..25_000 {
        let now = MonoNs(tick * TICK.0);
        true_arm.push(now, &arm, &qd);
        servo.note_arm(now, &arm, &qd);
        if tick % 40 == 20 {
            let exposure = MonoNs((tick - 20) * TICK.0);
            let then = true_arm.joints(exposure).unwrap();
            let X_CO = (robot.forward(&then) * X_EC).inv_mul(&X_WO);
            let m = seen(side_m, zoom, &X_CO, exposure, random);
            assert!(servo.add_measurement(now, &m, &robot).is_used(), "{tick}");
        }
        qd = match servo.law_output(&arm, &qd, &robot) {
            Some(LawOutput::Velocity(qd)) => qd,
            None if tick <= 20 => SVector::zeros(),
            other => panic!("{other:?} at {tick}"),
        };
        arm += qd * TICK.as_s();
    }
    let X_CO = (robot.forward(&arm) * X_EC).inv_mul(&X_WO);
    let m = seen(side_m, zoom, &X_CO, MonoNs(1), &mut Random::new(1));
    let errors = m.features().iter().zip(goal.features());
    errors.map(|(f, s_d)| (Vector2::new(f.x, f.y) - s_d).norm() * F_PX).fold(0.0, f64::max)
}

#[test]
fn unknown_cells_come_to_a_taught_view() {
    for seed in 0..3 {
        let ur5 = flown("ur5", [-0.02, -1.6, 1.95, -1.9, -1.57, -0.02], seed);
        let panda = flown("panda", [-0.15, -0.52, -0.13, -2.1, 0.08, 1.78, 0.2], seed);
        let scara = flown("scara", [0.1, 1.4, 0.5, -0.7], seed);
        assert!(ur5 < 0.15 && panda < 0.15 && scara < 0.15, "{seed}: {ur5} {panda} {scara} px");
    }
}
