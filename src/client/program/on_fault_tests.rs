#![allow(clippy::unwrap_used)]
use super::*;
use crate::client::fake_control::FakeControl;
use crate::config::NamedPlaces;
use crate::control::safety::Fault;
use std::path::Path;

/// A program whose last step of `[[on_fault]]` makes the file that is given back.
fn program(folder: &tempfile::TempDir, steps: &str) -> (Program, std::path::PathBuf) {
    let made = folder.path().join("made");
    let text = format!("{steps}[[on_fault]]\ncall = [\"touch\", \"{}\"]\n", made.display());
    let program = Program::parse("p.toml", &text, Path::new("."), NamedPlaces::default());
    (program.unwrap(), made)
}

#[test]
fn on_fault_is_done_while_its_fault_stands() {
    let folder = tempfile::tempdir().unwrap();
    let (program, made) = program(&folder, "[[steps]]\nwait_s = 20\n[[on_fault]]\nwait_s = 0.2\n");
    let control = FakeControl::served("stands");
    let mut fails = |line: &str| {
        if line.starts_with("steps[0]: wait") {
            control.fail(Fault::StopLatched.code());
        }
    };
    let end = control.client().run_program(&program, &mut fails).unwrap();
    assert_eq!((end.outcome, end.step.as_str()), (ProgramOutcome::Fault, "steps[0]"));
    assert!(made.exists() && !end.reason.contains("on_fault failed"), "{}", end.reason);
}

#[test]
fn a_fault_after_that_ends_on_fault_and_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let steps = "[[steps]]\nwait_s = 20\n[[on_fault]]\nreset = true\n[[on_fault]]\nwait_s = 20\n";
    for first in [Fault::StopLatched, Fault::TrackingError] {
        let (program, made) = program(&folder, steps);
        let control = FakeControl::served("another");
        let mut fails = |line: &str| {
            if line.starts_with("steps[0]: wait") {
                control.fail(first.code());
            } else if line.starts_with("on_fault[1]: wait") {
                control.fail(Fault::StopLatched.code());
            }
        };
        let end = control.client().run_program(&program, &mut fails).unwrap();
        assert_eq!(end.outcome, ProgramOutcome::Fault);
        assert!(end.reason.contains("; on_fault failed at on_fault[1]: fault (a stop"), "{}", end.reason);
        assert!(!made.exists());
    }
}

#[test]
fn a_motion_in_a_fault_ends_on_fault_and_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let steps = "[[steps]]\nwait_s = 20\n[[on_fault]]\nwait_s = 0.1\n[[on_fault]]\nservo = \"present\"\n";
    let (program, made) = program(&folder, steps);
    let control = FakeControl::served("moves");
    let mut fails = |line: &str| {
        if line.starts_with("steps[0]: wait") {
            control.fail(Fault::StopLatched.code());
        }
    };
    let end = control.client().run_program(&program, &mut fails).unwrap();
    assert!(end.reason.contains("; on_fault failed at on_fault[1]: fault (a stop"), "{}", end.reason);
    assert!(!made.exists() && control.state() == ControlState::Fault);
}

#[test]
fn on_fault_is_done_where_the_run_has_ended() {
    let folder = tempfile::tempdir().unwrap();
    let (program, made) = program(&folder, "[[steps]]\nwait_s = 20\n[[on_fault]]\nwait_s = 0.1\n");
    let mut control = Some(FakeControl::served("gone"));
    let client = control.as_ref().unwrap().client();
    let mut ends = |line: &str| {
        if line.starts_with("steps[0]: wait") {
            drop(control.take());
        }
    };
    let end = client.run_program(&program, &mut ends).unwrap();
    assert_eq!((end.outcome, end.reason.as_str()), (ProgramOutcome::Failed, "the run has ended"));
    assert!(made.exists());
}

#[test]
fn the_arm_is_held_before_on_fault_and_may_be_moved_there() {
    let folder = tempfile::tempdir().unwrap();
    let steps = "[[steps]]\nservo = \"present\"\n[[steps]]\ncall = [\"false\"]\n";
    for (more, state) in [
        ("", ControlState::Held),
        ("[[on_fault]]\nwait_s = 0.1\n[[on_fault]]\nservo = \"present\"\n", ControlState::Servoing),
    ] {
        let (program, made) = program(&folder, &format!("{steps}{more}"));
        let control = FakeControl::served("held");
        let mut at_first = None;
        let mut looks = |line: &str| {
            if line.starts_with("on_fault[0]") {
                at_first = Some(control.state());
            }
        };
        let end = control.client().run_program(&program, &mut looks).unwrap();
        assert_eq!(end.outcome, ProgramOutcome::Failed, "{}", end.reason);
        assert_eq!(at_first, Some(ControlState::Held), "before the first step");
        assert_eq!(control.state(), state, "what on_fault says");
        assert!(made.exists());
        std::fs::remove_file(made).unwrap();
    }
}
