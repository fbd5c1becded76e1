//! One run of the control loop without clock and processes: drive, controller, goal, and what is counted on the way.
//!
//! The real-time thread, the lockstep loop and in-process simulations all call [`ControlLoop::tick`]. It does not
//! allocate, log or fail.

use crate::calibration::GentleMotion;
use crate::controller::{ControlOutput, Controller};
use crate::drive::{Drive, DriveCommand, DriveState};
use crate::geometry::{Pose, rotation_angle};
use crate::messages::{
    ControlState, JointState, MAX_JOINTS, Measurement, Status, TargetStatus, frame_flag, joint_flag,
};
use crate::motion::ActingLimits;
use crate::run_statistics::{Event, RunStatistics};
use crate::safety::Fault;
use crate::scene::SceneMotion;
use crate::schedule::TICK;
use crate::servo::View;
use crate::summary::{FinalErrors, Outcome, SafetyReport};
use crate::time::{MonoNs, SpanNs};
use nalgebra::{SVector, Vector2};

/// Ticks between two status records: 50 Hz.
const STATUS_PERIOD: u64 = 20;
/// A stopping arm that has not come to rest by then is left to its drive.
const LONGEST_STOP: SpanNs = SpanNs(1_000_000_000);
/// A reference slower than this is at rest, rad/s or m/s.
const AT_REST: f64 = 1e-9;
/// The end of a calibration that lost its target.
const TARGET_LOST: Finish = Finish {
    outcome: Outcome::NotConverged,
    reason: "the target was lost while the arm moved: start with the target near the middle of the picture, and see to \
             its light",
};

/// What the loop is to reach, and when it ends without.
#[derive(Debug, Clone, Copy)]
pub struct RunPlan {
    /// Largest root mean square feature error, px; the goal.
    pub feature_error_px: f64,
    /// How long the goal must be held.
    pub hold: SpanNs,
    /// Latest end; `None` ends with the last frame only.
    pub duration: Option<SpanNs>,
    /// Whether the loop is closed: without it there is no goal to reach.
    pub closed_loop: bool,
    /// Whether ticks, frames and measurements are stamped by one clock: in real time, not in lockstep.
    pub one_clock: bool,
    /// Focal lengths that turn normalized errors into pixels.
    pub f_px: Vector2<f64>,
    /// Where the object is in a simulated scene at the first tick, in the frame in which it rests.
    pub X_WO: Option<Pose>,
    /// How it moves from there.
    pub scene_motion: SceneMotion,
}

/// The end of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Finish {
    /// How.
    pub outcome: Outcome,
    /// Why.
    pub reason: &'static str,
}

/// What one tick leaves for the rest of the world.
#[derive(Debug, Clone, Copy)]
pub struct TickRecord {
    /// The arm at the tick's time, and the command of the tick before.
    pub joint_state: JointState,
    /// The run after the tick, every 20 ms.
    pub status: Option<Status>,
    /// Set at the tick that ends the run.
    pub finish: Option<Finish>,
}

/// The loop of one run.
pub struct ControlLoop<const N: usize> {
    controller: Controller<N>,
    drive: Box<dyn Drive<N> + Send>,
    plan: RunPlan,
    statistics: RunStatistics,
    first: Option<MonoNs>,
    last: MonoNs,
    goal_since: Option<MonoNs>,
    state: ControlState,
    sensed: DriveState<N>,
    command: DriveCommand<N>,
    ending: Option<(MonoNs, Finish)>,
    last_frame_seen: bool,
    uses_measurement: bool,
    /// Limits that acted since the last status.
    acted: ActingLimits,
}

impl<const N: usize> ControlLoop<N> {
    /// A loop that has not ticked yet.
    #[must_use]
    pub fn new(controller: Controller<N>, drive: Box<dyn Drive<N> + Send>, plan: RunPlan) -> Self {
        let zero = SVector::zeros();
        Self {
            controller,
            drive,
            plan,
            statistics: RunStatistics::new(),
            first: None,
            last: MonoNs::ZERO,
            goal_since: None,
            state: ControlState::Waiting,
            sensed: DriveState { q: zero, qd: zero, truth: None },
            command: DriveCommand { tau: zero, q_r: zero, qd_r: zero },
            ending: None,
            last_frame_seen: false,
            uses_measurement: false,
            acted: ActingLimits::default(),
        }
    }

    /// First half of a tick: reads the drive at the tick's time.
    pub fn sense(&mut self, tick: u64, now: MonoNs) -> JointState {
        self.first.get_or_insert(now);
        self.last = now;
        self.sensed = self.drive.read(now);
        self.statistics.hash_state(&self.sensed);
        if let Some(fault) = self.drive.health().fault {
            self.controller.fail(fault);
        }
        joint_state(tick, now, &self.sensed, &self.command)
    }

    /// Second half: steps the controller on that state and writes the drive. A finish ends the run.
    pub fn act(
        &mut self,
        tick: u64,
        now: MonoNs,
        measurement: Option<&Measurement>,
    ) -> (Option<Status>, Option<Finish>) {
        self.uses_measurement = measurement.is_some();
        if let Some(m) = measurement {
            self.count(now, m);
        }
        let output = self.controller.step(now, &self.sensed, measurement);
        if let Some(intake) = output.intake {
            self.statistics.taken(now, intake);
        }
        self.drive.write(&output.command);
        self.command = output.command;
        self.statistics.ticked();
        self.note_state(now, &output);
        self.statistics.limited(now, &output.limits);
        self.acted = self.acted.with(&output.limits);
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
            self.acted = ActingLimits::default();
        }
        (status, finish)
    }

    /// A whole tick.
    pub fn tick(&mut self, tick: u64, now: MonoNs, measurement: Option<&Measurement>) -> TickRecord {
        let joint_state = self.sense(tick, now);
        let (status, finish) = self.act(tick, now, measurement);
        TickRecord { joint_state, status, finish }
    }

    /// Tells when the command of this tick was written; closes the latency of the measurement that it used.
    pub fn commanded(&mut self, at: MonoNs) {
        if std::mem::take(&mut self.uses_measurement) {
            self.statistics.commanded(at, self.plan.one_clock);
        }
    }

    /// Brings the arm to rest and ends the run with `reason`.
    pub fn stop(&mut self, now: MonoNs, reason: &'static str) {
        if self.ending.is_none() {
            self.ending = Some((now, Finish { outcome: Outcome::Stopped, reason }));
            self.statistics.event(now, Event::Stopping);
            self.controller.stop();
        }
    }

    /// Something failed outside of the cores: the run ends with the next [`act`](Self::act).
    pub fn fail(&mut self, fault: Fault) {
        self.controller.fail(fault);
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

    /// What was counted.
    #[must_use]
    pub fn statistics(&self) -> &RunStatistics {
        &self.statistics
    }

    fn count(&mut self, now: MonoNs, m: &Measurement) {
        self.last_frame_seen |= m.flags & frame_flag::LAST != 0;
        let set_point = self.controller.settings().servo.set_point();
        let error_px = View::of(m).map_or(f64::NAN, |view| set_point.error_rms_px(&view, &self.plan.f_px));
        self.statistics.count(now, m, error_px);
        if error_px.is_nan() || error_px > self.plan.feature_error_px {
            self.goal_since = None;
        } else {
            self.goal_since.get_or_insert(now);
        }
    }

    fn note_state(&mut self, now: MonoNs, output: &ControlOutput<N>) {
        let event = match (self.state, output.state, output.fault) {
            (before, ControlState::Fault, Some(fault)) if before != ControlState::Fault => {
                Some(Event::Fault(fault))
            }
            (ControlState::Servoing, ControlState::Holding, _) => Some(Event::Holding),
            (ControlState::Holding, ControlState::Servoing, _) => Some(Event::Resumed),
            _ => None,
        };
        if let Some(event) = event {
            self.statistics.event(now, event);
            if event == Event::Holding && self.controller.is_calibrating() {
                // What is lost of the motion would be missing in what is found.
                self.ending.get_or_insert((now, TARGET_LOST));
                self.controller.stop();
            }
        }
        self.state = output.state;
        if let Some(fault) = output.fault {
            self.ending.get_or_insert((now, Finish { outcome: Outcome::Fault, reason: fault.describe() }));
        }
    }

    /// A stop or a fault ends the run when the arm is at rest; everything else at once.
    fn finish(&self, now: MonoNs, output: &ControlOutput<N>) -> Option<Finish> {
        if let Some((since, finish)) = self.ending {
            let at_rest = output.command.qd_r.amax() < AT_REST;
            return (at_rest || now - since > LONGEST_STOP).then_some(finish);
        }
        if self.controller.is_calibrating() {
            let over = self.controller.gentle_motion().is_some_and(GentleMotion::is_over);
            if over && output.command.qd_r.amax() < AT_REST {
                return Some(Finish { outcome: Outcome::Finished, reason: "the calibration motion is over" });
            }
        } else if self.plan.closed_loop
            && self.state == ControlState::Servoing
            && self.goal_since.is_some_and(|since| now - since >= self.plan.hold)
        {
            return Some(Finish { outcome: Outcome::Converged, reason: "the goal was reached and held" });
        }
        if self.last_frame_seen {
            return Some(Finish { outcome: Outcome::Finished, reason: "the last frame was used" });
        }
        let time = now - self.first.unwrap_or(now);
        if self.plan.duration.is_some_and(|duration| time >= duration) {
            return Some(self.time_is_up());
        }
        None
    }

    fn time_is_up(&self) -> Finish {
        let reason = match (self.plan.closed_loop, self.state, self.statistics.last_measurement()) {
            (false, _, _) => {
                return Finish { outcome: Outcome::Finished, reason: "run.duration_s is over" };
            }
            (_, _, None) => "run.duration_s is over: no measurement ever came",
            (_, ControlState::Waiting, Some(m)) => match m.target_status() {
                TargetStatus::NoContrast => "run.duration_s is over: the frames have no contrast",
                TargetStatus::TooFewRegions => {
                    "run.duration_s is over: the target was never seen, too few dark regions"
                }
                TargetStatus::Ambiguous => {
                    "run.duration_s is over: the target's dots could not be told apart"
                }
                TargetStatus::WrongSize => {
                    "run.duration_s is over: frames have another size than the camera's"
                }
                TargetStatus::Inconsistent => {
                    "run.duration_s is over: the target's dots never fitted one pose; look for a shadow, glare or \
                     something in front, check [camera.lens] and [target], or allow for more (vision.model_sd_px)"
                }
                TargetStatus::NoMatch => "run.duration_s is over: the target was never found",
                TargetStatus::Found => self.why_never_used(),
            },
            _ if self.controller.gentle_motion().is_some() => {
                "run.duration_s is over before the calibration motion was: raise it to 15 or more"
            }
            (_, ControlState::Holding, Some(m)) if m.target_status() == TargetStatus::Inconsistent => {
                "run.duration_s is over: the target's dots fit no pose any more; look for a shadow, glare or something in front"
            }
            (_, ControlState::Holding, _) => "run.duration_s is over: the target was lost",
            _ => "run.duration_s is over before the goal was reached",
        };
        Finish { outcome: Outcome::NotConverged, reason }
    }

    /// The target is found, and yet nothing could be done about it.
    fn why_never_used(&self) -> &'static str {
        let intake = self.statistics.intake();
        if intake.refused_from_future > 0 {
            "run.duration_s is over: exposure stamps lie too far in the future to be used; set camera.stamp_offset_ms"
        } else if intake.refused_too_old > 0 {
            "run.duration_s is over: exposures are too old to be used; check camera.latency_ms and camera.stamp_offset_ms"
        } else {
            "run.duration_s is over: the target was found, but its place too uncertain (servo.object.max_uncertainty_m)"
        }
    }

    /// The object in the camera in simulated truth, m.
    fn true_view(&self) -> Option<Pose> {
        let (q, _) = self.sensed.truth?;
        let settings = self.controller.settings();
        let X_WC = settings.servo.settings().mount.X_WC(&settings.robot.forward(&q));
        let time = self.last - self.first.unwrap_or(self.last);
        Some(X_WC.inv_mul(&self.plan.scene_motion.object_at(&self.plan.X_WO?, time)))
    }

    /// Position and orientation of the camera relative to the desired one, from truth or else from the last pose.
    fn pose_errors(&self) -> Option<(f64, f64)> {
        let X_CO = self.true_view().or_else(|| self.statistics.last_found()?.pose())?;
        let X_DC = self.controller.settings().servo.set_point().X_DO()? * X_CO.inverse();
        Some((X_DC.translation.vector.norm(), rotation_angle(&X_DC.rotation.to_rotation_matrix())))
    }

    /// Errors now: against simulated truth where there is one, else from the last measurement.
    #[must_use]
    pub fn final_errors(&self) -> FinalErrors {
        let set_point = &self.controller.settings().servo.set_point();
        let feature_error = match self.true_view() {
            Some(X_CO) => set_point.error_rms_px_at(&X_CO, &self.plan.f_px),
            None => self.statistics.feature_error_px(),
        };
        let pose = self.pose_errors();
        FinalErrors {
            feature_error: Some(feature_error).filter(|e| e.is_finite()),
            position_error_m: pose.map(|(p, _)| p),
            orientation_error_rad: pose.map(|(_, o)| o),
        }
    }

    fn status(&self, tick: u64, now: MonoNs) -> Status {
        let (position_error_m, orientation_error_rad) = self.pose_errors().unwrap_or((f64::NAN, f64::NAN));
        let m = self.statistics.last_measurement().copied().unwrap_or_default();
        let latency = self.statistics.newest_latency();
        let us = |span: Option<SpanNs>| span.map_or(f64::NAN, SpanNs::as_us);
        Status {
            tick,
            stamp: now,
            time_s: self.duration_s(),
            feature_error_px: self.statistics.feature_error_px(),
            position_error_m,
            orientation_error_rad,
            exposure_to_command_us: us(latency.exposure_to_command),
            exposure_to_frame_us: us(latency.exposure_to_frame),
            frame_to_vision_us: us(latency.frame_to_vision),
            vision_us: us(latency.vision),
            measurement_to_command_us: us(latency.measurement_to_command),
            measurements: self.statistics.measurements(),
            frames: m.frames_received,
            frames_dropped: m.frames_dropped,
            target_lost: m.target_lost,
            missed_deadlines: 0,
            state: self.state as u32,
            target: m.status,
            limits: self.acted.kinds(),
            limited_joints: u32::from(self.acted.all_joints()),
        }
    }

    /// Time from the first tick to the last one, that one included, s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.first.map_or(0.0, |first| (self.last + TICK - first).as_s())
    }

    /// When the feature error came below 2 % of its first value for good, s.
    #[must_use]
    pub fn settling_time_s(&self) -> Option<f64> {
        self.statistics.settling_time_s(self.first?)
    }

    /// What safety saw.
    #[must_use]
    pub fn safety_report(&self) -> SafetyReport {
        self.statistics.safety_report(self.state, self.first.unwrap_or(MonoNs::ZERO))
    }
}

fn joint_state<const N: usize>(
    tick: u64,
    now: MonoNs,
    state: &DriveState<N>,
    command: &DriveCommand<N>,
) -> JointState {
    let (q_true, qd_true) = state.truth.unwrap_or((SVector::zeros(), SVector::zeros()));
    JointState {
        tick,
        stamp: now,
        joints: N as u32,
        flags: if state.truth.is_some() { joint_flag::TRUTH } else { 0 },
        q: padded(&state.q),
        qd: padded(&state.qd),
        tau: padded(&command.tau),
        q_r: padded(&command.q_r),
        qd_r: padded(&command.qd_r),
        q_true: padded(&q_true),
        qd_true: padded(&qd_true),
    }
}

fn padded<const N: usize>(v: &SVector<f64, N>) -> [f64; MAX_JOINTS] {
    let mut out = [0.0; MAX_JOINTS];
    for (to, from) in out.iter_mut().zip(v.iter()) {
        *to = *from;
    }
    out
}
