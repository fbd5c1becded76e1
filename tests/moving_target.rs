//! A target that moves by itself: with its motion estimated and fed forward the arm keeps up, without it lags.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

mod common;

use common::{number, run};

/// The feature error against truth after some seconds behind a target on a conveyor of 0.2 m/s, 25 Hz, 40 ms, px.
fn error_behind_a_conveyor(follows: bool) -> f64 {
    let moves = format!("servo.object.moves={follows}");
    let r = run(
        "conveyor",
        &[
            "--clock",
            "lockstep",
            "--duration-s",
            "5",
            "--set",
            "camera.latency_ms=40",
            "--set",
            "servo.gain_1_s=4",
            "--set",
            "servo.depth=estimated",
            "--set",
            "goal.hold_s=60",
            "--set",
            "scene.motion.kind=conveyor",
            "--set",
            // Across the reach of the arm, so that no singularity comes near.
            "scene.motion.velocity_m_s=[-0.14, -0.14, 0.0]",
            "--set",
            &moves,
        ],
    );
    // Without feed-forward the target runs out of the picture: the camera lags by its speed over the gain.
    assert!(!follows || r.summary["target_lost"] == 0, "{}", r.text());
    number(&r.summary, &["final", "feature_error"])
}

#[test]
fn feed_forward_keeps_up_with_a_conveyor() {
    let (with, without) = (error_behind_a_conveyor(true), error_behind_a_conveyor(false));
    println!(
        "feature error behind a conveyor of 0.2 m/s: {with:.3} px with feed-forward, {without:.1} px without"
    );
    assert!(with <= 1.0, "{with} px");
    assert!(without > 20.0 * with, "{without} px without shows what it is good for");
}
