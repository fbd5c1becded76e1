//! Why the arm moves: what there is to go by, and what is requested at a tick. The controller does not know it.
//!
//! | behaviour | input | motion command |
//! | --- | --- | --- |
//! | [`Servoing`] | views of the target | what the servo law says |
//! | [`Servoing::dry`] | the same without an arm, or before images of another one | nothing, and tells what the law says |
//! | [`ExcitationMotion`] | measurements, whatever their stamps say | an excitation motion of the joints, to calibrate by |
//! | [`CalibrationTour`] | where the board is seen at the start | a motion from posture to posture, with rests, to calibrate by |
//! | standing, braking | nothing | rest: what the controller does where no behaviour moves the arm |

mod calibration_tour;
mod excitation;
mod servoing;

pub use calibration_tour::CalibrationTour;
pub use excitation::ExcitationMotion;
pub use servoing::Servoing;

use super::outcome::Finish;
use crate::drive::DriveState;
use crate::messages::Measurement;
use crate::motion::MotionLimits;
use crate::robot::Robot;
use crate::servo::{Convergence, Drift, MeasurementVerdict, SetPoint};
use crate::time::MonoNs;
use nalgebra::{SVector, Vector6};

/// The arm as control knows it.
#[derive(Debug, Clone)]
pub struct ArmModel<const N: usize> {
    /// Kinematics and dynamics.
    pub robot: Robot<N>,
    /// What its reference is held to.
    pub limits: MotionLimits<N>,
}

/// What the joints shall do in a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MotionCommand<const N: usize> {
    /// Stand.
    Stand,
    /// Stand, although a law that is only looked at asks for this velocity, rad/s or m/s.
    Look(SVector<f64, N>),
    /// Move like this, rad/s or m/s, whatever the camera's posture: a motion of joints.
    Joints(SVector<f64, N>),
    /// Move like this, rad/s or m/s, on the way to a goal.
    Velocity(SVector<f64, N>, Convergence<N>),
    /// Push like this, N m or N, gravity included.
    Torque(SVector<f64, N>),
}

impl<const N: usize> MotionCommand<N> {
    /// The velocity that it names, rad/s or m/s.
    #[must_use]
    pub fn velocity(&self) -> SVector<f64, N> {
        match self {
            Self::Look(qd) | Self::Joints(qd) | Self::Velocity(qd, _) => *qd,
            Self::Stand | Self::Torque(_) => SVector::zeros(),
        }
    }
}

/// Something to move for.
pub trait Behaviour<const N: usize>: Send + std::fmt::Debug {
    /// Notes where the arm is; at every tick, before anything else.
    fn note_arm(&mut self, now: MonoNs, state: &DriveState<N>);

    /// Takes a measurement in; the arm stands in `q`.
    fn take(
        &mut self,
        now: MonoNs,
        q: &SVector<f64, N>,
        m: &Measurement,
        arm: &ArmModel<N>,
    ) -> MeasurementVerdict;

    /// Share of a requested velocity that what is known at `now` justifies, 0 to 1; at 0 there is nothing to go by.
    fn confidence(&self, now: MonoNs) -> f64;

    /// What the joints shall do at this tick.
    fn motion_command(&mut self, state: &DriveState<N>, robot: &Robot<N>) -> MotionCommand<N>;

    /// The arm does not move by this behaviour in this tick.
    fn pause(&mut self);

    /// What an arm in `q` that has lost its view may do to find it again; `None`: it stands.
    fn way_back(&self, _q: &SVector<f64, N>) -> Option<MotionCommand<N>> {
        None
    }

    /// Where the camera moves with the joints: for what holds an arm back near singular postures.
    fn camera_jacobian(&self, robot: &Robot<N>, q: &SVector<f64, N>) -> nalgebra::SMatrix<f64, 6, N>;

    /// The twist of the camera that is requested at `now` of one that no arm holds, `V_WC_C`, m/s and rad/s; `None` where an arm moves it,
    /// and where there is nothing to go by.
    fn camera_law_output(&self, _now: MonoNs) -> Option<Vector6<f64>> {
        None
    }

    /// What the measurement that was taken in told of the joints' motion beyond their encoders, once.
    fn take_drift(&mut self) -> Option<Drift<N>> {
        None
    }

    /// The goal.
    fn set_point(&self) -> &SetPoint;

    /// Makes what the camera sees the goal.
    fn teach(&mut self);

    /// Whether the goal is still being taught.
    fn is_teaching(&self) -> bool {
        false
    }

    /// From now on the goal is sought more slowly. Whether it is.
    fn reduce_gain(&mut self) -> bool {
        false
    }

    /// From now on the goal is sought as quickly as at first.
    fn seek_at_full_gain(&mut self) {}

    /// Whether a part of the target is hidden.
    fn is_degraded(&self) -> bool {
        false
    }

    /// The end of the run, where the behaviour has come to its own.
    fn finished(&self) -> Option<Finish> {
        None
    }

    /// Whether the run goes by a goal to be reached and held.
    fn has_goal(&self) -> bool {
        true
    }

    /// The end of a run that loses its view, where that cannot be made good.
    fn when_lost(&self) -> Option<Finish> {
        None
    }

    /// Why the time of the run was too short, where the behaviour knows.
    fn when_late(&self) -> Option<&'static str> {
        None
    }
}
