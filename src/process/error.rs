//! What can end a process before its time, and the exit code that says so.

use crate::config::ConfigError;
use crate::config::assemble::AssembleError;
#[cfg(feature = "cli")]
use crate::experiment::ExperimentError;
use crate::input::printable;
use crate::ipc::{Disagreement, InstanceError, IpcError};
#[cfg(feature = "cli")]
use crate::record::RecordingError;
#[cfg(feature = "cli")]
use crate::replay::ReplayError;
use crate::robot::RobotError;
#[cfg(feature = "cli")]
use crate::rt::IsRead;
#[cfg(feature = "cli")]
use crate::rt::SchedulingError;
#[cfg(feature = "cli")]
use crate::source::SourceError;
use std::fmt;
use std::path::PathBuf;
use thiserror::Error;

/// A process cannot start or go on.
#[derive(Debug, Error)]
pub enum ProcessError {
    /// The configuration is wrong.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The instance's name or place is not usable, or taken.
    #[error(transparent)]
    Instance(#[from] InstanceError),
    /// Shared memory failed.
    #[error(transparent)]
    Ipc(#[from] IpcError),
    /// The source of frames failed.
    #[cfg(feature = "cli")]
    #[error(transparent)]
    Source(#[from] SourceError),
    /// A camera that runs by itself gives no frames any more.
    #[error("the camera has given no frame for {0:.1} s: is it connected, and does it run?")]
    SourceSilent(f64),
    /// A camera that was away for longer than it may be.
    #[error(
        "the camera is {state}: no frame for {lasted_s:.1} s (`give_up_s` of its table); see to its cable and \
         power, or to its program"
    )]
    CameraAway {
        /// What is wrong with it.
        state: &'static str,
        /// How long.
        lasted_s: f64,
    },
    /// A camera that was to be looked at gave nothing.
    #[error(
        "{device}: no frame within {waited_s:.1} s; is it triggered from outside, or covered by another program?"
    )]
    NoFrame {
        /// The device.
        device: String,
        /// How long it was waited for.
        waited_s: f64,
    },
    /// A run file without a camera that could be looked at.
    #[error("camera.source: is no camera of this machine: set it to {instead}")]
    NoRealCamera {
        /// What would be one.
        instead: &'static str,
    },
    /// The program of an external camera was over before it had given anything.
    #[error(
        "camera.external.command: `{program}` ended with {status} before it gave an image; what it said stands above"
    )]
    CameraProgramEnded {
        /// The program.
        program: String,
        /// How it ended.
        status: std::process::ExitStatus,
    },
    /// A run file without a drive that could be checked.
    #[error("drive.kind: is no program of its own: set it to \"external\", or name the program after --")]
    NoExternalDrive,
    /// A request to stop came before a drive was checked.
    #[error("a stop was requested before the drive was checked; its arm was told to stay")]
    DriveCheckStopped,
    /// A measurement that nobody can mean.
    #[error("--duration-s {0}: must be more than 0 and at most 600")]
    ProbeDuration(f64),
    /// A process of a camera that the run file does not have.
    #[error("--camera {camera}: the run file has {cameras} camera(s), counted from 0")]
    NoSuchCamera {
        /// Which was asked for.
        camera: u8,
        /// How many there are.
        cameras: usize,
    },
    /// A vision process for one camera of a pair.
    #[error("--camera {camera}: one vision process serves both cameras of [stereo]: leave --camera out")]
    OneVision {
        /// Which was asked for.
        camera: u8,
    },
    /// ReportImages of a pair of cameras that are no pairs.
    #[error("{0} images: pairs are needed, left and right by turns")]
    OddImages(usize),
    /// A word that is no command, or names nothing that there is.
    #[error("{0}")]
    NoCommand(String),
    /// A goal in whose view nothing of the target was found.
    #[error(
        "the whole target was seen in none of {images} images: {status}; see to lens, light and target, or to where the arm stands"
    )]
    NothingTaught {
        /// How many were looked at.
        images: u64,
        /// What the last one showed.
        status: &'static str,
    },
    /// The robot file is wrong.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// The configuration does not make a working whole.
    #[error(transparent)]
    Assemble(#[from] AssembleError),
    /// An experiment gave nothing.
    #[cfg(feature = "cli")]
    #[error(transparent)]
    Experiment(#[from] ExperimentError),
    /// Real-time scheduling was refused under policy `enforce`.
    #[cfg(feature = "cli")]
    #[error(transparent)]
    Scheduling(#[from] SchedulingError),
    /// The external drive has another number of joints.
    #[error(
        "the external drive has {drive} joints, the robot of the run file {robot}: start it with the same robot"
    )]
    DriveJoints {
        /// The drive's.
        drive: u32,
        /// The robot's.
        robot: u32,
    },
    /// The external drive has other joints.
    #[error(transparent)]
    DriveJointNames(#[from] crate::drive::JointNamesError),
    /// The external drive stops between commands, or tells its states too seldom.
    #[error(transparent)]
    DriveProperties(#[from] crate::drive::DrivePropertiesError),
    /// The external drive says that the arm is where no arm is, or moves as none does.
    #[error(
        "the external drive's first state has {joint} at {q} rad or m, moving with {qd} rad/s or m/s: no arm does that (it may move \
         with {limit}); see to what the drive sends, and in which units"
    )]
    DriveState {
        /// What the joint is called.
        joint: String,
        /// Its position.
        q: f64,
        /// Its velocity.
        qd: f64,
        /// The velocity that it may have.
        limit: f64,
    },
    /// The external drive does not take the commands that it is to be given.
    #[error("drive.mode: the external drive does not take {mode} commands; it takes: {takes}")]
    DriveMode {
        /// What was asked for.
        mode: crate::drive::CommandMode,
        /// What it takes.
        takes: String,
    },
    /// A load is to be found, and torques are neither commanded nor measured.
    #[error(
        "drive.mode: no torques are commanded in mode {mode}, and the states of this drive carry none (`tau` is zero), so that a load does not show: use mode \
         torque, or a drive that measures torques"
    )]
    DriveWithoutTorques {
        /// The mode.
        mode: &'static str,
    },
    /// The external drive did not come, or came and did not answer.
    #[error("the external drive did not connect within {waited_s:.1} s ({limit}): {state}")]
    DriveAbsent {
        /// How long it was waited for.
        waited_s: f64,
        /// The key of that time.
        limit: &'static str,
        /// What there was of it.
        state: String,
    },
    /// A process that is there already was started with other numbers.
    #[error(
        "instance `{instance}`: {disagreements}; start all processes of a run with the same run file and the same --set"
    )]
    Disagree {
        /// Which.
        instance: String,
        /// In what.
        disagreements: Disagreements,
    },
    /// The program of an external drive or camera cannot be started.
    #[error("{key}: cannot start `{program}` in {folder}: {cause}", folder = folder.display())]
    ForeignProgram {
        /// The key that names it.
        key: &'static str,
        /// The program.
        program: String,
        /// Where it was to be started.
        folder: PathBuf,
        /// The system's word for it.
        cause: std::io::Error,
    },
    /// There is no run that could take a request.
    #[error(
        "no run of instance `{0}` is there: start one with `vservo serve`, or name another with --instance"
    )]
    NobodyThere(String),
    /// What is to be shown needs a terminal.
    #[error(
        "stdout is no terminal that can show a run: ask with `vservo ctl status --json`, or write it down with `vservo record`"
    )]
    NoTerminal,
    /// An address at which nothing can listen.
    #[error("cannot listen at {address}: {cause}; choose another port with --port (0: any that is free)")]
    Listen {
        /// The address.
        address: std::net::SocketAddr,
        /// The system's word for it.
        cause: std::io::Error,
    },
    /// The run of another user.
    #[error("instance `{instance}` is another user's run: {path} is {what}; ask as that user", path = path.display())]
    NotYourRun {
        /// Which.
        instance: String,
        /// Its place.
        path: PathBuf,
        /// What that is, and whose.
        what: String,
    },
    /// As many programs ask as can.
    #[error(
        "instance `{instance}` is asked by as many programs as can ({cause}); end some, or try again. `ctl stop` and \
         `ctl shutdown` get through all the same"
    )]
    Crowded {
        /// Which.
        instance: String,
        /// The transport's word for it.
        cause: String,
    },
    /// A signal ended the wait for an answer.
    #[error("interrupted while it waited for the answer: what was asked for may yet be done")]
    Interrupted,
    /// Control did not answer.
    #[error(
        "instance `{instance}` did not answer within {waited_s} s: it still starts, waits for its camera or drive, or hangs"
    )]
    NoAnswer {
        /// Which.
        instance: String,
        /// How long it was waited for.
        waited_s: f64,
    },
    /// A wait that nobody can mean.
    #[error("a time-out of {0} s: must be more than 0 and at most 3600")]
    Timeout(f64),
    /// A file cannot be written.
    #[error("{path}: cannot be written: {cause}; choose another place or free some space", path = path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's word for it, or [`IsRead`].
        cause: std::io::Error,
    },
    /// A report was asked for in a folder of something else.
    #[error(
        "{path} holds files and no report of vservo, and is left alone: name a folder that is new or empty, or one with an earlier \
         report",
        path = .0.display()
    )]
    NoReport(PathBuf),
    /// A robot cannot be used, or no longer.
    #[cfg(feature = "cli")]
    #[error(transparent)]
    Ur(#[from] vservo_ur::UrError),
    /// A robot cannot be used, or no longer.
    #[cfg(feature = "cli")]
    #[error(transparent)]
    Franka(#[from] vservo_franka::FrankaError),
    /// Control has sent no command to a drive for too long.
    #[error("no command from control for {milliseconds} ms: the arm was braked, and is at rest")]
    NoCommands {
        /// For how long.
        milliseconds: i64,
    },
    /// A robot is not simulated.
    #[error("a robot moves by its own clock: leave --clock lockstep (run.clock) away")]
    DriveLockstep,
    /// A robot that is emulated cannot be.
    #[error("cannot emulate a robot: {0}")]
    Emulator(std::io::Error),
    /// A recording cannot be written or read.
    #[cfg(feature = "cli")]
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// A recording cannot be replayed.
    #[cfg(feature = "cli")]
    #[error("{}: {cause}", path.display())]
    Replay {
        /// Which.
        path: PathBuf,
        /// Why.
        cause: Box<ReplayError>,
    },
    /// The recording of an arm cannot be replayed as the drive of this run.
    #[error("drive.replay.recording: {path}: {what}", path = path.display())]
    DriveRecording {
        /// The recording.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
    },
    /// A thread or a child process cannot be started.
    #[error("cannot start {what}: {cause}")]
    Start {
        /// What was to be started.
        what: &'static str,
        /// The system's word for it.
        cause: std::io::Error,
    },
    /// A thread panicked: a defect of this program.
    #[error("internal error: the {0} thread panicked; please report this with the lines above")]
    Panicked(&'static str),
    /// The signal handler cannot be installed.
    #[cfg(feature = "cli")]
    #[error("cannot handle signals: {0}")]
    Signals(#[from] ctrlc::Error),
    /// The effective configuration has no text form.
    #[error("internal error: the configuration cannot be written as TOML: {0}")]
    Toml(#[from] toml::ser::Error),
}

/// In what two processes of a run differ.
#[derive(Debug)]
pub struct Disagreements(pub Vec<Disagreement>);

/// How many differences are listed; the others are counted, so that two unlike run files do not fill the screen. Chosen by hand: one
/// wrong option makes one or two.
const TOLD: usize = 5;

impl fmt::Display for Disagreements {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let value = |value: &Option<String>| value.as_deref().unwrap_or("not set").to_owned();
        for (i, d) in self.0.iter().take(TOLD).enumerate() {
            let (there, here) = (value(&d.there), value(&d.here));
            write!(
                f,
                "{}{} is {there} in its {} process and {here} here",
                if i == 0 { "" } else { ", " },
                d.key,
                d.role
            )?;
        }
        let more = self.0.len().saturating_sub(TOLD);
        if more > 0 { write!(f, ", and {more} more") } else { Ok(()) }
    }
}

impl ProcessError {
    /// The message for people, line by line; names and paths in it are made printable.
    #[must_use]
    pub fn lines(&self) -> Vec<String> {
        match self {
            Self::Config(error) => error.lines().map(|line| printable(&line)).collect(),
            other => vec![printable(&other.to_string())],
        }
    }

    /// The exit code: 3 for configuration and input files, 4 for a camera that stays away or a robot that stops, 5 where nobody answers, 1 for everything else.
    #[cfg(feature = "cli")]
    #[must_use]
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Experiment(error) => error.exit_code(),
            Self::Source(error) if error.is_internal() => 1,
            Self::Write { cause, .. } if IsRead::is_cause_of(cause) => 2,
            Self::CameraAway { .. } | Self::Ur(_) | Self::Franka(_) | Self::NoCommands { .. } => 4,
            Self::Config(_)
            | Self::Source(_)
            | Self::NoSuchCamera { .. }
            | Self::OneVision { .. }
            | Self::NoRealCamera { .. }
            | Self::NoExternalDrive
            | Self::Robot(_)
            | Self::Assemble(_)
            | Self::Scheduling(_)
            | Self::Write { .. }
            | Self::Recording(_)
            | Self::Replay { .. }
            | Self::DriveRecording { .. }
            | Self::DriveJoints { .. }
            | Self::DriveJointNames(_)
            | Self::DriveProperties(_)
            | Self::DriveMode { .. }
            | Self::DriveState { .. }
            | Self::DriveWithoutTorques { .. }
            | Self::DriveAbsent { .. }
            | Self::DriveLockstep
            | Self::Emulator(_)
            | Self::ForeignProgram { .. }
            | Self::Listen { .. }
            | Self::Disagree { .. }
            | Self::Ipc(IpcError::Type { .. }) => 3,
            Self::Timeout(_)
            | Self::ProbeDuration(_)
            | Self::OddImages(_)
            | Self::NoCommand(_)
            | Self::NoTerminal
            | Self::NoReport(_) => 2,
            Self::NoFrame { .. }
            | Self::CameraProgramEnded { .. }
            | Self::NothingTaught { .. }
            | Self::NobodyThere(_)
            | Self::NotYourRun { .. }
            | Self::Crowded { .. }
            | Self::NoAnswer { .. } => 5,
            Self::DriveCheckStopped => 6,
            // 128 and the signal, as a shell says it; which signal it was does not matter to whoever sent it.
            Self::Interrupted => 130,
            Self::Instance(error) | Self::Ipc(IpcError::Place(error)) => error.exit_code(),
            Self::Ipc(_)
            | Self::SourceSilent(_)
            | Self::Start { .. }
            | Self::Panicked(_)
            | Self::Signals(_)
            | Self::Toml(_) => 1,
        }
    }
}
