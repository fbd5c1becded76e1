//! `vservo drive check` before real processes: a drive that keeps to its contract, one of a robot over the wire, and drives that do something wrong. Rules about
//! time and smoothness are not asked of a busy machine.

#![allow(clippy::unwrap_used, clippy::panic)]

use crate::common::{Instance, kill, vservo, wait_for_line, wait_until};
use crate::drive::{command, drive_by_hand};
use serde_json::Value;
use std::net::Ipv4Addr;
use std::process::{Output, Stdio};
use vservo_ur::emulator::{Emulator, EmulatorSettings, StiffJoints};
use vservo_ur::{RuntimeState, SafetyMode, Series};

/// What a loaded machine may do to the best of drives.
const BY_LOAD: [&str; 8] = ["rate", "age", "future", "lag", "follow", "velocity", "hold", "course"];
/// Checks on a machine that is too busy to judge motions are repeated. Each takes half a minute; a machine that is busy for five minutes fails a test.
const REPEATS: usize = 10;

pub(crate) fn checked(instance: &Instance, arguments: &[&str]) -> (Output, Value) {
    let output = vservo()
        .args(["drive", "check", "--json", "--instance", &instance.name])
        .args(["--set", "safety.drive_timeout_ms=2000"])
        .args(arguments)
        .output()
        .unwrap();
    instance.assert_gone();
    let answer = serde_json::from_slice(&output.stdout).unwrap_or_default();
    (output, answer)
}

/// The rules of this verdict that load cannot break.
pub(crate) fn rules(answer: &Value, verdict: &str) -> Vec<String> {
    let rules = answer["rules"].as_array().unwrap_or_else(|| panic!("no answer: {answer}"));
    let with = rules.iter().filter(|rule| rule["verdict"] == verdict);
    let mut names: Vec<String> = with.map(|rule| rule["rule"].as_str().unwrap().to_owned()).collect();
    names.retain(|name| !BY_LOAD.contains(&name.as_str()));
    names.dedup();
    names
}

/// The check of the test drive with this behaviour.
fn of_drive(behaviour: &str, more: &[&str]) -> (Output, Value) {
    let (set, instance) = (command(behaviour), Instance::new("checks"));
    checked(&instance, &[&["--set", "drive.kind=external", "--set", &set], more].concat())
}

/// The verdicts on a rule, one for each mode.
fn verdicts<'a>(answer: &'a Value, rule: &str) -> Vec<&'a str> {
    let rules = answer["rules"].as_array().unwrap();
    rules.iter().filter(|r| r["rule"] == rule).map(|r| r["verdict"].as_str().unwrap()).collect()
}

/// The first check in which the machine had the time that this rule takes, or the last of some.
fn calm(rule: &str, check: impl Fn() -> (Output, Value)) -> (Output, Value) {
    let mut last = check();
    for _ in 1..REPEATS {
        if !verdicts(&last.1, rule).contains(&"not_tested") {
            break;
        }
        last = check();
    }
    last
}

/// The first check of an honest drive in which a busy machine broke no rule in its place, or the last of some.
pub(crate) fn undisturbed(check: impl Fn() -> (Output, Value)) -> (Output, Value) {
    let mut last = calm("refuses_numbers", &check);
    for _ in 1..REPEATS {
        if rules(&last.1, "broken").is_empty() {
            break;
        }
        last = calm("refuses_numbers", &check);
    }
    last
}

#[test]
fn an_honest_drive_passes() {
    let (output, answer) = undisturbed(|| of_drive("", &[]));
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(rules(&answer, "broken").is_empty(), "{answer:#}\n{told}");
    for rule in [
        "answer",
        "every_start",
        "joint_names",
        "modes",
        "truth",
        "sequence",
        "tick",
        "clock",
        "stays",
        "last_exit",
        "silence",
    ] {
        assert!(rules(&answer, "ok").contains(&rule.to_owned()), "{rule}: {answer:#}\n{told}");
    }
    let broken = answer["broken"].as_u64().unwrap();
    assert_eq!(output.status.code(), Some(if broken == 0 { 0 } else { 3 }), "{answer:#}");
}

#[test]
fn what_a_drive_does_wrong_at_rest_is_found() {
    for (behaviour, mode, rule) in [
        ("three_joints", "velocity", "joints"),
        ("position_only", "velocity", "modes"),
        ("wrong_tick@300", "position", "tick"),
        ("time_of_day", "position", "clock"),
        ("leave@300", "velocity", "stays"),
        ("endless_speed", "velocity", "finite"),
        ("absurd_place", "position", "range"),
        ("swapped_names", "position", "joint_names"),
        ("turned_joint", "velocity", "joint_names"),
    ] {
        let mode = format!("drive.mode={mode}");
        let (output, answer) = of_drive(behaviour, &["--no-motion", "--set", &mode]);
        assert!(rules(&answer, "broken").contains(&rule.to_owned()), "{behaviour}: {answer:#}");
        assert_eq!(output.status.code(), Some(3), "{behaviour}");
        let remedies = answer["rules"].as_array().unwrap().iter().filter(|r| r["remedy"].is_string());
        assert_eq!(remedies.count() as u64, answer["broken"].as_u64().unwrap(), "{answer:#}");
    }
}

#[test]
fn a_drive_that_is_mute_or_falls_silent_is_found() {
    let set = ["--no-motion", "--set", "drive.mode=position", "--set", "drive.external.connect_timeout_s=4"];
    let (output, answer) = of_drive("mute", &set);
    assert_eq!(rules(&answer, "broken"), ["answer"], "{answer:#}");
    assert_eq!(output.status.code(), Some(3));
    // Here the pause is the point, and no load makes it shorter.
    let (_, answer) =
        of_drive("silent@200", &[&set[..3], &["--set", "safety.drive_timeout_ms=100"]].concat());
    let rate = answer["rules"].as_array().unwrap().iter().find(|r| r["rule"] == "rate").unwrap();
    assert_eq!(rate["verdict"], "broken", "{answer:#}");
}

#[test]
fn what_a_drive_does_wrong_in_motion_is_found() {
    for (behaviour, rule) in [("swapped", "order"), ("goes_on", "silence"), ("obeys_all", "refuses_joints")] {
        let (output, answer) = calm(rule, || of_drive(behaviour, &["--set", "drive.mode=velocity"]));
        assert_eq!(verdicts(&answer, rule), ["broken"], "{behaviour}: {answer:#}");
        assert_eq!(output.status.code(), Some(3), "{behaviour}");
    }
}

#[test]
fn the_drive_of_a_robot_passes_and_leaves_it_at_rest() {
    let [_, _, b, c] = std::process::id().to_be_bytes();
    let q = [0.4617, -1.7204, 1.4481, -1.2809, -1.8176, 0.9664];
    let robot = Emulator::start(EmulatorSettings {
        address: Ipv4Addr::new(127, 170 + b % 30, c, 1).into(),
        series: Series::ESeries,
        q,
        running: true,
        joints: Box::new(StiffJoints::default()),
    })
    .unwrap();
    let (host, instance) = (robot.address().to_string(), Instance::new("checksur"));
    let program = ["--", "vservo-drive-ur", "--host", &host, "--silence-ms", "1000", "--watchdog-ms", "500"];
    let arguments = [&["config/ur5e-emulated.toml"], &program[..]].concat();
    let (output, answer) = undisturbed(|| checked(&instance, &arguments));
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(rules(&answer, "broken").is_empty(), "{answer:#}\n{told}");
    let ok = rules(&answer, "ok");
    for rule in ["silence", "silence_told", "refuses_joints", "refuses_numbers", "last_exit"] {
        assert!(ok.contains(&rule.to_owned()), "{rule}: {answer:#}");
    }
    wait_until("the arm at rest, without a program", || {
        robot.arm().1 == [0.0; 6] && robot.modes().2 != RuntimeState::Playing
    });
    assert_eq!(robot.modes().1, SafetyMode::Normal, "{:?}", robot.log());
    let off = robot.arm().0.iter().zip(&q).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(off < 0.1, "{off} rad: hundredths of a radian, and back");
}

#[test]
fn the_drive_of_another_maker_passes_too() {
    use vservo_franka::emulator::{Emulator, EmulatorSettings};
    let [_, _, b, c] = std::process::id().to_be_bytes();
    let q = [-0.1577, -0.5223, -0.1384, -2.1133, 0.0871, 1.7882, 0.2074];
    let address: std::net::IpAddr = Ipv4Addr::new(127, 211 + b % 30, c, 1).into();
    // A busy machine keeps commands back for longer than a robot waits.
    let robot =
        Emulator::start(EmulatorSettings { missed_cycles: 1000, ..EmulatorSettings::fr3(address, q) });
    let (robot, host, instance) = (robot.unwrap(), address.to_string(), Instance::new("checksfr"));
    let program = ["--", "vservo-drive-franka", "--host", &host, "--silence-ms", "1000"];
    let arguments = [&["config/fr3-emulated.toml"], &program[..]].concat();
    let (output, answer) = undisturbed(|| checked(&instance, &arguments));
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(rules(&answer, "broken").is_empty(), "{answer:#}\n{told}");
    let ok = rules(&answer, "ok");
    for rule in ["silence", "silence_told", "refuses_joints", "refuses_numbers", "last_exit"] {
        assert!(ok.contains(&rule.to_owned()), "{rule}: {answer:#}");
    }
    wait_until("the arm at rest, without a motion", || {
        robot.arm().1.iter().all(|v| v.abs() < 1e-3)
            && robot.mode() == (vservo_franka::RobotMode::Idle, false)
    });
    assert_eq!(robot.log(), [""; 0]);
    let off = robot.arm().0.iter().zip(&q).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(off < 0.1, "{off} rad: hundredths of a radian, and back");
}

#[test]
fn a_stop_in_the_middle_leaves_nobody_behind() {
    let instance = Instance::new("checkstop");
    let mut child = vservo()
        .args(["drive", "check", "--instance", &instance.name, "--set", "drive.kind=external"])
        .args(["--set", &command(""), "--set", "drive.mode=position"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    wait_for_line(&mut child, "mode position: holds the arm, and moves");
    kill(child.id() as i32, "INT");
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(6));
    assert!(output.stdout.is_empty());
    instance.assert_gone();
}

#[test]
fn a_drive_that_is_started_by_hand_is_waited_for() {
    let instance = Instance::new("checkhand");
    let mut child = vservo()
        .args(["drive", "check", "--json", "--instance", &instance.name, "--set", "drive.kind=external"])
        .args(["--set", "drive.mode=position", "--set", "safety.drive_timeout_ms=2000"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    wait_for_line(&mut child, "start it now");
    let mut drive = drive_by_hand(&instance, "drive::drive_process");
    let output = child.wait_with_output().unwrap();
    let answer: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(rules(&answer, "broken").is_empty(), "{answer:#}");
    assert!(rules(&answer, "ok").contains(&"order".to_owned()), "{answer:#}");
    assert!(
        rules(&answer, "not_tested").contains(&"last_exit".to_owned()),
        "nobody knows its exit code: {answer:#}"
    );
    assert!(drive.wait().unwrap().success());
    instance.assert_gone();
}

#[test]
fn a_run_file_without_a_drive_of_its_own_is_told() {
    let output = vservo().args(["drive", "check"]).output().unwrap();
    assert_eq!(output.status.code(), Some(3));
    assert!(String::from_utf8_lossy(&output.stderr).contains("drive.kind: is no program of its own"));
}
