//! Assembly: from a validated configuration to the cores (vision, control and mission, drive, renderer) that it describes.

use crate::config::{Clock, Config, DriveKind, JointControl, Scene, SimulatedArm, Source, Task};
use crate::control::behaviour::{ArmModel, Behaviour, Excitation, Servoing, Waypoints};
use crate::control::control_loop::{ControlLoop, LoopSettings};
use crate::control::controller::{Controller, ControllerSettings};
use crate::control::safety::MeasurementWatch;
use crate::drive::{
    CommandMode, Drive, EncoderModel, IdealDrive, ShakingBase, SimulatedDrive, SimulatedDriveSettings,
    StandstillDrive, TorqueRipple,
};
use crate::faults::JointFaults;
use crate::imaging::ImageSizeError;
use crate::linalg::Random;
use crate::messages::MAX_JOINTS;
use crate::mission::{BelievedCell, Goal, LockstepRun, LookAndMove, Mission, RunPlan, RunTask, Service};
use crate::motion::{
    InverseDynamicsControl, JointController, JointLaw, MotionLimits, ObserverSettings, PdGravityControl,
    Workspace,
};
use crate::robot::{Friction, Robot, RobotError};
use crate::scene::{ArmHistory, Renderer, SceneError, SyntheticCamera};
use crate::servo::VisualServo;
use crate::vision::TaughtViewError;
use nalgebra::SVector;
use thiserror::Error;

mod cameras;
mod effort_rates;
mod stereo;
mod vision;

pub use cameras::{require_controllable, require_one_view};
use cameras::{second_goal, second_servo, truth};
pub use effort_rates::{before_drive, contradicted_lag};
pub use stereo::{stereo_set_point, stereo_vision, taught_points, taught_view};
use vision::measurement_faults;
pub use vision::{carrier, target_set, vision};

/// Why the cores of a valid configuration cannot be assembled.
#[derive(Debug, Error)]
pub enum AssembleError {
    /// A list does not have one entry for each joint.
    #[error("{key}: has {found} entries, the robot has {wanted} joints")]
    Joints {
        /// The list.
        key: &'static str,
        /// Its entries.
        found: usize,
        /// The robot's joints.
        wanted: usize,
    },
    /// The drive rejects its settings.
    #[error(transparent)]
    Drive(#[from] crate::drive::SimulatedDriveError),
    /// The joints that the drive names are others than those of the robot file.
    #[error(transparent)]
    JointNames(#[from] crate::drive::JointNamesError),
    /// The renderer rejects the scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// Several cameras of which nothing says how they control the arm.
    #[error(
        "[[cameras]]: {0} cameras, and nothing says how they control the arm: of two, [second_view] says what the second one is to see, or [stereo] makes them a \
         pair; more than two do not control (processes of each may be started by hand: `vservo camera CONFIG --camera N`)"
    )]
    SeveralCameras(usize),
    /// A run by two cameras where one is expected.
    #[error("[second_view]: {0} goes by one camera: leave out [second_view] and the second of [[cameras]]")]
    SecondView(&'static str),
    /// The true model of the simulated arm is invalid.
    #[error(transparent)]
    Arm(#[from] RobotError),
    /// The images do not come from a simulated scene.
    #[error(
        "camera.source: only `synthetic` can be simulated in one process; other sources need `vservo run`"
    )]
    NoScene,
    /// The configuration has no pair of cameras.
    #[error("stereo: the run file has no pair of cameras, or its goal lies behind them")]
    NoStereo,
    /// A real pair has no taught view.
    #[error(
        "stereo.taught_file: is missing: only a simulated pair can look from servo.desired by itself; make one with `vservo \
         teach-view`"
    )]
    NotTaught,
    /// The view of a simulated pair cannot be computed.
    #[error(
        "[stereo]: the {side} camera does not see the target in the desired view: {status}; see to servo.desired, or to the images"
    )]
    NotSeen {
        /// Which camera.
        side: &'static str,
        /// Why not.
        status: &'static str,
    },
    /// The points of a simulated pair are no valid taught view.
    #[error("[stereo]: what both cameras see in the desired view {0}")]
    Taught(#[from] TaughtViewError),
    /// The camera has no pixels.
    #[error(transparent)]
    Image(#[from] ImageSizeError),
    /// An external drive is another process, and a recorded one a file: only the control process can connect to it.
    #[error(
        "drive.kind: an external drive, and one that was recorded, needs the processes of `vservo run`; in one process use simulated or ideal"
    )]
    ExternalDrive,
}

/// A drive of a configuration.
pub type AnyDrive<const N: usize> = Box<dyn Drive<N> + Send>;

/// The joints' start positions, rad or m.
///
/// # Errors
/// When the list has another length.
pub fn q_start<const N: usize>(config: &Config) -> Result<SVector<f64, N>, AssembleError> {
    joint_vector("robot.q_start_rad_or_m", &config.start.q)
}

/// The limits of the joint reference: of the robot and of the configuration.
///
/// # Errors
/// When a list has another length.
pub fn motion_limits<const N: usize>(
    config: &Config,
    robot: &Robot<N>,
) -> Result<MotionLimits<N>, AssembleError> {
    let motion = &config.motion;
    Ok(MotionLimits::of(
        robot,
        joint_vector("motion.max_acceleration_rad_s2_or_m_s2", &motion.max_acceleration)?,
        joint_vector("motion.max_jerk_rad_s3_or_m_s3", &motion.max_jerk)?,
    ))
}

/// The renderer of the true scene of a configuration.
///
/// # Errors
/// [`AssembleError`], also for a configuration without a simulated scene.
pub fn renderer(config: &Config) -> Result<Renderer, AssembleError> {
    let (Source::Synthetic { look, sensor, response, .. }, Some(scene)) =
        (&config.camera.source, &config.scene)
    else {
        return Err(AssembleError::NoScene);
    };
    Ok(Renderer::new(scene.camera, scene.target.clone(), *look, *sensor)?
        .with_response(response, &config.camera.response)
        .with_backdrop(scene.backdrop)?
        .with_bystanders(&scene.bystanders)
        .with_further_targets(scene.further_in_first()))
}

/// The synthetic camera of a configuration, with its true parameters, for an arm at rest at its start.
///
/// # Errors
/// [`AssembleError`], also for a configuration without a simulated scene.
pub fn synthetic_camera<const N: usize>(config: &Config) -> Result<SyntheticCamera<N>, AssembleError> {
    let (Source::Synthetic { motion_blur, .. }, Some(scene)) = (&config.camera.source, &config.scene) else {
        return Err(AssembleError::NoScene);
    };
    let q_start = q_start(config)? + q_offset(scene)?;
    let history = ArmHistory::new(scene.arm.build()?, q_start);
    let renderer = renderer(config)?;
    let camera = SyntheticCamera::new(
        history,
        renderer,
        scene.mount,
        scene.places(),
        scene.occluders.clone(),
        *motion_blur,
    );
    Ok(camera.with_faults(config.camera.schedule))
}

fn q_offset<const N: usize>(scene: &Scene) -> Result<SVector<f64, N>, AssembleError> {
    joint_vector("scene.arm.q_offset_rad_or_m", &scene.q_offset)
}

/// The drive of a configuration; that of an open loop does not move.
///
/// # Errors
/// [`AssembleError`]; an external drive cannot be made here.
pub fn drive<const N: usize>(config: &Config, robot: &Robot<N>) -> Result<AnyDrive<N>, AssembleError> {
    let q_start = q_start::<N>(config)?;
    Ok(match (config.closes_the_loop(), config.drive.kind) {
        (_, DriveKind::External | DriveKind::Replay) => return Err(AssembleError::ExternalDrive),
        (false, _) => Box::new(StandstillDrive::new(q_start)),
        (true, DriveKind::Ideal) => {
            let ideal = IdealDrive::new(q_start).with_offset(true_offset(config)?);
            Box::new(if config.drive.mode == CommandMode::Velocity { ideal.by_velocity() } else { ideal })
        }
        (true, DriveKind::Simulated) => {
            Box::new(SimulatedDrive::new(robot.clone(), q_start, simulated_settings(config)?)?)
        }
        (true, DriveKind::None) => Box::new(StandstillDrive::new(q_start)),
    })
}

/// True joint positions less what the encoders read; zero where nothing is simulated.
fn true_offset<const N: usize>(config: &Config) -> Result<SVector<f64, N>, AssembleError> {
    config.scene.as_ref().map_or(Ok(SVector::zeros()), q_offset)
}

/// The settings of the simulated arm of a configuration.
///
/// # Errors
/// When a list does not fit `N`.
pub fn simulated_settings<const N: usize>(
    config: &Config,
) -> Result<SimulatedDriveSettings<N>, AssembleError> {
    let arm = &config.drive.simulated;
    let truth: Option<Robot<N>> = config.scene.as_ref().map(|scene| scene.arm.build()).transpose()?;
    let q_start = q_start::<N>(config)?;
    let rotor_inertia = truth
        .as_ref()
        .map_or(SVector::zeros(), |robot| robot.mass_matrix(&q_start).diagonal() * arm.untold_rotor_share);
    Ok(SimulatedDriveSettings {
        mode: config.drive.mode,
        substeps: arm.substeps,
        friction: arm.friction,
        hard_friction: arm.hard_friction,
        rotor_inertia,
        wind_up: arm.wind_up,
        ripple: arm.ripple.map(|ripple| TorqueRipple { seed: config.seed, ..ripple }),
        base: arm.base.map(|base| ShakingBase { seed: config.seed, ..base }),
        effort_limits: arm.effort_limits,
        tells_torque: arm.tells_torque,
        command_delay_ticks: arm.command_delay_ticks,
        arm: truth.map(|robot| {
            let friction = true_friction(&robot, arm, config.seed);
            robot.with_friction(friction)
        }),
        q_offset: true_offset(config)?,
        payload: arm.payload,
        encoder: EncoderModel {
            step: joint_vector("drive.simulated.encoder_step_rad_or_m", &arm.encoder_step)?,
            noise_sd: joint_vector("drive.simulated.encoder_noise_sd_rad_or_m", &arm.encoder_noise_sd)?,
            velocity_filter_hz: arm.velocity_filter_hz,
            seed: config.seed,
        },
        servo: arm.servo,
        surroundings: arm.surroundings,
        faults: JointFaults::new(&config.faults.joints, config.seed),
    })
}

/// Friction of a simulated arm: that of its robot file, varied over the joints, and the additional friction of the run file.
fn true_friction<const N: usize>(robot: &Robot<N>, arm: &SimulatedArm, seed: u64) -> [Friction; N] {
    let mut random = Random::new(seed);
    std::array::from_fn(|i| {
        let (told, limit) = (&robot.friction()[i], &robot.limits()[i]);
        let scale = random.between(1.0 - arm.friction_spread, 1.0 + arm.friction_spread);
        Friction {
            viscous: told.viscous * scale,
            coulomb: (told.coulomb + arm.untold_coulomb_share * limit.effort) * scale,
        }
    })
}

/// Control and mission of a configuration, with its drive.
///
/// # Errors
/// [`AssembleError`]; after [`Config::load`] only where lists do not fit `N`.
pub fn control_loop<const N: usize>(
    config: &Config,
    robot: Robot<N>,
) -> Result<LockstepRun<N>, AssembleError> {
    let drive = drive(config, &robot)?;
    control_loop_with(config, robot, drive)
}

/// Control and mission of a configuration with a drive that was made elsewhere.
///
/// # Errors
/// As for [`control_loop`].
pub fn control_loop_with<const N: usize>(
    config: &Config,
    robot: Robot<N>,
    drive: AnyDrive<N>,
) -> Result<LockstepRun<N>, AssembleError> {
    require_controllable(config)?;
    let names = drive.joint_names();
    if !names.is_empty() {
        crate::drive::compare_joint_names(names, robot.joint_names())?;
    }
    // A robot that makes up for its friction by itself has none for who commands its torques.
    let robot = if config.drive.torque_contains.friction {
        robot
    } else {
        robot.with_friction([Friction::default(); N])
    };
    let q_start = q_start::<N>(config)?;
    let limits = motion_limits(config, &robot)?;
    // A recorded arm is commanded like any other.
    let (closed_loop, has_arm) = (config.closes_the_loop(), config.has_an_arm());
    let joint_control = joint_controller(config, &robot, &q_start)?;
    let set_point = match &config.stereo {
        Some(_) => stereo_set_point(config)?,
        None => config.set_point.clone(),
    };
    let servo = VisualServo::new(config.servo.clone(), set_point);
    let watch = MeasurementWatch::new(config.safety.measurement_timeout, config.safety.slow_down_from);
    let cell = || BelievedCell {
        robot: robot.clone(),
        limits: limits.clone(),
        mount: config.camera.mount,
        camera: config.camera.model,
        points: config.target.points().iter().map(|point| point.p_O).collect(),
    };
    let planning = cell();
    let space = config.workspace.clone().map(|space| Workspace::new(robot.clone(), space));
    let (task, behaviour) = match (config.task, closed_loop) {
        (Task::CalibrateLatency, _) => {
            (RunTask::excitation(cell()), Behaviour::Excitation(Excitation::new(watch)))
        }
        (Task::CalibrateHandEye, _) => (RunTask::tour(cell()), Behaviour::Waypoints(Waypoints::default())),
        (Task::CalibrateLoad, _) => {
            (RunTask::load_tour(cell(), space.clone()), Behaviour::Waypoints(Waypoints::default()))
        }
        (Task::Servo, true) if config.looks_and_moves() => {
            (RunTask::LookAndMove(LookAndMove::new(cell())), Behaviour::Waypoints(Waypoints::passing()))
        }
        (Task::Servo, _) if has_arm => (RunTask::Servo, Behaviour::Servoing(Servoing::new(watch))),
        (Task::Servo, _) => (RunTask::Servo, Behaviour::Servoing(Servoing::new(watch).dry())),
    };
    let is_recorded = config.drive.kind == DriveKind::Replay;
    let settings = ControllerSettings {
        effort_rate: effort_rates::effort_rate(config, &robot),
        drive_period: config.drive.period,
        start_tolerance: config.start.tolerance,
        // A recorded arm was where it was.
        may_start_elsewhere: config.start.elsewhere || is_recorded,
        max_tracking_error: config.safety.max_tracking_error,
        obeys: !is_recorded,
        reaction: config.safety.contact,
        reduced_speed_share: config.safety.reduced_speed_share,
        space: config.workspace.clone(),
        ..ControllerSettings::new(ArmModel { robot, limits }, joint_control, config.drive.mode, q_start)
    };
    let plays_once = is_recorded || matches!(config.camera.source, Source::Replay { repeat: false, .. });
    let service = if config.serve {
        Service::Served
    } else {
        Service::OneShot { teaches: config.task == Task::Servo && config.goal.is_taught }
    };
    let plan = RunPlan {
        service,
        teaching_measurements: config.goal.measurements,
        duration: (!plays_once && !config.serve).then_some(config.duration),
        measurement_timeout: config.safety.measurement_timeout,
        closed_loop,
        f_px: cameras::f_px(&config.camera),
        path: config.servo.path.clone(),
        law: config.servo.law.clone(),
        follows: config.servo.object.is_some(),
        points: config.targets().map(|(_, target)| target.point_kind()).collect(),
        stability: f64::NAN,
    };
    let goal = Goal {
        id: 0,
        set_point: servo.set_point().clone(),
        tolerance_px: config.goal.feature_error_px,
        hold: config.goal.hold,
    };
    let one_lens = Some(&config.camera.model).filter(|_| config.stereo.is_none());
    let truth = config.scene.as_ref().map(|scene| truth(scene, one_lens)).transpose()?;
    let of_loop = LoopSettings {
        served: config.serve,
        moves_an_arm: closed_loop,
        one_clock: config.clock == Clock::Realtime,
    };
    let controller = Controller::new(settings, servo, behaviour).with_second(second_servo(config, watch));
    let control = ControlLoop::new(controller, drive, of_loop);
    let further = config.further_targets.iter().map(|further| further.set_point.clone());
    // Of two cameras the lens is no single one, and a target that moves tells nothing of the lens.
    let keeps = closed_loop && config.task == Task::Servo && config.further_cameras.is_empty();
    let keeps = keeps && config.servo.object.is_none() && config.servo.estimation.is_none();
    let mission = Mission::new(plan, task, goal, truth).with_further_goals(further).keeping_views(keeps);
    let mission = mission.with_second_goal(second_goal(config)?);
    Ok(LockstepRun::new(control, mission.in_cell(planning).in_space(space)))
}

fn joint_controller<const N: usize>(
    config: &Config,
    robot: &Robot<N>,
    q_start: &SVector<f64, N>,
) -> Result<JointController<N>, AssembleError> {
    let motion = &config.motion;
    let (omega_rad_s, zeta) = (motion.natural_frequency_rad_s, motion.damping_ratio);
    let law = match motion.controller {
        JointControl::InverseDynamics => {
            JointLaw::InverseDynamics(InverseDynamicsControl::new(omega_rad_s, zeta))
        }
        JointControl::OperationalSpace => {
            JointLaw::OperationalSpace(InverseDynamicsControl::new(omega_rad_s, zeta))
        }
        JointControl::PdGravity => {
            let mut control = PdGravityControl::for_posture(robot, q_start, omega_rad_s, zeta);
            if !motion.stiffness.is_empty() {
                control.stiffness = joint_vector("motion.stiffness_n_m_rad_or_n_m", &motion.stiffness)?;
            }
            if !motion.damping.is_empty() {
                control.damping = joint_vector("motion.damping_n_m_s_rad_or_n_s_m", &motion.damping)?;
            }
            JointLaw::PdGravity(control)
        }
        JointControl::PassThrough => JointLaw::PassThrough,
    };
    // A drive that closes its own loop makes up for its disturbances itself: torques do nothing there.
    let obeys_torque = config.drive.mode == CommandMode::Torque;
    let observer = ObserverSettings {
        disturbance_rad_s: if obeys_torque { motion.disturbance_rad_s } else { 0.0 },
        velocity_rad_s: if obeys_torque { motion.velocity_observer_rad_s } else { 0.0 },
        encoder_step: joint_vector("motion.encoder_step_rad_or_m", &motion.encoder_step)?,
        encoder_noise: joint_vector("drive.simulated.encoder_noise_sd_rad_or_m", &motion.encoder_noise)?,
        max_acceleration: ObserverSettings::bound(robot, q_start),
        inertia: ObserverSettings::free_inertia(robot, q_start),
    };
    let controller = JointController::new(law, observer);
    // What is not learnt at all is not learnt of the payload either.
    let learns = observer.disturbance_rad_s > 0.0;
    let acceleration = joint_vector("motion.max_acceleration_rad_s2_or_m_s2", &motion.max_acceleration)?;
    Ok(if learns {
        controller.with_payload_estimator(robot.clone(), acceleration, config.tool.mass > 0.0)
    } else {
        controller
    })
}

fn joint_vector<const N: usize>(key: &'static str, list: &[f64]) -> Result<SVector<f64, N>, AssembleError> {
    const { assert!(N <= MAX_JOINTS) };
    if list.len() == N {
        Ok(SVector::from_column_slice(list))
    } else {
        Err(AssembleError::Joints { key, found: list.len(), wanted: N })
    }
}
