//! Measurements as they come.

use super::Controller;
use crate::control::lifecycle::State;
use crate::control::safety::Fault;
use crate::control::trace::Event;
use crate::messages::Measurement;
use crate::servo::{CameraError, MeasurementVerdict, UnobservedMotion};
use crate::time::MonoNs;

impl<const N: usize> Controller<N> {
    /// Takes in a measurement at `now`, and what it says of the arm's motion.
    pub(super) fn take(&mut self, now: MonoNs, m: &Measurement) -> MeasurementVerdict {
        let (tried, tried_lens) = (self.servo.tries_mount(), self.servo.tries_lens());
        let verdict = self.servo.add_measurement(now, m, &self.arm.robot);
        if self.servo.tries_mount() && !tried {
            self.events.push(Event::MountTried);
        }
        if self.servo.tries_lens() && !tried_lens {
            self.events.push(Event::LensTried);
        }
        if verdict != MeasurementVerdict::OtherTarget {
            self.returning.note(m, verdict);
        }
        self.behaviour.note(now, m, verdict, &self.servo);
        let (drift, camera_error) = (self.servo.take_unobserved_motion(), self.servo.camera_error());
        self.use_sight(now, drift.as_ref(), camera_error);
        verdict
    }

    /// What a camera says of the arm's motion at `now`: joint motion that encoders do not show, and how it is not as told.
    pub(super) fn use_sight(
        &mut self,
        now: MonoNs,
        drift: Option<&UnobservedMotion<N>>,
        camera_error: Option<CameraError>,
    ) {
        if let Some(drift) = drift {
            self.joint_control.learn(drift, now);
        }
        if let (State::Servoing, Some(error)) = (self.state, camera_error) {
            self.fail(Fault::of_camera(error));
        }
    }
}
