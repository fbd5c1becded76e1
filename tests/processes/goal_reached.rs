//! A served run says that its goal was reached, that it was left, and why not; `vservo ctl wait` waits for it.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::common::{Instance, Lines, kill, vservo, wait_for_process, wait_until};
use crate::serve::Daemon;
use serde_json::Value;
use std::process::Stdio;

/// `vservo ctl wait WHAT`: exit code, answer, what was told on stderr.
fn wait(daemon: &Daemon, what: &str, timeout_s: &str) -> (Option<i32>, Value, String) {
    let output = vservo()
        .args(["ctl", "wait", what, "--json", "--timeout-s", timeout_s, "--instance", &daemon.instance.name])
        .output()
        .unwrap();
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    (output.status.code(), serde_json::from_slice(&output.stdout).unwrap_or(Value::Null), told)
}

#[test]
fn a_wait_ends_at_the_goal_and_says_what_is_there_instead() {
    let daemon = Daemon::start("goal-wait", &["--clock", "lockstep"]);
    let (code, _, told) = wait(&daemon, "converged", "60");
    assert_eq!(code, Some(5));
    assert!(told.contains("the run is idle"), "{told}");
    assert_eq!(daemon.ctl("status").1["at_goal"], false);

    daemon.accepts("start");
    let (code, end, told) = wait(&daemon, "converged", "120");
    assert_eq!((code, &end["is_reached"]), (Some(0), &Value::Bool(true)), "{told} {end}");
    let (_, status, _) = daemon.ctl("status");
    assert_eq!(
        (&status["at_goal"], &status["state"], &status["goal"]),
        (&true.into(), &"servoing".into(), &0.into())
    );
    // The goal counts as reached once it was held for 0.5 s.
    assert!(status["at_goal_s"].as_f64().unwrap() >= 0.5, "{status}");
    assert!(status["feature_error_px"].as_f64().unwrap() < 0.1, "{status}");

    let (code, _, told) = wait(&daemon, "fault", "0.2");
    assert_eq!(code, Some(5));
    assert!(told.contains("still servoing after 0.2 s"), "{told}");

    daemon.accepts("hold");
    assert_eq!(wait(&daemon, "state=held", "60").0, Some(0));
    wait_until("the goal to count as left", || daemon.ctl("status").1["at_goal"] == false);
    let (code, _, told) = wait(&daemon, "converged", "60");
    assert_eq!(code, Some(5));
    assert!(told.contains("the run is held"), "{told}");
    for wrong in ["dancing", "state=dancing"] {
        assert_eq!(wait(&daemon, wrong, "1").0, Some(2), "{wrong}");
    }
    daemon.accepts("shutdown");
    let (code, printed) = daemon.ended();
    assert_eq!(code, Some(0), "{printed}");
    assert!(printed.contains("the goal that was reached is not met any more"), "{printed}");
}

#[test]
fn the_end_of_a_run_ends_a_wait() {
    let daemon = Daemon::start("goal-gone", &["--clock", "lockstep"]);
    daemon.accepts("start");
    let waiting = vservo()
        .args(["ctl", "wait", "fault", "--timeout-s", "120", "--instance", &daemon.instance.name])
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    daemon.wait_for("servoing");
    daemon.accepts("shutdown");
    assert_eq!(daemon.ended().0, Some(0));
    let output = waiting.wait_with_output().unwrap();
    let told = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(5), "{told}");
    assert!(told.contains("the run has ended") || told.contains("no run of instance"), "{told}");
}

/// Each reason stands in the log of the running daemon, as fields that a program can read.
#[test]
fn the_log_has_each_reason_as_fields() {
    let instance = Instance::new("goal-log");
    let mut process = vservo()
        .args(["serve", "--log-format", "json", "--instance", &instance.name])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = Lines::of(&mut process);
    let ctl = |what: &str| vservo().args(["ctl", what, "--instance", &instance.name]).output().unwrap();
    wait_until("the daemon to answer", || ctl("status").status.code() == Some(0));
    assert_eq!(ctl("start").status.code(), Some(0));
    let mut line_of = |event: &str| -> Value {
        let line = lines.wait_for(&format!("\"event\":\"{event}\""));
        serde_json::from_str(&line).unwrap()
    };
    let requested = line_of("requested");
    assert_eq!(requested["fields"]["request"], "start", "{requested}");
    let reached = line_of("goal_reached");
    assert_eq!(reached["fields"]["goal"], 0, "{reached}");
    assert!(reached["fields"]["feature_error_px"].as_f64().unwrap() < 0.05, "{reached}");
    let camera = wait_for_process(&instance, "camera");
    kill(camera, "STOP");
    let holding = line_of("holding");
    assert_eq!(
        (&holding["level"], &holding["fields"]["state"]),
        (&"WARN".into(), &"holding".into()),
        "{holding}"
    );
    let left = line_of("goal_left");
    kill(camera, "CONT");
    assert!(
        left["fields"]["time_s"].as_f64().unwrap() > reached["fields"]["time_s"].as_f64().unwrap(),
        "{left}"
    );
    assert_eq!(ctl("shutdown").status.code(), Some(0));
    lines.drain();
    assert_eq!(process.wait().unwrap().code(), Some(0));
    instance.assert_gone();
}
