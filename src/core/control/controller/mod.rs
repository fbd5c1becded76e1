//! The controller: lifecycle, behaviour, motion and gate, one step a tick.
//!
//! ```text
//! DriveState ─► watch ─► lifecycle ─► behaviour's motion command, or rest ─► reference ─► joint controller ─► gate ─► DriveCommand
//! Measurement ──────────► behaviour                                   (limits)      (torque)
//! ```
//! When an arm at rest begins to move, and at each fault, the reference is reset to the measured arm if it is not there already.
//! A view that returns while the arm brakes does not reset it: the reference continues within the limits. A joint
//! controller gets the reference of this tick and its acceleration until the next, synchronous with the state that it acts
//! upon; a law that outputs torques moves the reference by the acceleration that they would cause.
//! `step` is total: it does not allocate, log, fail or look at a clock.

mod contact;
mod measurements;
mod motion;
mod orders;
mod rest;
mod returning;
mod searching;
mod second_servo;
mod sensing;
mod settings;
mod space;
mod torque_law;

pub use second_servo::SecondServo;
use settings::StartCheck;
pub use settings::{ControlOutput, ControllerSettings, Rest};

use crate::control::behaviour::{ArmModel, Behaviour, MotionCommand, PostureMotion, VelocityMotion};
use crate::control::gate::{Gate, Passed, SpaceBound};
use crate::control::lifecycle::{Cue, State, Step};
use crate::control::safety::{
    ArmWatch, Contact, ContactReaction, ContactWatch, EncoderWatch, Fault, RestWatch,
};
use crate::control::trace::{Event, Events};
use crate::drive::{CommandMode, DriveCommand, DriveState, DriveTiming, RepeatedStates};
use crate::messages::Measurement;
use crate::motion::{JointController, Limit, Reference, Workspace};
use crate::servo::VisualServo;
use crate::time::{MonoNs, SpanNs, TICK};
use contact::WayBack;
use motion::TickMotion;
use nalgebra::{SVector, Vector6};
use rest::Standstill;
pub use rest::UnknownJoint;
use returning::ReturnWatch;
use torque_law::Pushes;

/// A reference that is this near to the measured arm (rad or m; rad/s or m/s) is not reset to it. Chosen by hand: four steps of the
/// coarsest encoders that are tested, and a velocity that the joint controller corrects within the limits.
const ON_THE_ARM: (f64, f64) = (2e-3, 0.1);
/// Share of `safety.max_tracking_error_rad_or_m` above which, in a fault, the reference is reset to the arm that does not brake as commanded.
/// Chosen by hand: well below 1, so that the torque towards the reference stays small.
const ASTRAY: f64 = 0.3;
/// Speed below which an arm that was damped is held in position again, rad/s or m/s. Chosen by hand: an arm that sinks more slowly than this
/// under a wrong gravity model is caught, and a faster one is damped only.
const SLOW: f64 = 0.1;
/// Factor of its velocity limit above which a joint in a fault says that the model is wrong, or a motor dead: the one above which a joint is too fast (`safety/arm.rs`). A reference is never
/// above 1. Measured: an arm that a wall throws back is, for moments (1.1 fails `contact::an_arm_that_releases_goes_back_from_the_wall`).
const WILD: f64 = 1.5;

/// The controller of one arm with `N` joints.
#[derive(Debug)]
pub struct Controller<const N: usize> {
    arm: ArmModel<N>,
    /// Places measurements in time, and has the law.
    servo: VisualServo<N>,
    /// The law of a second camera that controls the arm, too.
    second: Option<Box<SecondServo<N>>>,
    behaviour: Behaviour<N>,
    /// The motion to a posture that a client asked for, in the state `Moving`.
    posture: PostureMotion<N>,
    /// The motion by velocities that a client commands, in the same state.
    velocity: VelocityMotion<N>,
    /// Whether friction is probed, so that the reference stands.
    probes: bool,
    /// How a law of torques pushes the joints.
    pushes: Pushes<N>,
    /// Whether the end of the behaviour's motion was reported.
    over_told: bool,
    joint_control: JointController<N>,
    /// Factor of the disturbance estimation rate.
    learning: f64,
    gate: Gate<N>,
    /// The gate's last word on where the arm is, where that is limited.
    space: Option<SpaceBound<N>>,
    start: StartCheck<N>,
    max_tracking_error: f64,
    /// Whether the arm does as it is told: see [`ControllerSettings::obeys`].
    obeys: bool,
    mode: CommandMode,
    reference: Reference<N>,
    state: State,
    returning: ReturnWatch<N>,
    fault: Option<Fault>,
    /// A fault from outside that the next step takes in.
    failure: Option<Fault>,
    /// Whether the next state of the drive is an old one, and how its states come.
    is_state_old: bool,
    repeats: RepeatedStates<N>,
    timing: DriveTiming,
    watch: ArmWatch<N>,
    encoder_watch: EncoderWatch<N>,
    rest_watch: RestWatch<N>,
    contact_watch: ContactWatch<N>,
    /// The joint torques that the drive's last state carries, N m or N.
    measured_torque: Option<SVector<f64, N>>,
    reaction: ContactReaction,
    /// Share of the velocity limits in reduced mode, and of this tick.
    reduced_speed_share: f64,
    speed_share: f64,
    contact: Option<Contact>,
    /// When something was last felt on the arm.
    touched_at: Option<MonoNs>,
    back: Option<WayBack<N>>,
    standstill: Standstill<N>,
    events: Events,
}

impl<const N: usize> Controller<N> {
    /// A controller of an arm at rest, which moves by `behaviour` and the law of `servo` once it is started.
    #[must_use]
    pub fn new(settings: ControllerSettings<N>, servo: VisualServo<N>, behaviour: Behaviour<N>) -> Self {
        let gate = settings.gate();
        let ControllerSettings { arm, joint_control, mode, q_start, .. } = settings;
        let limits = arm.limits.clone();
        let braking = SpanNs::from_s(limits.longest_braking_s());
        let (reference, space) =
            space::within(Reference::new(limits.clone(), q_start), &arm.robot, settings.space);
        Self {
            contact_watch: ContactWatch::new(&arm.robot, &joint_control, mode),
            reaction: settings.reaction,
            reduced_speed_share: settings.reduced_speed_share,
            speed_share: 1.0,
            measured_torque: None,
            contact: None,
            back: None,
            mode,
            gate: Gate::new(gate, &limits, &q_start),
            space,
            reference,
            arm,
            servo,
            second: None,
            behaviour,
            posture: PostureMotion::default(),
            velocity: VelocityMotion::default(),
            probes: false,
            pushes: Pushes::default(),
            over_told: false,
            joint_control,
            learning: 1.0,
            start: StartCheck {
                q: q_start,
                tolerance: settings.start_tolerance,
                elsewhere: settings.may_start_elsewhere,
                is_checked: false,
            },
            max_tracking_error: settings.max_tracking_error,
            obeys: settings.obeys,
            state: State::Idle,
            returning: ReturnWatch::default(),
            fault: None,
            failure: None,
            is_state_old: false,
            repeats: RepeatedStates::default(),
            timing: DriveTiming::of_period(settings.drive_period),
            watch: ArmWatch::default(),
            encoder_watch: EncoderWatch::default(),
            rest_watch: RestWatch::default(),
            touched_at: None,
            standstill: Standstill::new(braking),
            events: Events::default(),
        }
    }

    /// The arm as control knows it.
    #[must_use]
    pub fn arm(&self) -> &ArmModel<N> {
        &self.arm
    }

    /// The law and its inputs.
    #[must_use]
    pub fn servo(&self) -> &VisualServo<N> {
        &self.servo
    }

    /// The law output for a camera without an arm, `V_WC_C`, m/s and rad/s; `None` where an arm moves the camera, and where there is
    /// no usable view at `now`.
    #[must_use]
    pub fn camera_law_output(&self, now: MonoNs) -> Option<Vector6<f64>> {
        let goes = self.behaviour.is_dry()
            && self.state != State::Teaching
            && self.behaviour.confidence(now, &self.servo) > 0.0;
        goes.then(|| self.servo.camera_law_output()).flatten()
    }

    /// The state of the lifecycle.
    #[must_use]
    pub fn state(&self) -> State {
        self.state
    }

    /// Whether the arm is at rest.
    #[must_use]
    pub fn rest(&self) -> Rest {
        self.standstill.rest
    }

    /// The command that the drive is to hold when no other follows: the last one that passed the gate, at zero velocity.
    #[must_use]
    pub fn last_command(&self) -> DriveCommand<N> {
        self.gate.last()
    }

    /// The joint controller, which tells what was found of the arm that its model does not have.
    #[must_use]
    pub fn joint_control(&self) -> &JointController<N> {
        &self.joint_control
    }

    /// Number of commands that the gate had to change.
    #[must_use]
    pub fn gated(&self) -> u64 {
        self.gate.changed()
    }

    /// One tick: takes the drive's state and a measurement, if a new one has come, and gives the command for the
    /// time until the next tick.
    pub fn step(
        &mut self,
        now: MonoNs,
        drive: &DriveState<N>,
        measurement: Option<&Measurement>,
    ) -> ControlOutput<N> {
        let state = self.sense(now, drive);
        let (mut verdict, mut confidence) = (None, 0.0);
        let observed = state.map(|state| {
            let (q, qd) = self.joint_control.observe(&self.arm.robot, &state.q, &state.qd);
            DriveState { q, qd, ..state }
        });
        self.feel(now, observed.as_ref());
        if let Some(observed) = &observed {
            (verdict, confidence) = self.take_in(now, observed, measurement);
        }
        // Without a camera an arm that has lost its target would go back for nothing.
        let may_return = !self.behaviour.is_dry() && self.behaviour.sees(now);
        let to_begin = self.returning.is_to_begin();
        let returns = |state: &DriveState<N>| self.servo.way_back(&state.q, to_begin).filter(|_| may_return);
        let way_back = observed.as_ref().and_then(returns);
        let left = way_back.as_ref().map(|(qd, way)| qd.amax() / way.rate_1_s);
        if self.returning.goes_to_begin(left) {
            confidence = 0.0;
        }
        self.live(now, state.as_ref(), confidence, (may_return, left));
        if self.state != State::Servoing {
            self.interrupt();
        }
        let motion_command = match (&observed, self.state, way_back) {
            (Some(state), State::Servoing, _) => self.servoing(now, state, confidence),
            (Some(state), State::Returning, _) if self.returning.is_searching() => {
                confidence = 1.0;
                self.search(state)
            }
            (Some(_), State::Returning, Some((qd, convergence))) => {
                // The way back follows the arm's earlier postures and needs no view.
                confidence = 1.0;
                MotionCommand::Velocity(self.pace_of_return(qd), convergence)
            }
            (Some(state), State::Moving, _) => self.motion_asked_for(now, state),
            (Some(_), ..) => self.motion_back(now),
            _ => MotionCommand::Stand,
        };
        if self.behaviour.is_over() && !std::mem::replace(&mut self.over_told, true) {
            self.events.push(Event::MotionOver);
        }
        self.joint_control.soften(self.fault.is_some());
        self.joint_control.distrust(self.encoder_watch.distrusted());
        // Without a usable state the arm is assumed to be on its reference.
        let seen = state.is_some();
        let measured = state.unwrap_or_else(|| self.believed());
        let state = observed.unwrap_or(measured);
        let motion = self.motion(&state, &motion_command, confidence);
        let mut limits = motion.limits;
        let tau = self.torque(&state, &motion, seen, &mut limits);
        // In a fault the arm is only braked and held. A torque that carries a load unknown to the model may be needed for that and drives nothing,
        // so that the bound on the measured arm is not applied.
        let bounded = if self.fault.is_some() { self.believed() } else { measured };
        let gravity = || self.joint_control.carrying(&self.arm.robot).gravity(&bounded.q);
        let Passed { command, cut, fault } = self.gate.pass(self.reference.state(), &tau, &bounded, gravity);
        self.joint_control.note_given(&self.arm.robot, &state.q, &command.tau);
        limits.add(Limit::Effort, cut);
        // What does not reach the arm may wind up.
        let fault = fault.filter(|fault| self.obeys || *fault != Fault::CommandsRefused);
        let in_space = self.watch_space(&measured);
        if let Some(fault) =
            fault.or(in_space).or_else(|| self.astray(now, (&measured, &state.qd), &motion, seen))
        {
            self.fail(fault);
        }
        self.note_rest(now, seen.then_some(&measured));
        ControlOutput {
            command,
            state: self.state,
            fault: self.fault,
            requested_qd: motion_command.velocity(),
            limits,
            held_by: self.reference.space().and_then(Workspace::held_by),
            verdict,
            events: std::mem::take(&mut self.events),
            external_torque: self.contact_watch.external_torque(),
            contact: self.touched_by(&measured.q),
        }
    }

    /// Updates the lifecycle by the view, by whether the camera is at work, and how far it is to a posture to return to, rad or m.
    fn live(
        &mut self,
        now: MonoNs,
        state: Option<&DriveState<N>>,
        confidence: f64,
        way_back: (bool, Option<f64>),
    ) {
        let before = self.state;
        if let Some(fault) = self.failure.take() {
            let fault = self.of_stuck_readings(now, fault);
            self.fault.get_or_insert(fault);
            self.cue(Cue::Failed);
            if let Some(state) = state {
                let believed = self.distrust_encoders(fault, state);
                self.reset_to_measured(&believed);
            }
        }
        let rest = self.rest();
        if rest == Rest::AtRest || (rest == Rest::Unknown && self.fault.is_some()) {
            self.cue(Cue::AtRest);
        }
        self.cue(if confidence > 0.0 && state.is_some() { Cue::InView } else { Cue::OutOfView });
        self.note_way_back(now, before, way_back);
        if self.state == State::Moving {
            if self.posture.is_over(&self.reference.state().q) {
                self.cue(Cue::Arrived);
            } else if self.velocity.is_over(now, self.rests()) {
                self.cue(Cue::Silent);
            }
        }
        if self.state != State::Moving {
            self.posture.end();
            self.velocity.end();
        }
        let begins = (self.state == State::Servoing && before != State::Servoing)
            || (self.state == State::Returning && before == State::Waiting)
            || self.posture.is_new()
            || self.velocity.is_new();
        if let Some(state) = state.filter(|_| begins) {
            self.reset_to_measured(state);
            self.watch.restart();
            self.contact_watch.restart();
            self.begin_in_space(state);
        }
    }

    /// Whether the reference rests, and comes to no motion by what it has.
    fn rests(&self) -> bool {
        self.reference.rests_within(SpanNs(2 * TICK.0))
    }

    fn cue(&mut self, cue: Cue) {
        if let Step::To(next) = self.state.next(cue) {
            let event = match (self.state, next) {
                (_, State::Failing) => self.fault.map(Event::Fault),
                (State::Servoing, State::Holding) => Some(Event::Holding),
                (State::Holding, State::Returning) if self.returning.is_searching() => Some(Event::Searching),
                (State::Holding | State::Waiting, State::Returning) => Some(Event::Returning),
                (State::Holding | State::Returning, State::Servoing) => Some(Event::Resumed),
                (State::Teaching, State::Held) => Some(Event::Taught),
                (State::Moving, State::Held) if cue == Cue::Arrived => Some(Event::Arrived),
                (State::Moving, State::Held) if cue == Cue::Silent => Some(Event::VelocityEnded),
                _ => None,
            };
            event.into_iter().for_each(|event| self.events.push(event));
            self.state = next;
        }
    }

    /// Resets the reference to the measured arm, if it is not there already. While one of the two moves, this makes the reference's velocity
    /// jump, which is allowed in a fault only: a torque towards a wrong reference would keep the arm moving. What passes the gate never jumps.
    fn reset_to_measured(&mut self, state: &DriveState<N>) {
        let stands = !self.gate.is_open() || self.rest() == Rest::AtRest;
        // A drive in position or velocity mode continues from its last command: there the reference approaches the arm within the limits.
        let obeyed = self.mode != CommandMode::Torque && self.gate.is_open();
        if obeyed || !(stands || self.fault.is_some()) {
            return;
        }
        // The velocity that a noisy encoder reports of an arm at rest is ignored.
        let qd = if stands { SVector::zeros() } else { state.qd };
        let r = self.reference.state();
        if (r.q - state.q).amax() <= ON_THE_ARM.0 && (r.qd - qd).amax() <= ON_THE_ARM.1 {
            return;
        }
        self.reference.reset_to_measured(&state.q, &qd);
        self.gate.begin_at(&state.q);
        self.joint_control.reset_to_measured(&state.q, &qd);
    }

    /// The fault of an arm that does not follow its reference. In a fault the reference is reset to the arm, which moves at
    /// `qd`, the estimated velocity instead of that of a coarse encoder at a single tick.
    fn astray(
        &mut self,
        now: MonoNs,
        (state, qd): (&DriveState<N>, &SVector<f64, N>),
        motion: &TickMotion<N>,
        seen: bool,
    ) -> Option<Fault> {
        if !seen || !self.obeys {
            return None;
        }
        let distance = (motion.now.q - state.q).amax();
        if self.fault.is_some() {
            // An arm that does not brake as commanded deviates from its model: it is damped until it has nearly stopped.
            let is_wild =
                self.back.is_none() && (0..N).any(|i| qd[i].abs() > WILD * self.arm.limits.velocity[i]);
            // Motions that its model damps little (of joints about nearly the same axis, against each other) go on for seconds.
            let is_overdue =
                self.back.is_none() && !self.floats() && qd.amax() > SLOW && self.is_overdue(now);
            let astray = distance > ASTRAY * self.max_tracking_error
                || self.joint_control.damps()
                || is_wild
                || is_overdue;
            if self.mode == CommandMode::Torque && (astray || self.floats()) {
                self.reference.reset_to_measured(&state.q, qd);
                self.joint_control.damp(qd.amax() > SLOW || self.floats());
                self.choose_brake(now, (&state.q, qd), (is_wild, is_overdue));
            }
            self.joint_control.learn_in_fault(self.learns_in_fault(now));
            return None;
        }
        let behind = self.watch.follow(&state.q, &motion.way);
        // A drive that obeys velocities has no position to be away from: its lag is what it did less than it was told.
        let lag = if self.mode == CommandMode::Velocity { self.watch.lag() } else { distance };
        let swings = if motion.follows { self.watch.swing(&state.q, &motion.way, self.timing) } else { None };
        if lag > self.max_tracking_error { Some(Fault::TrackingError) } else { behind.or(swings) }
    }
}
