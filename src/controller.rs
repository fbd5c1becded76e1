//! The controller: servo law + motion + safety, one step a tick.
//!
//! ```text
//! DriveState ──────────────┬────────────────────────┐
//! Measurement ─► watch ─► servo law ─► reference ─► joint controller ─► DriveCommand
//!                  │         (qd wish)    (limits)      (torque)
//!                  └─ Waiting ─► Servoing ⇄ Holding;  Fault from any
//! ```
//! `step` is total: it does not allocate, log, fail or look at a clock.

use crate::drive::{DriveCommand, DriveState};
use crate::geometry::Pose;
use crate::messages::{ControlState, Measurement};
use crate::motion::{InverseDynamicsControl, MotionLimits, Reference};
use crate::robot::{ExpressedIn, Robot};
use crate::safety::{Fault, MeasurementWatch, Vision};
use crate::schedule::TICK;
use crate::servo::{ImageTask, SetPoint, joint_velocity};
use crate::time::MonoNs;
use nalgebra::SVector;

/// When the servo law is computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UpdatePolicy {
    /// Once for each measurement; the joint velocity is held.
    Frame,
    /// At every tick with the newest joint positions; the feature error is held.
    Tick,
}

/// Which depth goes into the interaction matrix.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DepthSource {
    /// That of the desired pose.
    Desired,
    /// That of the estimated pose; of the desired one where a measurement has no pose.
    Estimated,
}

/// What a controller is made of.
#[derive(Debug, Clone)]
pub struct ControllerSettings<const N: usize> {
    /// The arm's model.
    pub robot: Robot<N>,
    /// Camera in the flange frame.
    pub X_EC: Pose,
    /// The goal.
    pub set_point: SetPoint,
    /// K_s, 1/s.
    pub gain_1_s: f64,
    /// When the law is computed.
    pub update: UpdatePolicy,
    /// Depth in the interaction matrix.
    pub depth: DepthSource,
    /// Limits of the reference.
    pub limits: MotionLimits<N>,
    /// Joint controller.
    pub joint_control: InverseDynamicsControl,
    /// Watch over the measurements.
    pub watch: MeasurementWatch,
    /// Largest distance of a joint from its reference, rad or m.
    pub max_tracking_error: f64,
    /// Without it (replay) the law is computed but the reference stays where the arm is.
    pub closed_loop: bool,
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
    /// Whether a limit on position, velocity or acceleration acted.
    pub limited: bool,
    /// Whether an effort limit acted.
    pub saturated: bool,
}

/// The controller of one arm with `N` joints.
#[derive(Debug, Clone)]
pub struct Controller<const N: usize> {
    settings: ControllerSettings<N>,
    reference: Reference<N>,
    watch: MeasurementWatch,
    task: Option<ImageTask>,
    held: SVector<f64, N>,
    fault: Option<Fault>,
    stopping: bool,
    last_tau: SVector<f64, N>,
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
            task: None,
            held: zero,
            fault: None,
            stopping: false,
            last_tau: zero,
        }
    }

    /// The settings.
    #[must_use]
    pub fn settings(&self) -> &ControllerSettings<N> {
        &self.settings
    }

    /// From now on the arm slows down within its limits and stays where it comes to rest.
    pub fn stop(&mut self) {
        self.stopping = true;
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
            self.fault = self.fault.or(Some(Fault::DriveStateNotFinite));
            return self.blind_output();
        }
        let fresh = measurement.is_some_and(|m| self.take(m));
        let vision = self.watch.check(now);
        let wish = match (self.fault, vision) {
            (None, Vision::Fresh) if !self.stopping => self.wished_velocity(&drive.q, fresh),
            _ => SVector::zeros(),
        };
        let reference = if self.settings.closed_loop {
            *self.reference.advance(&wish, TICK)
        } else {
            *self.reference.state()
        };
        if (reference.q - drive.q).amax() > self.settings.max_tracking_error {
            self.fault = self.fault.or(Some(Fault::TrackingError));
        }
        let torque =
            self.settings.joint_control.torque(&self.settings.robot, &drive.q, &drive.qd, &reference);
        self.last_tau = torque.tau;
        ControlOutput {
            command: DriveCommand { tau: torque.tau, q_r: reference.q, qd_r: reference.qd },
            state: match (self.fault, vision) {
                (Some(_), _) => ControlState::Fault,
                (None, _) if self.stopping => ControlState::Stopped,
                (None, Vision::Never) => ControlState::Waiting,
                (None, Vision::Fresh) => ControlState::Servoing,
                (None, Vision::Stale) => ControlState::Holding,
            },
            fault: self.fault,
            wish,
            limited: reference.limited,
            saturated: torque.saturated,
        }
    }

    /// Takes a measurement into the servo law; true when it can be used.
    fn take(&mut self, measurement: &Measurement) -> bool {
        let settings = &self.settings;
        let pose = match settings.depth {
            DepthSource::Desired => None,
            DepthSource::Estimated => measurement.pose(),
        };
        let Some(task) = ImageTask::new(&settings.set_point, measurement, pose.as_ref(), settings.gain_1_s)
        else {
            return false;
        };
        self.task = Some(task);
        self.watch.good(measurement.exposure);
        true
    }

    fn wished_velocity(&mut self, q: &SVector<f64, N>, fresh: bool) -> SVector<f64, N> {
        let Some(task) = &self.task else { return SVector::zeros() };
        if fresh || self.settings.update == UpdatePolicy::Tick {
            let J_C = self.settings.robot.jacobian_of_frame(q, &self.settings.X_EC, ExpressedIn::Moving);
            // At a singularity of task or arm there is no velocity to follow: the arm slows down.
            self.held = joint_velocity(task, &J_C).unwrap_or_else(SVector::zeros);
        }
        self.held
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
            limited: false,
            saturated: false,
        }
    }
}
