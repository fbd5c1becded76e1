//! Why the arm moves: what there is to go by, and what is asked of the joints at a tick.
//!
//! | behaviour | goes by | asks for |
//! | --- | --- | --- |
//! | [`Servoing`] | views of the target | what the servo law says |
//! | [`Servoing::dry`] | the same without an arm, or before images of another one | nothing, and tells what the law says |
//! | [`Waypoints`] | a list of postures, whatever is in view | a motion from posture to posture, with rests |
//! | [`Excitation`] | measurements that keep coming, whatever their stamps say | the excitation motion of the joints |
//! | standing, braking | nothing | rest: what the controller does where no behaviour moves the arm |
//!
//! None of them plans: what is to be reached comes from the mission ([`Order`](super::order::ControlOrder)).

mod excitation;
mod servoing;
mod waypoints;

pub use excitation::Excitation;
pub use servoing::Servoing;
pub use waypoints::Waypoints;

use crate::drive::DriveState;
use crate::messages::Measurement;
use crate::motion::{ExcitationMotion, MotionLimits};
use crate::robot::Robot;
use crate::servo::{Convergence, MeasurementVerdict, VisualServo};
use crate::time::MonoNs;
use nalgebra::SVector;

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

/// What the arm moves for. One in a run, made before the first tick.
#[derive(Debug)]
pub enum Behaviour<const N: usize> {
    /// To the goal by what the camera sees.
    Servoing(Servoing),
    /// From posture to posture.
    Waypoints(Waypoints<N>),
    /// The motion by which stamps are compared.
    Excitation(Excitation<N>),
}

impl<const N: usize> Behaviour<N> {
    /// Takes in what `servo` made of a measurement at `now`.
    pub fn note(
        &mut self,
        now: MonoNs,
        m: &Measurement,
        verdict: MeasurementVerdict,
        servo: &VisualServo<N>,
    ) {
        match self {
            Self::Servoing(servoing) => servoing.note(m, verdict),
            Self::Waypoints(_) => {}
            Self::Excitation(excitation) => excitation.note(now, m, servo),
        }
    }

    /// Share of a velocity that what is known at `now` justifies, 0 to 1; at 0 there is nothing to go by.
    #[must_use]
    pub fn confidence(&self, now: MonoNs, servo: &VisualServo<N>) -> f64 {
        match self {
            Self::Servoing(servoing) => servoing.confidence(now, servo),
            Self::Waypoints(waypoints) => waypoints.confidence(),
            Self::Excitation(excitation) => excitation.confidence(now),
        }
    }

    /// What the joints shall do at this tick.
    pub fn motion_command(
        &mut self,
        state: &DriveState<N>,
        arm: &ArmModel<N>,
        servo: &mut VisualServo<N>,
    ) -> MotionCommand<N> {
        match self {
            Self::Servoing(servoing) => servoing.motion_command(state, &arm.robot, servo),
            Self::Waypoints(waypoints) => waypoints.motion_command(&state.q, &arm.limits),
            Self::Excitation(excitation) => excitation.motion_command(),
        }
    }

    /// Whether a law is only looked at: nothing moves, whatever it says.
    #[must_use]
    pub fn is_dry(&self) -> bool {
        matches!(self, Self::Servoing(servoing) if servoing.is_dry())
    }

    /// One more posture to go to, rad or m. Without room for it, or as another behaviour, it changes nothing.
    pub fn add_waypoint(&mut self, q: &SVector<f64, N>) {
        if let Self::Waypoints(waypoints) = self {
            waypoints.add(q);
        }
    }

    /// The motion by which to calibrate. As another behaviour it changes nothing.
    pub fn excite(&mut self, motion: &ExcitationMotion<N>) {
        if let Self::Excitation(excitation) = self {
            excitation.begin(motion);
        }
    }

    /// Whether the motion that was asked for has come to its end.
    #[must_use]
    pub fn is_over(&self) -> bool {
        match self {
            Self::Servoing(_) => false,
            Self::Waypoints(waypoints) => waypoints.is_over(),
            Self::Excitation(excitation) => excitation.is_over(),
        }
    }
}
