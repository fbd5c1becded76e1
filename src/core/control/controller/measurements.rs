//! Measurements as they come.

use super::Controller;
use crate::control::lifecycle::State;
use crate::control::safety::Fault;
use crate::messages::Measurement;
use crate::servo::MeasurementVerdict;
use crate::time::MonoNs;

impl<const N: usize> Controller<N> {
    /// Takes in a measurement at `now`, and what it says of the arm's motion.
    pub(super) fn take(&mut self, now: MonoNs, m: &Measurement) -> MeasurementVerdict {
        let verdict = self.servo.add_measurement(now, m, &self.arm.robot);
        if verdict != MeasurementVerdict::OtherTarget {
            self.returning.note(m);
        }
        self.behaviour.note(now, m, verdict, &self.servo);
        if let Some(drift) = self.servo.take_unobserved_motion() {
            self.joint_control.learn(&drift, now);
        }
        if let (State::Servoing, Some(error)) = (self.state, self.servo.mount_error()) {
            self.fail(Fault::of_mount(error));
        }
        verdict
    }
}
