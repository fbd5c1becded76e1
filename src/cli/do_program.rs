//! `vservo do`, and `vservo ctl run`: a running instance does the steps of a program.

use crate::client::{Client, ProgramOutcome};
use crate::config::Program;
use crate::control::outcome::{Outcome, STOPPED};
use crate::input::printable;
use crate::process::{ProcessError, StopFlag};
use crate::rt::tell;
use std::path::Path;

/// Reads all of the program, for the names of this run's file, then does it. The exit code: 0 done, 4 a fault, 5 a step failed, 6 stopped.
pub(super) fn do_program(program: &Path, instance: &str) -> Result<u8, ProcessError> {
    let client = Client::connect(instance)?.interrupted_by(StopFlag::on_signals()?);
    let program = Program::load(program, client.named_places())?;
    let end = client.run_program(&program, &mut |line| tell(format_args!("{}", printable(line))))?;
    let (code, word) = match end.outcome {
        ProgramOutcome::Done => (0, "done"),
        ProgramOutcome::Fault => (Outcome::Fault.exit_code(), "fault"),
        ProgramOutcome::Failed => (Outcome::NotConverged.exit_code(), "failed"),
        ProgramOutcome::Stopped => (STOPPED, "stopped"),
    };
    tell(format_args!("{word} at {}: {}", end.step, printable(&end.reason)));
    Ok(code)
}
