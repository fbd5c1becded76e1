//! Measurements as they come.

use super::Controller;
use crate::control::lifecycle::State;
use crate::control::safety::Fault;
use crate::control::trace::Event;
use crate::messages::Measurement;
use crate::servo::{MeasurementVerdict, MountError, UnobservedMotion};
use crate::time::MonoNs;

impl<const N: usize> Controller<N> {
    /// Takes in a measurement at `now`, and what it says of the arm's motion.
    pub(super) fn take(&mut self, now: MonoNs, m: &Measurement) -> MeasurementVerdict {
        let tried = self.servo.tries_mount();
        let verdict = self.servo.add_measurement(now, m, &self.arm.robot);
        if self.servo.tries_mount() && !tried {
            self.events.push(Event::MountTried);
        }
        if verdict != MeasurementVerdict::OtherTarget {
            self.returning.note(m, verdict);
        }
        self.behaviour.note(now, m, verdict, &self.servo);
        let (drift, mount_error) = (self.servo.take_unobserved_motion(), self.servo.mount_error());
        self.use_sight(now, drift.as_ref(), mount_error);
        verdict
    }

    /// What a camera says of the arm's motion at `now`: joint motion that encoders do not show, and how its mount is wrong.
    pub(super) fn use_sight(
        &mut self,
        now: MonoNs,
        drift: Option<&UnobservedMotion<N>>,
        mount_error: Option<MountError>,
    ) {
        if let Some(drift) = drift {
            self.joint_control.learn(drift, now);
        }
        if let (State::Servoing, Some(error)) = (self.state, mount_error) {
            self.fail(Fault::of_mount(error));
        }
    }
}
