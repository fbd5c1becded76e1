//! `vservo do`, and the client of the library: whole tasks of a running instance.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)] // helpers of tests are tests

use crate::common::{Lines, vservo, wait_until};
use crate::serve::Daemon;
use std::process::{Child, Command, Stdio};
use vservo::client::{Client, WaitFor};
use vservo::geometry::Pose;

#[allow(missing_docs, unreachable_pub)] // it is a program of its own
#[path = "../../examples/pick_and_place.rs"]
mod pick_and_place;

fn command(daemon: &Daemon, program: &str) -> Command {
    let mut command = vservo();
    command.args(["do", program, "--instance", &daemon.instance.name]);
    command
}

/// `vservo do` to its end: exit code, stdout and stderr.
fn done(daemon: &Daemon, program: &str) -> (Option<i32>, String, String) {
    let output = command(daemon, program).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    assert!(!text(&output.stderr).contains("panicked"), "{}", text(&output.stderr));
    (output.status.code(), text(&output.stdout), text(&output.stderr))
}

fn begun(daemon: &Daemon, program: &str) -> (Child, Lines) {
    let mut child = command(daemon, program).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let lines = Lines::of(&mut child);
    (child, lines)
}

/// Writes a program and gives its path.
fn written(folder: &tempfile::TempDir, text: &str) -> String {
    let path = folder.path().join("program.toml");
    std::fs::write(&path, text).unwrap();
    path.to_str().unwrap().to_owned()
}

const SHIPPED: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/config/programs/pick-and-place.toml");

#[test]
fn the_shipped_program_is_done_to_its_end() {
    let daemon = Daemon::start("do-shipped", &["--clock", "lockstep"]);
    let (code, printed, told) = done(&daemon, SHIPPED);
    assert_eq!(code, Some(0), "{told}");
    assert_eq!(printed, "gripper: close\ngripper: open\n".repeat(2), "{told}");
    for line in [
        "steps[0]: goto home",
        "steps[1]: round 2 of 2",
        "steps[1].steps[2]: servo place",
        "done at steps[2]",
    ] {
        assert!(told.contains(line), "{line}: {told}");
    }
    let (_, status, _) = daemon.ctl("status");
    assert_eq!(status["state"], "held");
    let q: Vec<f64> = status["q_rad_or_m"].as_array().unwrap().iter().map(|q| q.as_f64().unwrap()).collect();
    assert!(q.iter().zip([0.1, 1.5, 0.45, -0.7]).all(|(q, home)| (q - home).abs() < 1e-3), "{q:?}");
    // Two goals of the program were set twice.
    assert_eq!(status["goal"], 4);
    // `ctl run` is the same.
    let folder = tempfile::tempdir().unwrap();
    let program = written(&folder, "[[steps]]\ncall = [\"echo\", \"by ctl\"]\n");
    let output =
        vservo().args(["ctl", "run", &program, "--instance", &daemon.instance.name]).output().unwrap();
    assert_eq!((output.status.code(), output.stdout.as_slice()), (Some(0), &b"by ctl\n"[..]));
    daemon.accepts("shutdown");
    assert_eq!(daemon.ended().0, Some(0));
}

#[test]
fn what_is_wrong_is_told_before_anything_moves() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start("do-wrong", &["--clock", "lockstep"]);
    let before = daemon.ctl("status").1["q_rad_or_m"].clone();
    let good = "[postures.home]\nq_rad_or_m = [0.1, 1.5, 0.45, -0.7]\n[[steps]]\ngoto = \"home\"\n";
    for (text, told_is, code) in [
        ("[[steps]]\nservo = \"pick\"\n".to_owned(), "program.toml:", 3),
        ("[[steps]]\nservo = \"pick\"\n".to_owned(), "steps[1].servo: `pick` is not in [goals]", 3),
        ("[[steps]]\ncall = [\"./gripper\"]\n".to_owned(), "there is no program `./gripper`", 3),
        (
            "[postures.short]\nq_rad_or_m = [0.1]\n[[steps]]\ngoto = \"short\"\n".to_owned(),
            "steps[1].goto: `short`: has 1 joints, the arm 4",
            3,
        ),
    ] {
        let (exit_code, _, told) = done(&daemon, &written(&folder, &format!("{good}{text}")));
        assert_eq!(exit_code, Some(code), "{told}");
        assert!(told.contains(told_is), "{told_is}: {told}");
    }
    // What only the run knows, within other steps and for a fault too, and all of it at once.
    let text = "[postures.far]\nq_rad_or_m = [0.1, 1.5, 7.0, -0.7]\n\
                [goals.flat]\nposition_m = [0, 0, 0.5]\nrotation_rpy_deg = [89.5, 0, 0]\n\
                [goals.beside]\nposition_m = [2, 0, 0.5]\n\
                [[steps]]\nrepeat = 2\nsteps = [{ wait_s = 1 }, { servo = \"flat\" }]\n\
                [[steps]]\ngoto = \"far\"\n[[on_fault]]\nservo = \"beside\"\n";
    let (exit_code, _, told) = done(&daemon, &written(&folder, &format!("{good}{text}")));
    assert_eq!(exit_code, Some(3), "{told}");
    for line in [
        "program.toml:14:28: steps[1].steps[1].servo: `flat`: the camera would see the target edge-on",
        "(its plane would be seen 89.5 deg off its normal)",
        "program.toml:16:1: steps[2].goto: `far`: the joint `joint_3` would be at 7, its range is",
        "program.toml:18:1: on_fault[0].servo: `beside`: the target would not be in the image",
    ] {
        assert!(told.contains(line), "{line}: {told}");
    }
    assert!(!told.contains("goto home"), "no step was begun: {told}");
    let (_, after, _) = daemon.ctl("status");
    assert_eq!((&after["q_rad_or_m"], &after["state"]), (&before, &"idle".into()), "nothing has moved");
    assert_eq!(after["goal"], 0, "nor was a goal set");
    daemon.accepts("shutdown");
    assert_eq!(daemon.ended().0, Some(0));
}

/// Goals and postures of the run file serve programs too; a program's own of the same name goes first.
#[test]
fn programs_know_the_names_of_the_run_file() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(
        "do-names",
        &[
            "--clock",
            "lockstep",
            "--set",
            "goals.pick={position_m=[-0.1,0.1,0.6],rotation_rpy_deg=[0,0,-60]}",
            "--set",
            "postures.home={q_rad_or_m=[0.1,1.5,0.45,-0.7]}",
            "--set",
            "postures.away={q_rad_or_m=[0.2,1.4,0.45,-0.7]}",
        ],
    );
    let own = "[postures.away]\nq_rad_or_m = [0.15, 1.45, 0.45, -0.7]\n\
               [[steps]]\ngoto = \"home\"\n[[steps]]\nservo = \"pick\"\n[[steps]]\ngoto = \"away\"\n";
    let (code, _, told) = done(&daemon, &written(&folder, own));
    assert_eq!(code, Some(0), "{told}");
    let (_, status, _) = daemon.ctl("status");
    let q: Vec<f64> = status["q_rad_or_m"].as_array().unwrap().iter().map(|q| q.as_f64().unwrap()).collect();
    assert!(q.iter().zip([0.15, 1.45, 0.45, -0.7]).all(|(q, away)| (q - away).abs() < 1e-3), "{q:?}");
    let (code, _, told) = done(&daemon, &written(&folder, "[[steps]]\ngoto = \"hom\"\n"));
    assert_eq!(code, Some(3), "{told}");
    assert!(told.contains("did you mean `home`?"), "{told}");
    daemon.accepts("shutdown");
    assert_eq!(daemon.ended().0, Some(0));
}

#[test]
fn a_program_ends_where_a_step_fails_or_somebody_stops_it() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start("do-fails", &["--clock", "lockstep"]);
    // A command that says no.
    let text = "[[steps]]\nservo = \"present\"\ntimeout_s = 60\n[[steps]]\ncall = [\"false\"]\n\
                [[steps]]\ncall = [\"echo\", \"never\"]\n[[on_fault]]\ncall = [\"echo\", \"sorry\"]\n";
    let (code, printed, told) = done(&daemon, &written(&folder, text));
    assert_eq!((code, printed.as_str()), (Some(5), "sorry\n"), "{told}");
    assert!(told.contains("failed at steps[1]: `false` ended with exit status: 1"), "{told}");
    daemon.wait_for("held");
    // What takes too long; without on_fault the arm holds.
    let text = "[[steps]]\nservo = \"present\"\ntimeout_s = 60\n[[steps]]\ncall = [\"sleep\", \"1000\"]\ntimeout_s = 0.3\n";
    let (code, _, told) = done(&daemon, &written(&folder, text));
    assert_eq!(code, Some(5), "{told}");
    assert!(told.contains("failed at steps[1]: its time is over"), "{told}");
    daemon.wait_for("held");
    // All rounds together, pauses included.
    let text = "[[steps]]\nrepeat = 1000\ntimeout_s = 0.5\nsteps = [{ wait_s = 0.2 }]\n";
    let (code, _, told) = done(&daemon, &written(&folder, text));
    assert_eq!(code, Some(5), "{told}");
    assert!(told.contains("its time is over (timeout_s of steps[0])"), "{told}");

    // Somebody stops the arm: the program ends, and does not start it again.
    let text = "[[steps]]\nrepeat = 1000\nsteps = [{ servo = \"present\" }, { wait_s = 0.2 }]\n";
    let program = written(&folder, text);
    let (mut child, mut lines) = begun(&daemon, &program);
    lines.wait_for("round 3 of 1000");
    daemon.accepts("stop");
    let line = lines.wait_for("stopped at");
    assert!(line.contains("by somebody else"), "{line}");
    assert_eq!(child.wait().unwrap().code(), Some(6));
    daemon.wait_for("idle");

    // Ctrl-C ends the program and holds the arm.
    let (mut child, mut lines) = begun(&daemon, &program);
    lines.wait_for("round 2 of 1000");
    crate::common::kill(child.id() as i32, "INT");
    lines.wait_for("stopped at");
    assert_eq!(child.wait().unwrap().code(), Some(6));
    daemon.wait_for("held");
    daemon.accepts("shutdown");
    assert_eq!(daemon.ended().0, Some(0));
}

#[test]
fn a_fault_leads_to_what_the_program_has_for_it() {
    let folder = tempfile::tempdir().unwrap();
    let file = concat!(env!("CARGO_MANIFEST_DIR"), "/config/pan_tilt.toml");
    let set = ["--set", "scene.arm.friction_scale=6.0", "--set", "safety.max_tracking_error_rad_or_m=0.0002"];
    let daemon = Daemon::start("do-fault", &[&[file, "--clock", "lockstep"], &set[..]].concat());
    let text = "[[steps]]\nservo = \"present\"\n[[on_fault]]\ncall = [\"echo\", \"before\"]\n\
                [[on_fault]]\nreset = true\n[[on_fault]]\ncall = [\"echo\", \"after\"]\n";
    let (code, printed, told) = done(&daemon, &written(&folder, text));
    assert_eq!((code, printed.as_str()), (Some(4), "before\nafter\n"), "{told}");
    assert!(told.contains("fault at steps[0]") && told.contains("max_tracking_error"), "{told}");
    wait_until("the fault to be cleared", || daemon.state() == "idle");
    daemon.accepts("shutdown");
    assert_eq!(daemon.ended().0, Some(0));
}

/// A goal, a posture or a motion of another client is not taken for the program's own, and the step after it is not done.
#[test]
fn goals_and_motions_of_others_end_a_program() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start("do-others", &["--clock", "lockstep"]);
    let other = Client::connect(&daemon.instance.name).unwrap();
    let goals = "[goals.pick]\nposition_m = [-0.1, 0.1, 0.6]\nrotation_rpy_deg = [0, 0, -60]\n";
    let postures = "[postures.home]\nq_rad_or_m = [0.1, 1.5, 0.45, -0.7]\n";
    let waits = "[[steps]]\nwait_s = 1000\n[[steps]]\ncall = [\"echo\", \"gripper closes\"]\n";
    let pose = Pose::from_parts(
        nalgebra::Translation3::new(-0.05, -0.05, 0.5),
        nalgebra::UnitQuaternion::identity(),
    );
    let ended = |step: &str, does: &dyn Fn(), why: &str| {
        let text = format!("{goals}{postures}[[steps]]\n{step}\n{waits}");
        let (mut child, mut lines) = begun(&daemon, &written(&folder, &text));
        lines.wait_for("wait 1000 s");
        does();
        let line = lines.wait_for("stopped at steps[1]");
        assert!(line.contains(why), "{line}");
        assert_eq!(child.wait().unwrap().code(), Some(6));
        daemon.wait_for("held");
    };
    let accepted = |answer: vservo::client::RunAnswer| assert!(answer.accepted, "{answer:?}");
    ended(
        "servo = \"pick\"",
        &|| accepted(other.goal_pose(&pose).unwrap()),
        "another goal was set by somebody else",
    );
    ended("servo = \"pick\"", &|| accepted(other.goto(&[0.1, 1.5, 0.45, -0.7]).unwrap()), "by somebody else");
    ended(
        "goto = \"home\"",
        &|| accepted(other.jog_joints(&[0.05, 0.0, 0.0, 0.0]).unwrap()),
        "taken over by somebody else",
    );

    // A motion that somebody else has begun goes on when the program ends by it.
    let text = format!("{postures}[[steps]]\ngoto = \"home\"\n{waits}");
    let (mut child, mut lines) = begun(&daemon, &written(&folder, &text));
    lines.wait_for("wait 1000 s");
    accepted(other.start().unwrap());
    let line = lines.wait_for("stopped at steps[1]");
    assert!(line.contains("by somebody else"), "{line}");
    assert_eq!(child.wait().unwrap().code(), Some(6));
    assert_ne!(daemon.state(), "held");
    accepted(other.hold().unwrap());

    // A client of the library waits for its own goal and for its own posture; from where the target is in view.
    let own = Client::connect(&daemon.instance.name).unwrap();
    accepted(own.goto(&[0.0, 1.57, 0.5, -0.785]).unwrap());
    assert!(own.wait(WaitFor::State(vservo::messages::ControlState::Held), 60.0).unwrap().is_reached);
    accepted(own.goal_pose(&pose).unwrap());
    accepted(other.goal_pose(&pose).unwrap());
    accepted(own.start().unwrap());
    let end = own.wait(WaitFor::Converged, 60.0).unwrap();
    assert!(!end.is_reached && end.reason.contains("another goal was set"), "{end:?}");
    assert!(own.wait(WaitFor::Converged, 60.0).unwrap().is_reached, "it knows now");
    let held = WaitFor::State(vservo::messages::ControlState::Held);
    accepted(own.goto(&[0.3, 1.2, 0.4, -0.2]).unwrap());
    accepted(other.jog_joints(&[0.01, 0.0, 0.0, 0.0]).unwrap());
    let end = own.wait(held, 60.0).unwrap();
    assert!(!end.is_reached && end.reason.contains("somebody else"), "{end:?}");
    accepted(own.goto(&[0.1, 1.5, 0.45, -0.7]).unwrap());
    assert!(own.wait(held, 60.0).unwrap().is_reached);
    daemon.accepts("shutdown");
    assert_eq!(daemon.ended().0, Some(0));
}

/// The example of the library, in this process.
#[test]
fn a_client_of_the_library_picks_and_places() {
    let daemon = Daemon::start("client-pick", &["--clock", "lockstep"]);
    let cell = Client::connect(&daemon.instance.name).unwrap();
    let mut gripped = Vec::new();
    pick_and_place::pick_and_place(&cell, &mut |what| gripped.push(what.to_owned())).unwrap();
    assert_eq!(gripped, ["close", "open"]);
    assert_eq!(cell.status().unwrap().goal, Some(2));
    let refused = cell.goto(&[0.0]).unwrap();
    assert!(
        !refused.accepted && refused.reason.as_ref().unwrap().contains("one for each joint"),
        "{refused:?}"
    );
    assert!(Client::connect("no-such-run").is_err());
    cell.shutdown().unwrap();
    assert_eq!(daemon.ended().0, Some(0));
}
