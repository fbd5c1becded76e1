//! A target that moves by itself: with its motion estimated and fed forward the arm keeps up, without it lags.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

use crate::common::{number, run};

const CONVEYOR: [&str; 2] = [
    "scene.motion.kind=conveyor",
    // Across the reach of the arm, so that no singularity comes near.
    "scene.motion.velocity_m_s=[-0.14, -0.14, 0.0]",
];
const PENDULUM: [&str; 2] = ["scene.motion.kind=pendulum", "scene.motion.frequency_hz=0.2"];
const REGULAR: [&str; 2] = ["camera.synthetic.frame_loss=0", "camera.synthetic.latency_jitter_ms=0"];
const IRREGULAR: [&str; 2] = ["camera.synthetic.frame_loss=0.1", "camera.synthetic.latency_jitter_ms=10"];

/// The feature error against truth after some seconds behind a moving target, 25 Hz, 40 ms, px.
fn error_behind(motion: [&str; 2], camera: [&str; 2], follows: bool) -> f64 {
    let moves = format!("servo.object.moves={follows}");
    let fixed =
        ["camera.latency_ms=40", "servo.gain_1_s=4", "servo.depth=estimated", "goal.hold_s=60", &moves];
    let mut args = vec!["--clock", "lockstep", "--duration-s", "5"];
    for value in fixed.into_iter().chain(motion).chain(camera) {
        args.extend(["--set", value]);
    }
    let r = run("moving", &args);
    if follows {
        assert_eq!(r.summary["target_lost"], 0, "{}", r.text());
        assert_eq!(r.summary["safety"]["events"], serde_json::json!([]), "{}", r.text());
    }
    number(&r.summary, &["final", "feature_error_px"])
}

#[test]
fn feed_forward_keeps_up_with_a_conveyor() {
    let (with, without) = (error_behind(CONVEYOR, REGULAR, true), error_behind(CONVEYOR, REGULAR, false));
    println!(
        "feature error behind a conveyor of 0.2 m/s: {with:.3} px with feed-forward, {without:.1} px without"
    );
    assert!(with < 0.25, "{with} px, 0.14 px is obtained");
    // The camera lags by the target's speed over the gain, 0.05 m or 60 px and more; then the target is out of the image.
    assert!(without > 60.0, "{without} px without shows what it is good for");
}

#[test]
fn lost_and_late_frames_do_not_matter_behind_a_conveyor() {
    let error = error_behind(CONVEYOR, IRREGULAR, true);
    println!("feature error behind a conveyor with lost and late frames: {error:.3} px");
    assert!(error < 0.4, "{error} px");
}

#[test]
fn feed_forward_follows_a_pendulum() {
    let (with, without) = (error_behind(PENDULUM, REGULAR, true), error_behind(PENDULUM, REGULAR, false));
    println!(
        "feature error behind a pendulum of 0.05 m, 0.2 Hz: {with:.2} px with feed-forward, {without:.1} px without"
    );
    assert!(with < 1.2, "{with} px, 0.67 px is obtained");
    assert!(without > 15.0, "{without} px without shows what it is good for");
}
