//! Robots that stop by themselves, as their drives tell it: a fault in the robot's words, in which the arm rests, and which a reset ends where the robot lets it.

#![allow(clippy::unwrap_used)]

use crate::common::{assert_accurate, run, vservo, wait_until};
use crate::drive::{MAKERS_WORDS, command, external};
use crate::serve::Daemon;
use serde_json::Value;

const LOCKSTEP: [&str; 2] = ["--clock", "lockstep"];

/// States may stay away for a second: the drive is a process like any other, which a busy machine keeps waiting.
fn daemon(test: &str, behaviour: &str, extra: &[&str]) -> Daemon {
    let command = command(behaviour);
    let set = ["--set", "drive.kind=external", "--set", &command, "--set", "safety.drive_timeout_ms=1000"];
    let daemon = Daemon::start(test, &[&set[..], extra].concat());
    // It answers while it still waits for its drive, too.
    wait_until("a robot that is ready", || words(&status(&daemon), "robot_state") == "ready");
    daemon
}

fn status(daemon: &Daemon) -> Value {
    daemon.ctl("status").1
}

fn words<'a>(answer: &'a Value, key: &str) -> &'a str {
    answer[key].as_str().unwrap_or_default()
}

/// How far apart two postures are, rad or m.
fn apart(a: &Value, b: &Value) -> f64 {
    let [a, b] = [a, b].map(|answer| answer["q_rad_or_m"].as_array().unwrap());
    a.iter().zip(b).map(|(a, b)| (a.as_f64().unwrap() - b.as_f64().unwrap()).abs()).fold(0.0, f64::max)
}

/// In lockstep and by the clock: the fault is the robot's and no other, the arm rests where the robot stopped it, nothing starts, and a reset has the robot cleared.
#[test]
fn a_protective_stop_is_a_fault_that_a_reset_has_cleared() {
    for clock in ["lockstep", "realtime"] {
        let folder = tempfile::tempdir().unwrap();
        let recording = folder.path().join("run.mcap");
        let record = ["--clock", clock, "--record", recording.to_str().unwrap()];
        let daemon = daemon("robotstop", "protective_stop", &record);
        daemon.accepts("start");
        daemon.wait_for("fault");
        let answer = status(&daemon);
        assert!(words(&answer, "fault").contains("protective stop"), "{answer}");
        assert_eq!((words(&answer, "robot_state"), &answer["robot_code"]), ("protective_stop", &42.into()));
        assert_eq!(words(&answer, "robot_text"), MAKERS_WORDS);
        let line = vservo().args(["ctl", "status", "--instance", &daemon.instance.name]).output().unwrap();
        let line = String::from_utf8_lossy(&line.stdout).into_owned();
        assert!(line.contains(&format!("robot protective_stop (42): {MAKERS_WORDS}")), "{line}");
        assert_eq!(answer["waits_for"], Value::Null, "nobody has asked: {answer}");
        daemon.refuses("start", "reset");
        wait_until("a reset that is taken", || daemon.ctl("reset").0 == Some(0));
        let wait = ["ctl", "wait", "state=idle", "--timeout-s", "60", "--instance", &daemon.instance.name];
        let wait = vservo().args(wait).output().unwrap();
        assert_eq!(wait.status.code(), Some(0), "{wait:?}");
        let rested = status(&daemon);
        // Under torques an arm gives way by some milliradians when its brakes open.
        assert!(apart(&answer, &rested) < 1e-2, "it was held where it was stopped: {answer} {rested}");
        assert_eq!((&rested["fault"], words(&rested, "robot_state")), (&Value::Null, "ready"));
        assert_eq!(rested["robot_text"], Value::Null, "that is over");
        daemon.accepts("start");
        let wait = vservo()
            .args(["ctl", "wait", "converged", "--timeout-s", "120", "--instance", &daemon.instance.name])
            .output()
            .unwrap();
        assert_eq!(wait.status.code(), Some(0), "{wait:?}");
        daemon.accepts("shutdown");
        let (code, printed) = daemon.ended();
        assert_eq!(code, Some(0), "{printed}");
        assert!(printed.contains("the robot obeys commands again"), "{printed}");
        let replay = vservo().arg("replay").arg(&recording).output().unwrap();
        let told = String::from_utf8_lossy(&replay.stdout).into_owned();
        assert_eq!(replay.status.code(), Some(0), "{told}{}", String::from_utf8_lossy(&replay.stderr));
        // Played as a drive the recorded robot stops again, in the same words.
        let recorded = format!("drive.replay.recording={}", recording.display());
        let dry = ["--clock", "lockstep", "--set", "drive.kind=replay", "--set", &recorded];
        let dry = run("robotdry", &dry);
        assert_eq!(dry.summary["outcome"], "fault", "{}", dry.text());
        assert!(words(&dry.summary, "reason").contains("protective stop"), "{}", dry.text());
    }
}

#[test]
fn an_emergency_stop_is_not_cleared_from_here() {
    let daemon = daemon("robotestop", "emergency_stop", &LOCKSTEP);
    daemon.accepts("start");
    daemon.wait_for("fault");
    let before = status(&daemon);
    assert!(words(&before, "fault").contains("emergency stop"), "{before}");
    wait_until("an arm that stands", || {
        let (_, answer, _) = daemon.ctl("reset");
        words(&answer, "reason").contains("release its button")
    });
    daemon.refuses("reset", "power the robot and open its brakes at the robot");
    let after = status(&daemon);
    assert_eq!((words(&after, "state"), words(&after, "robot_state")), ("fault", "emergency_stop"));
    assert_eq!(before["q_rad_or_m"], after["q_rad_or_m"]);
    daemon.accepts("shutdown");
    daemon.ended();
}

#[test]
fn a_plain_run_ends_by_a_stop_of_the_robot_in_its_words() {
    for (behaviour, expected) in [
        ("protective_stop", "the robot reports a protective stop"),
        ("emergency_stop", "the robot reports an emergency stop"),
        ("unknown_state", "the robot reports a fault of its own"),
    ] {
        for clock in ["lockstep", "realtime"] {
            let r = external("robotends", behaviour, &["--clock", clock]);
            assert_eq!(r.output.status.code(), Some(4), "{}", r.text());
            let reason = r.summary["reason"].as_str().unwrap();
            assert!(reason.contains(expected), "{behaviour}: {reason}");
            let told = reason.matches(MAKERS_WORDS).count();
            assert_eq!(told, usize::from(behaviour != "unknown_state"), "{reason}");
            let logged = format!("the drive says: {MAKERS_WORDS}");
            assert_eq!(r.text().matches(&logged).count(), told, "{}", r.text());
        }
    }
}

/// In lockstep and by the clock: nothing moves where the drive's joints are others than those of the robot file, and both lists are told.
#[test]
fn joints_of_another_name_or_order_are_refused() {
    for (behaviour, expected) in [
        ("swapped_names", &["the same names in another order", "joint_2, joint_1, joint_3, joint_4"][..]),
        ("other_names", &["joint 1 is `joint_1_of_another` there", "joint_1, joint_2, joint_3, joint_4"]),
        ("fewer_names", &["3 joints, not 4", "joint_1, joint_2, joint_3;"]),
        ("turned_joint", &["joint 2 of the drive (`joint_2`) counts the other way round"]),
    ] {
        for clock in ["lockstep", "realtime"] {
            let r = external("robotnames", behaviour, &["--clock", clock]);
            assert_eq!(r.output.status.code(), Some(3), "{behaviour}: {}", r.text());
            let text = r.text();
            assert!(expected.iter().all(|words| text.contains(words)), "{behaviour} {clock}: {text}");
            assert_eq!(r.summary["ticks"].as_u64(), Some(0), "{}", r.summary);
        }
    }
}

#[test]
fn a_drive_that_tells_no_names_is_taken_as_before() {
    let [told, silent] =
        ["", "knows_no_names"].map(|behaviour| external("robotnoname", behaviour, &LOCKSTEP));
    let says = "the drive tells no names of its joints";
    assert_eq!([&told, &silent].map(|run| run.text().matches(says).count()), [0, 1], "{}", silent.text());
    assert_accurate(&silent);
    assert_eq!(told.summary["state_hash"], silent.summary["state_hash"]);
}

#[test]
fn a_drive_that_tells_nothing_of_its_robot_is_as_before() {
    let [told, silent] = ["", "knows_no_states"].map(|behaviour| external("robottold", behaviour, &LOCKSTEP));
    assert_accurate(&silent);
    assert_eq!(told.summary["state_hash"], silent.summary["state_hash"]);
}
