//! The command line: arguments -> configuration -> run -> exit code. Results go to stdout, everything else to stderr.

mod all_cores;
mod arguments;
mod benchmark;
mod black_box;
mod calibrate;
mod calibrate_arguments;
mod camera;
mod camera_arguments;
mod check;
mod completion;
mod ctl;
mod ctl_arguments;
mod detect;
mod do_program;
pub mod doctor;
mod drive;
mod drive_franka;
mod drive_ur;
mod emulate;
mod emulate_franka;
mod emulated_plant;
mod explain;
mod export;
mod faults;
mod layouts;
mod man;
mod misspelt;
mod monitor;
mod outputs;
mod place;
mod place_arguments;
mod pose_tool;
mod process_image;
mod record;
mod repeat;
mod replay;
mod shipped_file;
mod stereo_tool;
mod target;
mod teach;
mod teach_view;
mod tool_arguments;
mod tune;
mod uncalibrated;
mod view;
mod watch;
mod watched_run;

pub use arguments::{
    CameraArgument, CameraArguments, CellArguments, Cli, Command, DetectArguments, DoArguments,
    ExperimentArguments, LogArguments, RoleArguments, RoleCli, RunArguments, ServeArguments, TeachArguments,
    TeachViewArguments,
};
pub use benchmark::BenchmarkArguments;
pub use calibrate::{
    CalibrateFromArguments, CalibratePointsArguments, Calibration, HandEyeArguments, MotionArguments,
    PointLensArgument,
};
pub use calibrate_arguments::{
    BoardArguments, CalibrateCameraArguments, CalibrateStereoArguments, LensModelArgument, OddCoefficients,
};
pub use camera_arguments::{FormatArgument, SizeArgument};
pub use ctl_arguments::{CtlArguments, CtlCommand, CtlCommon, FixedNumbers, NumberList, SettingArgument};
pub use drive::{DriveCheckArguments, DriveQuestion};
pub use drive_franka::{DriveFrankaCli, drive_franka_main};
pub use drive_ur::{DriveUrCli, drive_ur_main};
pub use emulate::{EmulateCommand, EmulateUrArguments};
pub use emulate_franka::EmulateFrankaArguments;
pub use explain::{ExplainArguments, ReportArguments};
pub use export::{ExportArguments, ExportFor};
pub use faults::FaultsArguments;
pub use layouts::LayoutLanguage;
pub use monitor::MonitorArguments;
pub use place_arguments::{LookArgument, PlaceArguments, ViewArguments};
pub use record::RecordArguments;
pub use replay::ReplayArguments;
pub use target::{PaperArgument, TargetArguments};
pub use tool_arguments::{
    MotionMethod, PoseArguments, PoseMethod, ProcessArguments, StereoCommand, StereoMatchArguments,
    StereoMotionArguments, StereoRectifyArguments, StereoTriangulateArguments, TriangulationMethod,
};
pub use tune::TuneArguments;
pub use watch::WatchArguments;

use crate::config::assemble::require_controllable;
use crate::config::{Clock, Config, Draft};
use crate::experiment;
use crate::input::printable;
use crate::ipc::{Instance, Role};
use crate::messages::CameraId;
use crate::process::recorder::BlackBoxSettings;
use crate::process::supervisor::RunOutputs;
use crate::process::{self, NewReport, ProcessError, ReportFolder, StopFlag, run_report, supervisor};
use crate::report::summary::Summary;
use crate::rt::{self, print, tell};
use clap::Parser;
use misspelt::misspelt;
use outputs::{check_writable, lost, write_result};
use std::ffi::OsString;
use std::fs::File;
use std::io::stdin;
use std::os::fd::AsFd;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

/// `vservo`: everything, by sub-command.
#[must_use]
pub fn main() -> ExitCode {
    completion::answer();
    let cli = Cli::parse_from(log_format_last(std::env::args_os().collect()));
    log_as_asked(&cli.log);
    let result = match cli.command {
        None => match misspelt(cli.run.cell.config.as_deref()) {
            Some(message) => Err(ProcessError::NoCommand(message)),
            None => run_command(&cli.run),
        },
        Some(Command::Run(arguments)) => run_command(&arguments),
        Some(Command::Serve(arguments)) => {
            let results = Results {
                summary: arguments.summary.as_deref(),
                recording: arguments.record.as_deref(),
                report: None,
                black_box: arguments.black_box.settings(arguments.record.as_deref()),
            };
            let cell = arguments.cell.uncalibrated(arguments.uncalibrated);
            run(&cell, ["run.serve=true".to_owned()], results, false)
        }
        Some(Command::Do(arguments)) => do_program::do_program(&arguments.program, &arguments.instance),
        Some(Command::Ctl(arguments)) => ctl::ctl(&arguments),
        Some(Command::Camera(arguments)) => match camera::look(&arguments) {
            Some(result) => result,
            None => role(Role::Camera(CameraId::FIRST), &arguments.into()),
        },
        Some(Command::Drive { question }) => drive::drive(&question),
        Some(Command::Vision(arguments)) => role(Role::Vision(CameraId::FIRST), &arguments),
        Some(Command::Guardian(arguments)) => role(Role::Guardian, &arguments),
        Some(Command::Control(arguments)) => role(Role::Control, &arguments),
        Some(Command::Record(arguments)) => record::record(&arguments),
        Some(Command::Monitor(arguments)) => monitor::monitor(&arguments),
        Some(Command::Watch(arguments)) => watch::watch(&arguments),
        Some(Command::Replay(arguments)) => replay::replay(&arguments),
        Some(Command::Explain(arguments)) => explain::explain(&arguments),
        Some(Command::Export(arguments)) => export::export(&arguments),
        Some(Command::Report(arguments)) => explain::report(&arguments),
        Some(Command::Calibrate { what }) => calibrate::calibrate(&what),
        Some(Command::Experiment(arguments)) => run_experiment(&arguments),
        Some(Command::Detect(arguments)) => detect::detect(&arguments),
        Some(Command::Process(arguments)) => process_image::process_image(&arguments),
        Some(Command::Pose(arguments)) => pose_tool::pose(&arguments),
        Some(Command::Stereo { what }) => stereo_tool::stereo(&what),
        Some(Command::Target(arguments)) => target::target(&arguments),
        Some(Command::Teach(arguments)) => teach::teach(&arguments),
        Some(Command::TeachView(arguments)) => teach_view::teach_view(&arguments),
        Some(Command::Check { config, set, json }) => check::check(config.as_deref(), &set, json),
        Some(Command::Place(arguments)) => place::place(&arguments),
        Some(Command::Benchmark(arguments)) => benchmark::benchmark(&arguments),
        Some(Command::Faults(arguments)) => faults::faults(&arguments),
        Some(Command::Tune(arguments)) => tune::tune(&arguments),
        Some(Command::View(arguments)) => view::view(&arguments),
        Some(Command::Doctor { json, jitter_s }) => Ok(doctor::doctor(json, jitter_s)),
        Some(Command::DriveGuard { instance, supervised_by, command }) => {
            guard_drive(&command, &instance, supervised_by)
        }
        Some(Command::Emulate { what }) => emulate::emulate(&what),
        Some(Command::Config { name, list }) => shipped_file::shipped_file(name.as_deref(), list),
        Some(Command::Layouts { lang }) => Ok(shown(&layouts::layouts(lang), 0)),
        Some(Command::Completions(arguments)) => completion::print_script(&arguments),
        Some(Command::Man(arguments)) => man::write_pages(&arguments),
    };
    exit_code(result)
}

/// `vservo-camera`, `vservo-vision`, `vservo-control`: one role.
#[must_use]
pub fn role_main(role_of_binary: Role) -> ExitCode {
    let cli = RoleCli::parse();
    log_as_asked(&cli.log);
    exit_code(role(role_of_binary, &cli.role))
}

fn exit_code(result: Result<u8, ProcessError>) -> ExitCode {
    match result {
        Ok(code) => ExitCode::from(code),
        Err(error) => {
            for line in error.lines() {
                tell(format_args!("vservo: {line}"));
            }
            ExitCode::from(error.exit_code())
        }
    }
}

/// Shows results on stdout; the exit code. Results that cannot be shown are those of a file that cannot be written.
fn shown(text: &str, exit_code: u8) -> u8 {
    match print(text) {
        Ok(()) => exit_code,
        Err(cause) => lost(Path::new("stdout"), cause, exit_code),
    }
}

fn json(result: &impl serde::Serialize) -> String {
    serde_json::to_string_pretty(result).unwrap_or_default() + "\n"
}

/// Options of `run` and a command exclude each other, where clap counts `--log-format` before a command among the former: it is put
/// behind it.
fn log_format_last(mut arguments: Vec<OsString>) -> Vec<OsString> {
    let count = match arguments.get(1).map(|first| first.as_encoded_bytes()) {
        Some(b"--log-format") if arguments.len() > 3 => 2,
        Some(first) if first.starts_with(b"--log-format=") && arguments.len() > 2 => 1,
        _ => return arguments,
    };
    // behind `--` stands what belongs to others
    let end = arguments.iter().position(|a| a == "--").unwrap_or(arguments.len());
    if let Some(part) = arguments.get_mut(1..end) {
        part.rotate_left(count);
    }
    arguments
}

fn log_as_asked(arguments: &LogArguments) {
    rt::start_logging(arguments.log_format.as_deref().and_then(|form| form.parse().ok()));
    iceoryx2::prelude::set_log_level(iceoryx2::prelude::LogLevel::Error);
}

/// Tells what is allowed in a run file but hardly meant.
fn warn(config: &Config) {
    for warning in &config.warnings {
        tell(format_args!("vservo: warning: {}", printable(&warning.to_string())));
    }
}

fn run_command(arguments: &RunArguments) -> Result<u8, ProcessError> {
    let duration = arguments.duration_s.map(|s| format!("run.duration_s={s:?}"));
    let strict = arguments.strict.then(|| "camera.replay.strict=true".to_owned());
    let report = arguments.report.as_deref().map(|folder| (folder, repeat::of_run(arguments)));
    let (summary, recording) = (arguments.summary.as_deref(), arguments.record.as_deref());
    let results = Results { summary, recording, report, black_box: None };
    let cell = arguments.cell.uncalibrated(arguments.uncalibrated);
    run(&cell, duration.into_iter().chain(strict), results, !arguments.anyway)
}

/// Where the results of a run go, beside stdout.
struct Results<'a> {
    /// A file for the summary.
    summary: Option<&'a Path>,
    /// A file for everything that was sent.
    recording: Option<&'a Path>,
    /// A folder for the report, and the words of the command that repeats the run.
    report: Option<(&'a Path, Vec<String>)>,
    /// What is kept of the time before a fault.
    black_box: Option<BlackBoxSettings>,
}

/// Runs a cell with settings of the command; `refuses` a goal that the arm cannot reach.
fn run(
    cell: &CellArguments,
    settings: impl IntoIterator<Item = String>,
    results: Results<'_>,
    refuses: bool,
) -> Result<u8, ProcessError> {
    // First of all: a request to stop that comes early is one too.
    let stop = StopFlag::on_signals()?;
    let (config, instance) = prepare(cell, settings, refuses)?;
    let Results { summary, recording, report, black_box } = results;
    for path in summary.into_iter().chain(recording) {
        check_writable(path)?;
    }
    let (folder, words) = report.unzip();
    let report = folder.map(NewReport::begin).transpose()?;
    // Nobody waits for it, so that of a simulated clock it would miss most.
    let black_box = black_box.as_ref().filter(|_| config.clock == Clock::Realtime);
    let outputs = RunOutputs { report: report.as_ref().map(NewReport::folder), recording, black_box };
    let end = supervisor::run(&config, &instance, &stop, outputs)?;
    let exit_code = shown(&end.summary.to_text(), end.exit_code);
    let exit_code = write_summary(summary, &end.summary, exit_code);
    let command = repeat::command(&["run"], cell, &words.unwrap_or_default(), &end.summary);
    Ok(write_report(report, &config, &end.summary, command, exit_code))
}

/// Makes the page of a run, where a folder was named for it. The exit code, as for other results that cannot be written.
fn write_report(
    report: Option<NewReport>,
    config: &Config,
    summary: &Summary,
    command: String,
    exit_code: u8,
) -> u8 {
    let Some(report) = report else { return exit_code };
    match run_report::write(report, config, summary, &[command]) {
        Ok(page) => {
            tell(format_args!("report: {}", printable(&page.display().to_string())));
            exit_code
        }
        Err(error) => {
            error.lines().iter().for_each(|line| tell(format_args!("vservo: {line}")));
            if exit_code == 0 { error.exit_code() } else { exit_code }
        }
    }
}

/// The cell that a supervisor is to run, and its name; `refuses` a goal that the arm cannot reach.
fn prepare(
    cell: &CellArguments,
    settings: impl IntoIterator<Item = String>,
    refuses: bool,
) -> Result<(Config, Instance), ProcessError> {
    let draft = Draft::load(cell.config.as_deref(), &cell.settings(settings))?;
    let config = draft.clone().validate()?;
    require_controllable(&config)?;
    warn(&config);
    check::warn_of_preflight(&draft, &config, refuses)?;
    Ok((config, cell.instance.parse()?))
}

/// The summary as JSON, where a file was named for it. The exit code.
fn write_summary(path: Option<&Path>, summary: &Summary, exit_code: u8) -> u8 {
    path.map_or(exit_code, |path| write_result(path, json(summary), exit_code))
}

/// Longest time from the interruption of a call by a signal to the flag of the thread that handles it. Chosen by hand, for a loaded machine.
const SIGNAL_DELIVERY: Duration = Duration::from_millis(100);

fn role(role: Role, arguments: &RoleArguments) -> Result<u8, ProcessError> {
    let stop = StopFlag::on_signals()?;
    let config = match &arguments.config {
        Some(name) if arguments.config_on_stdin => config_on_stdin(name, &arguments.set)?,
        config => Config::load(config.as_deref(), &arguments.set)?,
    };
    match arguments.supervised_by {
        Some(supervisor) => process::follow_parent(supervisor, &stop), // which has warned
        None => warn(&config),
    }
    let awaited = config.awaits_its_end();
    let instance: Instance = arguments.instance.parse()?;
    if let Some(path) = &arguments.summary {
        check_writable(path)?;
    }
    let report = arguments.report.as_deref().map(ReportFolder::of_run);
    let report = report.as_ref();
    let ended = match role {
        Role::Camera(_) => {
            process::camera::run(&seen_by(arguments.camera, config)?, &instance, &stop).map(|()| None)
        }
        Role::Vision(_) => {
            let run = if config.stereo.is_some() {
                process::stereo_vision::run(
                    &pair_seen_by(arguments.camera, config)?,
                    &instance,
                    &stop,
                    report,
                )
            } else {
                process::vision::run(&seen_by(arguments.camera, config)?, &instance, &stop, report)
            };
            run.map(|()| None)
        }
        Role::Guardian => process::guardian::run(&config, &instance, &stop).map(|()| None),
        Role::Control
        | Role::Supervisor
        | Role::Drive
        | Role::CameraProgram(_)
        | Role::Recorder
        | Role::BlackBox => process::control::run(&config, &instance, &stop, report).map(Some),
    };
    match ended {
        Ok(None) => Ok(0),
        // The signal that asks for the stop interrupts the transport where it joins: that is the stop, not a failure.
        Err(ProcessError::Ipc(error)) if stop.is_requested_within(SIGNAL_DELIVERY) => {
            tracing::debug!("stopped while joining: {error}");
            Ok(0)
        }
        Err(error) => Err(error),
        Ok(Some(summary)) => {
            let text = if arguments.json {
                serde_json::to_string(&summary).unwrap_or_default() + "\n"
            } else {
                summary.to_text()
            };
            let exit_code = shown(&text, summary.outcome.exit_code_of(awaited));
            Ok(write_summary(arguments.summary.as_deref(), &summary, exit_code))
        }
    }
}

/// The configuration as the process of one camera has it: `camera` is that camera.
fn seen_by(camera: u8, config: Config) -> Result<Config, ProcessError> {
    let cameras = config.cameras().count();
    config.seen_by(CameraId(camera)).ok_or(ProcessError::NoSuchCamera { camera, cameras })
}

/// The configuration as the one vision process of a pair of cameras has it.
fn pair_seen_by(camera: u8, config: Config) -> Result<Config, ProcessError> {
    match camera {
        0 => Ok(config),
        camera => Err(ProcessError::OneVision { camera }),
    }
}

fn guard_drive(command: &[String], instance: &str, supervisor: i32) -> Result<u8, ProcessError> {
    let stop = StopFlag::on_signals()?;
    process::drive_guard::run(command, &instance.parse()?, supervisor, &stop)
}

/// The run file that a supervisor has open on this process's stdin. All its children have the same file, so that each
/// reads from its beginning, wherever the others are.
fn config_on_stdin(name: &Path, set: &[String]) -> Result<Config, ProcessError> {
    let read = || {
        let file = File::from(stdin().as_fd().try_clone_to_owned()?);
        let mut text = vec![0; usize::try_from(file.metadata()?.len()).unwrap_or_default()];
        file.read_exact_at(&mut text, 0)?;
        String::from_utf8(text).map_err(|e| std::io::Error::new(std::io::ErrorKind::InvalidData, e))
    };
    let text = read().map_err(|cause| ProcessError::Start { what: "with the run file on stdin", cause })?;
    Ok(Config::parse(&name.display().to_string(), &text, Path::new("."), set)?)
}

fn run_experiment(arguments: &ExperimentArguments) -> Result<u8, ProcessError> {
    let options = experiment::Options {
        camera: match arguments.camera {
            CameraArgument::Ideal => experiment::CameraKind::Ideal,
            CameraArgument::Rendered => experiment::CameraKind::Rendered,
        },
        count: arguments.count,
        progress: &|what| tell(what),
    };
    let (mut text, mut unwritten) = (String::new(), None);
    let (Some(name), Some(out)) = (&arguments.name, &arguments.out) else {
        return Ok(shown(&experiment::list(), 0));
    };
    for report in experiment::run(name, out, &options)? {
        text += &format!("{}\n", report.name);
        for line in &report.lines {
            text += &format!("  {line}\n");
        }
        match report.files {
            Ok(files) => files.iter().for_each(|file| text += &format!("  {}\n", file.display())),
            Err(error) => unwritten = Some(error),
        }
    }
    let exit_code = shown(&text, 0);
    unwritten.map_or(Ok(exit_code), |error| Err(error.into()))
}
