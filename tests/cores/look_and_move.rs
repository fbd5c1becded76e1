//! `servo.scheme = "look_and_move"`: one look, one motion, and another look. Where a motion ends is derived anew here.

#![allow(non_snake_case)]
#![allow(clippy::unwrap_used, clippy::panic)] // helpers of tests are tests

use nalgebra::{Point3, SVector, UnitQuaternion, Vector3};
use std::ops::ControlFlow;
use std::path::Path;
use vservo::config::Config;
use vservo::control::outcome::Outcome;
use vservo::control::trace::Event;
use vservo::geometry::Pose;
use vservo::sim::{Moment, SystemRun, simulate_system};

fn config(file: &str, set: &[&str]) -> Config {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config").join(file);
    let set: Vec<_> = ["servo.scheme=look_and_move"].iter().chain(set).map(ToString::to_string).collect();
    Config::load(Some(&path), &set).unwrap_or_else(|e| panic!("{file}: {e}"))
}

/// A run, the feature error at the end of each complete motion, px, and the joints at each tick.
fn run(config: &Config) -> (SystemRun, Vec<f64>, Vec<[f64; 6]>) {
    let (mut errors_px, mut joints) = (Vec::new(), Vec::new());
    let run = simulate_system(config, &mut |moment| {
        if let Moment::Tick(trace, errors) = moment {
            let q = &trace.joint_state.q;
            joints.push([q[0], q[1], q[2], q[3], q[4], q[5]]);
            if trace.events.iter().any(|event| event == Event::MotionOver) {
                errors_px.extend(errors.believed.feature_error_px);
            }
        }
        ControlFlow::Continue(())
    });
    (run.unwrap(), errors_px, joints)
}

/// A camera in the hand and one beside the arm; four, six and seven joints.
#[test]
fn with_a_right_description_one_or_two_looks_are_enough() {
    for file in ["ur5.toml", "panda.toml", "scara-d.toml", "scara-eye-to-hand.toml"] {
        let config = config(file, &[]);
        let (first, errors_px, _) = run(&config);
        assert_eq!(first.finish.outcome, Outcome::Converged, "{file}: {first:?}");
        assert!(errors_px.len() <= 1, "{file}: {errors_px:?}");
        assert!(first.errors.position_error_m.unwrap() < 1e-3, "{file}: {first:?}");
        assert_eq!(run(&config).0, first, "{file}: to the last bit");
    }
}

/// With the camera turned on the flange by `E`, the arm moves it by `E D E^-1` where it means to move it by `D`: so much is left, and
/// the next looks take it away.
#[test]
fn a_turned_mount_costs_looks_as_the_geometry_says() {
    let roll = 5.0f64.to_radians();
    let setting = format!("scene.camera.mount.rotation_rpy_rad=[{roll}, 0.0, 0.0]");
    for file in ["ur5.toml", "panda.toml"] {
        let config = config(file, &[&setting]);
        let (run, errors_px, _) = run(&config);
        assert_eq!(run.finish.outcome, Outcome::Converged, "{file}: {run:?}");
        assert!((2..=5).contains(&errors_px.len()), "{file}: {errors_px:?}");
        assert!(errors_px.windows(2).all(|pair| pair[1] < 0.4 * pair[0]), "{file}: {errors_px:?}");
        let expected_px = error_after_one_look_px(&config, roll);
        assert!((errors_px[0] / expected_px - 1.0).abs() < 0.03, "{file}: {} {expected_px}", errors_px[0]);
    }
}

/// Root mean square of the distances, over both coordinates as the run counts it, of the points of a square with 0.1 m sides.
fn error_after_one_look_px(config: &Config, roll: f64) -> f64 {
    let scene = config.scene.as_ref().unwrap();
    let X_BE = match config.start.q.len() {
        6 => forward::<6>(config),
        _ => forward::<7>(config),
    };
    let X_EC = Pose::from_parts(
        Vector3::new(0.0, 0.0, 0.05).into(),
        UnitQuaternion::from_axis_angle(&Vector3::x_axis(), roll),
    );
    let X_EC_believed = Pose::translation(0.0, 0.0, 0.05);
    let X_CO = (X_BE * X_EC).inverse() * scene.X_WO;
    let X_DO = *config.set_point.X_DO().unwrap();
    let meant = X_CO * X_DO.inverse();
    let E = X_EC.inverse() * X_EC_believed;
    let X_CO_after = (E * meant * E.inverse()).inverse() * X_CO;
    let corners = [(0.0, 0.0), (0.1, 0.0), (0.1, 0.1), (0.0, 0.1)].map(|(x, y)| Point3::new(x, y, 0.0));
    let sum: f64 = corners
        .iter()
        .map(|p| {
            let (a, b) = (X_DO * p, X_CO_after * p);
            (a.coords.xy() / a.z - b.coords.xy() / b.z).norm_squared()
        })
        .sum();
    800.0 * (sum / 4.0).sqrt()
}

fn forward<const N: usize>(config: &Config) -> Pose {
    config.robot.build::<N>().unwrap().forward(&SVector::from_column_slice(&config.start.q))
}

/// A target that moves on is always ahead by what it makes from a look to the next one. The arm follows it without ever turning back.
#[test]
fn a_moving_target_is_followed_and_makes_nothing_swing() {
    let set = [
        "scene.motion.kind=conveyor",
        "scene.motion.velocity_m_s=[0.0, 0.01, 0.0]",
        "run.duration_s=16",
        "goal.hold_s=60",
    ];
    let config = config("ur5.toml", &set);
    let (run, errors_px, joints) = run(&config);
    assert_eq!(run.finish.outcome, Outcome::NotConverged, "{run:?}");
    assert!(run.finish.reason.contains("has moved meanwhile"), "{}", run.finish.reason);
    assert_eq!(run.target_lost, 0);
    assert!(errors_px.len() >= 4, "{errors_px:?}");
    // From a look to the end of the rest after its motion 3 s at the most go by: 30 mm of 350 mm, or 70 px.
    assert!(errors_px[1..].iter().all(|e| (10.0..70.0).contains(e)), "{errors_px:?}");
    let robot = config.robot.build::<6>().unwrap();
    let y = |q: &[f64; 6]| robot.forward(&SVector::from_column_slice(q)).translation.y;
    let after_the_first = &joints[6000..];
    let (mut highest, mut back) = (f64::NEG_INFINITY, 0.0f64);
    for y in after_the_first.iter().map(y) {
        highest = highest.max(y);
        back = back.max(highest - y);
    }
    assert!(back < 1e-3, "turned back by {back} m");
}

#[test]
fn a_goal_that_no_posture_shows_is_told_and_nothing_moves() {
    let set = ["servo.desired.position_m=[-0.05, -0.05, 1.6]"];
    let (run, errors_px, joints) = run(&config("ur5.toml", &set));
    assert_eq!(run.finish.outcome, Outcome::NotConverged);
    assert!(run.finish.reason.contains("inverse kinematics"), "{}", run.finish.reason);
    assert!(errors_px.is_empty());
    let moved = joints.iter().flat_map(|q| (0..6).map(|i| (q[i] - joints[0][i]).abs())).fold(0.0, f64::max);
    assert!(moved < 1e-3, "{moved}");
}
