//! `servo.object.moves` before a target that does not: the arm converges as it does without, and does not jitter.

#![allow(clippy::unwrap_used)] // helpers of tests are tests

use std::ops::ControlFlow::Continue;
use vservo::config::Config;
use vservo::control::outcome::Outcome;
use vservo::sim::{Moment, simulate_system};

/// Settling time, s, and the root mean square of the joints' commanded speeds over the last half second, rad/s and m/s.
fn run(moves: bool) -> (f64, f64) {
    let set = [format!("servo.object.moves={moves}"), "goal.hold_s=1".into(), "run.duration_s=10".into()];
    let config = Config::load(None, &set).unwrap();
    let mut speeds = Vec::new();
    let run = simulate_system(&config, &mut |moment| {
        if let Moment::Tick(trace, _) = moment {
            speeds.push(trace.command.qd_r.iter().map(|qd| qd * qd).sum::<f64>());
        }
        Continue(())
    })
    .unwrap();
    assert_eq!(run.finish.outcome, Outcome::Converged, "{:?}", run.finish);
    let last = &speeds[speeds.len() - 600..speeds.len() - 100];
    (run.settling_time_s.unwrap(), (last.iter().sum::<f64>() / last.len() as f64).sqrt())
}

#[test]
fn an_estimated_motion_that_is_none_does_no_harm() {
    let (settled, jitter) = run(false);
    let (settled_with, jitter_with) = run(true);
    assert!(settled_with <= 1.25 * settled + 0.08, "{settled_with} s, {settled} s without");
    assert!(jitter_with <= 3.0 * jitter, "{jitter_with}, {jitter} without");
}
