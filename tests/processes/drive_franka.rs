//! Arms of Franka over the wire: control, the drive's process, and an emulated controller whose joints this test sees. Whatever ends a run leaves the arm at rest,
//! and says why.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // what is skipped is told

use crate::common::{Instance, Run, assert_accurate, kill, read_summary, run, run_once, vservo, wait_until};
use crate::drive::{ROBOT_PRIORITY, program, start_run};
use crate::serve::Daemon;
use std::net::{IpAddr, Ipv4Addr};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU8, Ordering};
use std::time::Duration;
use vservo::rt::with_priority;
use vservo_franka::emulator::{Emulator, EmulatorSettings, Fault, MISSED_CYCLES};
use vservo_franka::robot::RobotError;
use vservo_franka::{Joints, RobotMode};

/// Start of `fr3-emulated`, rad.
const START: Joints = [-0.1577, -0.5223, -0.1384, -2.1133, 0.0871, 1.7882, 0.2074];
const REFLEX: Fault = Fault::Reflex(RobotError::JointReflex);

/// A loopback address that no other test of this machine has.
fn address() -> IpAddr {
    static COUNT: AtomicU8 = AtomicU8::new(1);
    let [_, _, b, c] = std::process::id().to_be_bytes();
    Ipv4Addr::new(127, 170 + b % 40, c, COUNT.fetch_add(1, Ordering::Relaxed)).into()
}

/// A controller that waits longer than a robot for commands that a busy machine keeps back: a second.
pub(crate) fn robot() -> Emulator {
    let settings = EmulatorSettings { missed_cycles: 1000, ..EmulatorSettings::fr3(address(), START) };
    with_priority(ROBOT_PRIORITY, || Emulator::start(settings)).unwrap()
}

fn command(host: IpAddr, more: &[&str]) -> String {
    let host = host.to_string();
    let own = ["vservo-drive-franka", "--host", &host, "--silence-ms", "1000"];
    program(&[&own[..], more].concat())
}

/// Of a drive and of a control that a busy machine keeps back, too.
const PATIENT: [&str; 4] =
    ["--set", "safety.drive_timeout_ms=1000", "--set", "safety.guardian_timeout_ms=1000"];

/// A run with this robot, to its end.
pub(crate) fn run_with(test: &str, robot: &Emulator, extra: &[&str]) -> Run {
    let command = command(robot.address(), &[]);
    run(test, &[&["config/fr3-emulated.toml", "--set", &command], &PATIENT[..], extra].concat())
}

/// The same, still under way.
fn start_with(instance: &Instance, robot: &Emulator, summary: &Path) -> Child {
    let command = command(robot.address(), &[]);
    let slowly = ["--set", "servo.gain_1_s=0.4", "--summary", summary.to_str().unwrap()];
    let arguments = [&["config/fr3-emulated.toml", "--set", &command], &PATIENT[..], &slowly].concat();
    start_run(instance, &arguments, None)
}

fn assert_at_rest(robot: &Emulator) {
    wait_until("the arm at rest, without a motion", || {
        let (q, qd) = robot.arm();
        std::thread::sleep(Duration::from_millis(100));
        let way: f64 = robot.arm().0.iter().zip(&q).map(|(a, b)| (a - b).abs()).sum();
        qd.iter().all(|v| v.abs() < 1e-3) && way < 1e-4 && !robot.mode().1
    });
}

fn moves(robot: &Emulator) -> bool {
    robot.arm().1.iter().any(|v| v.abs() > 0.05)
}

#[test]
fn positions_and_velocities_converge_in_real_time() {
    for mode in ["position", "velocity"] {
        let robot = robot();
        let mode = format!("drive.mode={mode}");
        let r = run_with("frgoes", &robot, &["--set", &mode]);
        assert_accurate(&r);
        assert_at_rest(&robot);
        assert_eq!(robot.mode().0, RobotMode::Idle, "{:?}", robot.log());
        let gone: f64 = robot.arm().0.iter().zip(&START).map(|(a, b)| (a - b).abs()).sum();
        assert!(gone > 0.3, "{gone} rad: the arm behind the wire has moved");
        assert!(r.text().contains("vservo-drive-franka: robot at"), "{}", r.text());
    }
}

/// The emulator of the command line, with the arm of the run file behind it: positions, torques less its weights, and torques with a tool whose weight the robot adds
/// because it was told of it.
#[test]
fn the_run_files_own_arm_converges_behind_the_wire() {
    let tool = ["--set", "tool.mass_kg=1.5", "--set", "tool.com_m=[0.0, 0.0, 0.08]"];
    for (mode, carried) in [("position", &[][..]), ("torque", &[]), ("torque", &tool)] {
        let goes = || {
            let host = address();
            let mut emulator = vservo()
                .args(["emulate", "franka", "--missed-cycles", "1000", "--address", &host.to_string()])
                .args(carried)
                .stdout(Stdio::piped())
                .stderr(Stdio::piped())
                .spawn()
                .unwrap();
            wait_until("an emulator", || std::net::TcpStream::connect((host, 1337)).is_ok());
            let (command, mode) = (command(host, &[]), format!("drive.mode={mode}"));
            let set = ["config/fr3-emulated.toml", "--set", &command, "--set", &mode];
            let r = run_once("fremulated", &[&set[..], &PATIENT, carried].concat());
            kill(emulator.id() as i32, "TERM");
            assert_eq!(emulator.wait().unwrap().code(), Some(0));
            r
        };
        // A wrist that a last torque turns for as long as a busy machine holds control up becomes too fast, as a robot's would: such a run is begun again, with
        // another emulator: this one has stopped.
        let is_starved = |run: &Run| {
            let longest = run.summary["tick_us"]["wake"]["max"].as_f64();
            run.summary["outcome"] == "fault" && longest.is_some_and(|us| us > 5e3)
        };
        let calm = std::iter::repeat_with(goes).take(4).find(|run| !is_starved(run));
        assert_accurate(&calm.expect("a run that is not held up"));
    }
}

#[test]
fn a_stop_of_the_robot_ends_the_run_in_its_words() {
    for (fault, words) in [
        (REFLEX, "stopped by a reflex while the arm moved (joint_reflex)"),
        (Fault::UserStop, "the user stop is pressed while the arm moved"),
        (Fault::Close, "has closed the connection"),
    ] {
        let (robot, instance) = (robot(), Instance::new("frstops"));
        let folder = tempfile::tempdir().unwrap();
        let summary = folder.path().join("summary.json");
        let child = start_with(&instance, &robot, &summary);
        wait_until("a moving arm", || moves(&robot));
        robot.inject(fault);
        let output = child.wait_with_output().unwrap();
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(4), "{text}");
        let reason = read_summary(&summary)["reason"].as_str().unwrap().to_owned();
        assert!(reason.contains(words), "{fault:?}: {reason}\n{text}");
        assert_at_rest(&robot);
        instance.assert_gone();
    }
}

/// An instance that is served outlives a reflex: it is told as a protective stop, the arm rests, and a reset has it cleared; the user stop is not.
#[test]
fn a_served_robot_comes_back_by_a_reset() {
    let robot = robot();
    let set = command(robot.address(), &[]);
    let slow = ["config/fr3-emulated.toml", "--set", &set, "--set", "servo.gain_1_s=0.4"];
    let daemon = Daemon::start("frserved", &[&slow[..], &PATIENT].concat());
    let status = || daemon.ctl("status").1;
    wait_until("a robot that is ready", || status()["robot_state"] == "ready");
    daemon.accepts("start");
    wait_until("a moving arm", || moves(&robot));
    robot.inject(REFLEX);
    daemon.wait_for("fault");
    let answer = status();
    assert_eq!((&answer["robot_state"], &answer["robot_code"]), (&"protective_stop".into(), &407.into()));
    assert_at_rest(&robot);
    let q = robot.arm().0;
    wait_until("a reset that is taken", || daemon.ctl("reset").0 == Some(0));
    daemon.wait_for("idle");
    assert_eq!(robot.mode(), (RobotMode::Move, true));
    let way: f64 = robot.arm().0.iter().zip(&q).map(|(a, b)| (a - b).abs()).sum();
    assert!(way < 1e-3, "{way} rad: it is held where it was stopped");
    daemon.accepts("start");
    let wait = ["ctl", "wait", "converged", "--timeout-s", "120", "--instance", &daemon.instance.name];
    let wait = vservo().args(wait).output().unwrap();
    assert_eq!(wait.status.code(), Some(0), "{wait:?}");

    robot.inject(Fault::UserStop);
    daemon.wait_for("fault");
    wait_until("a refusal in words", || {
        let reason = daemon.ctl("reset").1["reason"].as_str().unwrap_or_default().to_owned();
        reason.contains("release its button")
    });
    assert_eq!((&status()["state"], &status()["robot_state"]), (&"fault".into(), &"emergency_stop".into()));
    assert_at_rest(&robot);
    daemon.accepts("shutdown");
    let (_, printed) = daemon.ended();
    assert!(printed.contains("the robot obeys commands again"), "{printed}");
}

#[test]
fn a_robot_that_may_not_move_is_refused_in_words() {
    for (fault, words) in [
        (Fault::Brakes, "open its brakes in Desk"),
        (REFLEX, "it is never cleared by itself"),
        (Fault::OldVersion, "the robot speaks version 9 of its interface, this driver version 10"),
    ] {
        let robot = robot();
        robot.inject(fault);
        let r = run_with("frrefused", &robot, &[]);
        assert_eq!(r.output.status.code(), Some(4), "{}", r.text());
        assert!(r.summary["reason"].as_str().unwrap().contains(words), "{}", r.summary);
        assert_eq!(robot.arm().0, START);
    }
    let robot = robot();
    robot.inject(REFLEX);
    let drive = env!("CARGO_BIN_EXE_vservo-drive-franka");
    let output =
        Command::new(drive).args(["--host", &robot.address().to_string(), "--recover"]).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    assert_eq!(robot.mode().0, RobotMode::Idle);
}

/// Whoever goes, in whatever way, leaves an arm at rest: control brakes it, or the drive does, or the robot itself.
#[test]
fn a_run_that_is_stopped_or_killed_leaves_the_arm_at_rest() {
    for signal in ["INT", "KILL"] {
        let (robot, instance) = (robot(), Instance::new("frkilled"));
        let folder = tempfile::tempdir().unwrap();
        let summary = folder.path().join("summary.json");
        let child = start_with(&instance, &robot, &summary);
        wait_until("a moving arm", || moves(&robot));
        kill(child.id() as i32, signal);
        child.wait_with_output().unwrap();
        assert_at_rest(&robot);
        if signal == "INT" {
            assert_eq!(read_summary(&summary)["outcome"], "stopped");
        }
        wait_until("the end of everybody", || {
            !Path::new(&format!("/dev/shm/vservo-{}", instance.name)).exists()
        });
    }
}

/// A client that is nobody's here, `pylibfranka`, against the emulator: states, positions, velocities and torques that move the arm, a reflex, its recovery.
#[test]
fn pylibfranka_receives_and_moves() {
    let python = std::env::var("VSERVO_PYTHON").unwrap_or_else(|_| "python3".into());
    let there = Command::new(&python).args(["-c", "import pylibfranka"]).output();
    if !there.is_ok_and(|output| output.status.success()) {
        assert!(std::env::var_os("VSERVO_REQUIRE_FRANKA").is_none(), "{python} has no pylibfranka");
        println!("skipped: {python} has no pylibfranka");
        return;
    }
    let robot = Emulator::start(EmulatorSettings {
        missed_cycles: 10 * MISSED_CYCLES,
        ..EmulatorSettings::fr3(address(), START)
    })
    .unwrap();
    let output = Command::new(&python)
        .args(["tests/fixtures/pylibfranka_client.py", &robot.address().to_string()])
        .output()
        .unwrap();
    let text = [output.stdout, output.stderr].map(|b| String::from_utf8_lossy(&b).into_owned()).concat();
    assert!(output.status.success(), "{text}");
    let words = |name: &str| text.lines().find_map(|line| line.strip_prefix(name)).expect(name).trim();
    let told = |name: &str| -> f64 { words(name).parse().unwrap() };
    // 1 kHz for a second; a busy machine sends fewer, never as few as a third.
    assert!((300.0..1100.0).contains(&told("states")), "{text}");
    // What it has seen is what the joints did. Of a motion that a busy machine broke off a part is left in front of the whole one.
    assert!((told("positioned") - 0.2).abs() < 1e-3 || text.contains("again"), "{text}");
    assert!((told("moved") - 0.1).abs() < 1e-3 || text.contains("again"), "{text}");
    assert!((0.03..0.5).contains(&told("pushed")) || text.contains("again"), "{text}");
    assert!(words("reflex").contains("joint_motion_generator_velocity_discontinuity"), "{text}");
    assert!((told("last_q0") - robot.arm().0[0]).abs() < 1e-6, "{text}");
    assert!(robot.arm().0[0] - START[0] > 0.19, "{text}");
    assert_at_rest(&robot);
}
