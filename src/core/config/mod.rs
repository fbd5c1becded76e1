//! The run file: TOML text -> raw tables -> a validated [`Config`].
//!
//! ```text
//! text + --set ──Document──► RawConfig ──validate──► Config
//!        └── syntax ──┴── types, unknown keys ──┴── ranges, consistency ──► all Problems of a step at once
//! ```

#[macro_use]
mod keys;

mod agreement;
pub mod assemble;
mod camera;
mod check;
mod draft;
mod estimation;
mod frame_source;
mod gains;
mod goal_file;
mod goal_path;
mod lens_file;
mod named_goal;
mod place;
mod pose_forms;
mod problem;
mod program;
mod raw;
mod refined;
mod scene;
mod second_view;
mod selection;
mod servo;
mod shipped;
mod source;
mod stereo;
mod tables;
mod target;
mod targets;
mod v4l2;
mod validate;
mod wait_for;

pub use camera::Camera;
pub use draft::Draft;
pub use estimation::UNCALIBRATED;
pub use frame_source::{CameraProgram, ReplayImages, Source, Timing};
pub use goal_file::{GoalFeature, GoalFile, GoalPose};
pub use named_goal::{ProgramGoal, TargetGoal};
pub use pose_forms::DEG as ANGLES_DEG;
pub use problem::{ConfigError, Problem};
pub use program::{NamedPlaces, Program, ProgramStep, StepAction};
pub use raw::{Clock, DriveKind, JointControl, RealtimePolicy, ResumePolicy, SchemeKind, SetPointKind, Task};
pub use raw::{RawNamedGoal, RawPosture};
pub use scene::{Scene, SceneObject};
pub use second_view::SecondView;
pub use shipped::{SHIPPED_FILES, ShippedFile};
pub use source::Document;
pub use stereo::{Stereo, taught_file};
pub use targets::{FIRST_TARGET, FurtherTarget};
pub use v4l2::{ControlValue, PixelFormatName, Shutter, V4l2Settings};
pub use wait_for::WaitFor;

use crate::control::safety::ContactReaction;
use crate::drive::{
    CommandMode, HardFriction, InnerServo, ShakingBase, Surroundings, TorqueContents, TorqueRipple,
};
use crate::faults::InjectedFaults;
use crate::motion::WorkspaceSettings;
use crate::robot::{Inertia, RobotDescription};
use crate::servo::{ServoSettings, SetPoint};
use crate::target::Target;
use crate::time::SpanNs;
use crate::vision::VisionSettings;
use raw::RawConfig;
use std::path::{Path, PathBuf};

/// The configuration that runs when none is named.
pub const DEFAULT_TOML: &str = include_str!("../../../config/default.toml");

/// A validated run file.
#[derive(Debug, Clone)]
pub struct Config {
    /// Task of the run: servoing, or a calibration motion.
    pub task: Task,
    /// Pace of the control loop.
    pub clock: Clock,
    /// Latest end of the run.
    pub duration: SpanNs,
    /// Seed of all random numbers.
    pub seed: u64,
    /// When the run counts as converged.
    pub goal: GoalTolerance,
    /// The arm.
    pub robot: RobotDescription,
    /// What the robot carries of it, in the flange's frame.
    pub tool: Inertia,
    /// Whether the run serves requests, until one ends it.
    pub serve: bool,
    /// Where the arm starts.
    pub start: Start,
    /// The camera that control uses.
    pub camera: Camera,
    /// The other cameras: the right one of a pair, or cameras that control does not use.
    pub further_cameras: Vec<Camera>,
    /// Settings of the pair, where the first two cameras measure together.
    pub stereo: Option<Stereo>,
    /// What the second camera sees and is to see, where both control the arm.
    pub second_view: Option<SecondView>,
    /// The target.
    pub target: Target,
    /// Further targets, in the order of their names: their numbers count from 1.
    pub further_targets: Vec<FurtherTarget>,
    /// The true scene, where the cell is simulated.
    pub scene: Option<Scene>,
    /// Settings of vision.
    pub vision: VisionSettings,
    /// The servo law.
    pub servo: ServoSettings,
    /// The set-point; where it is taught, its provisional values. A pair of cameras has the points of its taught view instead
    /// ([`assemble`]).
    pub set_point: SetPoint,
    /// Joint reference and joint controller.
    pub motion: Motion,
    /// Limits in space, where there are some.
    pub workspace: Option<WorkspaceSettings>,
    /// The drive.
    pub drive: DriveSettings,
    /// Reactions to faults.
    pub safety: Safety,
    /// What is put wrong about the simulated parts on purpose.
    pub faults: InjectedFaults,
    /// Scheduling of the control thread.
    pub realtime: Realtime,
    /// Warnings about values that are allowed but probably unintended, with remedies.
    pub warnings: Vec<Problem>,
    /// The file as read, with all defaults and absolute paths: what another process needs to run the same.
    pub effective: RawConfig,
}

/// Where the arm starts.
#[derive(Debug, Clone, PartialEq)]
pub struct Start {
    /// Joint positions, rad or m; as many as the robot has joints.
    pub q: Vec<f64>,
    /// Distance of a joint from there that counts as no difference, rad or m.
    pub tolerance: f64,
    /// Whether it may start elsewhere.
    pub elsewhere: bool,
}

/// When the run counts as converged.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GoalTolerance {
    /// Largest root mean square feature error, px.
    pub feature_error_px: f64,
    /// How long it must stay below.
    pub hold: SpanNs,
    /// Whether the set-point is taught from the view at the start.
    pub is_taught: bool,
    /// Number of measurements from which the set-point is taught.
    pub measurements: u32,
}

/// Joint reference and joint controller.
#[derive(Debug, Clone)]
pub struct Motion {
    /// Largest acceleration of each joint, rad/s^2 or m/s^2.
    pub max_acceleration: Vec<f64>,
    /// Largest jerk of each joint, rad/s^3 or m/s^3.
    pub max_jerk: Vec<f64>,
    /// Joint controller.
    pub controller: JointControl,
    /// Time in which the effort of a joint may rise from zero to its largest.
    pub effort_rise: SpanNs,
    /// How quickly the drive takes torques, N m/s or N/s of each joint; empty where it does not tell, and before it is connected.
    pub effort_rates: Vec<f64>,
    /// Natural frequency of the joint controller, rad/s.
    pub natural_frequency_rad_s: f64,
    /// Damping ratio of the joint controller.
    pub damping_ratio: f64,
    /// Stiffness of each joint under PD control, N m/rad or N/m; empty: from the natural frequency.
    pub stiffness: Vec<f64>,
    /// Damping of each joint under PD control, N m s/rad or N s/m; empty: from the damping ratio.
    pub damping: Vec<f64>,
    /// Bandwidth of the disturbance observer, rad/s; 0: none.
    pub disturbance_rad_s: f64,
    /// Bandwidth of the velocity observer, rad/s; 0: the velocities that the drive reports are used.
    pub velocity_observer_rad_s: f64,
    /// Step of each encoder and twice its noise, rad or m.
    pub encoder_step: Vec<f64>,
    /// The part of that which is known to be noise.
    pub encoder_noise: Vec<f64>,
}

/// The drive.
#[derive(Debug, Clone, PartialEq)]
pub struct DriveSettings {
    /// Kind of drive.
    pub kind: DriveKind,
    /// Its command mode.
    pub mode: CommandMode,
    /// Time from one of its states to the next; `None` where it does not tell, and before it is connected.
    pub period: Option<SpanNs>,
    /// What commanded torques contain.
    pub torque_contains: TorqueContents,
    /// Imperfections of the simulated arm.
    pub simulated: SimulatedArm,
    /// A drive in another process.
    pub external: DriveProgram,
    /// The recording of an arm that is replayed.
    pub recording: PathBuf,
}

/// Imperfections of the simulated arm.
#[derive(Debug, Clone, PartialEq)]
pub struct SimulatedArm {
    /// Integration steps per tick.
    pub substeps: u32,
    /// Whether friction acts.
    pub friction: bool,
    /// Stick-slip friction near standstill; `None`: smooth friction.
    pub hard_friction: Option<HardFriction>,
    /// Coulomb friction that is not in the robot file, as a share of the effort limits.
    pub untold_coulomb_share: f64,
    /// Spread of the friction over the joints, as a share.
    pub friction_spread: f64,
    /// Inertia of rotors that is not in the robot file, as a share of the joints' own.
    pub untold_rotor_share: f64,
    /// By how much joints yield to their largest efforts, rad or m; `None`: they are rigid.
    pub wind_up: Option<f64>,
    /// Ripple of the motors' torques, its seed left out.
    pub ripple: Option<TorqueRipple>,
    /// Motion of the base, its seed left out.
    pub base: Option<ShakingBase>,
    /// Whether effort limits act.
    pub effort_limits: bool,
    /// Whether states tell the motors' torques.
    pub tells_torque: bool,
    /// Delay of commands, ticks.
    pub command_delay_ticks: usize,
    /// Step of each joint's encoder, rad or m.
    pub encoder_step: Vec<f64>,
    /// Noise of each joint's encoder, rad or m.
    pub encoder_noise_sd: Vec<f64>,
    /// Cut-off of the velocity filter, Hz.
    pub velocity_filter_hz: f64,
    /// A load that is not in the controller's model.
    pub payload: Inertia,
    /// The drive's own servo.
    pub servo: InnerServo,
    /// What acts on it from outside.
    pub surroundings: Surroundings,
}

/// A drive in another process.
#[derive(Debug, Clone, PartialEq)]
pub struct DriveProgram {
    /// Program and arguments; empty where it is started from outside.
    pub command: Vec<String>,
    /// Where it is started.
    pub folder: PathBuf,
    /// Longest wait for an answer in lockstep.
    pub answer_timeout: SpanNs,
    /// Longest wait for a drive that the run has started itself, and for any drive's answer to the start.
    pub connect_timeout: SpanNs,
}

/// Reactions to faults.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Safety {
    /// Age of the last good measurement at which the arm slows down and holds.
    pub measurement_timeout: SpanNs,
    /// Share of it from which on the arm slows down.
    pub slow_down_from: f64,
    /// Age of an external drive's newest state at which the run ends.
    pub drive_timeout: SpanNs,
    /// More missed deadlines in a row than this stop the arm.
    pub max_missed_in_a_row: u64,
    /// Largest distance of a joint from its reference, rad or m.
    pub max_tracking_error: f64,
    /// What is done when something touches the arm.
    pub contact: ContactReaction,
    /// Share of the velocity limits with which the arm moves in the robot's reduced mode.
    pub reduced_speed_share: f64,
    /// How the run goes on after camera or vision was lost and started anew.
    pub resume: ResumePolicy,
    /// Whether a guardian watches the commands to an external drive.
    pub guardian: bool,
    /// Silence of a control that runs after which it stops the arm.
    pub guardian_timeout: SpanNs,
}

/// Scheduling of the control thread.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Realtime {
    /// Whether real-time scheduling is required.
    pub policy: RealtimePolicy,
    /// What is asked for.
    pub request: RealtimeRequest,
    /// How long the control thread spins before each deadline; `None`: as suits what it obtains.
    pub spin: Option<SpanNs>,
}

/// What is asked of the operating system.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RealtimeRequest {
    /// SCHED_FIFO priority, 1 to 99.
    pub priority: u32,
    /// Core to run on; any where it is `None`.
    pub cpu: Option<u32>,
    /// Whether to lock the process's memory.
    pub lock_memory: bool,
}

/// The keys of a run file that have a default, each with it.
#[must_use]
pub fn default_keys() -> toml::Table {
    toml::Table::try_from(RawConfig::default()).unwrap_or_default()
}

impl Config {
    /// Reads a run file, or the embedded default where `path` is `None`, and applies `--set` arguments. A word without folder and
    /// ending that is no file is the name of a shipped one.
    ///
    /// # Errors
    /// All problems of the first step that finds any: syntax, then types and unknown keys together with ranges.
    pub fn load(path: Option<&Path>, set: &[String]) -> Result<Self, ConfigError> {
        Draft::load(path, set)?.validate()
    }

    /// Reads a run file from `text`. Relative paths in it count from `folder`; those in `--set` from the working
    /// directory.
    ///
    /// # Errors
    /// As for [`Config::load`].
    pub fn parse(name: &str, text: &str, folder: &Path, set: &[String]) -> Result<Self, ConfigError> {
        Draft::parse(name, text, folder, set)?.validate()
    }

    /// The clock's name in a run file.
    #[must_use]
    pub fn clock_name(&self) -> &'static str {
        match self.clock {
            Clock::Realtime => "realtime",
            Clock::Lockstep => "lockstep",
        }
    }

    /// The servo law's name in a run file.
    #[must_use]
    pub fn scheme_name(&self) -> &'static str {
        match self.effective.servo.scheme {
            SchemeKind::PositionPd => "position_pd",
            SchemeKind::PositionResolvedVelocity => "position_resolved_velocity",
            SchemeKind::ImagePd => "image_pd",
            SchemeKind::ImageResolvedVelocity => "image_resolved_velocity",
            SchemeKind::Hybrid => "hybrid",
            SchemeKind::LookAndMove => "look_and_move",
        }
    }

    /// Whether the arm servoes in an open loop: one look, one motion.
    #[must_use]
    pub fn looks_and_moves(&self) -> bool {
        self.task == Task::Servo && self.effective.servo.scheme == SchemeKind::LookAndMove
    }

    /// The effective configuration as a run file.
    ///
    /// # Errors
    /// When a value has no TOML form.
    pub fn to_toml(&self) -> Result<String, toml::ser::Error> {
        let mut table = toml::Table::try_from(&self.effective)?;
        if !self.effective.cameras.is_empty() {
            table.remove("camera"); // which is the first of the list
        }
        toml::to_string(&table)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_of_the_version_before_is_read_and_told() {
        let load =
            |set: &[&str]| Config::load(None, &set.iter().map(ToString::to_string).collect::<Vec<_>>());
        let of = |key: &str| load(&[&format!("servo.{key}=3.5")]).unwrap();
        let (old, new) = (of("calm_gain_1_s"), of("gain_at_goal_1_s"));
        assert_eq!((old.servo.gain_at_goal_1_s, new.servo.gain_at_goal_1_s), (3.5, 3.5));
        let told = old.warnings.first().unwrap().to_string();
        assert!(
            told.contains("--set servo.calm_gain_1_s=3.5") && told.contains("gain_at_goal_1_s now"),
            "{told}"
        );
        assert_eq!(new.warnings, []);
        let both = |text: &str| Config::parse("cell.toml", text, Path::new("."), &[]);
        assert!(both("[servo]\ncalm_gain_1_s = 3.5").unwrap().warnings.len() == 1);
        let twice = both("[servo]\ncalm_gain_1_s = 3.5\ngain_at_goal_1_s = 2.0").unwrap_err().to_string();
        assert!(twice.contains("cell.toml:2:1: servo.calm_gain_1_s: unknown field"), "{twice}");
    }

    #[test]
    fn the_default_file_says_what_the_defaults_are() {
        let mut written = Config::load(None, &[]).unwrap().effective;
        written.drive.external.folder = RawConfig::default().drive.external.folder; // made absolute
        written.camera.external.folder = RawConfig::default().camera.external.folder;
        assert_eq!(written, RawConfig::default());
    }

    #[test]
    fn a_slow_camera_is_told_which_timeout_it_needs() {
        let load =
            |set: &[&str]| Config::load(None, &set.iter().map(ToString::to_string).collect::<Vec<_>>());
        let error = load(&["camera.rate_hz=1"]).unwrap_err().to_string();
        assert!(error.contains("safety.measurement_timeout_ms: 200 ms is shorter than a frame"), "{error}");
        assert!(error.contains("raise it above 2020 ms") && error.contains("camera.rate_hz"), "{error}");
        let doubtful = load(&["camera.rate_hz=1", "safety.measurement_timeout_ms=1500"]).unwrap();
        let warning = doubtful.warnings.first().unwrap().to_string();
        assert!(warning.contains("--set safety.measurement_timeout_ms=1500: "), "{warning}");
        assert!(warning.contains("(2020.0 ms): the arm holds whenever"), "{warning}");
        let late = ["camera.synthetic.latency_jitter_ms=101"];
        assert_eq!(load(&late).unwrap().warnings.len(), 1, "100 ms of jitter fill up the timeout");
        let enough = ["camera.rate_hz=1", "safety.measurement_timeout_ms=2100"];
        assert!(load(&enough).unwrap().warnings.is_empty());
    }

    #[test]
    fn shipped_run_files_give_no_warning() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config");
        let files = std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
        let run_files: Vec<_> = files.filter(|p| p.extension().is_some_and(|e| e == "toml")).collect();
        assert!(run_files.len() > 10);
        for file in run_files {
            let config = Config::load(Some(&file), &[]).unwrap();
            assert_eq!(config.warnings, [], "{}", file.display());
        }
    }

    #[test]
    fn the_effective_configuration_reads_back_as_itself() {
        let set = ["servo.gain_1_s=3".to_string(), "camera.replay.folder=images".to_string()];
        let config = Config::load(None, &set).unwrap();
        let text = config.to_toml().unwrap();
        let again = Config::parse("again", &text, Path::new("/elsewhere"), &[]).unwrap();
        assert_eq!(again.effective, config.effective);
        assert!(again.effective.camera.replay.folder.is_absolute());
    }
}
