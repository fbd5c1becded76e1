//! Failures that are planted in a simulated cell, and the cause that `vservo explain` names from what the run left. The detectors were tuned on other
//! sizes, seeds and joints than these.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::common::{Instance, vservo};
use serde_json::Value;
use std::path::Path;

/// Runs a cell with `settings` in lockstep and leaves a report, or a recording.
fn run(name: &str, (file, settings): (&str, &[&str]), kind: &str, place: &Path) {
    let instance = Instance::new(name);
    let output = vservo()
        .args(["run", file, "--clock", "lockstep", "--anyway", "--instance", &instance.name])
        .args(["--set", "run.duration_s=8"])
        .args(settings.iter().flat_map(|set| ["--set", set]))
        .arg(kind)
        .arg(place)
        .output()
        .unwrap();
    assert!(
        place.exists() && [Some(0), Some(4), Some(5)].contains(&output.status.code()),
        "{settings:?}: {output:?}"
    );
}

fn explained(place: &Path) -> Value {
    let output = vservo().arg("explain").arg(place).arg("--json").output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    serde_json::from_slice(&output.stdout).unwrap()
}

/// The causes that are named of a planted failure, the first one first.
fn causes(name: &str, cell: (&str, &[&str])) -> (Vec<String>, Value) {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("report");
    run(name, cell, "--report", &place);
    let told = explained(&place);
    let causes = told["findings"].as_array().unwrap().iter().map(|f| f["cause"].as_str().unwrap().to_owned());
    (causes.collect(), told)
}

#[track_caller]
fn named(wanted: &str, cells: &[(&str, &[&str])]) {
    for (i, cell) in cells.iter().enumerate() {
        let (causes, told) = causes(&format!("exp-{wanted}{i}"), *cell);
        assert_eq!(causes.first().map(String::as_str), Some(wanted), "{cell:?}: {told:#}");
        for finding in told["findings"].as_array().unwrap() {
            assert!(
                ["what", "evidence", "change"].iter().all(|key| !finding[key].as_str().unwrap().is_empty())
            );
        }
    }
}

#[test]
fn a_gain_that_is_too_high_is_named() {
    let held = "servo.update=frame";
    named(
        "gain_too_high",
        &[
            ("default", &[held, "servo.gain_1_s=40", "run.seed=5"]),
            ("scara-b", &[held, "servo.gain_1_s=35"]),
            ("ur5", &[held, "servo.gain_1_s=60"]),
        ],
    );
}

#[test]
fn a_wrong_depth_or_size_is_named() {
    named(
        "wrong_depth",
        &[
            ("default", &["servo.depth=constant", "servo.constant_depth_m=0.15"]),
            ("default", &["servo.depth=constant", "servo.constant_depth_m=2.2", "run.seed=3"]),
        ],
    );
    named(
        "wrong_scale",
        &[
            ("default", &["scene.target.scale=1.07", "run.seed=6"]),
            ("default", &["scene.target.scale=0.9"]),
            ("scara-b", &["scene.target.scale=0.93"]),
        ],
    );
}

#[test]
fn a_mount_that_is_off_is_named() {
    named(
        "wrong_mount",
        &[
            ("default", &["scene.camera.mount.rotation_rpy_rad=[0.0,0.0,-0.14]", "run.seed=2"]),
            ("scara-b", &["scene.camera.mount.rotation_rpy_rad=[0.0,0.0,0.1745]"]),
            ("default", &["scene.camera.mount.position_m=[0.0,-0.03,0.0]"]),
            ("ur5", &["scene.camera.mount.rotation_rpy_rad=[0.0,0.0,0.1745]"]),
        ],
    );
}

#[test]
fn wrong_stamps_are_named_with_their_size() {
    for (i, (error_ms, low, high)) in [(20.0, 17.0, 23.0), (-35.0, -40.0, -30.0)].into_iter().enumerate() {
        let setting = format!("camera.synthetic.stamp_error_ms={error_ms}");
        let (causes, told) = causes(&format!("expstamp{i}"), ("ur5", &[&setting, "run.seed=7"]));
        assert_eq!(causes.first().map(String::as_str), Some("wrong_stamps"), "{told:#}");
        let change = told["findings"][0]["change"].as_str().unwrap();
        let value = change.strip_prefix("camera.stamp_offset_ms = ").unwrap().split(';').next().unwrap();
        let offset: f64 = value.parse().unwrap();
        assert!((low..=high).contains(&-offset), "{change}");
    }
}

#[test]
fn a_target_that_moves_or_is_hidden_is_named() {
    named(
        "object_moves",
        &[
            ("default", &["scene.motion.kind=pendulum", "scene.motion.amplitude_m=[0.07,0.0,0.0]"]),
            ("default", &["scene.motion.kind=conveyor", "scene.motion.velocity_m_s=[0.0,-0.35,0.0]"]),
        ],
    );
    let sheet = "scene.occluder.size_m=[0.5,0.5]";
    named(
        "hidden",
        &[
            ("default", &["scene.occluder.from_s=0.35", "scene.occluder.until_s=90", sheet, "run.seed=4"]),
            ("ur5", &["scene.occluder.from_s=0.4", "scene.occluder.until_s=90", sheet]),
        ],
    );
    named("never_seen", &[("default", &["scene.dot_level=217.0"])]);
}

#[test]
fn what_stops_a_joint_is_named() {
    named(
        "jammed",
        &[
            ("default", &["drive.simulated.jam={joint=3,from_s=0.35}"]),
            ("default", &["drive.simulated.jam={joint=1,from_s=0.5}", "run.seed=9"]),
            ("ur5", &["drive.simulated.jam={joint=2,from_s=0.45}"]),
        ],
    );
    named(
        "friction",
        &[
            ("default", &["drive.simulated.untold_coulomb_share=0.4", "drive.simulated.hard_friction=true"]),
            ("default", &["drive.simulated.untold_coulomb_share=0.45", "run.seed=3"]),
        ],
    );
    named(
        "contact",
        &[
            ("default", &["drive.simulated.push={force_n=[0.0,90.0,0.0],from_s=0.6,until_s=1.4}"]),
            ("ur5", &["drive.simulated.push={force_n=[0.0,0.0,-70.0],from_s=0.7,until_s=1.5}"]),
        ],
    );
}

#[test]
fn what_a_drive_does_late_or_carries_is_named() {
    named(
        "drive_delay",
        &[
            ("default", &["drive.simulated.command_delay_ticks=32", "run.seed=8"]),
            ("ur5", &["drive.simulated.command_delay_ticks=20"]),
        ],
    );
    named(
        "load",
        &[
            ("default", &["drive.simulated.payload_kg=13.0"]),
            ("default", &["drive.simulated.payload_kg=5.5"]),
        ],
    );
    named("coarse_encoders", &[("default", &["drive.simulated.encoder_step_rad_or_m=[0.015]"])]);
}

#[test]
fn lost_frames_and_a_wrong_lens_are_named() {
    named(
        "frames_lost",
        &[
            ("default", &["camera.synthetic.frame_loss=0.6", "run.seed=11"]),
            ("ur5", &["camera.synthetic.frame_loss=0.35"]),
        ],
    );
    named(
        "wrong_lens",
        &[
            ("default", &["scene.camera.lens.fx_px=920.0"]),
            ("default", &["scene.camera.lens.k1=0.2", "run.seed=5"]),
        ],
    );
}

#[test]
fn slow_laws_and_low_limits_are_named() {
    named("gain_too_low", &[("default", &["servo.gain_1_s=0.15"]), ("ur5", &["servo.gain_1_s=0.2"])]);
    named("limits", &[("default", &["motion.max_acceleration_rad_s2_or_m_s2=[0.04]"])]);
}

/// Of a run in which nothing was planted nothing is told; a recording gives the same words as the report of the same run.
#[test]
fn a_recording_and_a_report_tell_the_same() {
    for (i, file) in ["default", "ur5", "scara-b", "tag"].into_iter().enumerate() {
        let (causes, told) = causes(&format!("expfine{i}"), (file, &["run.seed=21"]));
        assert!(causes.is_empty() && told["has_failed"] == false, "{file}: {told:#}");
    }
    let folder = tempfile::tempdir().unwrap();
    let cell = ("default", &["scene.camera.mount.position_m=[0.04,0.0,0.0]"][..]);
    let (report, recording) = (folder.path().join("report"), folder.path().join("run.mcap"));
    run("exprep", cell, "--report", &report);
    run("exprec", cell, "--record", &recording);
    let (a, b) = (explained(&report), explained(&recording));
    assert_eq!(a["findings"], b["findings"]);
    assert_eq!(a["speed"], b["speed"]);
    assert_eq!(a["events"], b["events"]);
    // The page from the recording has the same data as that of the run.
    let again = folder.path().join("again");
    let output = vservo().arg("report").args([&recording, &again]).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    for file in ["trace.csv", "goal.csv", "poses.csv", "events.csv", "config.toml"] {
        let read = |folder: &Path| std::fs::read_to_string(folder.join(file)).unwrap();
        assert!(read(&report) == read(&again), "{file}");
    }
    let first = |folder: &Path| std::fs::read(folder.join("frame-first-000000.png")).unwrap();
    assert_eq!(first(&report), first(&again));
    assert!(std::fs::read_to_string(again.join("index.html")).unwrap().contains("vservo replay"));
}
