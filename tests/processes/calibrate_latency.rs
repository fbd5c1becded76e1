//! `vservo calibrate latency` with the real processes: the stamp error of a simulated camera is found, put right, and told
//! where it cannot be found.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::common::{Instance, number, run, vservo, wait_for_line};
use serde_json::Value;
use std::process::{Output, Stdio};

fn calibrate(test: &str, arguments: &[&str]) -> Output {
    let instance = Instance::new(test);
    let output = vservo()
        .args(["calibrate", "latency"])
        .args(arguments)
        .args(["--instance", &instance.name])
        .output()
        .unwrap();
    instance.assert_gone();
    output
}

fn lockstep(test: &str, arguments: &[&str]) -> Output {
    calibrate(test, &[&["--clock", "lockstep"], arguments].concat())
}

fn text(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

/// What a calibration found, ms: the new value of `camera.stamp_offset_ms`, what that changes, and the standard deviation.
fn found(output: &Output) -> (f64, f64, f64) {
    assert_eq!(output.status.code(), Some(0), "{}", text(output));
    let summary: Value =
        serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {}", text(output)));
    assert_eq!(summary["outcome"], "finished");
    let value = |key| number(&summary, &["calibration", key]);
    (value("stamp_offset_ms"), value("change_ms"), value("sd_ms"))
}

fn set(key: &str, value: f64) -> [String; 2] {
    ["--set".into(), format!("{key}={value:?}")]
}

#[test]
fn a_stamp_error_is_found_and_put_right_on_every_arm() {
    for (file, late_ms) in [
        ("config/default.toml", 10.0),
        ("config/default.toml", -15.0),
        ("config/ur5.toml", 31.0),
        ("config/panda.toml", -8.0),
        ("config/pan_tilt.toml", 10.0),
        ("config/scara-eye-to-hand.toml", -40.0),
        ("config/scara-a.toml", 2.5),
    ] {
        let error = set("camera.synthetic.stamp_error_ms", late_ms);
        let error = error.each_ref().map(String::as_str);
        let (offset_ms, change_ms, sd_ms) =
            found(&lockstep("latency", &[&[file, "--json"], &error[..]].concat()));
        assert!((offset_ms + late_ms).abs() < 0.1, "{file}: {offset_ms} of {late_ms} ms");
        assert_eq!(offset_ms, change_ms);
        assert!(sd_ms > 0.0 && sd_ms < 0.1, "{file}: {sd_ms}");

        let again = set("camera.stamp_offset_ms", offset_ms);
        let again = again.each_ref().map(String::as_str);
        let (total_ms, change_ms, _) =
            found(&lockstep("latency", &[&[file, "--json"], &error[..], &again[..]].concat()));
        assert!(
            change_ms.abs() < 0.05 && (total_ms - offset_ms - change_ms).abs() < 1e-9,
            "{file}: {change_ms}"
        );
    }
}

#[test]
fn stamps_that_are_far_off_and_coarse_encoders_do_not_matter() {
    for extra in [
        // In the future by 100 ms, when it comes.
        ["camera.synthetic.stamp_error_ms=120", "camera.rate_hz=50"],
        ["camera.synthetic.stamp_error_ms=-150", "camera.latency_ms=60"],
        ["drive.simulated.encoder_step_rad_or_m=[1e-4]", "camera.synthetic.noise_sd_levels=8"],
        ["camera.synthetic.frame_loss=0.2", "camera.synthetic.latency_jitter_ms=30"],
        ["drive.kind=ideal", "camera.rate_hz=10"],
        ["drive.mode=velocity", "camera.rate_hz=200"],
        ["camera.rate_hz=2", "safety.measurement_timeout_ms=1200"],
        ["camera.exposure_ms=16", "motion.max_acceleration_rad_s2_or_m_s2=[0.5]"],
    ] {
        let output = lockstep("far", &["--json", "--set", extra[0], "--set", extra[1]]);
        let late_ms =
            extra[0].strip_prefix("camera.synthetic.stamp_error_ms=").map_or(0.0, |v| v.parse().unwrap());
        let (offset_ms, ..) = found(&output);
        assert!((offset_ms + late_ms).abs() < 0.5, "{extra:?}: {offset_ms}");
    }
}

#[test]
fn the_lines_for_the_run_file_are_printed_and_written() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("latency.toml");
    let out = path.to_str().unwrap();
    let output = lockstep("lines", &["--set", "camera.synthetic.stamp_error_ms=10", "--out", out]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output));
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(printed.starts_with("camera stamps are 10.0"), "{printed}");
    assert!(printed.contains(" ms late (sd 0.0") && printed.contains(" px -> "), "{printed}");
    let written = std::fs::read_to_string(&path).unwrap();
    let lines = written.split_once('\n').unwrap().1;
    assert!(
        written.starts_with("# vservo calibrate latency: camera stamps are ") && printed.ends_with(lines)
    );
    assert!(lines.starts_with("[camera]\nstamp_offset_ms = -"), "{written}");
    // The file is a run file.
    let again = run("lines", &[out, "--clock", "lockstep", "--set", "camera.synthetic.stamp_error_ms=10"]);
    assert_eq!(again.summary["outcome"], "converged", "{}", again.text());
    assert!(again.summary.get("calibration").is_none(), "a normal run has no calibration");
    let latency_us = number(&again.summary, &["latency_us", "exposure_to_command", "p50"]);
    assert!((latency_us - 20_000.0).abs() < 1000.0, "the stamps are right now: {latency_us}");

    let nowhere = lockstep("lines", &["--out", "/nowhere/latency.toml"]);
    assert_eq!(nowhere.status.code(), Some(3), "{}", text(&nowhere));
}

#[test]
fn the_offset_is_found_in_real_time() {
    let output =
        calibrate("rt-latency", &["--json", "--set", "camera.synthetic.stamp_error_ms=12", "--seed", "3"]);
    let (offset_ms, ..) = found(&output);
    assert!((offset_ms + 12.0).abs() < 3.0, "{offset_ms}: {}", text(&output));
}

#[test]
fn what_prevents_it_is_told() {
    for (extra, told, exit_code) in [
        ("camera.synthetic.frame_loss=0.85", "the target was lost while the arm moved", 5),
        ("motion.max_acceleration_rad_s2_or_m_s2=[0.001]", "the target moved by only", 5),
        ("run.duration_s=3.0", "run.duration_s is over before the calibration motion was", 5),
        ("camera.synthetic.stamp_error_ms=400", "no offset within 250 ms explains the image", 5),
        ("camera.rate_hz=1", "frames showed the target, 12 are needed", 5),
        ("drive.simulated.payload_kg=400", "something touches the arm", 4),
        ("scene.plate_level=31", "run.duration_s is over: the target was never seen", 5),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("latency.toml");
        let patience = "safety.measurement_timeout_ms=2500";
        let patience = if extra == "camera.rate_hz=1" { patience } else { "run.seed=1" };
        let output =
            lockstep("prevented", &["--set", extra, "--set", patience, "--out", path.to_str().unwrap()]);
        assert_eq!(output.status.code(), Some(exit_code), "{extra}: {}", text(&output));
        assert!(text(&output).contains("vservo: no offset was found: "), "{extra}: {}", text(&output));
        assert!(text(&output).contains(told), "{extra}: {}", text(&output));
        assert!(output.stdout.is_empty() && !path.exists(), "{extra}");
    }
}

#[test]
fn what_makes_no_sense_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let images = format!("camera.replay.folder={}", folder.path().display());
    for (extra, told) in [
        (["camera.source=replay", images.as_str()], "camera.source: is `replay`"),
        (["scene.motion.kind=conveyor", "run.seed=1"], "scene.motion.kind: must be `still`"),
        (["camera.stamp_offset_ms=501", "run.seed=1"], "camera.stamp_offset_ms: 501 is out of range"),
    ] {
        let output = lockstep("refused", &["--set", extra[0], "--set", extra[1]]);
        assert_eq!(output.status.code(), Some(3), "{extra:?}: {}", text(&output));
        assert!(text(&output).contains(told), "{extra:?}: {}", text(&output));
    }
}

/// A law so quick that it lives on right stamps: the view is carried over the motion since the exposure.
#[test]
fn a_quick_law_converges_with_the_offset_and_not_without() {
    let quick = [
        "config/ur5.toml",
        "--clock=lockstep",
        "--set=servo.scheme=position_resolved_velocity",
        "--set=servo.gain_1_s=30",
        "--set=servo.smooth_start_1_s=3",
        "--set=camera.rate_hz=100",
        "--set=camera.exposure_ms=2",
        "--set=camera.synthetic.stamp_error_ms=40",
    ];
    // before the swinging arm is slowed down, which brings it home too
    let short = "--duration-s=5";
    let without = run("quick", &[&quick[..], &[short]].concat());
    assert_eq!(without.summary["outcome"], "not_converged", "{}", without.text());
    let (offset_ms, ..) = found(&calibrate("quick", &[&quick[..], &["--json"]].concat()));
    let offset = set("camera.stamp_offset_ms", offset_ms);
    let offset = offset.each_ref().map(String::as_str);
    let with = run("quick", &[&quick[..], &[short], &offset[..]].concat());
    assert_eq!(with.summary["outcome"], "converged", "{}", with.text());
    assert!(number(&with.summary, &["settling_time_s"]) < 4.0, "{}", with.text());
}

#[test]
fn a_stop_brings_the_arm_to_rest_and_finds_nothing() {
    let instance = Instance::new("stopped");
    let mut child = vservo()
        .args(["calibrate", "latency", "--instance", &instance.name])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    wait_for_line(&mut child, "servoing");
    crate::common::kill(child.id() as i32, "INT");
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(6));
    assert!(output.stdout.is_empty());
    instance.assert_gone();
}
