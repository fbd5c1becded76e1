//! The controller: lifecycle, behaviour, motion and gate, one step a tick.
//!
//! ```text
//! DriveState ─► watch ─► lifecycle ─► behaviour's intent, or rest ─► reference ─► joint controller ─► gate ─► DriveCommand
//! Measurement ──────────► behaviour                                   (limits)      (torque)
//! ```
//! Each entry into motion, and each fault, puts the reference on the measured arm where it is not there already. A joint
//! controller gets the reference of this tick and its acceleration from here on, and is in step with the state that it acts
//! upon; a law that wishes torques moves the reference by the acceleration that they would bring about.
//! `step` is total: it does not allocate, log, fail or look at a clock.

use crate::control::behaviour::{ArmModel, Behaviour, Intent};
use crate::control::gate::{Gate, GateSettings, Passed};
use crate::control::lifecycle::{Cue, Refusal, Request, State, Step};
use crate::control::safety::{ArmWatch, Fault, RestWatch};
use crate::control::trace::{Event, Events};
use crate::drive::{CommandMode, DriveCommand, DriveState};
use crate::messages::Measurement;
use crate::motion::{ActingLimits, JointController, Limit, Reference, ReferenceState, brakeable, evade};
use crate::servo::{Approach, Intake};
use crate::time::TICK;
use crate::time::{MonoNs, SpanNs};
use nalgebra::SVector;

/// A reference so near to the measured arm (rad or m; rad/s or m/s) is on it.
const ON_THE_ARM: (f64, f64) = (2e-3, 0.1);
/// Share of the largest tracking error beyond which a braking reference is put back on the arm.
const ASTRAY: f64 = 0.3;
/// Rate at which an arm under a torque law is braked where its view is not to be trusted, 1/s.
const BRAKE_1_S: f64 = 8.0;
/// Difference of a joint's velocity from that of its reference up to which it is what is expected, rad/s or m/s.
const EXPECTED_SPEED: f64 = 1.0;
/// A joint that moves has all its Coulomb friction, rad/s or m/s.
const MOVES: f64 = 0.05;
/// Mean time for which a joint under a torque law is taken to have accelerated, where it has to move.
const START_S: f64 = 0.2;
/// Rate at which a reference that a drive obeys goes back to an arm that has not followed it, 1/s.
const BACK_1_S: f64 = 5.0;
/// How long an arm whose reference rests may go on moving.
const PATIENCE: SpanNs = SpanNs(2_000_000_000);

/// What a controller is made of.
#[derive(Debug, Clone)]
pub struct ControllerSettings<const N: usize> {
    /// The arm.
    pub arm: ArmModel<N>,
    /// Joint controller.
    pub joint_control: JointController<N>,
    /// What the drive obeys.
    pub mode: CommandMode,
    /// Time in which the effort of a joint may rise from zero to its largest.
    pub effort_rise: SpanNs,
    /// Where the run file has the arm start, rad or m.
    pub q_start: SVector<f64, N>,
    /// Distance of a joint from there beyond which the arm is not where the run file says.
    pub start_tolerance: f64,
    /// Whether it may start elsewhere.
    pub may_start_elsewhere: bool,
    /// Largest distance of a joint from its reference, rad or m.
    pub max_tracking_error: f64,
}

impl<const N: usize> ControllerSettings<N> {
    /// A controller of `arm` that starts in `q_start` before a drive which obeys `mode`; the rest as in the default run.
    #[must_use]
    pub fn new(
        arm: ArmModel<N>,
        joint_control: JointController<N>,
        mode: CommandMode,
        q_start: SVector<f64, N>,
    ) -> Self {
        Self {
            arm,
            joint_control,
            mode,
            effort_rise: SpanNs(10_000_000),
            q_start,
            start_tolerance: 0.02,
            may_start_elsewhere: false,
            max_tracking_error: 0.1,
        }
    }

    fn gate(&self) -> GateSettings<N> {
        let limits = self.arm.robot.limits();
        let effort = SVector::from_fn(|i, _| limits[i].effort);
        GateSettings { effort, effort_rate: effort / self.effort_rise.as_s(), mode: self.mode }
    }
}

/// What a step leads to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ControlOutput<const N: usize> {
    /// For the drive.
    pub command: DriveCommand<N>,
    /// What the controller does.
    pub state: State,
    /// Why it does nothing more, in fault.
    pub fault: Option<Fault>,
    /// The joint velocity that the behaviour asks for, before limits; rad/s or m/s.
    pub wish: SVector<f64, N>,
    /// The limits that acted, and on which joints.
    pub limits: ActingLimits,
    /// What became of the measurement, if there was one.
    pub intake: Option<Intake>,
    /// What happened.
    pub events: Events,
}

/// Whether the arm stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rest {
    /// Reference or measured arm move.
    Moving,
    /// Both stand.
    AtRest,
    /// The arm goes on moving although its reference has rested for 2 s.
    Restless,
    /// The reference stands; the arm cannot be seen.
    Unknown,
}

/// The controller of one arm with `N` joints.
#[derive(Debug)]
pub struct Controller<const N: usize> {
    arm: ArmModel<N>,
    behaviour: Box<dyn Behaviour<N>>,
    joint_control: JointController<N>,
    gate: Gate<N>,
    start: Start<N>,
    max_tracking_error: f64,
    mode: CommandMode,
    reference: Reference<N>,
    state: State,
    fault: Option<Fault>,
    /// A fault from outside that the next step takes in.
    failure: Option<Fault>,
    watch: ArmWatch<N>,
    rest_watch: RestWatch<N>,
    rest: Rest,
    /// Since when the reference rests while the arm is to stand, and since when it is braked.
    rests_since: Option<MonoNs>,
    brakes_since: Option<MonoNs>,
    /// From whatever motion to rest, with some patience.
    longest_braking: SpanNs,
    events: Events,
}

/// Where the arm starts.
#[derive(Debug, Clone, Copy)]
struct Start<const N: usize> {
    q: SVector<f64, N>,
    tolerance: f64,
    elsewhere: bool,
    is_checked: bool,
}

/// What a tick wants of the joints, within the limits.
struct Motion<const N: usize> {
    /// Where the reference is at the time of the state, and its acceleration from there on.
    now: ReferenceState<N>,
    /// Limits that acted.
    limits: ActingLimits,
    /// The joint controller follows a reference; else the acceleration of a law that wishes torques.
    follows: bool,
    /// How far each joint should go in this tick, rad or m.
    way: SVector<f64, N>,
}

impl<const N: usize> Controller<N> {
    /// A controller of an arm that stands, and moves for `behaviour` once it is started.
    #[must_use]
    pub fn new(settings: ControllerSettings<N>, behaviour: Box<dyn Behaviour<N>>) -> Self {
        let gate = settings.gate();
        let ControllerSettings { arm, joint_control, mode, q_start, .. } = settings;
        let limits = arm.limits.clone();
        let braking = SpanNs::from_s(limits.longest_braking_s());
        let longest_braking = SpanNs(PATIENCE.0.saturating_add(braking.0));
        Self {
            mode,
            gate: Gate::new(gate, limits.clone(), q_start),
            reference: Reference::new(limits, q_start),
            arm,
            behaviour,
            joint_control,
            start: Start {
                q: q_start,
                tolerance: settings.start_tolerance,
                elsewhere: settings.may_start_elsewhere,
                is_checked: false,
            },
            max_tracking_error: settings.max_tracking_error,
            state: State::Idle,
            fault: None,
            failure: None,
            watch: ArmWatch::default(),
            rest_watch: RestWatch::default(),
            rest: Rest::Moving,
            rests_since: None,
            brakes_since: None,
            longest_braking,
            events: Events::default(),
        }
    }

    /// The arm as control knows it.
    #[must_use]
    pub fn arm(&self) -> &ArmModel<N> {
        &self.arm
    }

    /// What the arm moves for.
    #[must_use]
    pub fn behaviour(&self) -> &dyn Behaviour<N> {
        self.behaviour.as_ref()
    }

    /// What the controller does.
    #[must_use]
    pub fn state(&self) -> State {
        self.state
    }

    /// Whether the arm stands.
    #[must_use]
    pub fn rest(&self) -> Rest {
        self.rest
    }

    /// Whether the measured arm has stood for 50 ms, whatever it is to do.
    #[must_use]
    pub fn arm_stands(&self) -> bool {
        self.rest_watch.is_at_rest()
    }

    /// Commands that the gate had to change.
    #[must_use]
    pub fn gated(&self) -> u64 {
        self.gate.changed()
    }

    /// Somebody wants something; it is so from the next step on.
    ///
    /// # Errors
    /// Why not.
    pub fn request(&mut self, request: Request) -> Result<(), Refusal> {
        match self.state.next(Cue::Request(request)) {
            Step::Refuse(refusal) => Err(refusal),
            Step::Stay => Ok(()),
            Step::To(next) => {
                if request == Request::Reset {
                    (self.fault, self.failure) = (None, None);
                }
                if request == Request::Teach {
                    self.behaviour.teach();
                }
                self.state = next;
                Ok(())
            }
        }
    }

    /// Something outside has failed. The first fault is the one that is told.
    pub fn fail(&mut self, fault: Fault) {
        self.failure.get_or_insert(fault);
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
        let (mut intake, mut confidence) = (None, 0.0);
        if let Some(state) = &state {
            self.behaviour.note_arm(now, state);
            intake = measurement.map(|m| self.behaviour.take(now, &state.q, m, &self.arm));
            confidence = self.behaviour.confidence(now);
        }
        self.live(state.as_ref(), confidence);
        let intent = match (&state, self.state.moves()) {
            (Some(state), true) => self.behaviour.intent(state, &self.arm.robot),
            (state, false) => {
                self.behaviour.pause();
                let lost = state.as_ref().filter(|_| self.state == State::Holding);
                if let Some(back) = lost.and_then(|state| self.behaviour.way_back(&state.q)) {
                    // It goes by where the arm was, not by a view.
                    confidence = 1.0;
                    back
                } else {
                    Intent::Stand
                }
            }
            (None, true) => Intent::Stand,
        };
        self.joint_control.soften(self.fault.is_some());
        // A state that is none: the arm is thought to be where its reference is.
        let seen = state.is_some();
        let state = state.unwrap_or_else(|| self.believed());
        let motion = self.motion(&state, &intent, confidence);
        let mut limits = motion.limits;
        let tau = self.torque(&state, &motion, seen, &mut limits);
        let Passed { command, cut, fault } = self.gate.pass(self.reference.state(), &tau);
        limits.add(Limit::Effort, cut);
        if let Some(fault) = fault.or_else(|| self.astray(&state, &motion, seen)) {
            self.fail(fault);
        }
        self.note_rest(now, seen);
        ControlOutput {
            command,
            state: self.state,
            fault: self.fault,
            wish: intent.velocity(),
            limits,
            intake,
            events: std::mem::take(&mut self.events),
        }
    }

    /// The drive's state, if it can be one of this arm.
    fn sense(&mut self, now: MonoNs, drive: &DriveState<N>) -> Option<DriveState<N>> {
        let wrong = self.watch.note(now, drive, &self.arm.limits);
        if let Some(fault) = wrong {
            self.fail(fault);
        }
        if wrong.is_some_and(Fault::blinds) || self.failure.is_some_and(Fault::blinds) {
            return None;
        }
        if self.fault.is_some_and(Fault::blinds) {
            // A drive that has reported what cannot be is believed again where it reports what is expected.
            let r = self.reference.state();
            if (drive.q - r.q).amax() > self.max_tracking_error || (drive.qd - r.qd).amax() > EXPECTED_SPEED {
                return None;
            }
        }
        self.rest_watch.note(drive);
        if !std::mem::replace(&mut self.start.is_checked, true) {
            if (drive.q - self.start.q).amax() > self.start.tolerance {
                self.events.push(Event::StartsElsewhere);
                if !self.start.elsewhere {
                    self.fail(Fault::StartsElsewhere);
                }
            }
            self.seat(drive, true);
        }
        Some(*drive)
    }

    /// Where the lifecycle goes by what is seen.
    fn live(&mut self, state: Option<&DriveState<N>>, confidence: f64) {
        let moved = self.state.moves();
        if let Some(fault) = self.failure.take() {
            self.fault.get_or_insert(fault);
            self.cue(Cue::Failed);
            if let Some(state) = state {
                self.seat(state, self.rest == Rest::AtRest);
            }
        }
        if self.rest == Rest::AtRest || (self.rest == Rest::Unknown && self.fault.is_some()) {
            self.cue(Cue::AtRest);
        }
        if self.state == State::Teaching && !self.behaviour.is_teaching() {
            self.cue(Cue::Taught);
        }
        self.cue(if confidence > 0.0 && state.is_some() { Cue::InView } else { Cue::OutOfView });
        if let Some(state) = state.filter(|_| self.state.moves() && !moved) {
            // What stands, stands: the velocity of a noisy encoder is none.
            self.seat(state, self.rest == Rest::AtRest);
            self.watch.restart();
        }
    }

    fn cue(&mut self, cue: Cue) {
        if let Step::To(next) = self.state.next(cue) {
            let event = match (self.state, next) {
                (_, State::Failing) => self.fault.map(Event::Fault),
                (State::Servoing, State::Holding) => Some(Event::Holding),
                (State::Holding, State::Servoing) => Some(Event::Resumed),
                (State::Teaching, State::Held) => Some(Event::Taught),
                _ => None,
            };
            event.into_iter().for_each(|event| self.events.push(event));
            self.state = next;
        }
    }

    /// Puts the reference on the measured arm, where it is not there already.
    fn seat(&mut self, state: &DriveState<N>, stands: bool) {
        let qd = if stands { SVector::zeros() } else { state.qd };
        let r = self.reference.state();
        // What a drive obeys goes on from what it was told: there the way back to the arm is one within the limits.
        if self.mode != CommandMode::Torque && self.gate.is_open() {
            return;
        }
        if (r.q - state.q).amax() <= ON_THE_ARM.0 && (r.qd - qd).amax() <= ON_THE_ARM.1 {
            return;
        }
        self.reference.seat(&state.q, &qd);
        self.gate.seat(&state.q, &qd);
        self.joint_control.seat(&state.q, &qd);
    }

    /// The arm where its reference is.
    fn believed(&self) -> DriveState<N> {
        let r = self.reference.state();
        DriveState { q: r.q, qd: r.qd, truth: None }
    }

    /// The reference of this tick, and on to that of the next one.
    fn motion(&mut self, state: &DriveState<N>, intent: &Intent<N>, confidence: f64) -> Motion<N> {
        let mut limits = ActingLimits::default();
        let wish = match intent {
            Intent::Torque(tau) => return self.pushed(state, tau, confidence),
            Intent::Stand | Intent::Look(_) if self.mode == CommandMode::Position && self.fault.is_some() => {
                (state.q - self.reference.state().q) * BACK_1_S
            }
            Intent::Stand | Intent::Look(_) => SVector::zeros(),
            Intent::Joints(qd) => *qd,
            Intent::Velocity(qd, approach) => {
                let (qd, acting) = self.held_back(&state.q, qd, approach, confidence);
                limits = acting;
                qd
            }
        };
        if self.mode == CommandMode::Velocity {
            // The drive obeys velocities alone: positions that were summed up from them would drift away from the arm.
            let qd = self.reference.state().qd;
            self.reference.place(&state.q, &qd);
            self.gate.place(&state.q, &qd);
        }
        let before = *self.reference.state();
        let after = self.reference.advance(&wish, TICK);
        let now = ReferenceState { q: before.q, qd: before.qd, ..*after };
        let way = now.qd * TICK.as_s();
        Motion { now, limits: limits.with(&after.limits), follows: true, way }
    }

    /// A law that wishes torques: the reference goes on from the arm with the acceleration that they bring about.
    fn pushed(&mut self, state: &DriveState<N>, tau: &SVector<f64, N>, confidence: f64) -> Motion<N> {
        let robot = &self.arm.robot;
        let within = SVector::from_fn(|i, _| {
            let effort = robot.limits().get(i).map_or(0.0, |limit| limit.effort);
            tau[i].clamp(-effort, effort)
        });
        // Friction is made up for, as the laws have it, which know of none.
        let qdd = robot.forward_dynamics(&state.q, &state.qd, &within);
        let trusted = qdd * confidence - state.qd * (BRAKE_1_S * (1.0 - confidence));
        self.reference.place(&state.q, &state.qd);
        self.gate.place(&state.q, &state.qd);
        let after = *self.reference.accelerate(&trusted, TICK);
        let mut limits = after.limits;
        if confidence < 1.0 {
            (0..N).for_each(|i| limits.set(Limit::View, i));
        }
        for i in (0..N).filter(|i| within[*i] != tau[*i]) {
            limits.set(Limit::Effort, i);
        }
        // A joint that stands is pushed through twice its friction before it has to move.
        let stiction = robot.friction_torque(&qdd.map(|a| MOVES * a.signum())) * 2.0;
        let loose = robot.forward_dynamics(&state.q, &state.qd, &(within - stiction));
        let way =
            SVector::from_fn(
                |i, _| if loose[i] * qdd[i] > 0.0 { loose[i] * START_S * TICK.as_s() } else { 0.0 },
            );
        Motion { now: ReferenceState { q: state.q, qd: state.qd, ..after }, limits, follows: false, way }
    }

    /// The wish, slowed down so that the arm can brake at the goal, where the view is old or uncertain, and ahead of
    /// singular postures and ends of ranges.
    fn held_back(
        &self,
        q: &SVector<f64, N>,
        wish: &SVector<f64, N>,
        approach: &Approach<N>,
        confidence: f64,
    ) -> (SVector<f64, N>, ActingLimits) {
        let ArmModel { robot, limits } = &self.arm;
        let (mut wish, mut acting) = brakeable(wish, approach, self.reference.state(), limits);
        if confidence < 1.0 {
            wish *= confidence;
            (0..N).for_each(|i| acting.set(Limit::View, i));
        }
        let J_C = self.behaviour.camera_jacobian(robot, q);
        let (wish, evading) = evade(robot, q, &J_C, &wish, &approach.free);
        (wish, acting.with(&evading))
    }

    /// The torque for the time until the next tick, N m or N.
    fn torque(
        &mut self,
        state: &DriveState<N>,
        motion: &Motion<N>,
        seen: bool,
        limits: &mut ActingLimits,
    ) -> SVector<f64, N> {
        let robot = &self.arm.robot;
        let torque = match (seen, motion.follows) {
            (false, _) => self.joint_control.blind_torque(robot, &motion.now),
            (true, true) => self.joint_control.torque(robot, &state.q, &state.qd, &motion.now),
            (true, false) => self.joint_control.torque_for(robot, &state.q, &state.qd, &motion.now.qdd),
        };
        limits.add(Limit::Effort, torque.saturated);
        torque.tau
    }

    /// What the arm does against its reference that it may not do. A reference that brakes is put back on the arm.
    fn astray(&mut self, state: &DriveState<N>, motion: &Motion<N>, seen: bool) -> Option<Fault> {
        if !seen {
            return None;
        }
        let distance = (motion.now.q - state.q).amax();
        if self.fault.is_some() {
            if self.mode == CommandMode::Torque && distance > ASTRAY * self.max_tracking_error {
                self.reference.seat(&state.q, &state.qd);
                self.gate.seat(&state.q, &state.qd);
            }
            return None;
        }
        let behind = self.watch.follow(&state.q, &motion.way);
        if distance > self.max_tracking_error { Some(Fault::TrackingError) } else { behind }
    }

    fn note_rest(&mut self, now: MonoNs, seen: bool) {
        let brakes = matches!(self.state, State::Stopping | State::Failing | State::Fault);
        let since = *self.brakes_since.get_or_insert(now);
        self.brakes_since = brakes.then_some(since);
        // From `v <= J T^2` braking takes at most two ticks `T`, and in one tick it changes the acceleration by at most
        // `J T`: a standstill at the next one is within the limits.
        let reference_rests = self.reference.rests_within(SpanNs(2 * TICK.0));
        let since = *self.rests_since.get_or_insert(now);
        self.rests_since = (reference_rests && !self.state.moves()).then_some(since);
        let is_over = |since: Option<MonoNs>, patience| since.is_some_and(|since| now - since > patience);
        self.rest = if self.rests_since.is_some() && (!seen || self.rest_watch.is_at_rest()) {
            if seen { Rest::AtRest } else { Rest::Unknown }
        } else if is_over(self.rests_since, PATIENCE)
            || (brakes && is_over(self.brakes_since, self.longest_braking))
        {
            Rest::Restless
        } else {
            Rest::Moving
        };
    }
}
