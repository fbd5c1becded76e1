//! The arguments, as clap reads them.
#![allow(rustdoc::broken_intra_doc_links)] // the words of commands have brackets

use super::calibrate::Calibration;
pub use super::camera_arguments::CameraArguments;
use super::explain::{ExplainArguments, ReportArguments};
use super::layouts::LayoutLanguage;
use super::place_arguments::{PlaceArguments, ViewArguments};
use super::tool_arguments::{PoseArguments, ProcessArguments, StereoCommand};
use super::{
    benchmark::BenchmarkArguments, black_box::BlackBoxArguments, completion, ctl_arguments::CtlArguments,
    drive::DriveQuestion, emulate::EmulateCommand, export::ExportArguments, faults::FaultsArguments,
    man::ManArguments, monitor::MonitorArguments, record::RecordArguments, replay::ReplayArguments,
    target::TargetArguments, tune::TuneArguments, watch::WatchArguments,
};
use crate::camera_model::Response;
use clap::{Args, Parser, Subcommand, ValueEnum};
use clap_complete::engine::{ArgValueCandidates, ArgValueCompleter};
use std::path::PathBuf;

/// Visual servoing in real time: camera, vision and 1 kHz joint control over shared memory.
///
/// Without a sub-command: `vservo run` with the embedded default configuration.
#[derive(Debug, Parser)]
#[command(version, args_conflicts_with_subcommands = true)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Option<Command>,
    /// Arguments of `run`, where no sub-command is given.
    #[command(flatten)]
    pub run: RunArguments,
    /// How it logs.
    #[command(flatten)]
    pub log: LogArguments,
}

/// How everything logs.
#[derive(Debug, Args)]
pub struct LogArguments {
    /// Form of the log on stderr; json has time stamps (VSERVO_LOG_FORMAT; VSERVO_LOG says how much)
    #[arg(long, value_name = "text|json", global = true, value_parser = ["text", "json"])]
    pub log_format: Option<String>,
}

/// `vservo-camera`, `vservo-vision`, `vservo-control`.
#[derive(Debug, Parser)]
#[command(version)]
pub struct RoleCli {
    /// What runs.
    #[command(flatten)]
    pub role: RoleArguments,
    /// How it logs.
    #[command(flatten)]
    pub log: LogArguments,
}

/// Sub-commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Start camera, vision and control, watch them, and tell how it went
    Run(RunArguments),
    /// The daemon: start camera, vision and control, and do what `vservo ctl` says until it says shutdown
    Serve(ServeArguments),
    /// Have a running instance do the steps of a program: postures, goals, waits, commands
    Do(DoArguments),
    /// Tell a running instance what to do, or ask how it stands
    Ctl(CtlArguments),
    /// The camera process alone; --list, --probe and --snapshot look at the cameras of this machine
    Camera(CameraArguments),
    /// Find out whether an external drive keeps to its contract
    Drive {
        /// What to find out
        #[command(subcommand)]
        question: DriveQuestion,
    },
    /// The vision process alone
    Vision(RoleArguments),
    /// The guardian of a run with an external drive, which the supervisor starts
    #[command(hide = true)]
    Guardian(RoleArguments),
    /// The control process alone
    Control(RoleArguments),
    /// Write down everything that a running instance sends into an MCAP file
    Record(RecordArguments),
    /// Watch a running instance in this terminal, and start, hold, stop and teach it by keys
    Monitor(MonitorArguments),
    /// Show a running instance in a browser: its image, errors, joints, latencies and events, and nothing to press
    Watch(WatchArguments),
    /// Run control, or vision, again on what was recorded, and compare bit for bit
    Replay(ReplayArguments),
    /// Tell in words how a run went: what limited its speed, what made it fail, which key to change
    Explain(ExplainArguments),
    /// Write a recording for Foxglove, for ROS 2, or as tables
    Export(ExportArguments),
    /// Make the page of a run from its recording, or of two side by side
    Report(ReportArguments),
    /// Find out about the cell: cameras from images of a board, stamps by moving the arm
    Calibrate {
        /// What to find out
        #[command(subcommand)]
        what: Calibration,
    },
    /// Repeat the textbook's examples, comparison and problems: CSV files, figures, metrics.json
    Experiment(ExperimentArguments),
    /// Find a target in image files
    Detect(DetectArguments),
    /// Do image processing step by step on a picture: thresholds, gradients, contours, regions, moments, with a picture of each
    Process(ProcessArguments),
    /// The pose of an object from the image of its points, by each of the textbook's ways, with all solutions
    Pose(PoseArguments),
    /// Two views of one scene: conjugate points, rectified images, positions, displacement of the camera
    Stereo {
        /// What to do
        #[command(subcommand)]
        what: StereoCommand,
    },
    /// Make a target to print, in true size
    Target(TargetArguments),
    /// Make what the camera sees now the goal of later runs: features, pose, an image
    Teach(TeachArguments),
    /// Make the view that a pair of cameras is to come back to, from images of both in the desired pose
    TeachView(TeachViewArguments),
    /// Print a run file that comes with the program, to start from; without a name the default with all keys
    Config {
        /// Which
        #[arg(add = ArgValueCandidates::new(completion::run_files))]
        name: Option<String>,
        /// Tell which there are
        #[arg(long, conflicts_with = "name")]
        list: bool,
    },
    /// Check a run file: everything that is wrong with it, what the camera sees at start and goal, whether the arm gets there
    Check {
        /// Run file (TOML), or the name of a shipped one; the default where it is left out
        #[arg(add = ArgValueCompleter::new(completion::run_file))]
        config: Option<PathBuf>,
        /// Change one value first; may be repeated
        #[arg(long, value_name = "key.path=value", add = ArgValueCandidates::new(completion::keys))]
        set: Vec<String>,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// Propose a start and a goal for an arm and a target, from which a run converges, and write them as a run file
    Place(PlaceArguments),
    /// Search values with which simulated runs settle sooner, and tell what they cost in calm and margins
    Tune(TuneArguments),
    /// Measure the laws on tasks of visual servoing, with truth, starts and seeds from a file: tables, a page, benchmark.json
    Benchmark(BenchmarkArguments),
    /// Put faults into simulated runs of laws and arms, and tell how each ends and what the arm did: tables, faults.csv
    Faults(FaultsArguments),
    /// Draw what the camera sees at the start and at the goal of a run
    View(ViewArguments),
    /// Examine whether this machine is fit for 1 kHz: kernel, limits, clock, and wake-up latency
    Doctor {
        /// Print JSON
        #[arg(long)]
        json: bool,
        /// How long to measure the wake-up latency, s; 0 leaves it out
        #[arg(long, value_name = "S", default_value_t = 10.0)]
        jitter_s: f64,
    },
    /// Be a robot that there is not: its network protocols, with a simulated arm behind them
    Emulate {
        /// Which
        #[command(subcommand)]
        what: EmulateCommand,
    },
    /// Between the supervisor and the program of an external drive
    #[command(hide = true)]
    DriveGuard {
        /// Name of the run
        #[arg(long)]
        instance: String,
        /// Process id of the supervisor
        #[arg(long)]
        supervised_by: i32,
        /// The program and its arguments
        #[arg(last = true)]
        command: Vec<String>,
    },
    /// Print the records, codes and services by which programs in other languages take part: as a C or C++ header, a Python module, or JSON
    Layouts {
        /// Language
        #[arg(long, value_enum, default_value_t = LayoutLanguage::C)]
        lang: LayoutLanguage,
    },
    /// Print a completion script for a shell
    Completions(completion::CompletionArguments),
    /// Write manual pages of all commands
    Man(ManArguments),
}

/// Pace of the control loop.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum ClockArgument {
    /// 1 kHz by the machine's clock
    Realtime,
    /// Simulated clock, repeatable to the last bit
    Lockstep,
}

impl ClockArgument {
    fn setting(self) -> String {
        match self {
            Self::Realtime => "run.clock=realtime".into(),
            Self::Lockstep => "run.clock=lockstep".into(),
        }
    }
}

/// Which run file, with which changes, under which name: what every command that starts a run takes.
#[derive(Debug, Clone, Args)]
pub struct CellArguments {
    /// Run file (TOML), or the name of a shipped one (`vservo config --list`); the default where it is left out
    #[arg(add = ArgValueCompleter::new(completion::run_file))]
    pub config: Option<PathBuf>,
    /// Pace of the control loop (run.clock)
    #[arg(long)]
    pub clock: Option<ClockArgument>,
    /// Change one value of the run file; may be repeated
    #[arg(long, value_name = "key.path=value", add = ArgValueCandidates::new(completion::keys))]
    pub set: Vec<String>,
    /// Seed of every random number (run.seed)
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Name of this run: runs with different names do not see each other
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub instance: String,
}

impl CellArguments {
    /// All changes to the run file: `--set`, then the named options, then what the command itself sets.
    #[must_use]
    pub fn settings(&self, of_the_command: impl IntoIterator<Item = String>) -> Vec<String> {
        let mut set = self.set.clone();
        set.extend(self.clock.map(ClockArgument::setting));
        set.extend(self.seed.map(|seed| format!("run.seed={seed}")));
        set.extend(of_the_command);
        set
    }
}

/// Arguments of `vservo run`.
#[derive(Debug, Args)]
pub struct RunArguments {
    /// What runs
    #[command(flatten)]
    pub cell: CellArguments,
    /// Latest end of the run, s (run.duration_s)
    #[arg(long, value_name = "S")]
    pub duration_s: Option<f64>,
    /// Of a replay: the first damaged file ends the run (camera.replay.strict)
    #[arg(long)]
    pub strict: bool,
    /// Servo with an unknown lens, mount and target to a taught view: learn the image Jacobian by moving
    #[arg(long)]
    pub uncalibrated: bool,
    /// Run also where `vservo check` says that the arm cannot reach the goal
    #[arg(long)]
    pub anyway: bool,
    /// Write the summary to this file as JSON
    #[arg(long, value_name = "FILE.json")]
    pub summary: Option<PathBuf>,
    /// Write down everything that is sent into this file
    #[arg(long, value_name = "FILE.mcap")]
    pub record: Option<PathBuf>,
    /// Write a report into this folder: index.html with figures, and all data as CSV; made when it does not exist
    #[arg(long, value_name = "DIR")]
    pub report: Option<PathBuf>,
}

/// Arguments of `vservo serve`.
#[derive(Debug, Args)]
pub struct ServeArguments {
    /// What runs
    #[command(flatten)]
    pub cell: CellArguments,
    /// Servo with an unknown lens, mount and target to a taught view: learn the image Jacobian by moving
    #[arg(long)]
    pub uncalibrated: bool,
    /// Write the summary to this file as JSON, at the end
    #[arg(long, value_name = "FILE.json")]
    pub summary: Option<PathBuf>,
    /// Write down everything that is sent into this file
    #[arg(long, value_name = "FILE.mcap")]
    pub record: Option<PathBuf>,
    /// What is kept of the time before a fault
    #[command(flatten)]
    pub black_box: BlackBoxArguments,
}

/// Arguments of `vservo do`.
#[derive(Debug, Args)]
pub struct DoArguments {
    /// The program (TOML)
    pub program: PathBuf,
    /// Name of the run
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub instance: String,
}

/// Arguments of a single process.
#[derive(Debug, Args)]
pub struct RoleArguments {
    /// Run file (TOML) or the name of a shipped one, the same for all processes; the default where it is left out
    #[arg(add = ArgValueCompleter::new(completion::run_file))]
    pub config: Option<PathBuf>,
    /// Name of the run that this process belongs to
    #[arg(long, value_name = "NAME", default_value = "default")]
    pub instance: String,
    /// Change one value of the run file; must be the same for all processes
    #[arg(long, value_name = "key.path=value")]
    pub set: Vec<String>,
    /// camera, vision: for which camera, by its place in `[[cameras]]`, from 0
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub camera: u8,
    /// control: write the summary to this file as JSON
    #[arg(long, value_name = "FILE.json")]
    pub summary: Option<PathBuf>,
    /// control: print the summary as one line of JSON
    #[arg(long)]
    pub json: bool,
    /// Process id of the supervisor: this process ends when that one dies
    #[arg(long, hide = true)]
    pub supervised_by: Option<i32>,
    /// The run file is open on stdin; CONFIG is only its name
    #[arg(long, hide = true)]
    pub config_on_stdin: bool,
    /// control, vision: leave what a report is made of in this folder
    #[arg(long, hide = true, value_name = "DIR")]
    pub report: Option<PathBuf>,
}

/// Of `vservo experiment`.
#[derive(Debug, Args)]
pub struct ExperimentArguments {
    /// Name of the experiment, or `all`
    #[arg(required_unless_present = "list", add = ArgValueCandidates::new(completion::experiments))]
    pub name: Option<String>,
    /// Tell which there are
    #[arg(long)]
    pub list: bool,
    /// Folder for the results; made when it does not exist
    #[arg(long, value_name = "DIR", required_unless_present = "list")]
    pub out: Option<PathBuf>,
    /// Projected points as in the textbook, or pixels through renderer and detection
    #[arg(long, value_enum, default_value = "ideal")]
    pub camera: CameraArgument,
    /// Random starts of `convergence`
    #[arg(long, value_name = "N", default_value_t = 10_000)]
    pub count: usize,
}

/// Arguments of `vservo detect`.
#[derive(Debug, Args)]
pub struct DetectArguments {
    /// PNG, PNM or JPEG files
    #[arg(required = true, value_name = "IMAGE")]
    pub images: Vec<PathBuf>,
    /// What to look for: four_dots[:SIDE_M[:chiral]], dots:COLSxROWS:PITCH_M, chessboard:COLSxROWS:SQUARE_M (inner corners),
    /// tag:FAMILY:SIZE_M[:ID] (without an id all tags of the family), polygon:X_M,Y_M;X_M,Y_M;... (corners), ellipse:AxB (half its axes); or what edges show: segments[:MIN_LENGTH_PX],
    /// ellipses[:MIN_AXIS_PX]
    #[arg(long, value_name = "KIND")]
    pub target: String,
    /// Calibration file of ROS (YAML); with it the pose is computed too
    #[arg(long, value_name = "FILE")]
    pub camera: Option<PathBuf>,
    /// How grey levels depend on light: unknown (tags tell it by their edges), linear, srgb (most images in files), gamma:G, or table:L,L,... (light of 2 to 33 equally spaced levels)
    #[arg(long, value_name = "RESPONSE", default_value_t = Response::Unknown)]
    pub response: Response,
    /// Print JSON, one object a line and image
    #[arg(long)]
    pub json: bool,
    /// Write the image with what was found drawn over it
    #[arg(long, value_name = "OUT.png")]
    pub overlay: Option<PathBuf>,
}

/// Arguments of `vservo teach`.
#[derive(Debug, Args)]
pub struct TeachArguments {
    /// Run file (TOML), or the name of a shipped one; the default where it is left out
    #[arg(add = ArgValueCompleter::new(completion::run_file))]
    pub config: Option<PathBuf>,
    /// Images in place of the run file's camera; may be repeated
    #[arg(long = "image", value_name = "FILE")]
    pub images: Vec<PathBuf>,
    /// File to write, for `servo.set_point.file`; an image of the view is written beside it, as PNG
    #[arg(long, value_name = "FILE.toml")]
    pub out: PathBuf,
    /// The target of [targets.NAME] whose goal it is; left out: that of [target]
    #[arg(long, value_name = "NAME")]
    pub target: Option<String>,
    /// How many measurements to take the mean of
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub measurements: u32,
    /// For `vservo run --uncalibrated`: the points need not fit lens and target of the run file
    #[arg(long)]
    pub uncalibrated: bool,
    /// Change one value of the run file; may be repeated
    #[arg(long, value_name = "key.path=value", add = ArgValueCandidates::new(completion::keys))]
    pub set: Vec<String>,
}

/// Arguments of `vservo teach-view`.
#[derive(Debug, Args)]
pub struct TeachViewArguments {
    /// Run file (TOML) with [stereo]
    pub config: PathBuf,
    /// Images: left, right, and so on by turns
    #[arg(required = true, num_args = 2..)]
    pub images: Vec<PathBuf>,
    /// File to write, for `stereo.taught_file`; stdout where it is left out
    #[arg(long, value_name = "FILE.toml")]
    pub out: Option<PathBuf>,
    /// Change one value first; may be repeated
    #[arg(long, value_name = "key.path=value")]
    pub set: Vec<String>,
}

/// Camera of an experiment.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum CameraArgument {
    /// Projected points.
    Ideal,
    /// Rendered images.
    Rendered,
}
