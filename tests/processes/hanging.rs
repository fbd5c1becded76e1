//! A process that hangs, and does not die, is noticed: a line, and then an orderly end.

#![allow(clippy::unwrap_used)]

use crate::common::{Instance, kill, vservo, wait_for_line, wait_for_process, wait_until};
use std::process::{Child, Stdio};

fn start(instance: &Instance, clock: &str) -> Child {
    vservo()
        .args(["run", "--clock", clock, "--instance", &instance.name])
        // In lockstep the goal is out of reach, so that the run is still there when its parts are stopped.
        .args(["--duration-s", "80000", "--set", "goal.hold_s=60", "--set", "goal.feature_error_px=1e-6"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

#[test]
fn a_suspended_process_ends_the_run_with_a_message() {
    std::thread::scope(|scope| {
        // In real time camera and vision are started anew instead: `restarts.rs`.
        for (clock, roles) in [("realtime", &["control"][..]), ("lockstep", &["control", "vision", "camera"])]
        {
            for role in roles {
                scope.spawn(move || {
                    let instance = Instance::new("hangs");
                    let mut child = start(&instance, clock);
                    wait_for_line(&mut child, "servoing");
                    kill(wait_for_process(&instance, role), "STOP");
                    let output = child.wait_with_output().unwrap();
                    let text = String::from_utf8_lossy(&output.stdout).into_owned();
                    assert_eq!(output.status.code(), Some(4), "{clock} {role}: {text}");
                    let reason = format!("fault (the {role} process hangs: no sign of life for ");
                    assert!(text.contains(&reason), "{clock} {role}: {text}");
                    instance.assert_gone();
                });
            }
        }
    });
}

/// By hand nobody watches: in lockstep control itself does not wait for ever.
#[test]
fn control_by_hand_gives_a_hanging_vision_up() {
    let instance = Instance::new("byhand");
    let role = |name: &str| {
        let mut command = vservo();
        command.args([name, "--instance", &instance.name]).args(["--set", "run.clock=lockstep"]);
        command.args(["--set", "run.duration_s=80000", "--set", "goal.feature_error_px=1e-6"]);
        command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
    };
    let (mut vision, mut camera, control) = (role("vision"), role("camera"), role("control"));
    let stat = format!("/proc/{}/stat", control.id());
    wait_until("ticks", || {
        let stat = std::fs::read_to_string(&stat).unwrap_or_default();
        stat.rsplit(')').next().and_then(|s| s.split_whitespace().nth(11)?.parse::<u64>().ok()) > Some(5)
    });
    kill(vision.id() as i32, "STOP");
    let output = control.wait_with_output().unwrap();
    let (out, err) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert_eq!(output.status.code(), Some(4), "{out}{err}");
    assert!(out.contains("fault (a measurement did not come"), "{out}");
    assert!(err.contains("does not come (without a sign of life: vision)"), "{err}");
    kill(vision.id() as i32, "KILL");
    kill(camera.id() as i32, "TERM");
    vision.wait().unwrap();
    camera.wait().unwrap();
    instance.assert_gone();
}

/// Everything was stopped together, and goes on together: nobody hangs.
#[test]
fn a_run_that_slept_as_a_whole_goes_on() {
    let instance = Instance::new("sleeps");
    let mut child = start(&instance, "lockstep");
    wait_for_line(&mut child, "servoing");
    let all = instance.processes();
    all.iter().for_each(|pid| kill(*pid, "STOP"));
    std::thread::sleep(std::time::Duration::from_secs(8)); // longer than the patience of the supervisor
    all.iter().rev().for_each(|pid| kill(*pid, "CONT"));
    std::thread::sleep(std::time::Duration::from_secs(1));
    kill(child.id() as i32, "INT");
    let output = child.wait_with_output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(text.contains("outcome       stopped"), "{text}");
    instance.assert_gone();
}
