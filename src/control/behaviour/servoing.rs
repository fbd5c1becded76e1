//! Servoing to the goal by what the camera sees.

use super::{ArmModel, Behaviour, MotionCommand};
use crate::control::safety::{Freshness, MeasurementWatch};
use crate::drive::DriveState;
use crate::messages::Measurement;
use crate::robot::Robot;
use crate::servo::{Drift, LawOutput, MeasurementVerdict, SetPoint, VisualServo};
use crate::time::MonoNs;
use nalgebra::{SMatrix, SVector, Vector6};

/// A servo law and the watch over what it goes by.
#[derive(Debug)]
pub struct Servoing<const N: usize> {
    servo: VisualServo<N>,
    watch: MeasurementWatch,
    /// Measurements that a lesson takes, where one is asked for.
    lesson: u32,
    /// Whether the law is only looked at.
    dry: bool,
}

impl<const N: usize> Servoing<N> {
    /// Servoing as `servo` does while `watch` trusts its measurements; `lesson` measurements teach a goal.
    #[must_use]
    pub fn new(servo: VisualServo<N>, watch: MeasurementWatch, lesson: u32) -> Self {
        Self { servo, watch, lesson, dry: false }
    }

    /// The same with an arm that does not move: there is none, or the images show another one.
    #[must_use]
    pub fn dry(self) -> Self {
        Self { dry: true, ..self }
    }
}

impl<const N: usize> Behaviour<N> for Servoing<N> {
    fn note_arm(&mut self, now: MonoNs, state: &DriveState<N>) {
        self.servo.note_arm(now, &state.q, &state.qd);
    }

    fn take(
        &mut self,
        now: MonoNs,
        _q: &SVector<f64, N>,
        m: &Measurement,
        arm: &ArmModel<N>,
    ) -> MeasurementVerdict {
        let verdict = self.servo.take(now, m, &arm.robot);
        if verdict.is_used() {
            self.watch.good(m.exposure);
        }
        verdict
    }

    fn confidence(&self, now: MonoNs) -> f64 {
        match self.watch.check(now) {
            Freshness::Fresh => self.watch.confidence(now).min(self.servo.confidence(now)),
            Freshness::Never | Freshness::Stale => 0.0,
        }
    }

    fn motion_command(&mut self, state: &DriveState<N>, robot: &Robot<N>) -> MotionCommand<N> {
        match (self.servo.law_output(&state.q, &state.qd, robot), self.servo.convergence()) {
            (Some(LawOutput::Velocity(qd)), _) if self.dry => MotionCommand::Look(qd),
            (Some(LawOutput::Velocity(qd)), Some(convergence)) => MotionCommand::Velocity(qd, *convergence),
            (Some(LawOutput::Torque(tau)), _) if !self.dry => MotionCommand::Torque(tau),
            // At a singularity of task or arm there may be nothing to follow.
            _ => MotionCommand::Stand,
        }
    }

    fn pause(&mut self) {
        self.servo.restart();
    }

    fn way_back(&self, q: &SVector<f64, N>) -> Option<MotionCommand<N>> {
        self.servo
            .way_back(q)
            .filter(|_| !self.dry)
            .map(|(qd, convergence)| MotionCommand::Velocity(qd, convergence))
    }

    fn camera_jacobian(&self, robot: &Robot<N>, q: &SVector<f64, N>) -> SMatrix<f64, 6, N> {
        *self.servo.settings().mount.camera(robot, q).1.matrix()
    }

    fn camera_law_output(&self, now: MonoNs) -> Option<Vector6<f64>> {
        let goes = self.dry && matches!(self.watch.check(now), Freshness::Fresh);
        goes.then(|| self.servo.camera_law_output()).flatten()
    }

    fn take_drift(&mut self) -> Option<Drift<N>> {
        self.servo.take_drift()
    }

    fn set_point(&self) -> &SetPoint {
        self.servo.set_point()
    }

    fn teach(&mut self) {
        self.servo.teach(self.lesson);
    }

    fn is_teaching(&self) -> bool {
        self.servo.is_teaching()
    }

    fn reduce_gain(&mut self) -> bool {
        !self.dry && self.servo.reduce_gain()
    }

    fn seek_at_full_gain(&mut self) {
        self.servo.seek_at_full_gain();
    }

    fn is_degraded(&self) -> bool {
        self.servo.is_degraded()
    }

    fn has_goal(&self) -> bool {
        !self.dry
    }
}
