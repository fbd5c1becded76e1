//! The whole system in one process and in simulated time: renderer, vision and control as `vservo run --clock lockstep`
//! runs them, to the last bit, without processes and shared memory.
//!
//! ```text
//! sense ─► joint state ─► source ─► pixels ─► Vision ─► Measurement ─ one latency later ─► act ─► drive
//! ```

use super::closed_loop::{self, ClosedLoop};
use super::commander::{Commander, CommanderSight, WantedMotion};
use super::second_eye::{SecondEye, exposed};
use crate::config::Config;
use crate::config::assemble::{self, AnyDrive, AssembleError};
use crate::control::behaviour::CommandedMotion;
use crate::control::order::ControlOrder;
use crate::control::outcome::{Finish, Outcome};
use crate::control::trace::Trace;
use crate::imaging::{ImageSizeError, ImageView};
use crate::messages::Measurement;
use crate::mission::{FinalErrors, LockstepRun, ModelError};
use crate::report::statistics::RunStatistics;
use crate::robot::{Robot, RobotError};
use crate::scene::{Exposure, SyntheticCamera};
use crate::time::MonoNs;
use crate::time::TICK;
use crate::vision::{Carrier, Frame, Prior, Side, StereoMeasurement, StereoVision, TargetChoice, TargetSet};
use nalgebra::SVector;
use std::collections::VecDeque;
use std::ops::ControlFlow::{self, Break, Continue};
use thiserror::Error;

/// Why a run cannot be simulated.
#[derive(Debug, Error)]
pub enum SimError {
    /// A part of it cannot be built.
    #[error(transparent)]
    Assemble(#[from] AssembleError),
    /// The arm cannot.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// The camera has no pixels.
    #[error(transparent)]
    Image(#[from] ImageSizeError),
    /// Only what a law would do can be commanded by somebody else.
    #[error(
        "nobody else can command this run: it needs an arm that servoes, which `task`, look-and-move and a drive without an arm do not"
    )]
    NotServoing,
}

/// A simulated run that has come to its end.
#[derive(Debug, Clone, PartialEq)]
pub struct SystemRun {
    /// How it ended.
    pub finish: Finish,
    /// Errors at the end, against truth.
    pub errors: FinalErrors,
    /// The same of a second camera that controls the arm, too; `None` without one.
    pub second_errors: Option<FinalErrors>,
    /// To 2 % of the first feature error, s.
    pub settling_time_s: Option<f64>,
    /// How often the target was lost.
    pub target_lost: u64,
    /// Measurements that fit the description of lens and target only with a model error; `None` where all fit.
    pub model_error: Option<ModelError>,
    /// Over every joint state, hexadecimal; that of the three processes.
    pub state_hash: String,
}

/// What can be watched of a run.
#[derive(Debug, Clone, Copy)]
pub enum Moment<'a> {
    /// A frame was exposed: its number and its pixels.
    Frame(u64, &'a ImageView<'a>),
    /// A measurement reaches control.
    Seen(&'a Measurement),
    /// A tick is over: what it left, and the errors against truth.
    Tick(&'a Trace, &'a FinalErrors),
}

/// Runs `config` in simulated time, whatever its clock, and tells `watch` what happens; a break of `watch` ends the run as
/// [`Outcome::Stopped`], wherever the arm is then.
///
/// # Errors
/// [`SimError`] when a part of the configuration cannot be built.
pub fn simulate_system(
    config: &Config,
    watch: &mut dyn FnMut(&Moment<'_>) -> ControlFlow<()>,
) -> Result<SystemRun, SimError> {
    simulate_system_with(config, &mut ConfiguredDrives, watch)
}

/// Makes the drive of a run, for the number of joints that its arm has.
pub trait Drives {
    /// The drive of `robot`.
    ///
    /// # Errors
    /// [`SimError`] when there is none for it.
    fn drive<const N: usize>(&mut self, config: &Config, robot: &Robot<N>) -> Result<AnyDrive<N>, SimError>;
}

/// The drive that the run file names.
pub(super) struct ConfiguredDrives;

impl Drives for ConfiguredDrives {
    fn drive<const N: usize>(&mut self, config: &Config, robot: &Robot<N>) -> Result<AnyDrive<N>, SimError> {
        Ok(assemble::drive(config, robot)?)
    }
}

/// As [`simulate_system`], with a drive of one's own and nobody but the law to command it. The camera sees the arm where its [`DriveState::truth`] is, or else where it says
/// that it is.
///
/// [`DriveState::truth`]: crate::drive::DriveState::truth
///
/// # Errors
/// [`SimError`] when a part of the configuration, or the drive, cannot be built.
pub fn simulate_system_with(
    config: &Config,
    drives: &mut impl Drives,
    watch: &mut dyn FnMut(&Moment<'_>) -> ControlFlow<()>,
) -> Result<SystemRun, SimError> {
    simulated(config, drives, None, watch)
}

/// As [`simulate_system_with`], with an arm that `commander` commands instead of the law of the run file, whenever a measurement reaches control. Camera, vision, limits,
/// joint control, gate and supervision are the same.
///
/// # Errors
/// As [`simulate_system_with`], and [`SimError::NotServoing`].
pub fn simulate_commanded(
    config: &Config,
    drives: &mut impl Drives,
    commander: &mut dyn Commander,
    watch: &mut dyn FnMut(&Moment<'_>) -> ControlFlow<()>,
) -> Result<SystemRun, SimError> {
    simulated(config, drives, Some(commander), watch)
}

fn simulated<'a>(
    config: &'a Config,
    drives: &mut impl Drives,
    commander: Option<&'a mut dyn Commander>,
    watch: &'a mut dyn FnMut(&Moment<'_>) -> ControlFlow<()>,
) -> Result<SystemRun, SimError> {
    let eyes = Eyes::of(config)?;
    let carrier = assemble::carrier(config)?;
    crate::dispatch_robot!(config.robot, |robot| {
        let camera = assemble::synthetic_camera(config)?;
        let right = right_camera(config)?;
        let second = SecondEye::of(config)?;
        let drive = drives.drive(config, &robot)?;
        let mut control = assemble::control_loop_with(config, robot, drive)?;
        if commander.is_some() && !control.control.hand_over() {
            return Err(SimError::NotServoing);
        }
        let i = config.camera.model.intrinsics();
        let pixels = vec![0; i.width_px as usize * i.height_px as usize];
        let mut system = System {
            config,
            control,
            eyes,
            carrier,
            choice: TargetChoice::default(),
            camera,
            right,
            second,
            pixels,
            commander,
            frames: VecDeque::new(),
            statistics: RunStatistics::new(config.robot.joint_names()),
            watch,
        };
        let finish = closed_loop::run(&config.camera.schedule, &mut system)?;
        let measurements = system.control.mission.measurements();
        Ok(SystemRun {
            finish,
            errors: system.control.final_errors(),
            second_errors: system.control.mission.second_errors(),
            settling_time_s: system.statistics.settling_time_s(),
            target_lost: measurements.vision_counts().target_lost,
            model_error: measurements.model_error().report(&config.camera.model, &config.target),
            state_hash: system.statistics.state_hash(),
        })
    })?
}

/// The vision of one camera or of two.
#[allow(clippy::large_enum_variant)] // one in a run
enum Eyes {
    One(TargetSet),
    Two(StereoVision),
}

impl Eyes {
    fn of(config: &Config) -> Result<Self, AssembleError> {
        Ok(match &config.stereo {
            None => Self::One(assemble::target_set(config)),
            Some(_) => Self::Two(assemble::stereo_vision(config)?),
        })
    }
}

/// The right camera of a pair, and what is known of it.
struct RightCamera<const N: usize> {
    config: Config,
    camera: SyntheticCamera<N>,
    pixels: Vec<u8>,
}

fn right_camera<const N: usize>(config: &Config) -> Result<Option<RightCamera<N>>, AssembleError> {
    let id = config.further_cameras.first().filter(|_| config.stereo.is_some()).map(|camera| camera.id);
    let Some(config) = id.and_then(|id| config.clone().seen_by(id)) else { return Ok(None) };
    let camera = assemble::synthetic_camera(&config)?;
    let i = config.camera.model.intrinsics();
    let pixels = vec![0; i.width_px as usize * i.height_px as usize];
    Ok(Some(RightCamera { config, camera, pixels }))
}

/// The cores of the processes.
struct System<'a, const N: usize> {
    config: &'a Config,
    control: LockstepRun<N>,
    eyes: Eyes,
    carrier: Box<dyn Carrier>,
    choice: TargetChoice,
    camera: SyntheticCamera<N>,
    right: Option<RightCamera<N>>,
    /// A second camera that controls the arm beside the first one.
    second: Option<SecondEye<N>>,
    pixels: Vec<u8>,
    commander: Option<&'a mut dyn Commander>,
    /// Frames that are on their way to a commander that looks at them.
    frames: VecDeque<(u64, Vec<u8>)>,
    statistics: RunStatistics,
    watch: &'a mut dyn FnMut(&Moment<'_>) -> ControlFlow<()>,
}

const WATCHED_ENOUGH: Finish = Finish { outcome: Outcome::Stopped, reason: "who watched has seen enough" };

fn time(tick: u64) -> MonoNs {
    MonoNs(TICK.0 * tick as i64)
}

impl<const N: usize> ClosedLoop for System<'_, N> {
    type Observation = Measurement;
    type Outcome = Result<Finish, SimError>;

    fn sense(&mut self, tick: u64) -> ControlFlow<Self::Outcome> {
        let state = self.control.sense(tick, time(tick));
        self.camera.arm(&state);
        if let Some(right) = &mut self.right {
            right.camera.arm(&state);
        }
        if let Some(second) = &mut self.second {
            second.note(&state);
        }
        self.carrier.note(&state);
        self.choice.note(&state);
        Continue(())
    }

    fn see(&mut self, tick: u64, frame_id: u64) -> ControlFlow<Self::Outcome, Measurement> {
        let camera = &self.config.camera;
        let exposure = Exposure { frame_id, mid: time(tick), span: camera.exposure };
        let frame = match exposed(camera, &mut self.camera, &exposure, &mut self.pixels) {
            Ok(frame) => frame,
            Err(e) => return Break(Err(e.into())),
        };
        if (self.watch)(&Moment::Frame(frame_id, &frame.image)).is_break() {
            return Break(Ok(WATCHED_ENOUGH));
        }
        if self.commander.as_ref().is_some_and(|commander| commander.wants_frames()) {
            self.frames.push_back((frame_id, frame.image.pieces().flatten().copied().collect()));
        }
        match &mut self.eyes {
            Eyes::One(vision) => {
                let X_WC = self.carrier.X_WC(exposure.mid.min(frame.header.exposure));
                let wanted = self.choice.at(exposure.mid);
                Continue(vision.process(wanted, &frame, &Prior { X_WC, ..Prior::default() }))
            }
            Eyes::Two(vision) => match look_twice(vision, &frame, self.right.as_mut(), &exposure) {
                Ok(measurement) => Continue(measurement),
                Err(e) => Break(Err(e.into())),
            },
        }
    }

    fn act(&mut self, tick: u64, seen: Option<Measurement>) -> ControlFlow<Self::Outcome> {
        let seen = match self.second.as_mut().map(|second| second.see(tick, seen)) {
            Some(Err(e)) => return Break(Err(e.into())),
            Some(Ok(seen)) => seen,
            None => seen,
        };
        if let Some(measurement) = &seen
            && (self.watch)(&Moment::Seen(measurement)).is_break()
        {
            return Break(Ok(WATCHED_ENOUGH));
        }
        if let Some(measurement) = &seen
            && self.ask(time(tick), measurement).is_break()
        {
            return Break(Ok(WATCHED_ENOUGH));
        }
        let trace = self.control.act(time(tick), seen.as_ref());
        self.statistics.note(&trace);
        let watched = (self.watch)(&Moment::Tick(&trace, &self.control.final_errors()));
        match trace.finish.or(watched.is_break().then_some(WATCHED_ENOUGH)) {
            Some(finish) => Break(Ok(finish)),
            None => Continue(()),
        }
    }
}

impl<const N: usize> System<'_, N> {
    /// Asks the commander, where there is one; its command counts from this tick on, as the answer of a law does.
    fn ask(&mut self, now: MonoNs, measurement: &Measurement) -> ControlFlow<()> {
        let Some(commander) = &mut self.commander else { return Continue(()) };
        while self.frames.front().is_some_and(|(id, _)| *id < measurement.frame_id) {
            self.frames.pop_front();
        }
        let frame = self.frames.front().filter(|(id, _)| *id == measurement.frame_id);
        let controller = self.control.controller();
        let (robot, mount) = (&controller.arm().robot, &controller.servo().settings().mount);
        let (q, qd) = self.control.control.measured_arm();
        let (X_WC, J) = mount.camera(robot, &q);
        // The history ends with the tick before: what is exposed now is seen from where the arm is now.
        let then = controller.servo().joints_at(measurement.exposure).filter(|_| measurement.exposure < now);
        let command = commander.command(&CommanderSight {
            now,
            measurement,
            frame: frame.map(|(_, pixels)| pixels.as_slice()),
            q: q.as_slice(),
            qd: qd.as_slice(),
            X_WC,
            X_WC_exposure: then.map_or(X_WC, |q| mount.X_WC(robot, &q)),
            J: &std::array::from_fn::<[f64; 6], N, _>(|joint| J.matrix().column(joint).into_owned().into()),
        })?;
        let motion = match command {
            WantedMotion::None => None,
            WantedMotion::Twist(V_C) => Some(CommandedMotion::Twist(V_C.into())),
            WantedMotion::Joints(qd) => {
                let each = |i: usize, _| qd.get(i).copied().unwrap_or_default();
                Some(CommandedMotion::Joints(SVector::from_fn(each)))
            }
        };
        self.control.control.obey(&ControlOrder::Command(motion));
        Continue(())
    }
}

/// Left frame and right frame of one number, as the process of two cameras takes them.
fn look_twice<const N: usize>(
    vision: &mut StereoVision,
    left: &Frame<'_>,
    right: Option<&mut RightCamera<N>>,
    exposure: &Exposure,
) -> Result<Measurement, ImageSizeError> {
    vision.look(Side::Left, left);
    if let Some(RightCamera { config, camera, pixels }) = right
        && !config.camera.schedule.is_lost(exposure.frame_id)
    {
        let exposure = Exposure { span: config.camera.exposure, ..*exposure };
        vision.look(Side::Right, &exposed(&config.camera, camera, &exposure, pixels)?);
    }
    vision.give_up(Side::Left, left.header.exposure);
    let mut of_left = Measurement::default();
    while let Some(StereoMeasurement { measurement, .. }) = vision.next_measurement() {
        if measurement.camera == left.header.camera {
            of_left = measurement;
        }
    }
    Ok(of_left)
}
