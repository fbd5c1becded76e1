//! The excitation motion in view of the target, from which the stamps of camera and encoders are compared.

use super::MotionCommand;
use crate::control::safety::{Freshness, MeasurementWatch};
use crate::messages::Measurement;
use crate::motion::ExcitationMotion;
use crate::servo::VisualServo;
use crate::time::{MonoNs, TICK};

/// The motion that the mission has sent, and whether the target stays in view on it.
#[derive(Debug)]
pub struct Excitation<const N: usize> {
    watch: MeasurementWatch,
    motion: Option<ExcitationMotion<N>>,
}

impl<const N: usize> Excitation<N> {
    /// A behaviour whose motion is set later, and which continues as long as `watch` finds the whole target in view.
    #[must_use]
    pub fn new(watch: MeasurementWatch) -> Self {
        Self { watch, motion: None }
    }

    /// Sets the motion; a second one is ignored.
    pub(super) fn begin(&mut self, motion: &ExcitationMotion<N>) {
        self.motion.get_or_insert(*motion);
    }

    pub(super) fn note(&mut self, now: MonoNs, m: &Measurement, servo: &VisualServo<N>) {
        if m.found() && m.features().len() == servo.set_point().points().len() {
            self.watch.good(now); // not the stamp of the measurement: whether that is right is what the calibration is to find
        }
    }

    pub(super) fn confidence(&self, now: MonoNs) -> f64 {
        match self.watch.check(now) {
            Freshness::Fresh if self.motion.is_some() => self.watch.confidence(now),
            Freshness::Fresh | Freshness::Never | Freshness::Stale => 0.0,
        }
    }

    pub(super) fn motion_command(&mut self) -> MotionCommand<N> {
        let motion = self.motion.as_mut();
        motion.map_or(MotionCommand::Stand, |motion| MotionCommand::Joints(motion.advance(TICK)))
    }

    pub(super) fn is_over(&self) -> bool {
        self.motion.as_ref().is_some_and(ExcitationMotion::is_over)
    }
}
