//! `vservo calibrate load`.

use super::super::{CellArguments, check_writable, json, prepare, repeat, shown, write_report, write_result};
use crate::control::outcome::Outcome;
use crate::process::supervisor::{self, FinishedRun, RunOutputs};
use crate::process::{NewReport, ProcessError, StopFlag};
use crate::rt::tell;
use clap::Args;
use std::path::PathBuf;

/// Time enough, unless somebody says otherwise: the tour of an arm with seven joints takes one to two minutes, and one whose limits are low more.
const DURATION: &str = "run.duration_s=600";

/// Arguments of `vservo calibrate load`.
#[derive(Debug, Args)]
pub struct LoadArguments {
    /// What runs
    #[command(flatten)]
    pub cell: CellArguments,
    /// Write the lines for the run file to this file
    #[arg(long, value_name = "FILE.toml")]
    pub out: Option<PathBuf>,
    /// Print the summary of the run as JSON, with what was found in `load`
    #[arg(long)]
    pub json: bool,
    /// Write a report of the motion into this folder: index.html with figures, and all data as CSV; made when it does not exist
    #[arg(long, value_name = "DIR")]
    pub report: Option<PathBuf>,
}

/// Moves the arm, finds the load, and tells it; the exit code.
///
/// # Errors
/// When the run cannot be started.
pub(in crate::cli) fn load(arguments: &LoadArguments) -> Result<u8, ProcessError> {
    let stop = StopFlag::on_signals()?;
    let mut cell = arguments.cell.clone();
    cell.set.insert(0, DURATION.to_owned());
    let (config, instance) = prepare(&cell, ["run.task=calibrate_load".to_owned()], false)?;
    if let Some(path) = &arguments.out {
        check_writable(path)?;
    }
    let report = arguments.report.as_deref().map(NewReport::begin).transpose()?;
    let outputs = RunOutputs { report: report.as_ref().map(NewReport::folder), recording: None };
    let end = supervisor::run(&config, &instance, &stop, outputs)?;
    let exit_code = load_found(arguments, &end);
    let command = repeat::command(&["calibrate", "load"], &arguments.cell, &[], &end.summary);
    Ok(write_report(report, &config, &end.summary, command, exit_code))
}

/// Tells what was found; the exit code.
fn load_found(arguments: &LoadArguments, end: &FinishedRun) -> u8 {
    let mut exit_code = end.exit_code;
    if arguments.json {
        exit_code = shown(&json(&end.summary), exit_code);
    }
    let Some(found) = end.summary.load.as_ref().filter(|_| end.exit_code == 0) else {
        tell(format_args!("vservo: no load was found: {}", end.summary.reason));
        return if exit_code == 0 { Outcome::NotConverged.exit_code() } else { exit_code };
    };
    if !arguments.json {
        let lines = format!("{}\nput this into the run file:\n\n{}", found.to_text(), found.to_toml());
        exit_code = shown(&lines, exit_code);
    }
    if let Some(path) = &arguments.out {
        let text = format!("# vservo calibrate load: {}\n{}", found.describe(), found.to_toml());
        return write_result(path, text, exit_code);
    }
    exit_code
}
