//! The cores in one process do to the last bit what the three processes do: there is one implementation of everything.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

mod common;

use vservo::config::Config;
use vservo::experiment::simulate_system;
use vservo::summary::Outcome;

#[test]
fn one_process_and_three_processes_agree_to_the_last_bit() {
    let settings = ["camera.latency_ms=55", "camera.rate_hz=30", "servo.update=frame"];
    let config = Config::load(None, &settings.map(String::from)).unwrap();
    let alone = simulate_system(&config, &mut |_| {}).unwrap();
    assert_eq!(alone.finish.outcome, Outcome::Converged, "{}", alone.finish.reason);
    assert!(alone.errors.position_error_m.unwrap() < 0.5e-3);

    let set = settings.map(|s| ["--set", s]).concat();
    let run = common::run("inproc", &[&["--clock", "lockstep"], set.as_slice()].concat());
    assert_eq!(run.summary["state_hash"], alone.state_hash, "{}", run.text());
}
