//! The command line: arguments -> configuration -> run -> exit code. Results go to stdout, everything else to stderr.

#![allow(clippy::print_stdout, clippy::print_stderr)]

mod arguments;

pub use arguments::{
    Calibration, CameraArgument, Cli, Command, ExperimentArguments, LatencyArguments, RoleArguments,
    RunArguments,
};

use crate::config::Config;
use crate::experiment;
use crate::ipc::{Instance, Role};
use crate::printable::printable;
use crate::process::{self, ProcessError, StopFlag, supervisor};
use crate::rt::doctor;
use crate::summary::Outcome;
use clap::{CommandFactory, Parser};
use std::io::{IsTerminal, Write, stderr, stdout};
use std::process::ExitCode;
use tracing_subscriber::EnvFilter;

/// `vservo`: everything, by sub-command.
#[must_use]
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    start_logging();
    let result = match cli.command {
        None => run(&cli.run),
        Some(Command::Run(arguments)) => run(&arguments),
        Some(Command::Camera(arguments)) => role(Role::Camera, &arguments),
        Some(Command::Vision(arguments)) => role(Role::Vision, &arguments),
        Some(Command::Control(arguments)) => role(Role::Control, &arguments),
        Some(Command::Calibrate { what: Calibration::Latency(arguments) }) => calibrate_latency(&arguments),
        Some(Command::Experiment(arguments)) => run_experiment(&arguments),
        Some(Command::Check { config, set }) => check(&config, &set),
        Some(Command::Doctor { json, jitter_s }) => Ok(doctor(json, jitter_s)),
        Some(Command::Completions { shell }) => {
            clap_complete::generate(shell, &mut Cli::command(), "vservo", &mut stdout());
            Ok(0)
        }
    };
    exit_code(result)
}

/// `vservo-camera`, `vservo-vision`, `vservo-control`: one role.
#[must_use]
pub fn role_main(role_of_binary: Role) -> ExitCode {
    let arguments = RoleArguments::parse();
    start_logging();
    exit_code(role(role_of_binary, &arguments))
}

fn exit_code(result: Result<u8, ProcessError>) -> ExitCode {
    match result {
        Ok(code) => ExitCode::from(code),
        Err(error) => {
            for line in error.lines() {
                eprintln!("vservo: {line}");
            }
            ExitCode::from(error.exit_code())
        }
    }
}

fn start_logging() {
    let filter =
        EnvFilter::try_from_env("VSERVO_LOG").unwrap_or_else(|_| EnvFilter::new("vservo=info,error"));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(stderr)
        .with_ansi(stderr().is_terminal())
        .without_time()
        .init();
    iceoryx2::prelude::set_log_level(iceoryx2::prelude::LogLevel::Error);
}

/// Tells what is allowed in a run file but hardly meant.
fn warn(config: &Config) {
    for warning in &config.warnings {
        eprintln!("vservo: warning: {}", printable(&warning.to_string()));
    }
}

fn run(arguments: &RunArguments) -> Result<u8, ProcessError> {
    let config = Config::load(arguments.config.as_deref(), &arguments.settings())?;
    warn(&config);
    let instance: Instance = arguments.instance.parse()?;
    let stop = StopFlag::on_signals()?;
    let options = supervisor::RunOptions { summary: arguments.summary.clone() };
    let end = supervisor::run(&config, &instance, &options, &stop)?;
    let _ = write!(stdout(), "{}", end.summary.to_text());
    Ok(end.exit_code)
}

fn calibrate_latency(arguments: &LatencyArguments) -> Result<u8, ProcessError> {
    let config = Config::load(arguments.config.as_deref(), &arguments.settings())?;
    warn(&config);
    let instance: Instance = arguments.instance.parse()?;
    if let Some(path) = &arguments.out {
        supervisor::check_writable(path)?;
    }
    let stop = StopFlag::on_signals()?;
    let end = supervisor::run(&config, &instance, &supervisor::RunOptions::default(), &stop)?;
    if arguments.json {
        let _ = writeln!(stdout(), "{}", serde_json::to_string_pretty(&end.summary).unwrap_or_default());
    }
    let Some(found) = end.summary.calibration.filter(|_| end.exit_code == 0) else {
        eprintln!("vservo: no offset was found: {}", end.summary.reason);
        return Ok(if end.exit_code == 0 { Outcome::NotConverged.exit_code() } else { end.exit_code });
    };
    if !arguments.json {
        print!("{}\nput this into the run file:\n\n{}", found.describe(), found.to_toml());
    }
    if let Some(path) = &arguments.out {
        let text = format!("# vservo calibrate latency: {}\n{}", found.describe(), found.to_toml());
        std::fs::write(path, text).map_err(|cause| ProcessError::Write { path: path.clone(), cause })?;
    }
    Ok(end.exit_code)
}

fn role(role: Role, arguments: &RoleArguments) -> Result<u8, ProcessError> {
    let stop = StopFlag::on_signals()?;
    let config = Config::load(arguments.config.as_deref(), &arguments.set)?;
    match arguments.supervised_by {
        Some(supervisor) => process::follow_parent(supervisor, &stop), // which has warned
        None => warn(&config),
    }
    let instance: Instance = arguments.instance.parse()?;
    match role {
        Role::Camera => process::camera::run(&config, &instance, &stop).map(|()| 0),
        Role::Vision => process::vision::run(&config, &instance, &stop).map(|()| 0),
        Role::Control | Role::Supervisor | Role::Drive => {
            let summary = process::control::run(&config, &instance, &stop)?;
            if let Some(path) = &arguments.summary {
                supervisor::write_summary(path, &summary)?;
            }
            let text = if arguments.json {
                serde_json::to_string(&summary).unwrap_or_default() + "\n"
            } else {
                summary.to_text()
            };
            let _ = write!(stdout(), "{text}");
            Ok(summary.outcome.exit_code())
        }
    }
}

fn check(config: &std::path::Path, set: &[String]) -> Result<u8, ProcessError> {
    let checked = Config::load(Some(config), set)?;
    warn(&checked);
    let i = checked.camera.model.intrinsics();
    println!(
        "{}: ok: {} on {}, {}x{} px at {} Hz, {}",
        printable(&config.display().to_string()),
        checked.scheme_name(),
        printable(&checked.robot.name),
        i.width_px,
        i.height_px,
        checked.camera.rate_hz,
        checked.clock_name()
    );
    Ok(0)
}

fn doctor(json: bool, jitter_s: f64) -> u8 {
    let checks = doctor::examine();
    let request = crate::config::RealtimeRequest { priority: 80, cpu: None, lock_memory: false };
    let jitter = (jitter_s > 0.0).then(|| doctor::measure(jitter_s.min(3600.0), request)).flatten();
    let report = doctor::Report { checks, jitter };
    let text = if json {
        serde_json::to_string_pretty(&report).unwrap_or_default() + "\n"
    } else {
        report.to_text()
    };
    let _ = write!(stdout(), "{text}");
    0
}

fn run_experiment(arguments: &ExperimentArguments) -> Result<u8, ProcessError> {
    let options = experiment::Options {
        camera: match arguments.camera {
            CameraArgument::Ideal => experiment::CameraKind::Ideal,
            CameraArgument::Rendered => experiment::CameraKind::Rendered,
        },
        count: arguments.count,
        progress: &|what| eprintln!("{what}"),
    };
    let mut text = String::new();
    for report in experiment::run(&arguments.name, &arguments.out, &options)? {
        text += &format!("{}\n", report.name);
        for line in &report.lines {
            text += &format!("  {line}\n");
        }
        for file in &report.files {
            text += &format!("  {}\n", file.display());
        }
    }
    let _ = write!(stdout(), "{text}");
    Ok(0)
}
