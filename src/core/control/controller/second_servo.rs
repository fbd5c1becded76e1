//! Two cameras that control one arm (10.1.1): the law of the second one beside that of the first.
//!
//! ```text
//! camera 0 ─► VisualServo ─► qd_0, trust ─┐
//!                                         ├─► compromise ─► motion command        both views trusted
//! camera 1 ─► VisualServo ─► qd_1, trust ─┘   or one of the two as it is          the other is missing or old
//! ```
//! A view that grows old loses its weight evenly, and with the last of it falls out of the task; one that comes back begins smoothly. Without either the arm holds.

use super::Controller;
use crate::control::behaviour::{MotionCommand, Servoing};
use crate::control::safety::MeasurementWatch;
use crate::control::trace::Event;
use crate::drive::DriveState;
use crate::geometry::Pose;
use crate::messages::Measurement;
use crate::robot::CameraJacobian;
use crate::servo::{JointWish, MeasurementVerdict, VisualServo, compromise};
use crate::time::{MonoNs, SpanNs};
use nalgebra::SVector;

/// The law of the second of two cameras.
#[derive(Debug)]
pub struct SecondServo<const N: usize> {
    /// The number of the camera.
    camera: u32,
    servo: VisualServo<N>,
    /// Age from which on its measurements are no view of now any more.
    timeout: SpanNs,
    servoing: Servoing,
    /// Its weight; that of the first camera is 1.
    weight: f64,
    /// How far the views of this tick are trusted, 0 to 1: that of the first camera, and this one.
    trust: [f64; 2],
    /// Which of them was missing at the last tick of servoing, since when, and whether that was told.
    missing: Option<(Event, MonoNs, bool)>,
}

impl<const N: usize> SecondServo<N> {
    /// Servoing by the camera with the number `camera` while `watch` trusts its measurements, with a `weight` beside that of the first camera, which is 1.
    #[must_use]
    pub fn new(camera: u32, servo: VisualServo<N>, watch: MeasurementWatch, weight: f64) -> Self {
        let (servoing, timeout) = (Servoing::new(watch), watch.timeout());
        Self { camera, servo, timeout, servoing, weight, trust: [0.0; 2], missing: None }
    }

    /// Sets the gain of its law, 1/s.
    pub(super) fn set_gain(&mut self, gain_1_s: f64) {
        self.servo.set_gain(gain_1_s);
    }

    /// What is to be told of views that are missing at `now`.
    fn news(&mut self, now: MonoNs) -> Option<Event> {
        let present = match self.trust.map(|trust| trust > 0.0) {
            [false, true] => Some(Event::FirstViewMissing),
            [true, false] => Some(Event::SecondViewMissing),
            _ => None,
        };
        let was_told = self.missing.is_some_and(|(.., told)| told);
        let Some(event) = present else {
            self.missing = None;
            return was_told.then_some(Event::BothViews);
        };
        let (missing, since, told) =
            self.missing.filter(|(before, ..)| *before == event).unwrap_or((event, now, false));
        // The cameras need not begin at once.
        let tells = !told && now - since > self.timeout;
        self.missing = Some((missing, since, told || tells));
        tells.then_some(event)
    }
}

impl<const N: usize> Controller<N> {
    /// The same with a second camera that controls the arm, too.
    #[must_use]
    pub fn with_second(self, second: Option<SecondServo<N>>) -> Self {
        let Some(second) = second else { return Self { second: None, ..self } };
        let second = SecondServo { servo: second.servo.beside_another(), ..second };
        Self { servo: self.servo.beside_another(), second: Some(Box::new(second)), ..self }
    }

    /// The law of the second camera, where one controls the arm.
    #[must_use]
    pub fn second_servo(&self) -> Option<&VisualServo<N>> {
        self.second.as_ref().map(|second| &second.servo)
    }

    /// Whether the law of this camera uses a view in which features are hidden.
    #[must_use]
    pub fn is_degraded(&self, camera: u32) -> bool {
        let second = self.second.as_ref().filter(|second| second.camera == camera);
        second.map_or(&self.servo, |second| &second.servo).is_degraded()
    }

    /// Takes in the arm at `now`, and a measurement; gives the verdict on it, and how far what is seen is trusted, 0 to 1.
    pub(super) fn take_in(
        &mut self,
        now: MonoNs,
        arm: &DriveState<N>,
        measurement: Option<&Measurement>,
    ) -> (Option<MeasurementVerdict>, f64) {
        self.servo.note_arm(now, &arm.q, &arm.qd);
        let Some(second) = &mut self.second else {
            let verdict = measurement.map(|m| self.take(now, m));
            return (verdict, self.behaviour.confidence(now, &self.servo));
        };
        second.servo.note_arm(now, &arm.q, &arm.qd);
        let verdict = match measurement {
            Some(m) if m.camera == second.camera => Some(self.take_second(now, m)),
            other => other.map(|m| self.take(now, m)),
        };
        let first = self.behaviour.confidence(now, &self.servo);
        let Some(second) = &mut self.second else { return (verdict, first) };
        second.trust = [first, second.servoing.confidence(now, &second.servo)];
        (verdict, second.trust[0].max(second.trust[1]))
    }

    /// Takes in a measurement of the second camera at `now`.
    fn take_second(&mut self, now: MonoNs, m: &Measurement) -> MeasurementVerdict {
        let Some(second) = &mut self.second else { return MeasurementVerdict::OtherFeatures };
        let verdict = second.servo.add_measurement(now, m, &self.arm.robot);
        second.servoing.note(now, m, verdict);
        let (drift, camera_error) = (second.servo.take_unobserved_motion(), second.servo.camera_error());
        self.use_sight(now, drift.as_ref(), camera_error);
        verdict
    }

    /// The arm does not move by what is seen at this tick.
    pub(super) fn interrupt(&mut self) {
        self.servo.restart();
        self.behaviour.interrupt();
        if let Some(second) = &mut self.second {
            second.servo.restart();
            second.missing = None;
        }
    }

    /// The motion command of this tick, of an arm that servoes by views that are trusted as far as `confidence` says.
    pub(super) fn servoing(
        &mut self,
        now: MonoNs,
        state: &DriveState<N>,
        confidence: f64,
    ) -> MotionCommand<N> {
        let pace = (self.pace(), confidence);
        let Some(second) = &mut self.second else {
            return self.behaviour.motion_command(state, pace, &self.arm, &mut self.servo);
        };
        second.news(now).into_iter().for_each(|event| self.events.push(event));
        let command = |is_trusted: bool, servo: &mut VisualServo<N>, servoing: &Servoing| {
            if is_trusted {
                servoing.motion_command(state, &self.arm.robot, servo)
            } else {
                servo.restart();
                MotionCommand::Stand
            }
        };
        let [of_first, of_second] = second.trust;
        let first = command(of_first > 0.0, &mut self.servo, &second.servoing);
        let other = command(of_second > 0.0, &mut second.servo, &second.servoing);
        let (MotionCommand::Velocity(qd_0, convergence_0), MotionCommand::Velocity(qd_1, convergence_1)) =
            (first, other)
        else {
            return if first == MotionCommand::Stand { other } else { first };
        };
        let wish = |qd, convergence, servo: &VisualServo<N>, weight| {
            let (_, J) = servo.settings().mount.camera(&self.arm.robot, &state.q);
            JointWish { qd, convergence, J, weight }
        };
        let wishes = [
            wish(qd_0, convergence_0, &self.servo, of_first),
            wish(qd_1, convergence_1, &second.servo, second.weight * of_second),
        ];
        compromise(&wishes)
            .map_or(MotionCommand::Stand, |(qd, convergence)| MotionCommand::Velocity(qd, convergence))
    }

    /// The share of the joint velocity `qd`, rad/s or m/s, of an arm at `q`, that the first motion before each camera that is trusted allows; that of the first camera is at `X_WC` with the Jacobian `J`.
    pub(super) fn first_motion_share(
        &mut self,
        q: &SVector<f64, N>,
        qd: &SVector<f64, N>,
        first: (&Pose, &CameraJacobian<N>),
    ) -> f64 {
        let Some(second) = &mut self.second else { return self.servo.first_motion_share(qd, first) };
        let [of_first, of_second] = second.trust;
        let of_first = if of_first > 0.0 { self.servo.first_motion_share(qd, first) } else { 1.0 };
        if of_second == 0.0 {
            return of_first;
        }
        let (X_WC, J) = second.servo.settings().mount.camera(&self.arm.robot, q);
        of_first.min(second.servo.first_motion_share(qd, (&X_WC, &J)))
    }

    /// Restores all of the law's gain, and the path of the goal from its begin.
    pub(super) fn begin_law_anew(&mut self) {
        self.servo.restore_gain();
        self.servo.restart_path();
        self.forget_losses();
        if let Some(second) = &mut self.second {
            second.servo.restore_gain();
        }
    }

    /// Halves the gain of the law, of both where there are two. Returns whether one was reduced.
    pub(super) fn reduce_law(&mut self) -> bool {
        let second = self.second.as_mut().is_some_and(|second| second.servo.reduce_gain());
        self.servo.reduce_gain() | second
    }
}
