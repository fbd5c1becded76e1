//! Requests that carry numbers, to a run that goes on: goals, taught goals, postures, small motions, settings.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::common::{vservo, wait_until};
use crate::serve::Daemon;
use serde_json::Value;

/// `vservo ctl ARGUMENTS`: exit code, answer, what was told on stderr.
fn ctl(daemon: &Daemon, arguments: &[&str]) -> (Option<i32>, Value, String) {
    let output = vservo()
        .args(["ctl", "--json", "--instance", &daemon.instance.name])
        .args(arguments)
        .output()
        .unwrap();
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!told.contains("panicked"), "{told}");
    (output.status.code(), serde_json::from_slice(&output.stdout).unwrap_or(Value::Null), told)
}

#[track_caller]
fn accepts(daemon: &Daemon, arguments: &[&str]) -> Value {
    let (code, answer, told) = ctl(daemon, arguments);
    assert_eq!(code, Some(0), "{arguments:?}: {answer} {told}");
    answer
}

#[track_caller]
fn refuses(daemon: &Daemon, arguments: &[&str], why: &str) {
    let (code, answer, told) = ctl(daemon, arguments);
    assert_eq!(code, Some(5), "{arguments:?}: {answer} {told}");
    assert!(told.contains(why), "{arguments:?}: {told}");
}

fn numbers(answer: &Value, key: &str) -> Vec<f64> {
    answer[key].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect()
}

fn posture(daemon: &Daemon) -> Vec<f64> {
    numbers(&accepts(daemon, &["status"]), "q_rad_or_m")
}

fn farthest(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

fn converges(daemon: &Daemon) -> Value {
    let end = accepts(daemon, &["wait", "converged", "--timeout-s", "120"]);
    end["status"].clone()
}

#[test]
fn another_goal_is_reached_while_the_run_goes_on() {
    let daemon = Daemon::start("rt-goal", &["--clock", "lockstep"]);
    accepts(&daemon, &["start"]);
    let first = converges(&daemon);
    let there = ["--position-m", "-0.04,0.03,0.55", "--rotation-rpy-deg", "0,0,-20"];
    let answer = accepts(&daemon, &[&["goal"], &there[..]].concat());
    assert_eq!((&answer["goal"], &answer["at_goal"]), (&1.into(), &false.into()), "{answer}");
    let second = converges(&daemon);
    assert_eq!(second["goal"], 1);
    assert!(
        farthest(&numbers(&first, "q_rad_or_m"), &numbers(&second, "q_rad_or_m")) > 0.05,
        "{first} {second}"
    );
    // Against simulated truth, so that it is the goal that was asked for.
    assert!(second["position_error_m"].as_f64().unwrap() < 0.5e-3, "{second}");
    assert!(second["orientation_error_rad"].as_f64().unwrap().to_degrees() < 0.1, "{second}");
    // The same as a quaternion is no other goal.
    let half = (-10.0_f64).to_radians();
    let xyzw = format!("0,0,{},{}", half.sin(), half.cos());
    accepts(&daemon, &["goal", "--position-m", "-0.04,0.03,0.55", "--rotation-xyzw", &xyzw]);
    wait_until("the error to that goal", || {
        let status = accepts(&daemon, &["status"]);
        status["goal"] == 2 && status["position_error_m"].as_f64().is_some_and(|m| m < 0.5e-3)
    });

    refuses(&daemon, &["goal", "--position-m", "0,0,-0.5"], "would not be in the image");
    refuses(&daemon, &["goal", "--position-m", "2,0,0.5"], "would not be in the image");
    refuses(&daemon, &["goal", "--position-m", "0,0,50"], "smaller than 8 px");
    refuses(
        &daemon,
        &["goal", "--position-m", "0,0,0.4", "--rotation-rpy-deg", "180,0,0"],
        "the back of the target",
    );
    refuses(
        &daemon,
        &["goal", "--position-m", "0,0,0.4", "--rotation-rpy-deg", "89.5,0,0"],
        "(its plane would be seen 89.5 deg off its normal)",
    );
    refuses(
        &daemon,
        &["goal", "--position-m", "0,0,0.5", "--rotation-xyzw", "0,0,0,1.2"],
        "its numbers are none",
    );
    assert_eq!(accepts(&daemon, &["status"])["goal"], 2, "what is refused changes nothing");
    accepts(&daemon, &["shutdown"]);
    assert_eq!(daemon.ended().0, Some(0));
}

#[test]
fn a_goal_is_taught_on_the_way_and_taken_up_again() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("taught.toml");
    let file = path.to_str().unwrap();
    let daemon = Daemon::start("rt-teach", &["--clock", "lockstep"]);
    let start = posture(&daemon);
    accepts(&daemon, &["start"]);
    daemon.wait_for("servoing");
    wait_until("the arm to be on its way", || farthest(&posture(&daemon), &start) > 0.02);
    accepts(&daemon, &["teach", "--save", file, "--timeout-s", "120"]);
    accepts(&daemon, &["teach", "--save", file, "--timeout-s", "120"]);
    // A file that is no goal may be the run file.
    let other = folder.path().join("run.toml");
    std::fs::write(&other, "[run]\nseed = 3\n").unwrap();
    let (code, _, told) = ctl(&daemon, &["teach", "--save", other.to_str().unwrap()]);
    assert!(code == Some(2) && told.contains("no taught goal"), "{code:?} {told}");
    assert_eq!(std::fs::read_to_string(&other).unwrap(), "[run]\nseed = 3\n");
    let held = posture(&daemon);
    let written: toml::Table = std::fs::read_to_string(&path).unwrap().parse().unwrap();
    assert_eq!(written["target"].as_str(), Some("four_dots"));
    let q: Vec<f64> =
        written["q_rad_or_m"].as_array().unwrap().iter().map(|q| q.as_float().unwrap()).collect();
    assert!(farthest(&q, &held) < 1e-3, "{q:?} {held:?}");

    // Away, and back by the view alone.
    accepts(&daemon, &["goal", "--position-m", "-0.04,0.03,0.55"]);
    accepts(&daemon, &["start"]);
    converges(&daemon);
    assert!(farthest(&posture(&daemon), &held) > 0.05);
    accepts(&daemon, &["goal", file]);
    let status = converges(&daemon);
    assert!(farthest(&numbers(&status, "q_rad_or_m"), &held) < 2e-3, "{status} {held:?}");
    // Away, and back by the posture alone.
    accepts(&daemon, &["goal", "--position-m", "-0.04,0.03,0.55"]);
    converges(&daemon);
    accepts(&daemon, &["goto", file]);
    accepts(&daemon, &["wait", "state=held", "--timeout-s", "120"]);
    assert!(farthest(&posture(&daemon), &held) < 1e-3);

    let other = folder.path().join("other.toml");
    std::fs::write(&other, written.to_string().replace("four_dots", "chessboard")).unwrap();
    let (code, _, told) = ctl(&daemon, &["goal", other.to_str().unwrap()]);
    assert_eq!(code, Some(2), "{told}");
    assert!(told.contains("target.kind of the run is \"four_dots\""), "{told}");
    accepts(&daemon, &["shutdown"]);
    assert_eq!(daemon.ended().0, Some(0));
}

#[test]
fn goals_and_postures_of_the_run_file_are_known_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let taught = folder.path().join("taught.toml");
    let s = "features = [{ id = 0, s = [-0.1, -0.1] }, { id = 1, s = [0.1, -0.1] }, { id = 2, s = [0.1, 0.1] }, { id = 3, s = [-0.1, 0.1] }]";
    std::fs::write(&taught, format!("target = \"four_dots\"\nq_rad_or_m = [0.4, 0.2, 0.1, 0.3]\n{s}\n"))
        .unwrap();
    let file = format!("file=\"{}\"", taught.display());
    let left = "goals.left={position_m=[-0.04,0.03,0.55],rotation_rpy_deg=[0,0,-20]}";
    let (learnt, home) = (format!("goals.learnt={{{file}}}"), format!("postures.home={{{file}}}"));
    let daemon =
        Daemon::start("rt-names", &["--clock", "lockstep", "--set", left, "--set", &learnt, "--set", &home]);
    std::fs::remove_file(&taught).unwrap(); // the run has what stood in it
    accepts(&daemon, &["start"]);
    converges(&daemon);
    accepts(&daemon, &["goal", "left"]);
    let status = converges(&daemon);
    assert_eq!(status["goal"], 1);
    assert!(status["position_error_m"].as_f64().unwrap() < 0.5e-3, "{status}");
    accepts(&daemon, &["goto", "home"]);
    accepts(&daemon, &["wait", "state=held", "--timeout-s", "120"]);
    assert!(farthest(&posture(&daemon), &[0.4, 0.2, 0.1, 0.3]) < 1e-3);
    accepts(&daemon, &["goal", "learnt"]);
    for (request, name, why) in [
        ("goal", "lefd", "did you mean `left`?"),
        ("goto", "left", "not in [postures]"),
        ("goal", "no-such.toml", "cannot be read"),
    ] {
        let (code, _, told) = ctl(&daemon, &[request, name]);
        assert_eq!(code, Some(2), "{told}");
        assert!(told.contains(why), "{name}: {told}");
    }
    accepts(&daemon, &["shutdown"]);
    assert_eq!(daemon.ended().0, Some(0));
}

#[test]
fn an_arm_goes_where_it_is_sent_and_no_farther_than_it_may() {
    // Slow, so that a stop comes on the way also where a busy machine starts a client late: simulated time goes on meanwhile, fifty times as fast as the clock.
    let slow = "motion.max_acceleration_rad_s2_or_m_s2=[0.02]";
    let daemon = Daemon::start("rt-goto", &["--clock", "lockstep", "--set", slow]);
    let start = posture(&daemon);
    let there: Vec<f64> = start.iter().zip([0.3, -0.2, 0.1, 0.4]).map(|(q, d)| q + d).collect();
    let text = there.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
    accepts(&daemon, &["goto", "--q", &text]);
    accepts(&daemon, &["wait", "state=held", "--timeout-s", "120"]);
    assert!(farthest(&posture(&daemon), &there) < 1e-3, "{:?} {there:?}", posture(&daemon));

    accepts(&daemon, &["jog", "--q", "-0.1,0,0.02,0"]);
    accepts(&daemon, &["wait", "state=held", "--timeout-s", "120"]);
    let jogged = posture(&daemon);
    let wanted = [there[0] - 0.1, there[1], there[2] + 0.02, there[3]];
    assert!(farthest(&jogged, &wanted) < 1e-3, "{jogged:?} {wanted:?}");
    // Along the axis of the camera of a SCARA, which the third joint alone moves.
    accepts(&daemon, &["jog", "--position-m", "0,0,0.03"]);
    accepts(&daemon, &["wait", "state=held", "--timeout-s", "120"]);
    let lowered = posture(&daemon);
    assert!(
        (lowered[2] - jogged[2]).abs() > 0.0299 && (lowered[2] - jogged[2]).abs() < 0.0301,
        "{lowered:?}"
    );
    assert!(farthest(&[lowered[0], lowered[1], lowered[3]], &[jogged[0], jogged[1], jogged[3]]) < 1e-3);

    let (code, _, told) =
        ctl(&daemon, &["goal", "--position-m", "0,0,0.5", "--rotation-rpy-deg", "0,0,1e300"]);
    assert!(code == Some(2) && told.contains("allowed is -361 to 361"), "{code:?} {told}");
    refuses(&daemon, &["goto", "--q", "0,0,0"], "one for each joint");
    refuses(&daemon, &["goto", "--q", "100,0,0,0"], "leave its range");
    refuses(&daemon, &["jog", "--q", "0.5,0,0,0"], "at most");
    refuses(&daemon, &["jog", "--q", "0,0,0.1,0"], "at most");
    refuses(&daemon, &["jog", "--rotation-rpy-deg", "5,0,0"], "no posture of this arm");
    refuses(&daemon, &["goto", "--q", "nan,0,0,0"], "finite");

    // From the way: a stop ends it, a hold holds it, another posture takes its place.
    let home = start.iter().map(f64::to_string).collect::<Vec<_>>().join(",");
    accepts(&daemon, &["goto", "--q", &home]);
    daemon.refuses("start", "still moves");
    accepts(&daemon, &["stop"]);
    daemon.wait_for("idle");
    assert!(farthest(&posture(&daemon), &start) > 1e-3);
    accepts(&daemon, &["goto", "--q", &text]);
    accepts(&daemon, &["goto", "--q", &home]);
    accepts(&daemon, &["wait", "state=held", "--timeout-s", "120"]);
    assert!(farthest(&posture(&daemon), &start) < 1e-3);
    accepts(&daemon, &["start"]);
    converges(&daemon);
    accepts(&daemon, &["shutdown"]);
    let (code, printed) = daemon.ended();
    assert_eq!(code, Some(0), "{printed}");
    assert!(printed.contains("the posture that was asked for is reached"), "{printed}");
}

#[test]
fn an_arm_moves_by_velocities_and_rests_after_them() {
    let daemon = Daemon::start("rt-velocity", &["--clock", "lockstep"]);
    let start = posture(&daemon);
    accepts(&daemon, &["velocity", "--q", "0.2,-0.1,0.02,0.3", "--hold-s", "0.5"]);
    accepts(&daemon, &["wait", "state=held", "--timeout-s", "120"]);
    let there: Vec<f64> = start.iter().zip([0.1, -0.05, 0.01, 0.15]).map(|(q, d)| q + d).collect();
    assert!(farthest(&posture(&daemon), &there) < 3e-3, "{:?} {there:?}", posture(&daemon));

    refuses(
        &daemon,
        &["velocity", "--q", "0.1,0,0", "--hold-s", "0.5"],
        "one for each joint or six of the camera",
    );
    refuses(&daemon, &["velocity", "--q", "0.1,0,0,0", "--hold-s", "5"], "0.01 to 1 s");
    refuses(&daemon, &["velocity", "--camera", "nan,0,0,0,0,0"], "finite");

    // Over and over, from the loop of a program: it takes the arm over from the law, and the law takes it back on request.
    accepts(&daemon, &["start"]);
    daemon.wait_for("servoing");
    let client = vservo::client::Client::connect(&daemon.instance.name).unwrap();
    let arm = client.velocities(1.0).unwrap();
    for _ in 0..20 {
        let answer = arm.camera(&[0.01, 0.0, 0.0, 0.0, 0.0, 0.0]).unwrap();
        assert_eq!((answer.reason, answer.state), (None, "moving"));
    }
    client.hold().unwrap();
    accepts(&daemon, &["start"]);
    converges(&daemon);
    accepts(&daemon, &["shutdown"]);
    assert_eq!(arm.camera(&[0.0; 6]).map(|answer| answer.reason.is_none()).ok().filter(|taken| *taken), None);
    let (code, printed) = daemon.ended();
    assert_eq!(code, Some(0), "{printed}");
    assert!(printed.contains("no velocity is asked for any more"), "{printed}");
}

#[test]
fn what_may_change_in_a_running_loop_is_set_within_its_bounds() {
    let daemon = Daemon::start("rt-set", &["--clock", "lockstep", "--set", "goal.feature_error_px=0.000001"]);
    accepts(&daemon, &["start"]);
    daemon.wait_for("servoing");
    let (code, _, told) = ctl(&daemon, &["wait", "converged", "--timeout-s", "0.5"]);
    assert_eq!(code, Some(5), "no arm is as near as that: {told}");
    accepts(&daemon, &["set", "tolerance", "0.1"]);
    accepts(&daemon, &["set", "hold", "1"]);
    assert!(converges(&daemon)["at_goal_s"].as_f64().unwrap() >= 1.0);
    // An arm at its goal is not where a stricter one asks it to be, and has not been there for longer than it has.
    accepts(&daemon, &["set", "tolerance", "0.000001"]);
    let (code, _, told) = ctl(&daemon, &["wait", "converged", "--timeout-s", "0.5"]);
    assert_eq!(code, Some(5), "{told}");
    accepts(&daemon, &["set", "tolerance", "0.1"]);
    let held_s = converges(&daemon)["at_goal_s"].as_f64().unwrap() + 5.0;
    accepts(&daemon, &["set", "hold", &held_s.to_string()]);
    assert!(converges(&daemon)["at_goal_s"].as_f64().unwrap() >= held_s);
    accepts(&daemon, &["set", "gain", "4"]);
    for (what, value) in
        [("gain", "0"), ("gain", "1000"), ("tolerance", "-1"), ("hold", "100"), ("hold", "nan")]
    {
        refuses(&daemon, &["set", what, value], "out of bounds");
    }
    assert_eq!(ctl(&daemon, &["set", "mass", "1"]).0, Some(2));
    accepts(&daemon, &["shutdown"]);
    assert_eq!(daemon.ended().0, Some(0));

    let torque = concat!(env!("CARGO_MANIFEST_DIR"), "/config/scara-a.toml");
    let daemon = Daemon::start("rt-set-torque", &[torque, "--clock", "lockstep"]);
    refuses(&daemon, &["set", "gain", "4"], "no single gain");
    accepts(&daemon, &["shutdown"]);
    assert_eq!(daemon.ended().0, Some(0));
}
