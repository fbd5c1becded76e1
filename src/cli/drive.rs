//! `vservo drive check`: whether the drive of a run file keeps to its contract, tried gently.

use super::{completion, json, shown};
use crate::config::{Config, DriveKind};
use crate::drive::check::{self, DriveRule, RuleFinding, RuleVerdict};
use crate::input::printable;
use crate::ipc::Instance;
use crate::process::{ProcessError, StopFlag, drive_check};
use clap::{Args, Subcommand};
use clap_complete::engine::{ArgValueCandidates, ArgValueCompleter};
use serde::Serialize;
use std::fmt::Write as _;
use std::path::PathBuf;

/// Questions about the drive of a run file.
#[derive(Debug, Subcommand)]
pub enum DriveQuestion {
    /// Start an external drive, hold its arm, move each joint by hundredths of a radian, and tell what it does wrong
    Check(DriveCheckArguments),
}

/// Arguments of `vservo drive check`.
#[derive(Debug, Args)]
pub struct DriveCheckArguments {
    /// Run file (TOML), or the name of a shipped one; the default where it is left out
    #[arg(add = ArgValueCompleter::new(completion::run_file))]
    pub config: Option<PathBuf>,
    /// Change one value of the run file; may be repeated
    #[arg(long, value_name = "key.path=value", add = ArgValueCandidates::new(completion::keys))]
    pub set: Vec<String>,
    /// Instance in which the drive is met
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub instance: String,
    /// Move nothing: the arm is held, and what needs motion is not tested
    #[arg(long)]
    pub no_motion: bool,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
    /// The drive's program and its arguments, in the place of drive.external.command; without any it is started by hand
    #[arg(last = true, value_name = "COMMAND")]
    pub command: Vec<String>,
}

/// The answer, for programs.
#[derive(Debug, Serialize)]
struct CheckedDrive {
    broken: usize,
    rules: Vec<CheckedRule>,
}

#[derive(Debug, Serialize)]
struct CheckedRule {
    #[serde(flatten)]
    finding: RuleFinding,
    /// How to mend it, where it is broken.
    #[serde(skip_serializing_if = "Option::is_none")]
    remedy: Option<&'static str>,
}

/// Does what was asked for.
pub(super) fn drive(question: &DriveQuestion) -> Result<u8, ProcessError> {
    let DriveQuestion::Check(arguments) = question;
    let stop = StopFlag::on_signals()?;
    let mut set = arguments.set.clone();
    if !arguments.command.is_empty() {
        set.push("drive.kind=external".into());
    }
    let mut config = Config::load(arguments.config.as_deref(), &set)?;
    if config.drive.kind != DriveKind::External {
        return Err(ProcessError::NoExternalDrive);
    }
    if !arguments.command.is_empty() {
        config.drive.external.command.clone_from(&arguments.command);
        config.drive.external.folder = std::env::current_dir().unwrap_or_default();
    }
    let instance: Instance = arguments.instance.parse()?;
    let logs = drive_check::run(&config, &instance, !arguments.no_motion, &stop)?;
    if stop.is_requested() {
        return Err(ProcessError::DriveCheckStopped);
    }
    let findings = explained(check::merged(logs.iter().flat_map(check::judge)), &config, arguments.no_motion);
    let broken = findings.iter().filter(|f| f.verdict == RuleVerdict::Broken).count();
    let text = if arguments.json {
        let remedy = |f: &RuleFinding| (f.verdict == RuleVerdict::Broken).then(|| f.rule.remedy());
        let rules = findings.into_iter().map(|finding| CheckedRule { remedy: remedy(&finding), finding });
        json(&CheckedDrive { broken, rules: rules.collect() })
    } else {
        table(&findings, broken)
    };
    Ok(shown(&text, if broken == 0 { 0 } else { 3 }))
}

/// Says why rules were not tested that no trial came to.
fn explained(mut findings: Vec<RuleFinding>, config: &Config, no_motion: bool) -> Vec<RuleFinding> {
    let answers = |f: &RuleFinding| f.rule == DriveRule::Answer && f.verdict == RuleVerdict::Ok;
    let why = if !findings.iter().any(answers) {
        "START was not answered"
    } else if no_motion {
        "nothing was to move (--no-motion)"
    } else if config.drive.external.command.is_empty() {
        "the drive was started by hand: name its program in drive.external.command, or after --"
    } else if config.clock == crate::config::Clock::Lockstep {
        "lockstep: a drive waits for its commands"
    } else {
        "a rule before it is broken, or the mode is torque: the arm is held, not moved"
    };
    for f in findings.iter_mut().filter(|f| f.verdict == RuleVerdict::NotTested && f.measured.is_empty()) {
        f.measured = why.into();
    }
    findings
}

/// A line for each rule, and how to mend what is broken.
fn table(findings: &[RuleFinding], broken: usize) -> String {
    let called =
        |f: &RuleFinding| f.mode.map_or_else(|| f.rule.to_string(), |mode| format!("{} ({mode})", f.rule));
    let width = findings.iter().map(|f| called(f).len()).max().unwrap_or(0);
    let mut text = String::new();
    for f in findings {
        let _ = writeln!(text, "{:width$}  {:10}  {}", called(f), f.verdict.as_str(), printable(&f.measured));
    }
    if broken == 0 {
        text += "nothing is broken\n";
    }
    let mut told = Vec::new();
    for rule in findings.iter().filter(|f| f.verdict == RuleVerdict::Broken).map(|f| f.rule) {
        if !told.contains(&rule) {
            told.push(rule);
            let _ = writeln!(text, "mend: {rule}: {}", rule.remedy());
        }
    }
    text
}
