//! `vservo calibrate latency`.

use super::super::{CellArguments, check_writable, json, prepare, repeat, shown, write_report, write_result};
use crate::control::outcome::Outcome;
use crate::process::supervisor::{self, FinishedRun, RunOutputs};
use crate::process::{NewReport, ProcessError, StopFlag};
use crate::rt::tell;
use clap::Args;
use std::path::PathBuf;

/// Arguments of `vservo calibrate latency`.
#[derive(Debug, Args)]
pub struct LatencyArguments {
    /// What runs
    #[command(flatten)]
    pub cell: CellArguments,
    /// Write the lines for the run file to this file
    #[arg(long, value_name = "FILE.toml")]
    pub out: Option<PathBuf>,
    /// Print the summary of the run as JSON, with what was found in `calibration`
    #[arg(long)]
    pub json: bool,
    /// Write a report of the motion into this folder: index.html with figures, and all data as CSV; made when it does not exist
    #[arg(long, value_name = "DIR")]
    pub report: Option<PathBuf>,
}

/// Moves the arm, finds the offset, and tells it; the exit code.
///
/// # Errors
/// When the run cannot be started.
pub(in crate::cli) fn latency(arguments: &LatencyArguments) -> Result<u8, ProcessError> {
    let stop = StopFlag::on_signals()?;
    let (config, instance) = prepare(&arguments.cell, ["run.task=calibrate_latency".to_owned()], false)?;
    if let Some(path) = &arguments.out {
        check_writable(path)?;
    }
    let report = arguments.report.as_deref().map(NewReport::begin).transpose()?;
    let outputs = RunOutputs { report: report.as_ref().map(NewReport::folder), recording: None };
    let end = supervisor::run(&config, &instance, &stop, outputs)?;
    let exit_code = latency_found(arguments, &end);
    let command = repeat::command(&["calibrate", "latency"], &arguments.cell, &[], &end.summary);
    Ok(write_report(report, &config, &end.summary, command, exit_code))
}

/// Tells what a calibration of the stamps found; the exit code.
fn latency_found(arguments: &LatencyArguments, end: &FinishedRun) -> u8 {
    let mut exit_code = end.exit_code;
    if arguments.json {
        exit_code = shown(&json(&end.summary), exit_code);
    }
    let Some(found) = end.summary.calibration.filter(|_| end.exit_code == 0) else {
        tell(format_args!("vservo: no offset was found: {}", end.summary.reason));
        return if exit_code == 0 { Outcome::NotConverged.exit_code() } else { exit_code };
    };
    if !arguments.json {
        let lines = format!("{}\nput this into the run file:\n\n{}", found.describe(), found.to_toml());
        exit_code = shown(&lines, exit_code);
    }
    if let Some(path) = &arguments.out {
        let text = format!("# vservo calibrate latency: {}\n{}", found.describe(), found.to_toml());
        return write_result(path, text, exit_code);
    }
    exit_code
}
