//! Scheme D with three points: from up to four poses they look the same, and a run that ends in another one than the goal says so; with two, from ever so many.

#![allow(non_snake_case)]
#![allow(clippy::unwrap_used)] // helpers of tests are tests

use nalgebra::{Point3, SVector, Vector2};
use std::ops::ControlFlow;
use std::path::Path;
use vservo::config::Config;
use vservo::control::outcome::Outcome;
use vservo::geometry::Pose;
use vservo::linalg::Random;
use vservo::pose::{Correspondence3, p3p};
use vservo::servo::PostureSearch;
use vservo::sim::simulate_system;

const THREE: [&str; 3] =
    ["servo.points=[1, 2, 3]", "servo.desired.rotation_rpy_rad=[0.35, 0.25, 0.0]", "run.duration_s=5"];

fn config(set: &[String]) -> Config {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/ur5.toml");
    let set: Vec<_> = THREE.iter().map(ToString::to_string).chain(set.iter().cloned()).collect();
    Config::load(Some(&path), &set).unwrap()
}

/// A posture from which the three points look as at the goal, and the fourth does not.
fn elsewhere(config: &Config) -> SVector<f64, 6> {
    let X_DO = *config.set_point.X_DO().unwrap();
    let three = [(0.0, 0.0), (0.1, 0.0), (0.1, 0.1)].map(|(x, y)| {
        let r = Point3::new(x, y, 0.0);
        let p = X_DO * r;
        Correspondence3 { r, s: Vector2::new(p.x / p.z, p.y / p.z) }
    });
    let robot = config.robot.build::<6>().unwrap();
    let search = PostureSearch { robot: &robot, mount: &config.camera.mount };
    let X_WO = config.scene.as_ref().unwrap().X_WO;
    let mut random = Random::new(2);
    let is_other = |X: &&Pose| {
        let fourth = *X * Point3::new(0.0, 0.1, 0.0);
        let px = config.camera.model.project(&fourth);
        X.inv_mul(&X_DO).rotation.angle() > 0.05
            && px.is_some_and(|px| config.camera.model.contains(&px, 30.0))
    };
    let poses = p3p(&three).unwrap();
    for X_CO in poses.as_slice().iter().filter(is_other) {
        let X_WC = X_WO * X_CO.inverse();
        for _ in 0..40 {
            let q = search.towards(&search.anywhere(&mut random), &X_WC);
            let off = search.X_WC(&q).inv_mul(&X_WC);
            if off.translation.vector.norm() < 1e-6 && off.rotation.angle() < 1e-6 {
                return q;
            }
        }
    }
    unreachable!("no other pose of {} is within reach", poses.as_slice().len())
}

#[test]
fn an_end_in_another_pose_is_told_as_ambiguous() {
    let q = elsewhere(&config(&[]));
    let start = format!("robot.q_start_rad_or_m={:?}", q.as_slice());
    // With the mean of both matrices another way is taken.
    let way = "servo.interaction=current".to_owned();
    let run = simulate_system(&config(&[start, way]), &mut |_| ControlFlow::Continue(())).unwrap();
    assert_eq!(run.finish.outcome, Outcome::NotConverged, "{run:?}");
    assert!(run.finish.reason.contains("up to four poses"), "{}", run.finish.reason);
    assert!(run.errors.feature_error_px.unwrap() > 0.5, "{run:?}");
}

#[test]
fn the_check_warns_of_three_points_alone() {
    let warnings = |config: Config| config.warnings.iter().map(ToString::to_string).collect::<String>();
    assert!(warnings(config(&[])).contains("up to four poses"));
    assert!(!warnings(config(&["servo.points=[1, 2, 3, 4]".to_owned()])).contains("up to four poses"));
}

#[test]
fn an_end_that_too_few_points_leave_open_blames_them() {
    let run = simulate_system(&config(&["servo.points=[1, 2]".into()]), &mut |_| ControlFlow::Continue(()))
        .unwrap();
    assert_eq!(run.finish.outcome, Outcome::NotConverged, "{run:?}");
    let reason = run.finish.reason;
    assert!(reason.contains("servo.points") && !reason.contains("camera.lens"), "{reason}");
}

#[test]
fn a_feature_that_is_named_twice_is_refused() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/ur5.toml");
    for (set, key) in [
        ("servo.points=[1, 2, 3, 1]", "servo.points[3]: names 1 more than once"),
        ("servo.segments=[[1, 2], [3, 4], [2, 1]]", "servo.segments[2]: names [1, 2] more than once"),
    ] {
        let told = Config::load(Some(&path), &[set.into()]).unwrap_err().to_string();
        assert!(told.contains(key) && told.contains("servo.weights"), "{told}");
    }
}
