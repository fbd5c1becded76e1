//! An excitation motion before the target, by which the stamps of camera and encoders are compared.

use super::{ArmModel, Behaviour, MotionCommand};
use crate::calibration::{ExcitationTrajectory, image_reach};
use crate::camera_model::CameraModel;
use crate::control::outcome::{Finish, Outcome};
use crate::control::safety::{Freshness, MeasurementWatch};
use crate::drive::DriveState;
use crate::messages::Measurement;
use crate::robot::Robot;
use crate::servo::{MeasurementVerdict, SetPoint, VisualServo};
use crate::time::MonoNs;
use crate::time::TICK;
use nalgebra::{SMatrix, SVector};

const OVER: Finish = Finish { outcome: Outcome::Finished, reason: "the calibration motion is over" };
/// What is lost of the motion would be missing in what is found.
const TARGET_LOST: Finish = Finish {
    outcome: Outcome::NotConverged,
    reason: "the target was lost while the arm moved: start with the target near the middle of the image, and see to \
             its light",
};
const TOO_SHORT: &str = "run.duration_s is over before the calibration motion was: raise it to 15 or more";

/// The motion, from the first good measurement on.
#[derive(Debug)]
pub struct ExcitationMotion<const N: usize> {
    /// Knows target and mount, and judges measurements.
    servo: VisualServo<N>,
    camera: CameraModel,
    watch: MeasurementWatch,
    motion: Option<ExcitationTrajectory<N>>,
}

impl<const N: usize> ExcitationMotion<N> {
    /// A motion before `camera` that begins when the whole target is seen, and goes on while `watch` says that it is.
    #[must_use]
    pub fn new(servo: VisualServo<N>, camera: CameraModel, watch: MeasurementWatch) -> Self {
        Self { servo, camera, watch, motion: None }
    }
}

impl<const N: usize> Behaviour<N> for ExcitationMotion<N> {
    fn note_arm(&mut self, now: MonoNs, state: &DriveState<N>) {
        self.servo.note_arm(now, &state.q, &state.qd);
    }

    fn take(
        &mut self,
        now: MonoNs,
        q: &SVector<f64, N>,
        m: &Measurement,
        arm: &ArmModel<N>,
    ) -> MeasurementVerdict {
        let verdict = self.servo.take(now, m, &arm.robot);
        let points = self.servo.set_point().points();
        if m.found() && m.features().len() == points.len() {
            if self.motion.is_none() {
                let mount = &self.servo.settings().mount;
                let reach = image_reach(&arm.robot, mount, &self.camera, points, &arm.limits, q, m);
                self.motion = reach.map(|reach| ExcitationTrajectory::new(q, &reach, &arm.limits));
            }
            if self.motion.is_some() {
                self.watch.good(now); // whatever its stamp says: that is what is to be found out
            }
        }
        verdict
    }

    fn confidence(&self, now: MonoNs) -> f64 {
        match self.watch.check(now) {
            Freshness::Fresh => self.watch.confidence(now),
            Freshness::Never | Freshness::Stale => 0.0,
        }
    }

    fn motion_command(&mut self, _state: &DriveState<N>, _robot: &Robot<N>) -> MotionCommand<N> {
        self.motion
            .as_mut()
            .map_or(MotionCommand::Stand, |motion| MotionCommand::Joints(motion.advance(TICK)))
    }

    fn pause(&mut self) {}

    fn camera_jacobian(&self, robot: &Robot<N>, q: &SVector<f64, N>) -> SMatrix<f64, 6, N> {
        *self.servo.settings().mount.camera(robot, q).1.matrix()
    }

    fn set_point(&self) -> &SetPoint {
        self.servo.set_point()
    }

    fn teach(&mut self) {}

    fn finished(&self) -> Option<Finish> {
        self.motion.as_ref().is_some_and(ExcitationTrajectory::is_over).then_some(OVER)
    }

    fn has_goal(&self) -> bool {
        false
    }

    fn when_lost(&self) -> Option<Finish> {
        Some(TARGET_LOST)
    }

    fn when_late(&self) -> Option<&'static str> {
        self.motion.is_some().then_some(TOO_SHORT)
    }
}
