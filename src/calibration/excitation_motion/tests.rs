use super::*;
use crate::config::Config;
use crate::messages::{FeaturePoint, TargetStatus};
use crate::motion::Reference;
use crate::time::TICK;
use nalgebra::{Vector3, Vector4};
use proptest::prelude::*;
use std::path::Path;

const TICKS: usize = (DURATION.0 / TICK.0) as usize;

fn limits<const N: usize>(robot: &Robot<N>) -> MotionLimits<N> {
    MotionLimits {
        lower: SVector::from_fn(|i, _| robot.limits()[i].lower),
        upper: SVector::from_fn(|i, _| robot.limits()[i].upper),
        velocity: SVector::from_fn(|i, _| robot.limits()[i].velocity),
        acceleration: SVector::repeat(10.0),
        jerk: SVector::repeat(500.0),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(20))]

    /// Through the reference, whose limits must not act: the end is where the beginning was, at rest.
    #[test]
    fn it_ends_where_it_began_and_no_limit_acts(
        start in prop::array::uniform4(0.02..0.98f64), reach in prop::array::uniform4(-0.5..0.5f64),
        strength in 0.02..1.0f64
    ) {
        let robot = crate::robot::load("scara").unwrap().build::<4>().unwrap();
        let mut limits = limits(&robot);
        limits.velocity *= strength;
        limits.acceleration *= strength;
        limits.jerk *= strength;
        let q = Vector4::from_fn(|i, _| limits.lower[i] + start[i] * (limits.upper[i] - limits.lower[i]));
        let mut motion = ExcitationTrajectory::new(&q, &Vector4::from(reach), &limits);
        let mut reference = Reference::new(limits.clone(), q);
        let (mut farthest, mut ticks) = (Vector4::zeros(), 0);
        while !motion.is_over() || reference.state().qd.amax() > 1e-9 {
            let qd = motion.advance(TICK);
            let state = reference.advance(&qd, TICK);
            prop_assert_eq!(state.limits, crate::motion::ActingLimits::default());
            farthest = farthest.sup(&(state.q - q).abs());
            ticks += 1;
            prop_assert!(ticks < 2 * TICKS, "comes to rest");
        }
        prop_assert!((reference.state().q - q).amax() < 1e-9, "{}", reference.state().q - q);
        for i in 0..4 {
            let a = motion.amplitude()[i];
            prop_assert!(farthest[i] <= a.abs() + 1e-6, "{i}: {} {a}", farthest[i]);
            prop_assert!(farthest[i] >= 0.6 * a.abs(), "{i}: {} {a}", farthest[i]);
            prop_assert!(a * reach[i] >= 0.0 && a.abs() <= reach[i].abs());
            let end = room(i, &q, &limits, a);
            prop_assert!(a.abs() <= RANGE_SHARE * end);
        }
    }
}

#[test]
fn a_joint_at_the_end_of_its_range_stays() {
    let robot = crate::robot::load("scara").unwrap().build::<4>().unwrap();
    let limits = limits(&robot);
    let q = limits.upper;
    let out = ExcitationTrajectory::new(&q, &Vector4::repeat(0.1), &limits);
    assert_eq!(out.amplitude(), &Vector4::zeros());
    let back = ExcitationTrajectory::new(&(q * 1.1), &Vector4::repeat(-0.1), &limits);
    assert!(back.amplitude().iter().all(|a| *a <= 0.0 && a.is_finite()));
}

fn seen(config: &Config, X_CO: &crate::geometry::Pose) -> Option<Measurement> {
    let mut m =
        Measurement { status: TargetStatus::Found as u32, feature_count: 4, ..Measurement::default() };
    for (f, point) in m.features.iter_mut().zip(config.target.points()) {
        let (i, p) = (point.id, X_CO * point.p_O);
        let px = config.camera.model.project(&p).filter(|px| config.camera.model.contains(px, 0.0))?;
        *f = FeaturePoint { id: i as u64, u_px: px.x, v_px: px.y, x: p.x / p.z, y: p.y / p.z, sigma_px: 0.0 };
    }
    m.set_pose(X_CO);
    Some(m)
}

/// The whole motion of a run file's arm, with the target moved aside by `shift`: how far the points move in the image,
/// px. Points that leave the image fail the test.
fn motion_px<const N: usize>(file: &str, shift: &Vector3<f64>) -> Option<f64> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(file);
    let config = Config::load(Some(&path), &[]).unwrap();
    let robot = config.robot.build::<N>().unwrap();
    let mut q = crate::config::assemble::q_start::<N>(&config).unwrap();
    let X_CO_at = |q: &SVector<f64, N>| {
        let mut X_WO = config.X_WO().unwrap();
        X_WO.translation.vector += shift;
        config.camera.mount.X_WC(&robot.forward(q)).inv_mul(&X_WO)
    };
    let first = seen(&config, &X_CO_at(&q))?;
    let limits = limits(&robot);
    let points = config.target.points().iter().map(|point| point.p_O).collect::<Vec<_>>();
    let mount = &config.camera.mount;
    let reach = image_reach(&robot, mount, &config.camera.model, &points, &limits, &q, &first).unwrap();
    let mut motion = ExcitationTrajectory::new(&q, &reach, &limits);
    let mut most: f64 = 0.0;
    while !motion.is_over() {
        q += motion.advance(TICK) * TICK.as_s();
        let now = seen(&config, &X_CO_at(&q)).expect("the target stays in the image");
        for (a, b) in now.features().iter().zip(first.features()) {
            most = most.max((a.u_px - b.u_px).hypot(a.v_px - b.v_px));
        }
    }
    Some(most)
}

#[test]
fn the_target_moves_clearly_and_stays_in_the_image() {
    let (mut tried, mut clear) = (0, 0);
    for shift in (0..60).map(|k| {
        let (a, b) = (f64::from(k) * 2.4, 0.003 * f64::from(k));
        Vector3::new(b * a.cos(), b * a.sin(), 0.0)
    }) {
        for moved in [
            motion_px::<4>("default.toml", &shift),
            motion_px::<6>("ur5.toml", &shift),
            motion_px::<7>("panda.toml", &shift),
            motion_px::<2>("pan_tilt.toml", &shift),
            motion_px::<4>("scara-eye-to-hand.toml", &shift),
        ]
        .into_iter()
        .flatten()
        {
            assert!((1.0..250.0).contains(&moved), "{shift}: {moved} px");
            tried += 1;
            clear += usize::from(moved > 20.0);
        }
    }
    assert!(tried > 100 && clear > tried * 9 / 10, "{clear} of {tried}");
}

#[test]
fn without_a_pose_nothing_is_known_of_the_reach() {
    let config = Config::load(None, &[]).unwrap();
    let robot = config.robot.build::<4>().unwrap();
    let q = crate::config::assemble::q_start::<4>(&config).unwrap();
    let m = Measurement { feature_count: 4, ..Measurement::default() };
    let points = config.target.points().iter().map(|point| point.p_O).collect::<Vec<_>>();
    let reach = |m: &Measurement| {
        image_reach(&robot, &config.camera.mount, &config.camera.model, &points, &limits(&robot), &q, m)
    };
    assert!(reach(&m).is_none());
}
