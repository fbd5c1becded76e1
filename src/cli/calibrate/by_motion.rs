//! `vservo calibrate latency` and `vservo calibrate load`: what a gentle motion of the arm tells.

use super::super::{CellArguments, check_writable, json, prepare, repeat, shown, write_report, write_result};
use crate::control::outcome::Outcome;
use crate::process::supervisor::{self, FinishedRun, RunOutputs};
use crate::process::{NewReport, ProcessError, StopFlag};
use crate::report::summary::Summary;
use crate::rt::tell;
use clap::Args;
use std::path::PathBuf;

/// Time enough for a load, unless somebody says otherwise: the tour of an arm with seven joints takes one to two minutes, and one whose limits are low more.
const DURATION_OF_LOAD: &str = "run.duration_s=600";

/// Arguments of `vservo calibrate latency` and `vservo calibrate load`.
#[derive(Debug, Args)]
pub struct MotionArguments {
    /// What runs
    #[command(flatten)]
    pub cell: CellArguments,
    /// Write the lines for the run file to this file
    #[arg(long, value_name = "FILE.toml")]
    pub out: Option<PathBuf>,
    /// Print the summary of the run as JSON, with what was found in `calibration` or `load`
    #[arg(long)]
    pub json: bool,
    /// Write a report of the motion into this folder: index.html with figures, and all data as CSV; made when it does not exist
    #[arg(long, value_name = "DIR")]
    pub report: Option<PathBuf>,
}

/// What is sought.
#[derive(Debug, Clone, Copy)]
pub(in crate::cli) enum Sought {
    /// The offset of the camera's stamps.
    Latency,
    /// What the arm carries.
    Load,
}

/// What was found, in words and as lines of a run file.
struct Found {
    line: String,
    text: String,
    toml: String,
}

impl Sought {
    fn command(self) -> &'static str {
        match self {
            Self::Latency => "latency",
            Self::Load => "load",
        }
    }

    fn noun(self) -> &'static str {
        match self {
            Self::Latency => "offset",
            Self::Load => "load",
        }
    }

    fn found(self, summary: &Summary) -> Option<Found> {
        match self {
            Self::Latency => {
                let offset = summary.calibration.as_ref()?;
                let line = offset.describe();
                Some(Found { text: line.clone(), line, toml: offset.to_toml() })
            }
            Self::Load => {
                let load = summary.load.as_ref()?;
                Some(Found { text: load.to_text(), line: load.describe(), toml: load.to_toml() })
            }
        }
    }
}

/// Moves the arm, finds what is sought, and tells it; the exit code.
///
/// # Errors
/// When the run cannot be started.
pub(in crate::cli) fn by_motion(sought: Sought, arguments: &MotionArguments) -> Result<u8, ProcessError> {
    let stop = StopFlag::on_signals()?;
    let mut cell = arguments.cell.clone();
    if let Sought::Load = sought {
        cell.set.insert(0, DURATION_OF_LOAD.to_owned());
    }
    let (config, instance) = prepare(&cell, [format!("run.task=calibrate_{}", sought.command())], false)?;
    if let Some(path) = &arguments.out {
        check_writable(path)?;
    }
    let report = arguments.report.as_deref().map(NewReport::begin).transpose()?;
    let outputs = RunOutputs { report: report.as_ref().map(NewReport::folder), ..RunOutputs::default() };
    let end = supervisor::run(&config, &instance, &stop, outputs)?;
    let exit_code = tell_found(sought, arguments, &end);
    let command = repeat::command(&["calibrate", sought.command()], &arguments.cell, &[], &end.summary);
    Ok(write_report(report, &config, &end.summary, command, exit_code))
}

/// Tells what was found; the exit code.
fn tell_found(sought: Sought, arguments: &MotionArguments, end: &FinishedRun) -> u8 {
    let mut exit_code = end.exit_code;
    if arguments.json {
        exit_code = shown(&json(&end.summary), exit_code);
    }
    let Some(found) = sought.found(&end.summary).filter(|_| end.exit_code == 0) else {
        tell(format_args!("vservo: no {} was found: {}", sought.noun(), end.summary.reason));
        return if exit_code == 0 { Outcome::NotConverged.exit_code() } else { exit_code };
    };
    let Found { line, text, toml } = found;
    if !arguments.json {
        exit_code = shown(&format!("{text}\nput this into the run file:\n\n{toml}"), exit_code);
    }
    if let Some(path) = &arguments.out {
        let text = format!("# vservo calibrate {}: {line}\n{toml}", sought.command());
        return write_result(path, text, exit_code);
    }
    exit_code
}
