use super::*;
use crate::config::Config;
use crate::messages::{FeaturePoint, TargetStatus};
use crate::motion::ExcitationMotion;
use crate::time::TICK;
use nalgebra::Vector3;
use std::path::Path;

fn limits<const N: usize>(robot: &Robot<N>) -> MotionLimits<N> {
    MotionLimits {
        lower: SVector::from_fn(|i, _| robot.limits()[i].lower),
        upper: SVector::from_fn(|i, _| robot.limits()[i].upper),
        velocity: SVector::from_fn(|i, _| robot.limits()[i].velocity),
        acceleration: SVector::repeat(10.0),
        jerk: SVector::repeat(500.0),
    }
}

fn seen(config: &Config, X_CO: &crate::geometry::Pose) -> Option<Measurement> {
    let mut m =
        Measurement { status: TargetStatus::Found as u32, feature_count: 4, ..Measurement::default() };
    for (f, point) in m.features.iter_mut().zip(config.target.points()) {
        let (i, p) = (point.id, X_CO * point.p_O);
        let px = config.camera.model.project(&p).filter(|px| config.camera.model.contains(px, 0.0))?;
        *f = FeaturePoint { id: i as u64, u_px: px.x, v_px: px.y, x: p.x / p.z, y: p.y / p.z, sd_px: 0.0 };
    }
    m.set_pose(X_CO);
    Some(m)
}

/// The whole motion of a run file's arm, with the target moved aside by `shift`: how far the points move in the image,
/// px. Points that leave the image fail the test.
fn motion_px<const N: usize>(file: &str, shift: &Vector3<f64>) -> Option<f64> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config").join(file);
    let config = Config::load(Some(&path), &[]).unwrap();
    let robot = config.robot.build::<N>().unwrap();
    let mut q = crate::config::assemble::q_start::<N>(&config).unwrap();
    let X_CO_at = |q: &SVector<f64, N>| {
        let mut X_WO = config.X_WO().unwrap();
        X_WO.translation.vector += shift;
        config.camera.mount.X_WC(&robot, q).inv_mul(&X_WO)
    };
    let first = seen(&config, &X_CO_at(&q))?;
    let limits = limits(&robot);
    let points = config.target.points().iter().map(|point| point.p_O).collect::<Vec<_>>();
    let mount = &config.camera.mount;
    let reach = image_reach(&robot, mount, &config.camera.model, &points, &limits, &q, &first).unwrap();
    let mut motion = ExcitationMotion::new(&q, &reach, &limits);
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
