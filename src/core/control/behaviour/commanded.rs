//! Motions that somebody else commands: a twist of the camera or velocities of the joints. An entrant of the benchmark commands instead of the law, for as long
//! as measurements come; what a client commands in a running loop is a [`VelocityMotion`](super::VelocityMotion).

use super::{ArmModel, MotionCommand};
use crate::control::safety::{Freshness, MeasurementWatch};
use crate::drive::DriveState;
use crate::messages::Measurement;
use crate::robot::{InverseOptions, Mount, Robot};
use crate::time::MonoNs;
use nalgebra::{SVector, Vector6};

/// What is commanded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CommandedMotion<const N: usize> {
    /// The twist of the camera `V_WC_C`, m/s and rad/s.
    Twist(Vector6<f64>),
    /// Velocities of the joints, rad/s or m/s.
    Joints(SVector<f64, N>),
}

impl<const N: usize> CommandedMotion<N> {
    /// The velocities of the joints, rad/s or m/s: a twist by the Jacobian of the camera on `mount` at this tick, damped near singular postures and ends of
    /// ranges as for every law; velocities of the joints as they are.
    #[must_use]
    pub(super) fn joint_velocity(
        &self,
        q: &SVector<f64, N>,
        mount: &Mount,
        robot: &Robot<N>,
    ) -> SVector<f64, N> {
        match self {
            Self::Joints(qd) => *qd,
            Self::Twist(V_C) => {
                let (_, J) = mount.camera(robot, q);
                let (J, none) = (J.matrix(), SVector::zeros());
                robot.damped_velocity(q, J, V_C, &none, &InverseOptions::default()).qd
            }
        }
    }
}

/// The last commanded motion, while the measurements to which it answers are fresh enough to be trusted.
#[derive(Debug)]
pub struct CommandedBehaviour<const N: usize> {
    watch: MeasurementWatch,
    mount: Mount,
    motion: Option<CommandedMotion<N>>,
}

impl<const N: usize> CommandedBehaviour<N> {
    /// A behaviour that waits for its first motion, of a camera on `mount`, while `watch` trusts the measurements.
    #[must_use]
    pub fn new(watch: MeasurementWatch, mount: Mount) -> Self {
        Self { watch, mount, motion: None }
    }

    /// Sets the motion; `None`: the arm brakes and rests until there is one.
    pub(super) fn set(&mut self, motion: Option<CommandedMotion<N>>) {
        self.motion = motion;
    }

    /// A measurement to which the motion answers. Whether it is good is for whoever commands to say.
    pub(super) fn note(&mut self, m: &Measurement) {
        if self.motion.is_some() {
            self.watch.good(m.exposure);
        }
    }

    pub(super) fn confidence(&self, now: MonoNs) -> f64 {
        match self.watch.check(now) {
            Freshness::Fresh if self.motion.is_some() => self.watch.confidence(now),
            Freshness::Fresh | Freshness::Never | Freshness::Stale => 0.0,
        }
    }

    /// The motion at the `confidence` in what it answers to.
    pub(super) fn motion_command(
        &self,
        state: &DriveState<N>,
        confidence: f64,
        arm: &ArmModel<N>,
    ) -> MotionCommand<N> {
        let Some(motion) = self.motion else { return MotionCommand::Stand };
        MotionCommand::Joints(motion.joint_velocity(&state.q, &self.mount, &arm.robot) * confidence)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use crate::motion::MotionLimits;
    use crate::robot::load;
    use crate::time::SpanNs;

    const TWIST: [f64; 6] = [0.02, -0.01, 0.03, 0.1, 0.05, -0.2];

    fn behaviour() -> (CommandedBehaviour<6>, ArmModel<6>, DriveState<6>) {
        let robot = load("ur5").unwrap().build::<6>().unwrap();
        let limits = MotionLimits::of(&robot, SVector::repeat(10.0), SVector::repeat(500.0));
        let q = Vector6::new(0.4, -1.7, 1.5, -1.3, -1.8, 0.9);
        let mount = Mount::EyeInHand { X_EC: Pose::translation(0.0, 0.0, 0.05) };
        let watch = MeasurementWatch::new(SpanNs(100), 0.5);
        let state = DriveState { q, qd: Vector6::zeros(), truth: None };
        (CommandedBehaviour::new(watch, mount), ArmModel { robot, limits }, state)
    }

    #[test]
    fn a_twist_is_what_the_camera_does() {
        let (mut commanded, arm, state) = behaviour();
        assert_eq!(commanded.motion_command(&state, 1.0, &arm), MotionCommand::Stand);
        commanded.set(Some(CommandedMotion::Twist(TWIST.into())));
        let (_, J) = commanded.mount.camera(&arm.robot, &state.q);
        for confidence in [1.0, 0.5] {
            let qd = commanded.motion_command(&state, confidence, &arm).velocity();
            assert!((J.matrix() * qd - Vector6::from(TWIST) * confidence).amax() < 1e-9);
        }
        let qd = Vector6::new(0.1, 0.2, 0.0, -0.1, 0.0, 0.3);
        commanded.set(Some(CommandedMotion::Joints(qd)));
        assert_eq!(commanded.motion_command(&state, 1.0, &arm), MotionCommand::Joints(qd));
    }

    #[test]
    fn a_motion_is_trusted_while_measurements_come() {
        let (mut commanded, ..) = behaviour();
        let at = |exposure: i64| Measurement { exposure: MonoNs(exposure), ..Measurement::default() };
        commanded.note(&at(0));
        assert_eq!(commanded.confidence(MonoNs(10)), 0.0, "nothing is commanded yet");
        commanded.set(Some(CommandedMotion::Twist(TWIST.into())));
        assert_eq!(commanded.confidence(MonoNs(10)), 0.0, "commanded upon nothing that was seen");
        commanded.note(&at(10));
        assert_eq!(commanded.confidence(MonoNs(40)), 1.0);
        let old = commanded.confidence(MonoNs(85));
        assert!((old - 0.5).abs() < 1e-12, "{old}");
        assert_eq!(commanded.confidence(MonoNs(111)), 0.0);
        commanded.note(&at(100));
        commanded.set(None);
        assert_eq!(commanded.confidence(MonoNs(111)), 0.0, "no command");
    }
}
