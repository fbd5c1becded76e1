//! Failures that are planted in a simulated cell, and the cause that `vservo explain` names from what the run left. The detectors were tuned on other
//! sizes, seeds and joints than these.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::common::{Instance, kill, vservo, wait_for_process, wait_until};
use serde_json::Value;
use std::path::Path;
use std::process::Stdio;

/// Runs a cell with `settings` in lockstep and leaves a report, or a recording.
fn run(name: &str, (file, settings): (&str, &[&str]), kind: &str, place: &Path) {
    let instance = Instance::new(name);
    let output = vservo()
        .args(["run", file, "--clock", "lockstep", "--anyway", "--instance", &instance.name])
        // The failures were planted for arms that start at full speed.
        .args(["--set", "run.duration_s=8", "--set", "servo.first_motion_m_s=0"])
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

/// The summary of such a run.
fn summary(name: &str, cell: (&str, &[&str])) -> Value {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("summary.json");
    run(name, cell, "--summary", &place);
    serde_json::from_str(&std::fs::read_to_string(&place).unwrap()).unwrap()
}

#[test]
fn a_summary_tells_payloads_as_they_are_and_no_rotors() {
    for (i, (file, mass)) in
        [("ur5", 3.0), ("panda", 2.5), ("xarm7", 3.0), ("xarm7", 2.2)].into_iter().enumerate()
    {
        let payload = format!("drive.simulated.payload_kg={mass}");
        let told = summary(&format!("sum-load{i}"), (file, &[&payload]));
        let number = |key: &str| told["payload"][key].as_f64().unwrap();
        let (kg, sd) = (number("mass_kg"), number("mass_sd_kg"));
        assert!((kg - mass).abs() < 2.0 * sd && sd < 0.2 * mass, "{file}: {kg} +- {sd} kg of {mass}");
        assert!(told["rotors_kg_m2_or_kg"].is_null(), "{file} with {mass} kg: {told:#}");
    }
}

#[test]
fn a_jammed_joint_is_named_and_makes_no_force_at_the_flange() {
    for joint in 2..4 {
        let jam = format!("drive.simulated.jam={{joint={joint},from_s=0.6}}");
        let told = summary(&format!("sum-jam{joint}"), ("ur5", &[&jam]));
        let contact = &told["contact"];
        let names = told["joint_names"].as_array().unwrap();
        assert_eq!(contact["joint_name"], names[contact["joint"].as_u64().unwrap() as usize]);
        assert!(contact["force_n"].is_null(), "{contact}");
    }
}

#[test]
fn a_gain_that_is_too_high_is_named() {
    let (held, way) = ("servo.update=frame", "servo.interaction=current");
    named(
        "gain_too_high",
        &[
            ("default", &[held, way, "servo.gain_1_s=40", "run.seed=5"]),
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
            ("ur5", &["scene.motion={kind=\"circle\",radius_m=[0.05,0.0,0.0],frequency_hz=0.5}"]),
            ("panda", &["scene.motion={kind=\"circle\",radius_m=[0.04,0.0,0.0],frequency_hz=0.3}"]),
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

/// By its own motion, and by that of an arm whose camera is turned against its mount while nothing keeps the target in view.
#[test]
fn a_target_that_leaves_the_image_is_named() {
    let (moves, not_kept) = ("scene.motion.kind=conveyor", "servo.visibility.guard=false");
    named(
        "left_the_image",
        &[
            (
                "default",
                &[
                    not_kept,
                    "servo.return_to_last_seen=false",
                    "scene.camera.mount.rotation_rpy_rad=[0.0,0.0,1.1]",
                ],
            ),
            ("default", &[moves, "scene.motion.velocity_m_s=[0.0,-1.5,0.0]", "run.seed=12"]),
            ("ur5", &[moves, "scene.motion.velocity_m_s=[1.2,0.0,0.0]"]),
        ],
    );
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
    let frozen = "faults=[{kind='encoder_freeze',from_s=0.4,duration_s=100.0,joint=1}]";
    named(
        "stuck_reading",
        &[("default", &[frozen]), ("ur5", &[frozen, "drive.mode=velocity"]), ("ur5", &[frozen])],
    );
    named(
        "friction",
        &[
            ("default", &["drive.simulated.untold_coulomb_share=0.4", "drive.simulated.hard_friction=true"]),
            (
                "default",
                &["servo.interaction=current", "drive.simulated.untold_coulomb_share=0.45", "run.seed=3"],
            ),
        ],
    );
    named(
        "contact",
        &[
            (
                "default",
                &[
                    "servo.interaction=current",
                    "drive.simulated.push={force_n=[0.0,90.0,0.0],from_s=0.6,until_s=1.4}",
                ],
            ),
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
fn rotors_that_nobody_told_and_a_base_that_shakes_are_named() {
    named(
        "untold_rotors",
        &[
            ("ur5", &["drive.simulated.untold_rotor_share=11", "run.seed=13"]),
            ("panda", &["drive.simulated.untold_rotor_share=9", "run.seed=5"]),
            ("xarm7", &["drive.simulated.untold_rotor_share=7", "run.seed=2"]),
            ("scara-b", &["drive.simulated.untold_rotor_share=9"]),
        ],
    );
    let shakes = "drive.simulated.base_frequency_hz=6.3";
    named(
        "shaking_base",
        &[
            ("ur5", &["drive.simulated.base_acceleration_m_s2=[0.4,0.7,0.2]", shakes, "run.seed=17"]),
            ("panda", &["drive.simulated.base_acceleration_m_s2=[0.5,0.0,0.7]", "run.seed=8"]),
            (
                "scara-b",
                &["servo.gain_1_s=1", "drive.simulated.base_acceleration_m_s2=[0.0,1.8,0.0]", shakes],
            ),
        ],
    );
}

#[test]
fn joints_that_yield_are_named() {
    named(
        "elastic_joints",
        &[
            ("panda", &["drive.simulated.joint_wind_up_rad_or_m=0.0095", "run.seed=4"]),
            ("xarm7", &["drive.simulated.joint_wind_up_rad_or_m=0.04"]),
            ("ur5", &["drive.simulated.joint_wind_up_rad_or_m=0.035", "run.seed=6"]),
            ("ur5", &["drive.simulated.joint_wind_up_rad_or_m=0.045", "run.seed=2"]),
        ],
    );
}

/// A process of a run by the clock that stands still for a while, as one that gets no core. A run that a busy machine ends before is begun again.
fn stands_still(name: &str, role: &str, seconds: f64) -> Value {
    for attempt in 0..10 {
        let instance = Instance::new(&format!("{name}{attempt}"));
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("report");
        let mut child = vservo()
            .args(["run", "--instance", &instance.name, "--set", "servo.gain_1_s=0.5", "--duration-s", "4"])
            .arg("--report")
            .arg(&place)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let process = wait_for_process(&instance, role);
        let mut moves = false;
        wait_until("the arm to move, or the run to end", || {
            let output =
                vservo().args(["ctl", "status", "--json", "--instance", &instance.name]).output().unwrap();
            let answer: Value = serde_json::from_slice(&output.stdout).unwrap_or(Value::Null);
            moves = answer["state"] == "servoing" && answer["time_s"].as_f64().is_some_and(|s| s > 0.6);
            moves || child.try_wait().unwrap().is_some()
        });
        if moves {
            kill(process, "STOP");
            std::thread::sleep(std::time::Duration::from_secs_f64(seconds));
            kill(process, "CONT");
        }
        child.wait().unwrap();
        instance.assert_gone();
        if moves {
            return explained(&place);
        }
    }
    panic!("ten runs in which the arm did not move");
}

/// A recording of a run whose control was killed has no end of it: that is told, and no stop on request.
#[test]
fn a_control_that_was_killed_stopped_nothing_on_request() {
    let instance = Instance::new("expkilled");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let mut child = vservo()
        .args([
            "run",
            "--instance",
            &instance.name,
            "--set",
            "goal.hold_s=60",
            "--duration-s",
            "60",
            "--record",
        ])
        .arg(&path)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let control = wait_for_process(&instance, "control");
    wait_until("the run to be on its way", || {
        let output =
            vservo().args(["ctl", "status", "--json", "--instance", &instance.name]).output().unwrap();
        let answer: Value = serde_json::from_slice(&output.stdout).unwrap_or(Value::Null);
        answer["time_s"].as_f64().is_some_and(|s| s > 0.6)
    });
    kill(control, "KILL");
    assert_eq!(child.wait().unwrap().code(), Some(4));
    let told = explained(&path);
    let verdict = told["verdict"].as_str().unwrap();
    assert!(verdict.starts_with("Cut off") && verdict.contains("control was gone"), "{verdict}");
}

#[test]
fn a_silent_camera_and_missed_deadlines_are_named() {
    let told = stands_still("expdead", "control", 0.3);
    assert_eq!(told["findings"][0]["cause"], "deadlines", "{told:#}");
    // One that is suspended is started anew before a run of seconds is lost; one that hangs is not.
    let folder = tempfile::tempdir().unwrap();
    let hangs = "faults=[{kind='process_hangs',process='camera',from_s=0.6,duration_s=100.0}]";
    let (instance, place) = (Instance::new("expsilent"), folder.path().join("report"));
    let slow = ["--set", "servo.gain_1_s=0.5", "--duration-s", "4", "--set", hangs];
    let args = ["run", "--clock", "realtime", "--instance", &instance.name];
    let output = vservo().args(args).args(slow).arg("--report").arg(&place).output().unwrap();
    assert!(place.exists(), "{output:?}");
    instance.assert_gone();
    let told = explained(&place);
    assert_eq!(told["findings"][0]["cause"], "frames_stopped", "{told:#}");
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

/// What control refuses tells nothing of the cell; the first finding says why it did.
#[test]
fn measurements_that_were_refused_are_named() {
    let jump = "faults=[{kind=\"clock_jump\",from_s=0.5,duration_s=20,delay_ms=200}]";
    named("wrong_stamps", &[("ur5", &[jump])]);
    let [freeze, stale, overtaken] = ["freeze", "stale", "overtaken"]
        .map(|kind| format!("faults=[{{kind=\"{kind}\",from_s=0.5,duration_s=20}}]"));
    named("repeated_views", &[("ur5", &[&freeze]), ("ur5", &[&stale]), ("default", &[&overtaken])]);
}

#[test]
fn what_keeps_a_goal_from_being_met_is_named() {
    let far = "servo.desired.position_m=[0.0,0.0,2.5]";
    named(
        "at_its_end",
        &[
            ("ur5", &[far, "run.duration_s=60"]),
            ("ur5", &[far, "motion.max_acceleration_rad_s2_or_m_s2=[60]"]),
        ],
    );
    let fine = "goal.feature_error_px=0.0001";
    named(
        "fine_tolerance",
        &[("tag", &["goal.feature_error_px=0.0005"]), ("default", &[fine]), ("ur5", &[fine])],
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

/// Two recordings on one page: what differs in their run files, and how each ended.
#[test]
fn two_recordings_are_seen_side_by_side() {
    let folder = tempfile::tempdir().unwrap();
    let recordings = ["a", "b"].map(|name| folder.path().join(format!("{name}.mcap")));
    run("expcmp-a", ("default", &[]), "--record", &recordings[0]);
    run("expcmp-b", ("default", &["servo.gain_1_s=7"]), "--record", &recordings[1]);
    let place = folder.path().join("compared");
    let output = vservo().arg("report").args(&recordings).arg(&place).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let page = std::fs::read_to_string(place.join("index.html")).unwrap();
    let (gain, ends) =
        (page.find("<td>servo.gain_1_s</td>").unwrap(), page.matches("Converged after").count());
    assert!(page[gain..gain + 80].contains("<td>15.0</td><td>7"), "{}", &page[gain..gain + 80]);
    assert_eq!(ends, 2);
    assert!(!page.contains("<td>run.seed</td>") && page.contains("joint_2"));
    assert!(!page.replace("http://www.w3.org/2000/svg", "").contains("http"), "it needs nothing else");
}
