//! Errors and status of a run.

use super::errors::{TrueGoal, errors_of, off_goal};
use super::{FinalErrors, Goal, Hindsight, MeasurementLog, Mission};
use crate::control::outcome::Finish;
use crate::control::safety::ContactNumbers;
use crate::control::trace::Trace;
use crate::geometry::Pose;
use crate::messages::{ControlState, Status, status_flag};
use crate::servo::SetPoint;
use crate::time::{SpanNs, TICK};

impl<const N: usize> Mission<N> {
    /// The end of the run; `None` before.
    #[must_use]
    pub fn finish(&self) -> Option<Finish> {
        self.finish
    }

    /// The goal.
    #[must_use]
    pub fn goal(&self) -> &Goal {
        &self.goal
    }

    /// Root mean square feature error of the last measurement that has one, px; NaN before.
    #[must_use]
    pub fn feature_error_px(&self) -> f64 {
        self.measurements.error_px()
    }

    /// The last state of control; at the end, the outcome.
    #[must_use]
    pub fn state(&self) -> ControlState {
        self.state
    }

    /// The log of the measurements.
    pub fn measurements(&self) -> &MeasurementLog {
        &self.measurements
    }

    /// Time from the first tick to the last one, that one included, s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.first.map_or(0.0, |first| (self.last + TICK - first).as_s())
    }

    /// The target of the goal in the camera in simulated truth, m.
    fn true_view(&self) -> Option<Pose> {
        let q = self.q_true()?;
        self.truth.as_ref()?.X_CT(self.goal.set_point.target(), &q, self.since_first())
    }

    /// From the first tick to the last one.
    pub(super) fn since_first(&self) -> SpanNs {
        self.last - self.first.unwrap_or(self.last)
    }

    /// Position and orientation of the camera relative to the desired one, from truth or else from the last pose.
    fn pose_errors(&self) -> Option<(f64, f64)> {
        let Some(X_CO) = self.true_view() else {
            return off_goal(&self.goal.set_point, &self.measured_view()?);
        };
        off_goal(self.true_goal().map_or(&self.goal.set_point, |(goal, _)| goal), &X_CO)
    }

    /// The goal as the true lens has it, where it is an image and the cell is simulated.
    fn true_goal(&self) -> Option<&TrueGoal> {
        // on a path a goal is a pose
        self.true_goal.as_ref().filter(|_| self.goal.set_point.is_seen())
    }

    /// The same of any goal.
    #[must_use]
    pub fn in_truth(&self, goal: &SetPoint) -> Option<SetPoint> {
        self.truth.as_ref()?.sight.as_ref()?.goal(goal).map(|(goal, _)| goal)
    }

    /// The object in the camera by the last measurement, m.
    fn measured_view(&self) -> Option<Pose> {
        self.measurements.last_found()?.pose()
    }

    /// Errors when the end of the run was decided, or now: the displacement of braking at the end does not count.
    #[must_use]
    pub fn final_errors(&self) -> FinalErrors {
        self.errors_at_end.unwrap_or_else(|| self.errors())
    }

    /// What the run tells at its end of its accuracy and its description, by all that it has seen. Takes a tenth of a second, and a second where nothing fits.
    #[must_use]
    pub fn hindsight(&self) -> Hindsight {
        let first_target = self.goal.set_point.target() == 0;
        let known = self.views.as_ref().filter(|_| first_target).zip(self.cell.as_ref());
        known.map_or_else(Hindsight::default, |(views, cell)| {
            views.hindsight(cell, &self.goal.set_point, self.q_at_end.as_ref())
        })
    }

    /// Errors now: against simulated truth where there is one, else from the last measurement.
    pub(super) fn errors(&self) -> FinalErrors {
        let goal = (&self.goal.set_point, &self.plan.f_px);
        errors_of(goal, &self.measurements, self.true_view(), self.true_goal())
    }

    pub(super) fn status(&self, trace: &Trace) -> Status {
        let (position_error_m, orientation_error_rad) = self.pose_errors().unwrap_or((f64::NAN, f64::NAN));
        let m = self.measurements.last().copied().unwrap_or_default();
        let vision = self.measurements.vision_counts();
        let latency = self.measurements.latency();
        let us = |span: Option<SpanNs>| span.map_or(f64::NAN, SpanNs::as_us);
        let contact = ContactNumbers::of(trace.contact.as_ref());
        Status {
            tick: trace.joint_state.tick,
            sequence: self.statuses,
            stamp: trace.time,
            time_s: self.duration_s(),
            // Of two cameras the larger one, since both goals are to be reached.
            feature_error_px: self
                .second
                .as_ref()
                .map_or(f64::NAN, |second| second.error_px())
                .max(self.measurements.error_px()),
            position_error_m,
            orientation_error_rad,
            exposure_to_command_us: us(latency.exposure_to_command),
            exposure_to_frame_us: us(latency.exposure_to_frame),
            frame_to_vision_us: us(latency.frame_to_vision),
            vision_us: us(latency.vision),
            measurement_to_command_us: us(latency.measurement_to_command),
            V_C: trace.V_C.unwrap_or([f64::NAN; 6]),
            measurements: self.measurements.count(),
            frames: vision.frames,
            frames_dropped: vision.frames_dropped,
            target_lost: vision.target_lost,
            missed_deadlines: trace.missed_deadlines,
            camera_state_s: f64::NAN,
            stability: self.plan.stability,
            at_goal_s: self.goal_watch.at_goal_s(trace.time),
            contact_torque: contact.torque,
            contact_force: contact.force,
            state: self.state as u32,
            target: m.status,
            limits: self.acted.kinds(),
            limited_joints: u32::from(self.acted.all_joints()),
            arm: 0,
            flags: if self.measurements.is_degraded() { status_flag::DEGRADED } else { 0 }
                | if self.searches { status_flag::SEARCHING } else { 0 },
            camera_state: 0, // which its companion knows
            goal: self.goal.id,
            camera_restarts: 0, // these too
            vision_restarts: 0,
            target_number: self.goal.set_point.target(),
            contact_joint: contact.joint,
        }
    }
}
