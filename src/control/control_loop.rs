//! One run of the control loop without clock and processes: drive, controller, goal, and what is counted on the way.
//!
//! The real-time thread, the lockstep loop and in-process simulations all call [`ControlLoop::tick`]. It does not
//! allocate, log or fail.

mod status;

pub use crate::control::outcome::Finish;

use crate::control::controller::{ControlOutput, Controller};
use crate::control::lifecycle::{Refusal, Request};
use crate::control::measurement_log::MeasurementLog;
use crate::control::outcome::{FinalErrors, Outcome};
use crate::control::records::{command_trace, joint_state};
use crate::control::residual::{NO_NEARER, OUT_OF_REACH, ResidualWatch};
use crate::control::run_end::{self, NextStep, RunEnd};
use crate::control::safety::Fault;
use crate::control::trace::{Event, Events, FrameStamps, LatencyStages, MeasurementRecord, Trace};
use crate::control::truth::Truth;
use crate::drive::{Drive, DriveCommand, DriveState};
use crate::messages::{ControlState, JointState, Measurement, frame_flag};
use crate::motion::ActingLimits;
use crate::servo::{MeasurementVerdict, View};
use crate::time::TICK;
use crate::time::{MonoNs, SpanNs};
use nalgebra::{SVector, Vector2};

/// Ticks between two status records: 50 Hz.
const STATUS_PERIOD: u64 = 20;
/// An arm swings whose error does not fall below so many times that of the goal: nearer to it, it is given time.
const SWINGS_FROM: f64 = 1.5;
/// The end of an open loop whose images are over.
const LAST_FRAME: Finish = Finish { outcome: Outcome::Finished, reason: "the last frame was used" };
/// The end of a closed loop whose camera has no more frames.
const NO_MORE_FRAMES: Finish = Finish {
    outcome: Outcome::NotConverged,
    reason: "the camera said that its last frame has come, before the goal was reached",
};

/// The end of a run that somebody asked for.
const SHUT_DOWN: Finish = Finish { outcome: Outcome::Stopped, reason: "somebody asked for the end" };

/// What makes a run begin, and end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Service {
    /// It starts by itself, after a lesson where the goal is taught, and ends when it is done.
    OneShot {
        /// Whether the goal is taught first.
        teaches: bool,
    },
    /// It does what it is told, and ends when it is told.
    Served,
}

/// What the loop is to reach, and when it ends without.
#[derive(Debug, Clone, Copy)]
pub struct RunPlan {
    /// What makes the run begin, and end.
    pub service: Service,
    /// Largest root mean square feature error, px; the goal.
    pub feature_error_px: f64,
    /// How long the goal must be held.
    pub hold: SpanNs,
    /// When the arm is brought to rest at the latest; `None` ends with the last frame only.
    pub duration: Option<SpanNs>,
    /// Whether the loop is closed: without it there is no goal to reach.
    pub closed_loop: bool,
    /// Whether ticks, frames and measurements are stamped by one clock: in real time, not in lockstep.
    pub one_clock: bool,
    /// Focal lengths that turn normalized errors into pixels.
    pub f_px: Vector2<f64>,
}

/// The loop of one run.
pub struct ControlLoop<const N: usize> {
    controller: Controller<N>,
    drive: Box<dyn Drive<N> + Send>,
    plan: RunPlan,
    truth: Option<Truth<N>>,
    measurements: MeasurementLog,
    ticks: u64,
    statuses: u64,
    first: Option<MonoNs>,
    last: MonoNs,
    goal_since: Option<MonoNs>,
    residual: ResidualWatch,
    /// Whether it was told that the goal was held.
    goal_told: bool,
    state: ControlState,
    sensed: DriveState<N>,
    command: DriveCommand<N>,
    end: RunEnd,
    errors_at_end: Option<FinalErrors>,
    last_frame_seen: bool,
    /// The measurement that this tick's command uses.
    used: Option<Measurement>,
    joint_state: JointState,
    events: Events,
    /// Limits that acted since the last status.
    acted: ActingLimits,
}

impl<const N: usize> ControlLoop<N> {
    /// A loop that has not ticked yet; `truth` is that of a simulated cell.
    #[must_use]
    pub fn new(
        controller: Controller<N>,
        drive: Box<dyn Drive<N> + Send>,
        plan: RunPlan,
        truth: Option<Truth<N>>,
    ) -> Self {
        let zero = SVector::zeros();
        Self {
            controller,
            drive,
            plan,
            truth,
            measurements: MeasurementLog::new(),
            ticks: 0,
            statuses: 0,
            first: None,
            last: MonoNs::ZERO,
            goal_since: None,
            residual: ResidualWatch::default(),
            goal_told: false,
            state: ControlState::Waiting,
            sensed: DriveState { q: zero, qd: zero, truth: None },
            command: DriveCommand { tau: zero, q_r: zero, qd_r: zero },
            end: RunEnd::default(),
            errors_at_end: None,
            last_frame_seen: false,
            used: None,
            joint_state: JointState::default(),
            events: Events::default(),
            acted: ActingLimits::default(),
        }
    }

    /// First half of a tick: reads the drive at the tick's time.
    pub fn sense(&mut self, tick: u64, now: MonoNs) -> JointState {
        if self.first.is_none() {
            self.first = Some(now);
            self.begin();
        }
        self.last = now;
        let late = self.drive.health().late_states;
        self.sensed = self.drive.read(now);
        if self.drive.health().late_states > late {
            self.controller.follow_anew();
        }
        if let Some(fault) = self.drive.health().fault {
            self.controller.fail(Fault::Drive(fault));
        }
        self.joint_state = joint_state(tick, self.ticks, now, &self.sensed, &self.command);
        self.joint_state
    }

    /// Second half: steps the controller on that state and writes the drive. A finish ends the run.
    pub fn act(&mut self, tick: u64, now: MonoNs, measurement: Option<&Measurement>) -> Trace {
        self.used = measurement.copied();
        let output = self.controller.step(now, &self.sensed, measurement);
        let measurement_record = measurement.map(|m| self.count(now, m, output.verdict));
        self.drive.write(&output.command);
        self.command = output.command;
        self.ticks += 1;
        self.note_state(&output);
        self.acted = self.acted.with(&output.limits);
        if tick.is_multiple_of(STATUS_PERIOD) {
            self.residual.note_arm(now, self.controller.arm_stands());
            self.reduce_gain();
        }
        let finish = self.finish(now, &output);
        if let Some(finish) = finish {
            self.drive.end();
            self.state = match finish.outcome {
                Outcome::Converged => ControlState::Converged,
                Outcome::Fault => ControlState::Fault,
                Outcome::NotConverged | Outcome::Finished | Outcome::Stopped => ControlState::Stopped,
            };
        }
        let status = (tick.is_multiple_of(STATUS_PERIOD) || finish.is_some()).then(|| self.status(tick, now));
        if status.is_some() {
            self.statuses += 1;
            self.acted = ActingLimits::default();
        }
        let events = std::mem::take(&mut self.events);
        let joint_state = self.joint_state;
        let command = command_trace(&output);
        Trace {
            time: now,
            joint_state,
            command,
            commanded: now,
            state: self.state,
            fault: output.fault,
            lost: 0,
            status,
            measurement_record,
            limits: output.limits,
            events,
            finish,
        }
    }

    /// A whole tick.
    pub fn tick(&mut self, tick: u64, now: MonoNs, measurement: Option<&Measurement>) -> Trace {
        self.sense(tick, now);
        self.act(tick, now, measurement)
    }

    /// Tells when the command of the tick of `trace` was written, which closes the latency of the measurement that it used.
    pub fn commanded(&mut self, at: MonoNs, trace: &mut Trace) {
        trace.commanded = at;
        if let (Some(m), Some(measurement_record)) = (self.used.take(), &mut trace.measurement_record) {
            let latency = LatencyStages::of(&m, at, self.plan.one_clock);
            self.measurements.commanded(latency);
            measurement_record.latency = Some(latency);
        }
    }

    /// Brings the arm to rest and ends the run with `reason`.
    pub fn stop(&mut self, reason: &'static str) {
        if self.end.decided().is_none() {
            self.end.decide(Finish { outcome: Outcome::Stopped, reason });
            self.events.push(Event::Stopping);
            let _ = self.controller.request(Request::Shutdown); // nothing refuses it
        }
    }

    /// Does what somebody wants.
    ///
    /// # Errors
    /// Why not.
    pub fn request(&mut self, request: Request) -> Result<(), Refusal> {
        if self.end.decided().is_some() {
            return Err(Refusal::Ending);
        }
        self.controller.request(request)?;
        self.events.push(Event::Requested(request));
        match request {
            Request::Shutdown => self.end.decide(SHUT_DOWN),
            // Idle is what a run that is not served never is.
            Request::Stop if self.plan.service != Service::Served => self.end.decide(SHUT_DOWN),
            Request::Reset => self.drive.reset(),
            Request::Start => {
                (self.goal_since, self.goal_told) = (None, false);
                // What an earlier start came to says nothing about this one.
                self.residual.begin_anew();
            }
            Request::Hold | Request::Teach | Request::Stop => {}
        }
        Ok(())
    }

    /// A run that is not told what to do starts by itself.
    fn begin(&mut self) {
        if let (Service::OneShot { teaches }, None) = (self.plan.service, self.end.decided()) {
            let first = if teaches { Request::Teach } else { Request::Start };
            let _ = self.controller.request(first); // it is idle, and takes both
        }
    }

    /// Something failed outside of the cores: the run ends with the next [`act`](Self::act).
    pub fn fail(&mut self, fault: Fault) {
        self.controller.fail(fault);
    }

    /// No tick follows, whatever state the loop is in: the drive is to stop by its own means.
    pub fn abandon(&mut self) {
        self.drive.end();
    }

    /// Ticks that found no new state of the drive in time.
    #[must_use]
    pub fn late_drive_states(&self) -> u64 {
        self.drive.health().late_states
    }

    /// The controller.
    #[must_use]
    pub fn controller(&self) -> &Controller<N> {
        &self.controller
    }

    /// Ticks done.
    #[must_use]
    pub fn ticks(&self) -> u64 {
        self.ticks
    }

    /// What the loop does, or did last.
    #[must_use]
    pub fn state(&self) -> ControlState {
        self.state
    }

    /// What control remembers of the measurements.
    pub(crate) fn measurements(&self) -> &MeasurementLog {
        &self.measurements
    }

    fn count(
        &mut self,
        now: MonoNs,
        m: &Measurement,
        verdict: Option<MeasurementVerdict>,
    ) -> MeasurementRecord {
        self.last_frame_seen |= m.flags & frame_flag::LAST != 0;
        let set_point = self.controller.behaviour().set_point();
        // What the law refused says nothing about the goal: it is old, or of another target. Nor does braking at the end.
        let has_ended = self.end.decided().is_some();
        let is_of_goal =
            !matches!(verdict, Some(MeasurementVerdict::TooFewFeatures | MeasurementVerdict::ImpossiblePose));
        let judged = is_of_goal && !has_ended;
        let view = View::of(m, set_point).filter(|_| judged);
        let error_px = view.map_or(f64::NAN, |view| set_point.error_rms_px(&view, &self.plan.f_px));
        self.measurements.note(m, verdict, error_px, &mut self.events);
        if verdict.is_some_and(MeasurementVerdict::is_used) {
            let degraded = self.controller.behaviour().is_degraded();
            self.measurements.note_degraded(degraded, &mut self.events);
        }
        let measurement_record =
            MeasurementRecord { frame: FrameStamps::of(m), verdict, error_px, latency: None };
        if verdict.is_some_and(MeasurementVerdict::is_refused) {
            return measurement_record;
        }
        self.residual.note_error(now, error_px);
        if error_px.is_nan() || error_px > self.plan.feature_error_px {
            self.goal_since = None;
        } else {
            self.goal_since.get_or_insert(now);
        }
        measurement_record
    }

    fn note_state(&mut self, output: &ControlOutput<N>) {
        for event in output.events.iter() {
            self.events.push(event);
            if event == Event::Holding
                && let Some(finish) = self.controller.behaviour().when_lost()
            {
                self.end.decide(finish);
            }
        }
        self.state = output.state.told();
        if self.plan.service == Service::Served {
            return;
        }
        if let Some(fault) = output.fault {
            self.end.decide(Finish::fault(fault));
        }
        let begins = matches!(self.plan.service, Service::OneShot { teaches: true });
        if begins && output.events.iter().any(|event| event == Event::Taught) {
            let _ = self.controller.request(Request::Start); // refused where somebody wants something else
        }
    }

    /// The end of the run, once the arm is at rest.
    fn finish(&mut self, now: MonoNs, output: &ControlOutput<N>) -> Option<Finish> {
        if self.end.decided().is_none()
            && let Some(finish) = self.reached(now)
        {
            self.end.decide(finish);
        }
        if self.end.decided().is_some() && self.errors_at_end.is_none() {
            self.errors_at_end = Some(self.errors());
        }
        // In lockstep no state comes any more where the drive does not answer.
        let drive_is_gone = !self.plan.one_clock && matches!(output.fault, Some(Fault::Drive(_)));
        let waits_for_arm = self.plan.closed_loop && !drive_is_gone;
        match self.end.next(self.controller.rest(), waits_for_arm) {
            NextStep::GoOn => None,
            NextStep::Brake => {
                let _ = self.controller.request(Request::Shutdown); // nothing refuses it
                None
            }
            NextStep::GiveUp => {
                self.events.push(Event::Fault(Fault::NotAtRest));
                // The fault that came first is the reason, this one its consequence.
                self.end.decide(Finish::fault(Fault::NotAtRest));
                self.end.decided()
            }
            NextStep::Over(finish) => Some(finish),
        }
    }

    /// How the run ends by itself, if it does at this tick.
    fn reached(&mut self, now: MonoNs) -> Option<Finish> {
        let behaviour = self.controller.behaviour();
        let held = self.state == ControlState::Servoing
            && behaviour.has_goal()
            && self.goal_since.is_some_and(|since| now - since >= self.plan.hold);
        if self.plan.service == Service::Served {
            if held && !std::mem::replace(&mut self.goal_told, true) {
                self.events.push(Event::GoalReached);
            }
            return None;
        }
        if let Some(finish) = behaviour.finished() {
            return Some(finish);
        }
        if held {
            return Some(Finish { outcome: Outcome::Converged, reason: "the goal was reached and held" });
        }
        if self.last_frame_seen {
            return Some(if self.plan.closed_loop { NO_MORE_FRAMES } else { LAST_FRAME });
        }
        let time = now - self.first.unwrap_or(now);
        let time_is_up = self.plan.duration.is_some_and(|duration| time >= duration);
        let goal_px = self.plan.feature_error_px;
        let no_nearer = || self.residual.is_no_nearer(goal_px).then_some(NO_NEARER);
        let stays = || self.residual.constant_px(goal_px).map(|_| OUT_OF_REACH).or_else(no_nearer);
        let when_late =
            behaviour.when_late().or_else(|| stays().filter(|_| self.state == ControlState::Servoing));
        time_is_up
            .then(|| run_end::time_is_up(self.plan.closed_loop, self.state, when_late, &self.measurements))
    }

    /// An arm that moves about a goal which it does not reach is slowed down; one that then sticks before it is not any more.
    fn reduce_gain(&mut self) {
        let goal_px = self.plan.feature_error_px;
        if self.end.decided().is_some() {
            return;
        }
        if self.residual.constant_px(goal_px).is_some() {
            if self.controller.restore_gain() {
                self.residual.begin_anew();
            }
        } else if self.residual.is_no_nearer(SWINGS_FROM * goal_px) && self.controller.reduce_gain() {
            self.residual.begin_anew();
            self.events.push(Event::GainReduced);
        }
    }

    /// Time from the first tick to the last one, that one included, s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.first.map_or(0.0, |first| (self.last + TICK - first).as_s())
    }
}
