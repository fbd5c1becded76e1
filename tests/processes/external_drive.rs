//! A drive in another process: the same as the built-in one, and what becomes of a run when it fails.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // what was measured

use crate::common::{
    Instance, Run, assert_accurate, kill, number, read_summary, run, vservo, wait_for_line, wait_until,
};
use crate::drive::{command, drive_by_hand, external, start_run};
use crate::replay::assert_identical;
use std::path::Path;
use std::process::{Child, Stdio};

fn drive_of(instance: &Instance) -> i32 {
    let wanted = format!("VSERVO_INSTANCE={}", instance.name);
    let mut found = None;
    wait_until("the drive", || {
        found = std::fs::read_dir("/proc").unwrap().flatten().find_map(|entry| {
            let pid = entry.file_name().to_string_lossy().parse::<i32>().ok()?;
            let own = |file: &str, text: &str| {
                let bytes = std::fs::read(entry.path().join(file)).unwrap_or_default();
                bytes.split(|b| *b == 0).any(|part| part == text.as_bytes())
            };
            (own("cmdline", "drive::drive_process") && own("environ", &wanted)).then_some(pid)
        });
        found.is_some()
    });
    found.unwrap()
}

fn start(instance: &Instance, behaviour: &str, extra: &[&str]) -> Child {
    start_logged(instance, behaviour, extra, None)
}

/// As [`start`]; the drive writes the largest speed of every command into `log`.
fn start_logged(instance: &Instance, behaviour: &str, extra: &[&str], log: Option<&Path>) -> Child {
    let command = command(behaviour);
    let own = ["--set", "drive.kind=external", "--set", "goal.hold_s=60", "--set", &command];
    start_run(instance, &[&own[..], &["--duration-s", "60"], extra].concat(), log)
}

const LOCKSTEP: [&str; 2] = ["--clock", "lockstep"];

/// Robots add their weight and their friction to what is commanded, or not: told so, control leaves out what they add, and the arm comes to its goal either way.
#[test]
fn torques_contain_what_the_robot_does_not_add() {
    let settled = |contains: &str| {
        let set = format!("drive.torque_contains={contains}");
        let run = external("contents", "", &[&LOCKSTEP[..], &["--set", &set]].concat());
        assert_accurate(&run);
        number(&run.summary, &["settling_time_s"])
    };
    let whole = settled("[\"gravity\",\"friction\"]");
    for contains in ["[\"friction\"]", "[\"gravity\"]", "[]"] {
        let rest = settled(contains);
        assert!((rest - whole).abs() < 0.1, "{contains}: {rest} s, whole torques: {whole} s");
    }
}

/// The drive's own record of what it was commanded, from the first torque on: it converges, and brakes in the middle of its motion, without a torque that rises more quickly than the drive tells.
#[test]
fn torques_rise_no_more_quickly_than_the_drive_takes_them() {
    let config = vservo::config::Config::load(None, &[]).unwrap();
    let efforts: Vec<f64> = config.robot.joints.iter().map(|joint| joint.limits.effort).collect();
    for (rise_ms, payload_kg, duration_s, code) in [
        (100, 0.0, "30", 0),
        (200, 0.0, "30", 0),
        (400, 0.0, "30", 0),
        (200, 1.0, "30", 0),
        (200, 0.0, "0.6", 5),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let record = folder.path().join("torques");
        let recording = folder.path().join("run.mcap");
        let set = format!("\"env\", \"VSERVO_TEST_TORQUES={}\"", record.display());
        let set = command(&format!("slow_torques@{rise_ms}")).replacen("\"env\"", &set, 1);
        let payload = format!("drive.simulated.payload_kg={payload_kg}");
        let external = ["--set", "drive.kind=external", "--set", &set, "--set", &payload];
        let external =
            [&external[..], &["--duration-s", duration_s, "--record", recording.to_str().unwrap()]].concat();
        let run = run("slowtorques", &[&LOCKSTEP[..], &external].concat());
        assert_eq!(run.output.status.code(), Some(code), "{rise_ms} ms: {}", run.text());
        assert!(run.text().contains("torques rise by no more than the drive takes"), "{}", run.text());
        let text = std::fs::read_to_string(&record).unwrap();
        let torques = text.lines().map(|l| l.split(' ').map(|v| v.parse::<f64>().unwrap()).collect());
        let torques: Vec<Vec<f64>> = torques.collect();
        assert!(torques.len() > 300, "{}", torques.len());
        for (joint, effort) in efforts.iter().enumerate() {
            let rise = |w: &[Vec<f64>]| (w[1][joint] - w[0][joint]).abs() * f64::from(rise_ms) / effort;
            let fastest = torques.windows(2).map(rise).fold(0.0, f64::max);
            assert!(fastest <= 1.0 + 1e-9, "{rise_ms} ms, joint {joint}: {fastest} of the rate");
            println!(
                "{rise_ms} ms, {payload_kg} kg, {duration_s} s, joint {joint}: {fastest:.3} of the rate at most"
            );
        }
        // The replay knows from the recording what the drive told.
        assert_identical(&recording);
    }
}

#[test]
fn in_lockstep_it_equals_the_built_in_drive_to_the_last_bit() {
    let cases: [&[&str]; 3] = [
        &[],
        &["drive.mode=position", "drive.simulated.payload_kg=1"],
        &[
            "drive.mode=velocity",
            "drive.simulated.encoder_step_rad_or_m=[1e-5]",
            "drive.simulated.command_delay_ticks=2",
        ],
    ];
    for case in cases {
        let mut arguments = LOCKSTEP.to_vec();
        for set in case {
            arguments.extend(["--set", set]);
        }
        let built_in = run("builtin", &arguments);
        let outside = external("outside", "", &arguments);
        assert_accurate(&outside);
        assert_eq!(built_in.summary["state_hash"], outside.summary["state_hash"], "{case:?}");
        assert_eq!(built_in.summary["final"], outside.summary["final"]);
        assert_eq!(number(&outside.summary, &["late_drive_states"]), 0.0);
    }
}

#[test]
fn without_truth_the_camera_shows_what_is_measured() {
    let built_in = run("builtin", &LOCKSTEP);
    let outside = external("notruth", "no_truth", &LOCKSTEP);
    assert_accurate(&outside);
    // The encoders are exact here: the images are the same, the errors come from the last measurement.
    assert_eq!(built_in.summary["state_hash"], outside.summary["state_hash"]);
    assert_ne!(built_in.summary["final"], outside.summary["final"]);
}

/// What is found is the offset against the states as control has them: in real time they are a little old.
#[test]
fn the_latency_can_be_calibrated() {
    // a loaded machine may keep the drive waiting, which is nothing to this test
    let set =
        ["run.task=calibrate_latency", "camera.synthetic.stamp_error_ms=10", "safety.drive_timeout_ms=1000"]
            .map(|line| ["--set", line])
            .concat();
    for (clock, behaviour, within_ms) in
        [("lockstep", "", 0.1), ("lockstep", "no_truth", 0.1), ("realtime", "", 5.0)]
    {
        let r = external("calibrates", behaviour, &[&set[..], &["--clock", clock]].concat());
        assert_eq!(r.summary["outcome"], "finished", "{}", r.text());
        let offset_ms = number(&r.summary, &["calibration", "stamp_offset_ms"]);
        assert!((offset_ms + 10.0).abs() < within_ms, "{clock}: {offset_ms}");
        assert!(r.text().contains("calibration   camera stamps are "), "{}", r.text());
    }
}

fn assert_fault(r: &Run, reason: &str, event: &str) {
    assert_eq!(r.output.status.code(), Some(4), "{}", r.text());
    assert_eq!(r.summary["outcome"], "fault");
    assert!(r.summary["reason"].as_str().unwrap().contains(reason), "{}", r.text());
    let events = r.summary["safety"]["events"].to_string();
    assert!(events.contains(event), "{events}");
}

#[test]
fn a_drive_that_is_out_of_step_hangs_or_leaves_ends_the_run() {
    let patience = ["--set", "drive.external.answer_timeout_s=0.4"];
    let lockstep = [&LOCKSTEP[..], &patience].concat();
    let r = external("wrong", "wrong_tick@100", &lockstep);
    assert_fault(&r, "another tick", "another tick");
    assert_eq!(number(&r.summary, &["ticks"]), 101.0, "{}", r.summary);
    assert_fault(&external("silent", "silent@100", &lockstep), "did not answer", "did not answer");
    assert_fault(&external("leaves", "leave@100", &LOCKSTEP), "has left", "has left");
}

#[test]
fn a_killed_drive_ends_the_run() {
    for clock in ["lockstep", "realtime"] {
        let instance = Instance::new("killeddrive");
        let goal = ["--clock", clock, "--set", "safety.drive_timeout_ms=500"];
        let mut child = start(&instance, "", &goal);
        wait_for_line(&mut child, "servoing");
        kill(drive_of(&instance), "KILL");
        let output = child.wait_with_output().unwrap();
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert_eq!(output.status.code(), Some(4), "{text}");
        assert!(text.contains("the drive process ended") && text.contains("signal 9"), "{text}");
        instance.assert_gone();
    }
}

/// However the supervisor goes down, the arm is braked by control to the end, with a drive that is still there.
#[test]
fn an_arm_whose_supervisor_is_killed_comes_to_rest() {
    for clock in ["realtime", "lockstep"] {
        let instance = Instance::new("restless");
        let folder = tempfile::tempdir().unwrap();
        let log = folder.path().join("speeds");
        let speeds = || -> Vec<f64> {
            let text = std::fs::read_to_string(&log).unwrap_or_default();
            text.lines().filter_map(|l| l.parse().ok()).collect()
        };
        // Quick at the start, and late to brake: at a jerk of 4 that takes more than half a second.
        let set = ["--set", "servo.gain_1_s=10", "--set", "motion.max_jerk_rad_s3_or_m_s3=[4.0,4.0,4.0,4.0]"];
        let timeout =
            ["--set", "safety.drive_timeout_ms=2000", "--set", "safety.max_tracking_error_rad_or_m=10"];
        let extra = [&["--clock", clock], &set[..], &timeout].concat();
        let mut child = start_logged(&instance, "", &extra, Some(&log));
        wait_until("a moving arm", || speeds().last().is_some_and(|v| *v > 0.2));
        kill(child.id() as i32, "KILL");
        child.wait().unwrap();
        instance.assert_gone();
        let speeds = speeds();
        let fastest = speeds.iter().copied().fold(0.0, f64::max);
        assert!(fastest > 0.2, "{clock}: {fastest}");
        assert!(speeds.last().is_some_and(|v| *v < 0.02), "{clock}: the last command is {:?}", speeds.last());
        let steps = speeds.windows(2).map(|w| (w[1] - w[0]).abs()).fold(0.0, f64::max);
        assert!(steps < 0.02, "{clock}: the speed jumps by {steps}");
    }
}

#[test]
fn in_real_time_it_converges() {
    let r = external("rtdrive", "", &["--set", "safety.drive_timeout_ms=1000"]);
    assert_accurate(&r);
    assert!(r.summary["late_drive_states"].is_u64());
}

#[test]
fn in_real_time_a_stale_state_stops_the_arm() {
    // The reference runs away from a state that stands still: that watch is put off.
    let late = ["--set", "safety.drive_timeout_ms=300", "--set", "safety.max_tracking_error_rad_or_m=10"];
    let r = external("stale", "silent@300", &late);
    assert_fault(&r, "safety.drive_timeout_ms", "states stopped");
    assert!(number(&r.summary, &["late_drive_states"]) >= 290.0, "{}", r.summary);
}

#[test]
fn a_stop_does_not_wait_for_a_drive_that_hangs() {
    let instance = Instance::new("stopsilent");
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("speeds");
    let child = start_logged(&instance, "silent@200", &LOCKSTEP, Some(&log));
    wait_until("the drive's silence", || {
        std::fs::read_to_string(&log).is_ok_and(|text| text.lines().count() >= 200)
    });
    let drive = drive_of(&instance);
    kill(child.id() as i32, "INT");
    let output = child.wait_with_output().unwrap();
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    // Whether the arm came to rest, nobody knows: that is no orderly stop.
    assert!(text.contains("outcome       fault (the external drive did not answer"), "{text}");
    assert!(!Path::new(&format!("/proc/{drive}")).exists(), "the drive ends with the run");
    instance.assert_gone();
}

#[test]
fn a_drive_that_does_not_fit_is_refused_before_anything_moves() {
    for (behaviour, message) in [
        ("position_only", "does not take torque commands; it takes: position"),
        ("three_joints", "has 3 joints, the robot of the run file 4"),
        ("endless_speed", "no arm does that"),
        ("absurd_speed", "moving with 100 rad/s or m/s: no arm does that"),
        ("absurd_place", "no arm does that"),
    ] {
        let r = external("unfit", behaviour, &LOCKSTEP);
        assert_eq!(r.output.status.code(), Some(3), "{}", r.text());
        assert!(r.text().contains(message), "{}", r.text());
    }
    let missing = ["--set", "drive.kind=external", "--set", "drive.external.command=[\"no-such-drive\"]"];
    let r = run("missing", &[&LOCKSTEP[..], &missing].concat());
    assert_eq!(r.output.status.code(), Some(3), "{}", r.text());
    assert!(r.text().contains("drive.external.command: cannot start `no-such-drive`"), "{}", r.text());
    let ideal = ["--set", "drive.kind=ideal", "--set", "drive.mode=torque"];
    let r = run("idealtorque", &[&LOCKSTEP[..], &ideal].concat());
    assert_eq!(r.output.status.code(), Some(3), "{}", r.text());
    assert!(r.text().contains("drive.mode") && r.text().contains("takes no torque"), "{}", r.text());
}

#[test]
fn a_drive_that_was_started_by_hand_is_found_and_missed() {
    let instance = Instance::new("drivebyhand");
    let folder = tempfile::tempdir().unwrap();
    let summary = folder.path().join("summary.json");
    let mut child = vservo()
        .args(["run", "--instance", &instance.name, "--set", "drive.kind=external", "--clock", "lockstep"])
        .args(["--duration-s", "60", "--set", "goal.hold_s=60", "--summary"])
        .arg(&summary)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    wait_for_line(&mut child, "waiting for the external drive");
    let mut drive = drive_by_hand(&instance, "drive::drive_process");
    let status = |child: &mut Child| child.try_wait().unwrap();
    wait_until("the first frames", || {
        assert_eq!(status(&mut child), None);
        // The drive is at work when it has used some processor time.
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", drive.id())).unwrap_or_default();
        stat.rsplit(')').next().and_then(|s| s.split_whitespace().nth(11)?.parse::<u64>().ok()) > Some(2)
    });
    drive.kill().unwrap();
    drive.wait().unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(4));
    let summary = read_summary(&summary);
    assert_eq!(summary["reason"], "the external drive has left", "{summary}");
    instance.assert_gone();
}
