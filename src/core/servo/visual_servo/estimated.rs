//! The law with an image Jacobian that is learnt: [`JacobianLearner`](crate::servo::jacobian_learner::JacobianLearner).
//!
//! Neither lens, mount, target nor pose is used: only where the points are seen, and how the arm moves. The joint velocity is
//! `qd = k (J' A J)^-1 J' b` with the learner's normal equations A, b and the arm's Jacobian J, slowed down where M would change faster than it is learnt.

use super::{LastMeasurement, LawAnswer, VisualServo};
use crate::geometry::Pose;
use crate::messages::Measurement;
use crate::robot::Robot;
use crate::servo::jacobian_learner::LearnerStep;
use crate::servo::{
    Arm, CautiousTask, Convergence, LawOutput, MeasurementVerdict, Task, TwistTask, View, joint_velocity,
};
use crate::time::MonoNs;
use nalgebra::{Matrix6, SVector, Vector6};

/// Largest motion of the camera in a second, rad or shares of the target's distance: at 25 Hz M changes by 2 % from frame to frame. Chosen by hand.
const MAX_MOTION_1_S: f64 = 0.5;

impl<const N: usize> VisualServo<N> {
    /// Takes in a measurement whose stamp is good, `seen` with the joints at `q` and the camera at `X_WC`.
    pub(super) fn learn_from(
        &mut self,
        (now, measurement): (MonoNs, &Measurement),
        seen: View,
        (q, X_WC): (&SVector<f64, N>, &Pose),
    ) -> MeasurementVerdict {
        let partial = seen.is_partial();
        let (Some(view), Some(learner)) = (seen.sufficient(&self.goal), &mut self.learner) else {
            return MeasurementVerdict::TooFewFeatures;
        };
        if !learner.note_frame(measurement, &self.goal, (q, X_WC)) {
            return MeasurementVerdict::Inconsistent;
        }
        if !partial {
            self.seen_whole_at(q, None);
        }
        let nothing = TwistTask { matrix: Matrix6::zeros(), vector: Vector6::zeros(), error: 0.0 };
        let exposure = measurement.exposure;
        let last = LastMeasurement {
            exposure,
            view,
            task: Task::Twist(nothing),
            X_WC: *X_WC,
            first_X_WC: *X_WC,
            partial,
            supposed: false,
        };
        self.last = Some(last);
        if exposure > now { MeasurementVerdict::UsedFromFuture } else { MeasurementVerdict::Used }
    }

    /// The law output of a tick for joints at `q` that move at `qd`. Without a convergence it is a motion to learn from.
    pub(super) fn learnt_output(
        &mut self,
        (q, qd): (&SVector<f64, N>, &SVector<f64, N>),
        robot: &Robot<N>,
    ) -> Option<LawOutput<N>> {
        let (last, now) = (self.last?, self.history.newest()?);
        let (X_WC, J) = self.settings.mount.camera(robot, q);
        let learner = self.learner.as_mut()?;
        match learner.step((q, robot.limits()), (&X_WC, &J), &self.goal)? {
            LearnerStep::Learn(qd) => {
                (self.held, self.start) = (None, None);
                Some(LawOutput::Velocity(qd))
            }
            LearnerStep::Approach(task) => {
                let arm = Arm { J, qd: *qd, gravity: SVector::zeros() };
                let unit = joint_velocity(&task.task, 1.0, &arm.J)?;
                learner.note_share_left(now, task.share_left(&(arm.J.matrix() * unit)));
                let answer = self.approach(&task, unit, (&last.view, &X_WC), &arm)?;
                self.held = Some(answer);
                Some(self.started(answer.law_output))
            }
        }
    }

    /// The law output for a step `unit` of the joints that meets the task, with gain, largest motion and guard.
    fn approach(
        &self,
        task: &CautiousTask,
        unit: SVector<f64, N>,
        (view, X_WC): (&View, &Pose),
        arm: &Arm<N>,
    ) -> Option<LawAnswer<N>> {
        let estimator = self.learner.as_ref()?.estimator();
        let mut rate_1_s = self.settings.law.rate_1_s(&Task::Twist(task.task));
        let error = || task.task.error / f64::sqrt(self.goal.selection().points().count() as f64);
        rate_1_s *= self.settings.reduced_near_goal((self.gain_share, self.noise), rate_1_s, error);
        let motion_1_s = rate_1_s * estimator.motion(&(arm.J.matrix() * unit));
        rate_1_s *= (MAX_MOTION_1_S / motion_1_s).min(1.0);
        let convergence = Convergence { remaining: unit, ..Convergence::at(rate_1_s) };
        let mut qd = unit * rate_1_s;
        if let Some(guard) = &self.settings.visibility
            && let Some(now) = view.moved(|i| estimator.predicted(i, X_WC))
        {
            qd = guard.hold_learnt((&self.goal, &now), |i| estimator.rows(i).copied(), arm, qd);
        }
        Some(LawAnswer { law_output: LawOutput::Velocity(qd), convergence })
    }
}

#[cfg(test)]
mod tests;
