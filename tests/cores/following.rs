//! A target that swings by itself: its acceleration is estimated and carried on, so that the arm stays near it.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

use std::ops::ControlFlow::Continue;
use std::path::Path;
use vservo::config::Config;
use vservo::sim::{Moment, simulate_system};

/// Root mean square of the true feature error from 2 s to 6 s behind a pendulum of the amplitude `m` along x, y, z of the base and so many `hz`, px.
fn error_behind(file: &str, m: [f64; 3], hz: f64, seed: u64) -> f64 {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("config/{file}.toml"));
    let set = [
        "servo.object.moves=true".into(),
        "goal.hold_s=60".into(),
        "run.duration_s=6".into(),
        "scene.motion.kind=pendulum".into(),
        format!("scene.motion.amplitude_m={m:?}"),
        format!("scene.motion.frequency_hz={hz}"),
        format!("run.seed={seed}"),
    ];
    let config = Config::load(Some(&path), &set).unwrap();
    let (mut ticks, mut count, mut squares) = (0, 0.0, 0.0);
    let run = simulate_system(&config, &mut |moment| {
        if let Moment::Tick(_, errors) = moment {
            ticks += 1;
            if (2000..6000).contains(&ticks) {
                squares += errors.feature_error_px.unwrap().powi(2);
                count += 1.0;
            }
        }
        Continue(())
    })
    .unwrap();
    assert_eq!(run.target_lost, 0, "{file} {m:?} {hz}");
    f64::sqrt(squares / count)
}

/// Half of what a constant velocity between measurements left, px: measured with the version before.
#[test]
fn errors_behind_a_pendulum_are_half_of_what_velocity_leaves() {
    for (file, m, hz, before_px) in [
        ("ur5", [0.0, 0.1, 0.0], 0.5, 9.1),
        ("ur5", [0.0, 0.05, 0.0], 0.5, 4.2),
        ("ur5", [0.0, 0.05, 0.0], 0.2, 0.74),
        ("ur5", [0.06, 0.0, 0.03], 0.4, 3.5),
        ("ur5", [0.04, 0.04, 0.0], 0.6, 7.4),
        ("panda", [0.0, 0.06, 0.0], 0.45, 3.9),
        ("default", [-0.04, 0.04, 0.03], 0.35, 1.2),
        ("default", [0.0, 0.1, 0.0], 0.5, 4.9),
        ("default", [0.0, 0.05, 0.0], 0.2, 0.43),
    ] {
        let px = error_behind(file, m, hz, 61);
        assert!(px <= 0.5 * before_px, "{file} {m:?} {hz} Hz: {px} px, {before_px} px before");
    }
}
