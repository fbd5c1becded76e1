//! Visual servoing to the goal.

use super::MotionCommand;
use crate::control::safety::{Freshness, MeasurementWatch};
use crate::drive::DriveState;
use crate::messages::Measurement;
use crate::robot::Robot;
use crate::servo::{LawOutput, MeasurementVerdict, VisualServo};
use crate::time::MonoNs;

/// Servoing, while measurements are fresh enough to be trusted.
#[derive(Debug)]
pub struct Servoing {
    watch: MeasurementWatch,
    /// Whether the law is only observed.
    dry: bool,
}

impl Servoing {
    /// Servoing while `watch` trusts the measurements.
    #[must_use]
    pub fn new(watch: MeasurementWatch) -> Self {
        Self { watch, dry: false }
    }

    /// The same with an arm that does not move: there is none, or the images show another one.
    #[must_use]
    pub fn dry(self) -> Self {
        Self { dry: true, ..self }
    }

    pub(super) fn is_dry(&self) -> bool {
        self.dry
    }

    /// The same view of measurements, for whoever commands the arm instead of the law; `None` where the law is only observed.
    pub(super) fn handed_over(&self) -> Option<MeasurementWatch> {
        (!self.dry).then_some(self.watch)
    }

    pub(in crate::control) fn note(&mut self, now: MonoNs, m: &Measurement, verdict: MeasurementVerdict) {
        self.watch.came(now);
        if verdict.is_used() {
            self.watch.good(m.exposure);
        }
    }

    /// The goal is of another target from now on.
    pub(super) fn forget_target(&mut self) {
        self.watch.forget();
    }

    /// Whether measurements keep coming at `now`, with or without a target.
    pub(super) fn sees(&self, now: MonoNs) -> bool {
        self.watch.sees(now)
    }

    pub(in crate::control) fn confidence<const N: usize>(&self, now: MonoNs, servo: &VisualServo<N>) -> f64 {
        match self.watch.check(now) {
            Freshness::Fresh => self.watch.confidence(now).min(servo.confidence(now)),
            Freshness::Never | Freshness::Stale => 0.0,
        }
    }

    pub(in crate::control) fn motion_command<const N: usize>(
        &self,
        state: &DriveState<N>,
        robot: &Robot<N>,
        servo: &mut VisualServo<N>,
    ) -> MotionCommand<N> {
        match (servo.law_output(&state.q, &state.qd, robot), servo.convergence()) {
            (Some(LawOutput::Velocity(qd)), _) if self.dry => MotionCommand::Look(qd),
            // A motion of which the law learns leads to no goal.
            (Some(LawOutput::Velocity(qd)), None) => MotionCommand::Joints(qd),
            (Some(LawOutput::Velocity(qd)), Some(convergence)) => MotionCommand::Velocity(qd, *convergence),
            (Some(LawOutput::Torque(tau)), Some(convergence)) if !self.dry => {
                MotionCommand::Torque(tau, servo.joint_damping(&state.q, robot), *convergence)
            }
            // At a singularity of the task or of the arm there may be no law output.
            _ => MotionCommand::Stand,
        }
    }
}
