//! The cores in one process do to the last bit what the three processes do: there is one implementation of everything.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

#[allow(dead_code)]
#[path = "../examples/in_process.rs"]
mod example;

mod common;

use vservo::config::Config;
use vservo::summary::Outcome;

#[test]
fn one_process_and_three_processes_agree_to_the_last_bit() {
    let settings = ["camera.latency_ms=55", "camera.rate_hz=30", "servo.update=frame"];
    let config = Config::load(None, &settings.map(String::from)).unwrap();
    let (finish, distance_m, hash) = example::simulate(&config, None).unwrap();
    assert_eq!(finish.outcome, Outcome::Converged, "{}", finish.reason);
    assert!(distance_m.unwrap() < 0.5e-3);

    let set = settings.map(|s| ["--set", s]).concat();
    let run = common::run("inproc", &[&["--clock", "lockstep"], set.as_slice()].concat());
    assert_eq!(run.summary["state_hash"], hash, "{}", run.text());
}
