//! `servo.limit_avoidance_1_s` in whole runs: an arm with more joints than its task needs stays farther from the ends of its
//! ranges, and the camera does not notice.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

use std::ops::ControlFlow::Continue;
use std::path::Path;
use vservo::config::Config;
use vservo::control::outcome::Outcome;
use vservo::sim::{Moment, simulate_system};

/// Joint positions and true feature errors at every tick.
fn course(gain_1_s: f64) -> (Vec<[f64; 7]>, Vec<f64>) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/panda.toml");
    // The whole cell is turned about the base, so that the first joint comes near the end of its range of 2.9 rad.
    let set = [
        "robot.q_start_rad_or_m=[1.8023, -0.5223, -0.1384, -2.1133, 0.0871, 1.7882, 0.2074]".to_string(),
        "scene.object.position_m=[-0.23601, 0.44362, 0.0]".into(),
        "scene.object.rotation_rpy_rad=[3.141592653589793, 0.0, 1.96]".into(),
        "goal.hold_s=6".into(),
        format!("servo.limit_avoidance_1_s={gain_1_s}"),
    ];
    let config = Config::load(Some(&path), &set).unwrap();
    let (mut joints, mut errors) = (Vec::new(), Vec::new());
    let run = simulate_system(&config, &mut |moment| {
        if let Moment::Tick(trace, now) = moment {
            joints.push(std::array::from_fn(|i| trace.joint_state.q[i]));
            errors.push(now.feature_error_px.unwrap());
        }
        Continue(())
    })
    .unwrap();
    assert_eq!(run.finish.outcome, Outcome::Converged, "{:?}", run.finish);
    (joints, errors)
}

#[test]
fn joints_stay_farther_from_their_ends_and_the_image_stays() {
    let (plain, seen) = course(0.0);
    let (avoiding, seen_avoiding) = course(2.0);
    let most = |course: &[[f64; 7]]| course.iter().map(|q| q[0]).fold(f64::NEG_INFINITY, f64::max);
    let last = |course: &[[f64; 7]]| course.last().unwrap()[0];
    let apart = plain.iter().zip(&avoiding).map(|(a, b)| (a[0] - b[0]).abs()).fold(0.0, f64::max);
    assert!(apart > 0.05, "the joints' paths differ by {apart} rad");
    assert!(last(&avoiding) < last(&plain) - 0.05, "{} {}", last(&avoiding), last(&plain));
    assert!(most(&avoiding) < most(&plain) - 0.02, "{} {}", most(&avoiding), most(&plain));
    let first = seen[0];
    let off = seen.iter().zip(&seen_avoiding).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(off < 0.03 * first, "the image differs by {off} of {first} px");
}
