//! Position-based laws from the homography (`servo.pose_from = "homography"`): a target of unknown size is servoed to its view in the goal.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)] // helpers of tests are tests

use nalgebra::SVector;
use std::ops::ControlFlow::Continue;
use std::path::Path;
use vservo::config::Config;
use vservo::control::outcome::Outcome;
use vservo::sim::{Moment, simulate_system};

fn set(words: &[String]) -> Result<Config, String> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/ur5-b.toml");
    Config::load(Some(&path), words).map_err(|e| e.to_string())
}

/// The shipped cell as it truly is, with a target that is believed to be `size` times as large; the desired view stays the same, from as many times as far.
fn believed(size: f64) -> Vec<String> {
    let truth = set(&[]).unwrap().effective.clone();
    let (target, desired) = (&truth.target, truth.servo.desired.position_m);
    let lengths = [
        ("side_m", target.side_m),
        ("radius_m", target.radius_m),
        ("radius_p1_m", target.radius_p1_m),
        ("margin_m", target.margin_m),
    ];
    let both = |(key, length): (&str, f64)| {
        [format!("target.{key}={}", length * size), format!("scene.target.{key}={length}")]
    };
    let mut words: Vec<_> = lengths.into_iter().flat_map(both).collect();
    words.push(format!("servo.desired.position_m={:?}", desired.map(|p| p * size)));
    words.push("servo.pose_from=homography".into());
    words
}

/// A size that is half or twice the true one changes how fast the camera gets to the same view, and not where it is then.
#[test]
fn a_target_of_unknown_size_comes_to_the_same_view() {
    for size in [0.5, 0.8, 1.0, 1.5, 2.0] {
        let config = set(&believed(size)).unwrap();
        let robot = config.robot.build::<6>().unwrap();
        let mut q = SVector::<f64, 6>::zeros();
        let run = simulate_system(&config, &mut |moment| {
            if let Moment::Tick(trace, _) = moment {
                q = SVector::from_fn(|i, _| trace.joint_state.q_true[i]);
            }
            Continue(())
        })
        .unwrap();
        let scene = config.scene.as_ref().unwrap();
        // The camera is where the shipped file has it, whatever size is believed.
        let there = scene.mount.X_WC(&robot, &q).inv_mul(&scene.X_WO);
        let off = there.inv_mul(set(&[]).unwrap().set_point.X_DO().unwrap());
        println!("{size}: {:?}, off by {off}", run.finish);
        assert_eq!(run.finish.outcome, Outcome::Converged, "{size}: {:?}", run.finish);
        assert!(off.translation.vector.norm() < 5e-4 && off.rotation.angle() < 2e-3, "{size}: {off}");
    }
}

#[test]
fn what_has_no_homography_is_refused_at_its_key() {
    for (word, told) in [
        ("servo.scheme=image_resolved_velocity", "position_pd"),
        ("servo.dimension=4", "servo.dimension is 4"),
        ("servo.points=[1, 2, 3]", "needs 4 points, not 3"),
    ] {
        let words = ["servo.pose_from=homography".to_owned(), word.to_owned()];
        let error = set(&words).map(|_| ()).unwrap_err();
        assert!(error.contains("servo.pose_from") && error.contains(told), "{word}: {error}");
    }
}
