//! The controller: servo law + motion + safety, one step a tick.
//!
//! ```text
//! DriveState ──────────────┬────────────────────────┐
//! Measurement ─► watch ─► servo law ─► reference ─► joint controller ─► DriveCommand
//!                  │         (qd wish)    (limits)      (torque)
//!                  │         (torque wish) ──── effort limits ─────────►   schemes A and C
//!                  │         (qd of a gentle motion instead of the law, while the latency is calibrated)
//!                  └─ Waiting ─► Servoing ⇄ Holding;  Fault from any
//! ```
//! Under a torque law the reference stays on the arm, so that a stop, a hold, a fault or a joint that comes too near its
//! limits brakes from the motion of that moment.
//! `step` is total: it does not allocate, log, fail or look at a clock.

use crate::calibration::{GentleMotion, image_reach};
use crate::camera_model::CameraModel;
use crate::control::safety::{Fault, Freshness, MeasurementWatch};
use crate::drive::{DriveCommand, DriveState};
use crate::messages::{ControlState, Measurement};
use crate::motion::{ActingLimits, JointController, Limit, MotionLimits, Reference, brakeable, evade};
use crate::robot::Robot;
use crate::servo::{Approach, Intake, VisualServo, Wish};
use crate::time::TICK;
use crate::time::{MonoNs, SpanNs};
use nalgebra::SVector;

/// What a controller is made of.
#[derive(Debug, Clone)]
pub struct ControllerSettings<const N: usize> {
    /// The arm's model.
    pub robot: Robot<N>,
    /// From what the camera sees to what the joints shall do.
    pub servo: VisualServo<N>,
    /// Limits of the reference.
    pub limits: MotionLimits<N>,
    /// Joint controller.
    pub joint_control: JointController<N>,
    /// Watch over the measurements.
    pub watch: MeasurementWatch,
    /// Largest distance of a joint from its reference, rad or m.
    pub max_tracking_error: f64,
    /// Without it (pictures that do not show this arm) the law is computed but the reference stays where the arm is.
    pub closed_loop: bool,
    /// Calibration of the latency: the camera before which the arm moves gently, instead of servoing.
    pub calibrates: Option<CameraModel>,
}

/// What a step leads to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ControlOutput<const N: usize> {
    /// For the drive.
    pub command: DriveCommand<N>,
    /// What the controller does.
    pub state: ControlState,
    /// Why it does nothing more, in state `Fault`.
    pub fault: Option<Fault>,
    /// The joint velocity that the servo law asks for, before limits; rad/s or m/s.
    pub wish: SVector<f64, N>,
    /// The limits that acted, and on which joints.
    pub limits: ActingLimits,
    /// What became of the measurement, if there was one.
    pub intake: Option<Intake>,
}

/// The controller of one arm with `N` joints.
#[derive(Debug, Clone)]
pub struct Controller<const N: usize> {
    settings: ControllerSettings<N>,
    reference: Reference<N>,
    watch: MeasurementWatch,
    fault: Option<Fault>,
    stopping: bool,
    has_servoed: bool,
    last_tau: SVector<f64, N>,
    /// The motion of a calibration, from the first good measurement on.
    gentle: Option<GentleMotion<N>>,
}

impl<const N: usize> Controller<N> {
    /// A controller whose reference rests in `q_start`.
    #[must_use]
    pub fn new(settings: ControllerSettings<N>, q_start: SVector<f64, N>) -> Self {
        let reference = Reference::new(settings.limits.clone(), q_start);
        let watch = settings.watch;
        let zero = SVector::zeros();
        Self {
            settings,
            reference,
            watch,
            fault: None,
            stopping: false,
            has_servoed: false,
            last_tau: zero,
            gentle: None,
        }
    }

    /// The settings.
    #[must_use]
    pub fn settings(&self) -> &ControllerSettings<N> {
        &self.settings
    }

    /// Whether this controller calibrates instead of servoing.
    #[must_use]
    pub fn is_calibrating(&self) -> bool {
        self.settings.calibrates.is_some()
    }

    /// The motion of a calibration, once it has begun.
    #[must_use]
    pub fn gentle_motion(&self) -> Option<&GentleMotion<N>> {
        self.gentle.as_ref()
    }

    /// From now on the arm slows down within its limits and stays where it comes to rest.
    pub fn stop(&mut self) {
        self.stopping = true;
    }

    /// Whether the reference stands still, or is so slow that a standstill at the next tick is within its limits: from
    /// `v <= J T^2` braking takes at most two ticks `T`, and in one tick it changes the acceleration by at most `J T`.
    #[must_use]
    pub fn reference_rests(&self) -> bool {
        self.reference.rests_within(SpanNs(2 * TICK.0))
    }

    /// Something outside has failed: the run ends. The first fault is the one that is told.
    pub fn fail(&mut self, fault: Fault) {
        self.fault.get_or_insert(fault);
    }

    /// One tick: takes the drive's state and a measurement, if a new one has come, and gives the command for the
    /// time until the next tick.
    pub fn step(
        &mut self,
        now: MonoNs,
        drive: &DriveState<N>,
        measurement: Option<&Measurement>,
    ) -> ControlOutput<N> {
        if !drive.q.iter().chain(drive.qd.iter()).all(|x| x.is_finite()) {
            self.fail(Fault::DriveStateNotFinite);
        } else if !self.settings.limits.is_plausible(&drive.q, &drive.qd) {
            self.fail(Fault::DriveStateImplausible);
        }
        if self.fault.is_some_and(Fault::blinds) {
            return self.blind_output();
        }
        self.settings.servo.note_arm(now, &drive.q, &drive.qd);
        let intake = measurement.map(|m| self.take(now, drive, m));
        let (freshness, confidence) = self.trust(now);
        let answer = if self.fault.is_none() && freshness == Freshness::Fresh && !self.stopping {
            self.has_servoed = true;
            self.answer(drive)
        } else {
            self.settings.servo.restart();
            None
        };
        let mut limits = ActingLimits::default();
        let (wish, approach) = match answer {
            Some(Wish::Velocity(qd)) => (qd, self.settings.servo.approach().copied()),
            Some(Wish::Torque(tau)) if self.settings.closed_loop => {
                self.reference.reseat(&drive.q, &drive.qd);
                // Where the arm could not stop within its range any more, a torque law has to wait.
                if self.settings.limits.can_stop(&drive.q, &drive.qd) {
                    return self.direct_output(drive, tau, intake);
                }
                (SVector::zeros(), None)
            }
            // At a singularity of task or arm there may be nothing to follow: the arm slows down.
            Some(Wish::Torque(_)) | None => (SVector::zeros(), None),
        };
        let reference = if self.settings.closed_loop {
            // A gentle motion is one of joints: no singular posture is in its way, and it keeps within their ranges.
            let (qd, acting) = match self.gentle {
                Some(_) => (wish, ActingLimits::default()),
                None => self.held_back(&drive.q, &wish, approach.as_ref(), confidence),
            };
            let reference = *self.reference.advance(&qd, TICK);
            limits = acting.with(&reference.limits);
            reference
        } else {
            *self.reference.state()
        };
        if (reference.q - drive.q).amax() > self.settings.max_tracking_error {
            self.fault = self.fault.or(Some(Fault::TrackingError));
        }
        let torque =
            self.settings.joint_control.torque(&self.settings.robot, &drive.q, &drive.qd, &reference);
        self.last_tau = torque.tau;
        limits.add(Limit::Effort, torque.saturated);
        ControlOutput {
            command: DriveCommand { tau: torque.tau, q_r: reference.q, qd_r: reference.qd },
            state: match (self.fault, freshness) {
                (Some(_), _) => ControlState::Fault,
                (None, _) if self.stopping => ControlState::Stopped,
                (None, Freshness::Never) => ControlState::Waiting,
                (None, Freshness::Fresh) => ControlState::Servoing,
                (None, Freshness::Stale) => ControlState::Holding,
            },
            fault: self.fault,
            wish,
            limits,
            intake,
        }
    }

    /// Takes a measurement in; what became of it.
    fn take(&mut self, now: MonoNs, drive: &DriveState<N>, m: &Measurement) -> Intake {
        let Self { settings, watch, .. } = self;
        let intake = settings.servo.take(now, m, &settings.robot);
        let Some(camera) = &settings.calibrates else {
            if intake.is_used() {
                watch.good(m.exposure);
            }
            return intake;
        };
        let ControllerSettings { robot, servo, limits, .. } = &*settings;
        let points = servo.set_point().points();
        if m.found() && m.features().len() == points.len() {
            if self.gentle.is_none() {
                let reach = image_reach(robot, &servo.settings().mount, camera, points, limits, &drive.q, m);
                self.gentle = reach.map(|reach| GentleMotion::new(&drive.q, &reach, limits));
            }
            if self.gentle.is_some() {
                watch.good(now); // whatever its stamp says: that is what is to be found out
            }
        }
        intake
    }

    /// Whether there is a view to go by, and the share of the wished velocity that it justifies, 0 to 1.
    fn trust(&self, now: MonoNs) -> (Freshness, f64) {
        let mut confidence = self.watch.confidence(now);
        if !self.is_calibrating() {
            confidence = confidence.min(self.settings.servo.confidence(now));
        }
        let freshness = match self.watch.check(now) {
            Freshness::Fresh if confidence > 0.0 => Freshness::Fresh,
            Freshness::Fresh if !self.has_servoed => Freshness::Never,
            Freshness::Fresh | Freshness::Stale => Freshness::Stale,
            Freshness::Never => Freshness::Never,
        };
        (freshness, confidence)
    }

    fn answer(&mut self, drive: &DriveState<N>) -> Option<Wish<N>> {
        let Self { settings, gentle, .. } = self;
        match gentle {
            Some(motion) => Some(Wish::Velocity(motion.advance(TICK))),
            None if settings.calibrates.is_some() => None,
            None => settings.servo.wish(&drive.q, &drive.qd, &settings.robot),
        }
    }

    /// The wish, slowed down so that the arm can brake at the goal, where the view is old or uncertain, and ahead of
    /// singular postures and ends of ranges.
    fn held_back(
        &self,
        q: &SVector<f64, N>,
        wish: &SVector<f64, N>,
        approach: Option<&Approach<N>>,
        confidence: f64,
    ) -> (SVector<f64, N>, ActingLimits) {
        let ControllerSettings { robot, servo, limits, .. } = &self.settings;
        let (mut wish, mut acting) = match approach {
            Some(approach) => brakeable(wish, approach, self.reference.state(), limits),
            None => (*wish, ActingLimits::default()),
        };
        if confidence < 1.0 && approach.is_some() {
            wish *= confidence;
            (0..N).for_each(|i| acting.set(Limit::View, i));
        }
        let (_, J) = servo.settings().mount.camera(robot, q);
        let free = approach.map_or_else(SVector::zeros, |approach| approach.free);
        let (wish, evading) = evade(robot, q, J.matrix(), &wish, &free);
        (wish, acting.with(&evading))
    }

    /// A torque law speaks to the drive itself, within the effort limits.
    fn direct_output(
        &mut self,
        drive: &DriveState<N>,
        wanted: SVector<f64, N>,
        intake: Option<Intake>,
    ) -> ControlOutput<N> {
        let mut tau = wanted;
        let mut limits = ActingLimits::default();
        for (i, limit) in self.settings.robot.limits().iter().enumerate() {
            tau[i] = wanted[i].clamp(-limit.effort, limit.effort);
            if tau[i] != wanted[i] {
                limits.set(Limit::Effort, i);
            }
        }
        self.last_tau = tau;
        ControlOutput {
            command: DriveCommand { tau, q_r: drive.q, qd_r: drive.qd },
            state: ControlState::Servoing,
            fault: None,
            wish: SVector::zeros(),
            limits,
            intake,
        }
    }

    /// Without a usable joint state nothing can be computed: the last reference without motion and the last torque,
    /// which at low speed balances gravity. The run ends.
    fn blind_output(&self) -> ControlOutput<N> {
        let reference = self.reference.state();
        ControlOutput {
            command: DriveCommand { tau: self.last_tau, q_r: reference.q, qd_r: SVector::zeros() },
            state: ControlState::Fault,
            fault: self.fault,
            wish: SVector::zeros(),
            limits: ActingLimits::default(),
            intake: None,
        }
    }
}
