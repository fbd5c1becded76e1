//! A camera in the hand and one beside the arm in one task (`[second_view]`): the same bits in one process and in five, recorded and replayed; by the clock,
//! with a vision process that hangs; what clients may ask for.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::common::{Instance, Lines, Run, kill, number, run, vservo, wait_until};
use crate::replay::assert_identical;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::Stdio;
use vservo::config::Config;
use vservo::control::outcome::Outcome;
use vservo::sim::{SystemRun, simulate_system};

fn file() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("config/ur5-two-cameras.toml")
}

fn alone(set: &[&str]) -> SystemRun {
    let set: Vec<String> = set.iter().map(ToString::to_string).collect();
    let config = Config::load(Some(&file()), &set).unwrap();
    simulate_system(&config, &mut |_| ControlFlow::Continue(())).unwrap()
}

fn processes(test: &str, set: &[&str], more: &[&str]) -> Run {
    let file = file();
    let mut arguments = vec![file.to_str().unwrap()];
    arguments.extend(more);
    set.iter().for_each(|s| arguments.extend(["--set", s]));
    run(test, &arguments)
}

#[test]
fn two_cameras_are_the_same_in_one_process_and_in_five() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    // Cameras of one rate, whose measurements meet at each tick; and of two, with losses and delays of their own.
    let odd = [
        "cameras[1].rate_hz=30",
        "cameras[1].latency_ms=27",
        "cameras[0].synthetic.frame_loss=0.1",
        "cameras[1].synthetic.frame_loss=0.2",
        "cameras[1].synthetic.latency_jitter_ms=9",
    ];
    for set in [&[][..], &odd] {
        let one = alone(set);
        assert_eq!(one.finish.outcome, Outcome::Converged, "{}", one.finish.reason);
        for _ in 0..2 {
            let run = processes("twolock", set, &["--clock", "lockstep", "--record", path.to_str().unwrap()]);
            let s = &run.summary;
            assert_eq!(s["state_hash"], one.state_hash, "{}", run.text());
            assert_eq!(s["outcome"], "converged");
            let second = one.second_errors.unwrap();
            assert_eq!(s["second_camera"]["final"]["position_error_m"].as_f64(), second.position_error_m);
            assert!(number(s, &["second_camera", "final", "position_error_m"]) < 0.5e-3, "{s}");
            assert!(
                number(s, &["second_camera", "intake", "used"]) > 20.0
                    && s["second_camera"]["name"] == "beside",
                "{s}"
            );
            assert!(run.text().contains("second camera `beside`: "), "{}", run.text());
        }
        let text = assert_identical(&path);
        assert!(text.contains(&one.state_hash), "{text}");
        let frames = vservo().args(["replay", "--from", "frames"]).arg(&path).output().unwrap();
        assert!(String::from_utf8_lossy(&frames.stderr).contains("[second_view]"), "{frames:?}");
    }
}

#[test]
fn two_cameras_converge_by_the_clock() {
    let run = processes("tworeal", &[], &["--clock", "realtime"]);
    let s = &run.summary;
    assert_eq!(s["outcome"], "converged", "{}", run.text());
    assert!(number(s, &["final", "position_error_m"]) < 1e-3, "{s}");
    assert!(number(s, &["second_camera", "final", "position_error_m"]) < 1e-3, "{s}");
    let processes = s["processes"].as_object().unwrap();
    for role in ["camera", "camera-1", "vision", "vision-1", "control"] {
        assert!(processes.contains_key(role), "{role}: {s}");
    }
}

/// The vision of the second camera hangs: the arm goes on by the first one, which is told, and by both when it was started anew.
#[test]
fn a_second_vision_that_hangs_leaves_the_first_in_charge() {
    let instance = Instance::new("twohang");
    let mut child = vservo()
        .args(["serve", file().to_str().unwrap(), "--clock", "realtime", "--instance", &instance.name])
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = Lines::of(&mut child);
    let ctl = |words: &[&str]| {
        let output =
            vservo().arg("ctl").args(words).args(["--json", "--instance", &instance.name]).output().unwrap();
        let answer: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap_or_default();
        (output.status.code(), answer, String::from_utf8_lossy(&output.stderr).into_owned())
    };
    wait_until("the start", || ctl(&["start"]).0 == Some(0));
    wait_until("the goal", || ctl(&["status"]).1["at_goal_s"].as_f64().is_some());
    // Each camera has a goal of its own, and a client could give one alone.
    for words in [&["goal", "--position-m", "-0.05,-0.05,0.4"][..], &["teach"]] {
        let (code, _, text) = ctl(words);
        assert_ne!(code, Some(0), "{words:?}");
        assert!(text.contains("two keep those of the run file"), "{words:?} {text}");
    }
    let second = instance
        .processes()
        .into_iter()
        .find(|pid| {
            let line = std::fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
            let words: Vec<_> = line.split(|b| *b == 0).collect();
            words.get(1) == Some(&&b"vision"[..]) && words.windows(2).any(|w| w == [&b"--camera"[..], b"1"])
        })
        .unwrap();
    kill(second, "STOP");
    lines.wait_for("the second camera does not see its target");
    assert_eq!(ctl(&["status"]).1["state"], "servoing");
    // Control and supervisor tell in either order that it is back.
    lines.wait_for("both cameras see their targets");
    wait_until("its new start to be counted", || ctl(&["status"]).1["vision_restarts"] == 1);
    assert_eq!(ctl(&["status"]).1["state"], "servoing");
    assert_eq!(ctl(&["shutdown"]).0, Some(0));
    lines.drain();
    assert_eq!(child.wait().unwrap().code(), Some(0));
    instance.assert_gone();
}
