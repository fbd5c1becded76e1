//! The goal of a second camera that controls the arm beside the first one: it is counted and judged by itself, and a run has reached its goal when both have.

use super::errors::{TrueGoal, errors_of};
use super::goal_watch::{CONVERGED, GoalWatch};
use super::residual::{ResidualWatch, is_at_its_end};
use super::{FinalErrors, Goal, MeasurementLog, Mission};
use crate::control::outcome::Finish;
use crate::control::trace::Trace;
use crate::messages::{ControlState, Measurement};
use crate::mission::truth::{Truth, true_goal};
use crate::servo::{MeasurementVerdict, SetPoint, View};
use crate::time::{MonoNs, SpanNs};
use nalgebra::{SVector, Vector2};

const FIRST_LOST: &str = "run.duration_s is over: the first camera does not see its target, and the arm has not reached the goal of the second one by which it went";
const SECOND_LOST: &str = "run.duration_s is over: the second camera does not see its target, and the arm has not reached the goal of the first one by which it went";
const FIRST_LOST_AT_GOAL: &str = "run.duration_s is over: the goal of the second camera was reached, and the first one does not see its target";
const SECOND_LOST_AT_GOAL: &str = "run.duration_s is over: the goal of the first camera was reached, and the second one does not see its target";
const CONTRADICTION: &str = "the arm stands where what both cameras ask for balances: their goals cannot be met together; compare servo.desired with second_view.desired, both mounts and \
                             both targets with what is there, or let one count more (second_view.weight)";

/// The second of two goals.
pub struct SecondGoal<const N: usize> {
    /// The number of the camera.
    camera: u32,
    set_point: SetPoint,
    /// Focal lengths that turn normalized errors into pixels.
    f_px: Vector2<f64>,
    truth: Option<Truth<N>>,
    true_goal: Option<TrueGoal>,
    measurements: MeasurementLog,
    watch: GoalWatch,
    residual: ResidualWatch,
    errors_at_end: Option<FinalErrors>,
}

impl<const N: usize> SecondGoal<N> {
    /// The goal `set_point` of the camera with the number `camera` and the focal lengths `f_px`, px; `truth` is that of a simulated cell.
    #[must_use]
    pub fn new(camera: u32, set_point: SetPoint, f_px: Vector2<f64>, truth: Option<Truth<N>>) -> Self {
        Self {
            camera,
            true_goal: true_goal(truth.as_ref(), &set_point),
            set_point,
            f_px,
            truth,
            measurements: MeasurementLog::new(),
            watch: GoalWatch::default(),
            residual: ResidualWatch::default(),
            errors_at_end: None,
        }
    }

    /// Its measurements.
    #[must_use]
    pub fn measurements(&self) -> &MeasurementLog {
        &self.measurements
    }

    /// Root mean square feature error of its last measurement that has one, px; NaN before.
    pub(super) fn error_px(&self) -> f64 {
        self.measurements.error_px()
    }

    /// Errors in the posture `q_true`, rad or m, the time `since` after the first tick.
    fn errors(&self, q_true: Option<&SVector<f64, N>>, since: SpanNs) -> FinalErrors {
        let true_view = self
            .truth
            .as_ref()
            .zip(q_true)
            .and_then(|(truth, q)| truth.X_CT(self.set_point.target(), q, since));
        errors_of((&self.set_point, &self.f_px), &self.measurements, true_view, self.true_goal.as_ref())
    }

    /// Takes in a measurement of its camera; what braking at the end shows is not `judged`.
    fn count(
        &mut self,
        trace: &mut Trace,
        m: &Measurement,
        verdict: Option<MeasurementVerdict>,
        judged: bool,
        goal: &Goal,
    ) {
        let is_of_goal =
            !matches!(verdict, Some(MeasurementVerdict::TooFewFeatures | MeasurementVerdict::ImpossiblePose));
        let view = View::of(m, &self.set_point).filter(|_| judged && is_of_goal);
        let error_px = view.map_or(f64::NAN, |view| self.set_point.error_rms_px(&view, &self.f_px));
        self.measurements.note(m, verdict, error_px, &mut trace.events);
        if let Some(record) = &mut trace.measurement_record {
            record.error_px = error_px;
            if verdict.is_some_and(MeasurementVerdict::is_used) {
                self.measurements.note_degraded(record.degraded, &mut trace.events);
            }
            self.measurements.commanded(record.latency);
        }
        if !verdict.is_some_and(MeasurementVerdict::is_refused) {
            self.residual.note_error(trace.time, error_px, crate::servo::stated_px2(m).sqrt());
            self.watch.watch((trace.time, m), (error_px, true), (&self.set_point, goal), &self.f_px);
        }
    }
}

impl<const N: usize> Mission<N> {
    /// The same with the goal of a second camera.
    #[must_use]
    pub fn with_second_goal(self, second: Option<SecondGoal<N>>) -> Self {
        Self { second: second.map(Box::new), ..self }
    }

    /// The goal of the second camera, where one controls the arm.
    #[must_use]
    pub fn second_goal(&self) -> Option<&SecondGoal<N>> {
        self.second.as_deref()
    }

    /// The errors of the second camera at its goal, as [`Self::final_errors`]; `None` of a run with one camera.
    #[must_use]
    pub fn second_errors(&self) -> Option<FinalErrors> {
        let second = self.second.as_ref()?;
        Some(
            second.errors_at_end.unwrap_or_else(|| second.errors(self.q_true().as_ref(), self.since_first())),
        )
    }

    /// Takes in a measurement of the second camera; returns whether it was one.
    pub(super) fn count_second(
        &mut self,
        trace: &mut Trace,
        m: &Measurement,
        verdict: Option<MeasurementVerdict>,
    ) -> bool {
        let judged = self.end.decided().is_none();
        let Some(second) = self.second.as_mut().filter(|second| second.camera == m.camera) else {
            return false;
        };
        second.count(trace, m, verdict, judged, &self.goal);
        true
    }

    /// Watches the goals anew: a client asks for the start.
    pub(super) fn watch_goals_anew(&mut self) {
        self.goal_watch.begin_anew();
        if let Some(second) = &mut self.second {
            second.watch.begin_anew();
            second.residual.begin_anew();
        }
    }

    /// Notes whether the arm is at rest at the tick `now`, for the errors that stay.
    pub(super) fn note_arm_at_goals(&mut self, now: MonoNs) {
        let at_rest = self.rest.is_at_rest();
        self.residual.note_arm(now, at_rest);
        if let Some(second) = &mut self.second {
            second.residual.note_arm(now, at_rest);
        }
    }

    /// Keeps the errors at the end.
    pub(super) fn keep_second_errors(&mut self) {
        let errors = self.second_errors();
        if let Some(second) = &mut self.second {
            second.errors_at_end = errors;
        }
    }

    /// Whether the last measurement of the target is no view of `now` any more.
    fn is_stale(&self, measurements: &MeasurementLog, now: MonoNs) -> bool {
        measurements.last_found().is_none_or(|m| now - m.exposure > self.plan.measurement_timeout)
            || measurements.last().is_some_and(|m| !m.found())
    }

    /// The end of a run whose goal is held at `now`; of two cameras both goals are to be, by views of now.
    pub(super) fn held(&self, now: MonoNs) -> Option<Finish> {
        let first = self.goal_watch.held(now, self.goal.hold);
        let Some(second) = &self.second else { return first };
        let is_fresh = !self.is_stale(&self.measurements, now) && !self.is_stale(&second.measurements, now);
        let other = second.watch.held(now, self.goal.hold).filter(|_| is_fresh)?;
        // What is held in the mean alone is told.
        first.map(|first| if first == CONVERGED { other } else { first })
    }

    /// Whether the second camera is away from its goal, or does not see its target; false of a run with one camera.
    pub(super) fn second_is_away(&self, now: MonoNs) -> bool {
        self.second
            .as_ref()
            .is_some_and(|second| second.watch.is_away() || self.is_stale(&second.measurements, now))
    }

    /// Why a run with two cameras that servoes has not reached its goal at `now`; `None` where neither of them says why.
    pub(super) fn why_not_both(&self, now: MonoNs, trace: &Trace) -> Option<&'static str> {
        let second = self.second.as_ref().filter(|_| self.state == ControlState::Servoing)?;
        let (hold, goal_px) = (self.goal.hold, self.goal.tolerance_px);
        let lost = (self.is_stale(&self.measurements, now), self.is_stale(&second.measurements, now));
        match lost {
            (true, false) if second.watch.held(now, hold).is_some() => Some(FIRST_LOST_AT_GOAL),
            (true, false) => Some(FIRST_LOST),
            (false, true) if self.goal_watch.held(now, hold).is_some() => Some(SECOND_LOST_AT_GOAL),
            (false, true) => Some(SECOND_LOST),
            _ => {
                let stays =
                    [&self.residual, &second.residual].iter().any(|one| one.constant_px(goal_px).is_some());
                (stays && !is_at_its_end(&trace.limits)).then_some(CONTRADICTION)
            }
        }
    }
}
