//! The behaviours that move the arm: what each uses as its input, and the motion command that it gives at each tick.
//!
//! | behaviour | input | motion command |
//! | --- | --- | --- |
//! | [`Servoing`] | views of the target | the output of the servo law |
//! | [`Servoing::dry`] | the same without an arm, or with images of another arm | none; the output of the law is reported |
//! | [`Waypoints`] | a list of postures, independent of the view | a motion from posture to posture, with rests |
//! | [`Excitation`] | measurements that keep arriving, whatever their stamps | the excitation motion of the joints |
//! | [`CommandedBehaviour`] | motions that somebody else commands upon measurements | that motion, held until the next |
//! | [`PostureMotion`] | one posture that a client asked for | a motion there from rest, beside the behaviour of the run |
//! | [`VelocityMotion`] | velocities that a client commands, each for a time | those velocities, and standstill once it is silent |
//! | standing, braking | none | standstill, where no behaviour moves the arm |
//!
//! None of them plans: goals, waypoints and motions come from the mission ([`Order`](super::order::ControlOrder)).

mod commanded;
mod excitation;
mod posture_motion;
mod servoing;
mod velocity_motion;
mod waypoints;

pub use commanded::{CommandedBehaviour, CommandedMotion};
pub use excitation::Excitation;
pub use posture_motion::PostureMotion;
pub use servoing::Servoing;
pub use velocity_motion::VelocityMotion;
pub use waypoints::{LIMIT_SHARE, Waypoints};

use crate::drive::DriveState;
use crate::messages::Measurement;
use crate::motion::{ExcitationMotion, MotionLimits};
use crate::robot::{Mount, Robot};
use crate::servo::{Convergence, MeasurementVerdict, VisualServo};
use crate::time::MonoNs;
use nalgebra::{SMatrix, SVector};

/// The arm as control knows it.
#[derive(Debug, Clone)]
pub struct ArmModel<const N: usize> {
    /// Kinematics and dynamics.
    pub robot: Robot<N>,
    /// The limits of its reference.
    pub limits: MotionLimits<N>,
}

/// The motion command of a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MotionCommand<const N: usize> {
    /// Stand.
    Stand,
    /// Stand, while the output of a law that is only observed is reported, rad/s or m/s.
    Look(SVector<f64, N>),
    /// Joint velocities of a motion in joint space, rad/s or m/s.
    Joints(SVector<f64, N>),
    /// Joint velocities of a law, rad/s or m/s, on the way to a goal.
    Velocity(SVector<f64, N>, Convergence<N>),
    /// Joint torques, N m or N, gravity included, the damping of the joints that is part of them, N m s/rad or N s/m, and how they lead to the goal.
    Torque(SVector<f64, N>, SMatrix<f64, N, N>, Convergence<N>),
}

impl<const N: usize> MotionCommand<N> {
    /// Its velocity, rad/s or m/s; zero for torques and standstill.
    #[must_use]
    pub fn velocity(&self) -> SVector<f64, N> {
        match self {
            Self::Look(qd) | Self::Joints(qd) | Self::Velocity(qd, _) => *qd,
            Self::Stand | Self::Torque(..) => SVector::zeros(),
        }
    }
}

/// The behaviour of a run, made before the first tick.
#[derive(Debug)]
pub enum Behaviour<const N: usize> {
    /// Visual servoing to the goal.
    Servoing(Servoing),
    /// Motion from posture to posture.
    Waypoints(Waypoints<N>),
    /// The excitation motion of a latency calibration.
    Excitation(Excitation<N>),
    /// Motions that somebody else commands.
    Commanded(CommandedBehaviour<N>),
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
            Self::Servoing(servoing) => servoing.note(now, m, verdict),
            Self::Waypoints(_) => {}
            Self::Excitation(excitation) => excitation.note(now, m, servo),
            Self::Commanded(commanded) => commanded.note(m),
        }
    }

    /// The goal is of another target from now on: what was seen before counts no more.
    pub fn forget_target(&mut self) {
        if let Self::Servoing(servoing) = self {
            servoing.forget_target();
        }
    }

    /// Whether measurements keep coming at `now`, with or without a target; only servoing looks for one.
    #[must_use]
    pub fn sees(&self, now: MonoNs) -> bool {
        match self {
            Self::Servoing(servoing) => servoing.sees(now),
            Self::Waypoints(_) | Self::Excitation(_) | Self::Commanded(_) => false,
        }
    }

    /// Confidence in the input at `now`, 0 to 1: the factor of a velocity. At 0 there is no usable input.
    #[must_use]
    pub fn confidence(&self, now: MonoNs, servo: &VisualServo<N>) -> f64 {
        match self {
            Self::Servoing(servoing) => servoing.confidence(now, servo),
            Self::Waypoints(waypoints) => waypoints.confidence(),
            Self::Excitation(excitation) => excitation.confidence(now),
            Self::Commanded(commanded) => commanded.confidence(now),
        }
    }

    /// The motion command of this tick. Motions along a path go on at `pace`, 1 where nothing in space holds them, and commanded ones at the `confidence` in their input.
    pub fn motion_command(
        &mut self,
        state: &DriveState<N>,
        (pace, confidence): (f64, f64),
        arm: &ArmModel<N>,
        servo: &mut VisualServo<N>,
    ) -> MotionCommand<N> {
        match self {
            Self::Servoing(servoing) => servoing.motion_command(state, &arm.robot, servo),
            Self::Waypoints(waypoints) => waypoints.motion_command(&state.q, pace, &arm.limits),
            Self::Excitation(excitation) => excitation.motion_command(),
            Self::Commanded(commanded) => commanded.motion_command(state, confidence, arm),
        }
    }

    /// Whether the law is only observed: nothing moves, whatever its output.
    #[must_use]
    pub fn is_dry(&self) -> bool {
        matches!(self, Self::Servoing(servoing) if servoing.is_dry())
    }

    /// Whether the arm moves by the law.
    pub(in crate::control) fn goes_by_law(&self) -> bool {
        matches!(self, Self::Servoing(servoing) if !servoing.is_dry())
    }

    /// Appends a waypoint, rad or m. Without room for it, or in another behaviour, it changes nothing.
    pub fn add_waypoint(&mut self, q: &SVector<f64, N>) {
        if let Self::Waypoints(waypoints) = self {
            waypoints.add(q);
        }
    }

    /// From now on somebody else commands the motions of an arm with a camera on `mount`, instead of the law. Returns whether: only servoing is handed over.
    pub fn hand_over(&mut self, mount: Mount) -> bool {
        let watch = match self {
            Self::Servoing(servoing) => servoing.handed_over(),
            _ => None,
        };
        if let Some(watch) = watch {
            *self = Self::Commanded(CommandedBehaviour::new(watch, mount));
        }
        watch.is_some()
    }

    /// Sets the motion that is commanded, or that there is none. In another behaviour it changes nothing.
    pub fn command(&mut self, motion: Option<CommandedMotion<N>>) {
        if let Self::Commanded(commanded) = self {
            commanded.set(motion);
        }
    }

    /// The arm does not move by this behaviour at this tick: it waits, or was held or stopped.
    pub fn interrupt(&mut self) {
        if let Self::Waypoints(waypoints) = self {
            waypoints.interrupt();
        }
    }

    /// Sets the excitation motion of a calibration. In another behaviour it changes nothing.
    pub fn excite(&mut self, motion: &ExcitationMotion<N>) {
        if let Self::Excitation(excitation) = self {
            excitation.begin(motion);
        }
    }

    /// Whether the requested motion is complete.
    #[must_use]
    pub fn is_over(&self) -> bool {
        match self {
            Self::Servoing(_) | Self::Commanded(_) => false,
            Self::Waypoints(waypoints) => waypoints.is_over(),
            Self::Excitation(excitation) => excitation.is_over(),
        }
    }
}
