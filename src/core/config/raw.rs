//! The run file as written: every key with its default, checked for its type alone.
//!
//! Each table rejects unknown keys. `validate` checks the values.

use super::target::RawTarget;
use crate::control::safety::ContactReaction;
use crate::vision::PoseApproach;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

mod drive;
mod faults;
mod motion;
mod named_goal;
mod second_view;
mod servo;
mod stereo;
mod truth;
mod workspace;

pub(super) use super::frame_source::{LensWord, RawCamera, RawLens, RawRoi};
pub(super) use super::place::{
    Carrier, MountKind, RawBackdrop, RawBystander, RawMount, RawObject, RawOccluder, RawSceneMotion,
    SceneMotionKind,
};
pub use drive::DriveKind;
pub(super) use drive::{RawDrive, RawSimulated, TorquePart};
pub(super) use faults::{FaultKind, RawFault};
pub use motion::JointControl;
pub(super) use motion::RawMotion;
pub use named_goal::{RawNamedGoal, RawPosture};
pub(super) use second_view::RawSecondView;
pub(super) use servo::{AreaKind, DampingOn, Depth, FeatureGain, Gains, PoseFrom, RawPd, RawServo};
pub use servo::{SchemeKind, SetPointKind};
pub(super) use stereo::{RawStereo, RawTaughtPoint, RawTaughtView};
pub(super) use truth::{RawTrueArm, RawTrueCamera, RawTrueLens, RawTrueTarget};
pub(super) use workspace::RawWorkspace;

table! {
    /// A whole run file.
    RawConfig {
        /// `[run]`
        run: RawRun = RawRun::default(),
        /// `[goal]`
        goal: RawGoal = RawGoal::default(),
        /// `[robot]`
        robot: RawRobot = RawRobot::default(),
        /// `[tool]`
        tool: RawTool = RawTool::default(),
        /// `[camera]`
        camera: RawCamera = RawCamera::default(),
        /// `[[cameras]]`, instead of `[camera]`
        #[serde(skip_serializing_if = "Vec::is_empty")]
        cameras: Vec<RawCamera> = Vec::new(),
        /// `[stereo]`: the first two cameras as a pair
        stereo: Option<RawStereo> = None,
        /// `[second_view]`: the second camera controls the arm beside the first one
        second_view: Option<RawSecondView> = None,
        /// `[target]`
        target: RawTarget = RawTarget::default(),
        /// `[targets.NAME]`: further targets, one at a time, with the keys of `[target]`
        #[serde(skip_serializing_if = "BTreeMap::is_empty")]
        targets: BTreeMap<String, RawTarget> = BTreeMap::new(),
        /// `[scene]`
        scene: RawScene = RawScene::default(),
        /// `[vision]`
        vision: RawVision = RawVision::default(),
        /// `[servo]`
        servo: RawServo = RawServo::default(),
        /// `[motion]`
        motion: RawMotion = RawMotion::default(),
        /// `[workspace]`
        workspace: RawWorkspace = RawWorkspace::default(),
        /// `[drive]`
        drive: RawDrive = RawDrive::default(),
        /// `[safety]`
        safety: RawSafety = RawSafety::default(),
        /// `[realtime]`
        realtime: RawRealtime = RawRealtime::default(),
        /// `[[faults]]`: what is put wrong on purpose
        #[serde(skip_serializing_if = "Vec::is_empty")]
        faults: Vec<RawFault> = Vec::new(),
        /// `[goals.NAME]`: goals that `vservo ctl goal` may name
        #[serde(skip_serializing_if = "BTreeMap::is_empty")]
        goals: BTreeMap<String, RawNamedGoal> = BTreeMap::new(),
        /// `[postures.NAME]`: postures that `vservo ctl goto` may name
        #[serde(skip_serializing_if = "BTreeMap::is_empty")]
        postures: BTreeMap<String, RawPosture> = BTreeMap::new(),
    }
}

word! {
    /// Which clock paces the control loop.
    Clock {
        /// The machine's monotonic clock at 1 kHz.
        Realtime,
        /// A simulated clock that waits for its measurements: repeatable, as fast as the machine allows.
        Lockstep,
    }
}

word! {
    /// What the arm moves for.
    Task {
        /// Servoing to the goal.
        Servo,
        /// An excitation motion that shows how the camera's stamps lie against the encoders'.
        CalibrateLatency,
        /// Views of a board from all sides, with a rest in each, that show where the camera sits.
        CalibrateHandEye,
        /// Postures about the start, by ways that show in the torques what the flange carries.
        CalibrateLoad,
    }
}

table! {
    /// How long and by which clock.
    RawRun {
        /// What the arm moves for.
        task: Task = Task::Servo,
        /// Pace of the control loop.
        clock: Clock = Clock::Realtime,
        /// The run ends at this time even if the goal is not reached, s.
        duration_s: f64 = 30.0,
        /// Seed of every random number in the run.
        seed: u64 = 1,
        /// The run accepts requests of `vservo ctl`, and ends on request; `vservo serve` sets it.
        serve: bool = false,
    }
}

table! {
    /// When the run counts as converged.
    RawGoal {
        /// Largest root mean square feature error, px.
        feature_error_px: f64 = 0.05,
        /// How long the error must stay below, s.
        hold_s: f64 = 0.5,
    }
}

table! {
    /// The arm and where it starts.
    RawRobot {
        /// Name of a shipped robot, or path of a robot file.
        model: String = "scara".into(),
        /// Joint positions at the start, rad or m.
        q_start_rad_or_m: Vec<f64> = vec![0.0, std::f64::consts::FRAC_PI_2, 0.5, -std::f64::consts::FRAC_PI_4],
        /// Largest distance of a joint from there that counts as a start there, rad or m.
        start_tolerance_rad_or_m: f64 = 0.02,
        /// Whether the arm may start elsewhere.
        start_elsewhere: bool = false,
    }
}

table! {
    /// What the flange carries that the robot file does not contain: a gripper, a camera, a load.
    RawTool {
        /// Mass, kg.
        mass_kg: f64 = 0.0,
        /// Centre of mass in the flange's frame, m.
        com_m: [f64; 3] = [0.0; 3],
        /// Moments of inertia about the centre of mass, along the flange's axes: xx, yy, zz, xy, xz, yz, kg m^2.
        inertia_kg_m2: [f64; 6] = [0.0; 6],
    }
}

pose_table! {
    /// A pose: position and fixed-axis roll, pitch, yaw (`R = Rz(yaw) Ry(pitch) Rx(roll)`).
    RawPose {
        /// Position, m.
        position_m: [f64; 3] = [0.0; 3],
        /// Roll, pitch, yaw, rad.
        rotation_rpy_rad: [f64; 3] = [0.0; 3],
    }
}

table! {
    /// A simulated scene: pose of the target, grey levels, and the true parameters that differ from the controller's model.
    RawScene {
        /// `[scene.object]`
        object: RawObject = RawObject::default(),
        /// `[scene.objects.NAME]`: where the targets of `[targets.NAME]` are
        #[serde(skip_serializing_if = "BTreeMap::is_empty")]
        objects: BTreeMap<String, RawObject> = BTreeMap::new(),
        /// `[scene.motion]`
        motion: RawSceneMotion = RawSceneMotion::default(),
        /// `[scene.occluder]`
        occluder: RawOccluder = RawOccluder::default(),
        /// `[[scene.occluders]]`: more of them
        #[serde(skip_serializing_if = "Vec::is_empty")]
        occluders: Vec<RawOccluder> = Vec::new(),
        /// `[scene.backdrop]`
        backdrop: RawBackdrop = RawBackdrop::default(),
        /// `[[scene.bystanders]]`
        #[serde(skip_serializing_if = "Vec::is_empty")]
        bystanders: Vec<RawBystander> = Vec::new(),
        /// `[scene.camera]`
        camera: RawTrueCamera = RawTrueCamera::default(),
        /// `[scene.target]`
        target: RawTrueTarget = RawTrueTarget::default(),
        /// `[scene.arm]`
        arm: RawTrueArm = RawTrueArm::default(),
        /// Grey level of the background.
        background_level: f64 = 90.0,
        /// Grey level of the plate, and of all that is light.
        plate_level: f64 = 220.0,
        /// Grey level of the dots, and of all other marks.
        dot_level: f64 = 30.0,
    }
}

table! {
    /// Detection.
    RawVision {
        /// Searches predicted windows first; without it the whole frame every time.
        track: bool = true,
        /// Model error: standard deviation, px, by which lens and target differ from their description; a measurement is
        /// rejected when its points do not fit one pose.
        model_sd_px: f64 = 0.0,
        /// Which way the pose is found (10.3).
        pose: PoseApproach = PoseApproach::Both,
    }
}

word! {
    /// How a run goes on after camera or vision was lost and started anew.
    ResumePolicy {
        /// With the first good measurement.
        Automatic,
        /// The arm is held until somebody asks for `start`.
        Manual,
    }
}

table! {
    /// Reactions to faults.
    RawSafety {
        /// Age of the last good measurement at which the arm slows down and holds, ms.
        measurement_timeout_ms: f64 = 200.0,
        /// Share of that time from which on the arm slows down.
        slow_down_from: f64 = 0.75,
        /// Age of an external drive's newest state at which the run ends as a fault, ms; in real time only.
        drive_timeout_ms: f64 = 20.0,
        /// Real time: more missed deadlines in a row than this stop the arm and end the run.
        max_missed_deadlines_in_a_row: u32 = 100,
        /// Distance of a joint from its reference at which the run ends as a fault, rad or m; left out: 0.1, and what an external drive's lag is at the fastest joint's limit.
        max_tracking_error_rad_or_m: Option<f64> = None,
        /// What is done when something touches the arm while it moves.
        contact: ContactReaction = ContactReaction::Stop,
        /// Share of the velocity limits with which the arm moves while its robot says that it is in reduced mode.
        reduced_speed_share: f64 = 0.25,
        /// Real time: how the run goes on after its camera or vision process was lost and started anew.
        resume: ResumePolicy = ResumePolicy::Automatic,
        /// Real time, an external drive: whether a guardian watches control's commands and stops the arm when they are late, missing or wrong.
        guardian: bool = true,
        /// Silence of a control that runs after which the guardian stops the arm, ms; left out: as long as control may miss deadlines.
        guardian_timeout_ms: Option<f64> = None,
    }
}

word! {
    /// Whether real-time scheduling is required.
    RealtimePolicy {
        /// All of it is required for a start.
        Enforce,
        /// As far as it is available; a line reports what was obtained.
        Try,
        /// None.
        Off,
    }
}

table! {
    /// Scheduling of the control thread.
    RawRealtime {
        /// Whether it is required.
        policy: RealtimePolicy = RealtimePolicy::Try,
        /// SCHED_FIFO priority.
        priority: u32 = 80,
        /// Core that the control thread is bound to; any where it is left out.
        cpu: Option<u32> = None,
        /// Locks all memory of the control process.
        lock_memory: bool = true,
        /// The control thread sleeps to so long before each deadline and spins the rest, us. Left out: 50 where SCHED_FIFO
        /// was obtained, 0 where not.
        spin_us: Option<f64> = None,
    }
}
