//! The law output for a view and a goal, and how it leads there: prediction, gain, guard and null-space motion.

use super::feed_forward::{follow, follow_twist};
use super::{LastMeasurement, LawAnswer, ServoGoal, ServoSettings, UpdatePolicy, View, VisualServo, pace};
use crate::robot::Robot;
use crate::servo::{Arm, Convergence, LawOutput, ObjectMotion, Task, away_from_limits, seek_null_motion};
use crate::time::{MonoNs, SpanNs};
use nalgebra::{SMatrix, SVector};

impl<const N: usize> VisualServo<N> {
    /// The damping of the joints at `q` (rad or m) by which the last output of a torque law was lessened, N m s/rad or N s/m: `J^T D J + K_D`. Zero for other laws.
    #[must_use]
    pub fn joint_damping(&self, q: &SVector<f64, N>, robot: &Robot<N>) -> SMatrix<f64, N, N> {
        let Some(LastMeasurement { task: Task::Wrench(task), .. }) = &self.last else {
            return SMatrix::zeros();
        };
        let (_, J) = self.settings.mount.camera(robot, q);
        task.joint_damping(&J, &self.settings.law.joint_damping())
    }
}

impl ServoSettings {
    pub(super) fn law_output<const N: usize>(
        &self,
        pursuit: ServoGoal<'_>,
        last: &LastMeasurement,
        object: Option<(&ObjectMotion, MonoNs)>,
        (q, qd): (&SVector<f64, N>, &SVector<f64, N>),
        robot: &Robot<N>,
    ) -> Option<LawAnswer<N>> {
        let (X_WC, J) = self.mount.camera(robot, q);
        let arm = Arm {
            J,
            qd: *qd,
            gravity: if self.law.is_torque() { robot.gravity(q) } else { SVector::zeros() },
        };
        let secondary = self.limit_avoidance_1_s.map(|gain| away_from_limits(q, robot.limits(), gain));
        if self.update != UpdatePolicy::Predict {
            return self.answer(pursuit, (&last.view, &last.task), &arm, secondary.as_ref());
        }
        // With a first-order lag T the arm, told to stand, would come to rest in q + T qd: the error there is what can
        // still be acted upon, and the lag drops out of the loop.
        let X_WC = if self.lead == SpanNs::ZERO {
            X_WC
        } else {
            self.mount.X_WC(robot, &(q + qd * self.lead.as_s()))
        };
        let object = object.map(|(object, now)| (object, now + self.lead));
        let moved = object.map(|(object, then)| object.displacement(last.exposure, then));
        let X_WC_then = moved.map_or(last.X_WC, |moved| moved * last.X_WC);
        let view = last.view.predicted_at(&X_WC.inv_mul(&X_WC_then), pursuit.goal)?;
        let task = self.law.task(pursuit.goal, &view).ok()?;
        let object = object.filter(|_| !self.law.is_torque());
        let along = object.map_or_else(SVector::zeros, |(object, then)| follow(object, then, &X_WC, &J));
        // What moves along with the object does not move in the image: the guard would hold the arm back from it.
        let beside = Arm { qd: arm.qd - along, ..arm };
        let mut answer = self.answer(pursuit, (&view, &task), &beside, secondary.as_ref())?;
        if let (LawOutput::Velocity(qd), true) = (&mut answer.law_output, object.is_some()) {
            answer.convergence.feed_forward = along;
            *qd += along;
        }
        if let (LawOutput::Velocity(qd), Some(moving)) = (&mut answer.law_output, &pursuit.motion) {
            let along = follow_twist(&moving.twist_of_camera(view.X_CO().unwrap_or(&moving.X_DO)), &J);
            answer.convergence.feed_forward += along;
            *qd += along;
        }
        Some(answer)
    }

    /// The law output with the null-space part of the `secondary` motion, modified so that the target stays in the image.
    pub(super) fn answer<const N: usize>(
        &self,
        pursuit: ServoGoal<'_>,
        (view, task): (&View, &Task),
        arm: &Arm<N>,
        secondary: Option<&SVector<f64, N>>,
    ) -> Option<LawAnswer<N>> {
        let mut law_output = self.law.output(task, arm)?;
        let mut rate_1_s = self.law.rate_1_s(task);
        if let LawOutput::Velocity(qd) = &mut law_output
            && self.object.is_none()
        {
            let share = self.gain_at(pursuit, rate_1_s, view);
            *qd *= share;
            rate_1_s *= share;
        }
        if let (LawOutput::Velocity(qd), UpdatePolicy::Predict) = (&mut law_output, self.update) {
            let factor = pace::as_quick_as_held(rate_1_s * self.held_lag.as_s());
            *qd *= factor;
            rate_1_s *= factor;
        }
        let mut convergence = Convergence::at(rate_1_s);
        if let LawOutput::Velocity(qd) = &law_output {
            convergence.remaining = qd / rate_1_s;
        }
        let law_output = match &self.visibility {
            Some(guard) => guard.hold(pursuit.goal, view, (task, &self.law.joint_damping()), arm, law_output),
            None => law_output,
        };
        let mut answer = LawAnswer { law_output, convergence };
        if let (LawOutput::Velocity(qd), Task::Twist(task), Some(wanted)) =
            (&mut answer.law_output, task, secondary)
            && let Some(free) = seek_null_motion(task, &arm.J, wanted)
        {
            answer.convergence.null_space = free;
            *qd += free;
        }
        Some(answer)
    }
}
