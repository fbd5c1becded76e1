//! `vservo drive check`: plays control's side of an external drive's contract, without camera, vision or a law, and writes down what is sent and what comes.
//!
//! ```text
//! instance, role of control ─► program behind its guard ─► START, START ─► phases of the plan ─► LAST ─► the program's end      once for each trial
//! ```
//! Whatever ends a trial (its plan, Ctrl-C, a state that departs, silence of the drive), the arm is told to hold where it is, and then LAST, as long as the
//! program is there.

mod session;

use super::supervisor::InstanceGuard;
use super::supervisor::child::Child;
use super::{Membership, ProcessError, StopFlag};
use crate::config::{Clock, Config};
use crate::dispatch_robot;
use crate::drive::check::{
    self, ArmFacts, DriveLog, DriveRule, DriveTrial, JointFacts, ProgramExit, RuleVerdict,
};
use crate::drive::{CommandMode, TorqueContents};
use crate::ipc::{Instance, Role};
use crate::messages::{DriveStateMsg, MAX_JOINTS, drive_flag};
use crate::robot::JointKind;
use crate::rt::{now, prepare_thread, tell};
use nalgebra::SVector;
use session::TrialSession;

/// Rules whose breach ends the trials: an arm that goes elsewhere is not moved on.
const MISLEADS: [DriveRule; 4] = [DriveRule::Course, DriveRule::Order, DriveRule::Sign, DriveRule::Follow];
/// Rate of the loop that holds an arm by torques, rad/s, with critical damping. Chosen by hand: slow enough for commands that are late by 10 ms, and stiff
/// enough that friction and a few per cent of the model's weight do not show.
const HOLDING_RAD_S: f64 = 20.0;

/// Tries the drive of `config`; what was sent and received, trial by trial. Nothing moves by itself unless `moves`.
///
/// # Errors
/// When the instance cannot be had, or shared memory fails.
pub fn run(
    config: &Config,
    instance: &Instance,
    moves: bool,
    stop: &StopFlag,
) -> Result<Vec<DriveLog>, ProcessError> {
    let by_hand = config.drive.external.command.is_empty();
    let mut logs = Vec::new();
    // A velocity tells joints, signs and units apart before a wrong position could make the arm leap.
    let first = match config.drive.mode {
        CommandMode::Position if !by_hand => CommandMode::Velocity,
        mode => mode,
    };
    let mut todo = vec![(DriveTrial::Motion, first)];
    while let Some((trial, mode)) = todo.pop().filter(|_| !stop.is_requested()) {
        tell(format_args!("vservo drive check: {}", what(trial, mode, moves)));
        let log = tried(config, instance, (trial, mode, moves), stop)?;
        // What else there is to try is known from the first answer.
        if logs.is_empty()
            && !by_hand
            && log.received.iter().any(|r| r.state.flags & drive_flag::INITIAL != 0)
        {
            let modes = log.received.first().map_or(0, |r| r.state.modes);
            todo = further(config, (modes, first), moves);
        }
        if check::judge(&log).iter().any(|f| f.verdict == RuleVerdict::Broken && MISLEADS.contains(&f.rule)) {
            tell("vservo drive check: the arm does not go where it is told, and is not moved any more");
            todo.clear();
        }
        logs.push(log);
    }
    Ok(logs)
}

fn what(trial: DriveTrial, mode: CommandMode, moves: bool) -> String {
    match trial {
        DriveTrial::Motion if moves && mode != CommandMode::Torque => {
            format!("mode {mode}: holds the arm, and moves one joint after another by hundredths of a radian")
        }
        DriveTrial::Motion => format!("mode {mode}: holds the arm"),
        DriveTrial::Silence => format!("mode {mode}: no commands"),
        DriveTrial::WrongJoints => format!("mode {mode}: commands of another number of joints"),
        DriveTrial::NotFinite => format!("mode {mode}: commands that are not finite"),
    }
}

/// The trials after the first, the next one last.
fn further(
    config: &Config,
    (modes, first): (u32, CommandMode),
    moves: bool,
) -> Vec<(DriveTrial, CommandMode)> {
    let takes = |mode: &CommandMode| modes & mode.bit() != 0;
    let moving = [CommandMode::Velocity, CommandMode::Position];
    let mut todo = Vec::new();
    if config.clock == Clock::Realtime
        // A velocity that nobody takes back is what silence is about.
        && let Some(mode) = moving.into_iter().chain([CommandMode::Torque]).find(takes)
    {
        if moves {
            todo.push((DriveTrial::NotFinite, mode));
        }
        if moves && mode != CommandMode::Torque {
            todo.push((DriveTrial::WrongJoints, mode));
        }
        todo.push((DriveTrial::Silence, mode));
    }
    let others = moving.into_iter().rev().filter(|mode| takes(mode) && *mode != first);
    todo.extend(others.map(|mode| (DriveTrial::Motion, mode)));
    todo
}

/// One trial, in a thread of its own: the program is started before it gets its priority, which would be the program's too.
fn tried(
    config: &Config,
    instance: &Instance,
    what: (DriveTrial, CommandMode, bool),
    stop: &StopFlag,
) -> Result<DriveLog, ProcessError> {
    let mut config = config.clone();
    let arm = arm_facts(&config, config.drive.mode);
    config.drive.mode = what.1;
    config.effective.drive.mode = Some(what.1);
    std::thread::scope(|scope| {
        let work = || one_trial(&config, arm, instance, what, stop);
        let thread = std::thread::Builder::new().name("drive-check".into()).spawn_scoped(scope, work);
        let thread = thread.map_err(|cause| ProcessError::Start { what: "the thread of a trial", cause })?;
        thread.join().unwrap_or(Err(ProcessError::Panicked("drive-check")))
    })
}

fn one_trial(
    config: &Config,
    arm: ArmFacts,
    instance: &Instance,
    (trial, mode, moves): (DriveTrial, CommandMode, bool),
    stop: &StopFlag,
) -> Result<DriveLog, ProcessError> {
    let (_place, _written) = InstanceGuard::take(config, instance)?;
    let membership = Membership::join(instance, Role::Control, config)?;
    let services = membership.services();
    let texts = services.drive_text_receiver()?;
    let (state, listener) = services.drive_state_receiver()?;
    let (command, presence) = (services.drive_command_sender()?, services.drive_presence()?);
    let external = &config.drive.external;
    let program = Child::spawn_program(Role::Drive, &external.command, &external.folder, instance)?;
    let _ = prepare_thread(&config.realtime.request);
    let log = DriveLog {
        trial,
        mode,
        arm,
        sent: Vec::new(),
        received: Vec::new(),
        texts: Vec::new(),
        phases: Vec::new(),
        until: now(),
        given_up: None,
        exit: if program.is_some() { ProgramExit::Ran } else { ProgramExit::Unknown },
    };
    let torques = holding_torques(config)?;
    let mut session = TrialSession {
        instance,
        stop,
        membership,
        presence,
        command,
        state,
        texts,
        listener,
        program,
        answer_timeout: external.answer_timeout,
        torques,
        contents: config.drive.torque_contains,
        log,
    };
    let result = session.go(config, moves).and_then(|()| session.say_last());
    // Whatever it was that failed: the program is not left alone.
    let log = session.end();
    result.map(|()| log)
}

fn arm_facts(config: &Config, wanted: CommandMode) -> ArmFacts {
    let joints = config.robot.joints.iter().map(|joint| JointFacts {
        name: joint.name.clone(),
        limits: joint.limits,
        prismatic: joint.kind == JointKind::Prismatic,
    });
    ArmFacts {
        joints: joints.collect(),
        connect_timeout: config.drive.external.connect_timeout,
        drive_timeout: config.safety.drive_timeout,
        lead: config.servo.lead,
        wanted,
        lockstep: config.clock == Clock::Lockstep,
    }
}

/// Torques that hold an arm at a posture, from its state: weight, and a slow loop through the mass matrix.
type HoldingTorques = Box<dyn Fn(&[f64; MAX_JOINTS], &DriveStateMsg) -> [f64; MAX_JOINTS]>;

fn holding_torques(config: &Config) -> Result<HoldingTorques, ProcessError> {
    let contents = config.drive.torque_contains;
    Ok(dispatch_robot!(config.robot, |robot| torques_of(robot, contents))?)
}

fn torques_of<const N: usize>(robot: crate::robot::Robot<N>, contents: TorqueContents) -> HoldingTorques {
    Box::new(move |q_r, state| {
        let of = |values: &[f64; MAX_JOINTS]| {
            SVector::<f64, N>::from_iterator(values.iter().copied().chain(std::iter::repeat(0.0)).take(N))
        };
        let (q, qd) = (of(&state.q), of(&state.qd));
        let wanted = (of(q_r) - q) * (HOLDING_RAD_S * HOLDING_RAD_S) - qd * (2.0 * HOLDING_RAD_S);
        let whole = robot.inverse_dynamics(&q, &SVector::zeros(), &wanted);
        let tau = if contents.gravity { whole } else { whole - robot.gravity(&q) };
        let mut out = [0.0; MAX_JOINTS];
        for ((to, tau), limits) in out.iter_mut().zip(tau.iter()).zip(robot.limits()) {
            *to = tau.clamp(-limits.effort, limits.effort);
        }
        out
    })
}
