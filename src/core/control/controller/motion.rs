//! From a motion command to a reference within the limits, and to the torque that follows it.

use super::Controller;
use super::torque_law::{settled_velocity, stilled};
use crate::control::behaviour::{ArmModel, MotionCommand};
use crate::control::lifecycle::State;
use crate::drive::{CommandMode, DriveState};
use crate::motion::{ActingLimits, Limit, ReferenceState, brakeable, damp_singularity};
use crate::servo::Convergence;
use crate::time::{SpanNs, TICK};
use nalgebra::SVector;

/// Rate at which an arm under a torque law is braked without a trusted view, 1/s. Chosen by hand: its speed falls to 5 % in 0.4 s. The
/// deceleration is this rate times the speed: 10 rad/s^2 is needed from 1.25 rad/s on, and with twice the rate from 0.6 rad/s on.
const BRAKE_1_S: f64 = 8.0;
/// Speed at which a joint has its whole Coulomb friction, and below which it may be held, rad/s or m/s. Chosen by hand; it must lie above the width over which the
/// friction model changes its sign, 1e-3 (`robot/model.rs`).
const MOVES: f64 = 0.05;
/// The share of what was learnt of a load that may still be wrong while it is learnt. Chosen by hand: without it untold loads of 1 to 1.5 kg on scara-c ended as a joint that does not follow, with it
/// none of 0.5 to 3 kg does; what holds a joint that is jammed is learnt too, and four fifths of the push on it count.
const LOAD_DOUBT: f64 = 0.2;
/// Rate at which a torque law is taken to converge that does not say it, 1/s. Chosen by hand: the gain of the shipped velocity laws.
const UNKNOWN_RATE_1_S: f64 = 15.0;
/// Rate at which a reference goes back to an arm that has not followed it, after a fault in position mode, 1/s. Chosen by hand: the
/// difference falls to 5 % in 0.6 s, within the limits of the reference.
const BACK_1_S: f64 = 5.0;

/// The motion of the joints in one tick, within the limits.
pub(super) struct TickMotion<const N: usize> {
    /// The reference at the time of the state, and its acceleration from there on.
    pub(super) now: ReferenceState<N>,
    /// Limits that acted.
    pub(super) limits: ActingLimits,
    /// Whether the joint controller follows a reference; otherwise the motion is the acceleration of a law that outputs torques.
    pub(super) follows: bool,
    /// Displacement that each joint should make in this tick, rad or m.
    pub(super) way: SVector<f64, N>,
}

impl<const N: usize> Controller<N> {
    /// The state of an arm that is on its reference.
    pub(super) fn believed(&self) -> DriveState<N> {
        let r = self.reference.state();
        DriveState { q: r.q, qd: r.qd, truth: None }
    }

    /// The reference of this tick, and on to that of the next one.
    pub(super) fn motion(
        &mut self,
        state: &DriveState<N>,
        motion_command: &MotionCommand<N>,
        confidence: f64,
    ) -> TickMotion<N> {
        let mut limits = ActingLimits::default();
        let settled = self.settled(state, motion_command);
        let motion_command = settled.as_ref().unwrap_or(motion_command);
        let moves = matches!(motion_command, MotionCommand::Joints(_) | MotionCommand::Velocity(..));
        let probes = self.joint_control.probe(moves) && self.mode == CommandMode::Torque;
        self.probes = probes;
        let requested_qd = match motion_command {
            MotionCommand::Torque(tau, ..) => return self.pushed(state, tau, confidence),
            MotionCommand::Stand | MotionCommand::Look(_)
                if self.mode == CommandMode::Position && self.fault.is_some() =>
            {
                (state.q - self.reference.state().q) * BACK_1_S
            }
            MotionCommand::Stand | MotionCommand::Look(_) => SVector::zeros(),
            // Friction is confirmed before the arm moves for the first time.
            _ if probes => SVector::zeros(),
            MotionCommand::Joints(qd) => *qd,
            MotionCommand::Velocity(qd, convergence) => {
                let (qd, acting) = self.held_back(&state.q, qd, convergence, confidence);
                limits = acting;
                qd
            }
        };
        if self.mode == CommandMode::Velocity {
            // The drive obeys velocities alone: positions that are integrated from them would drift away from the arm.
            self.reference.relocate(&state.q);
            self.gate.relocate(&state.q);
        }
        if probes && self.reference.rests_within(SpanNs(2 * TICK.0)) {
            // A reference that has braked rests but for the last digits; joints are probed at one that rests wholly.
            let r = *self.reference.state();
            let q = if self.joint_control.begins_anew() { state.q } else { r.q };
            if q != r.q || r.qd.amax() > 0.0 {
                self.reference.reset_to_measured(&q, &SVector::zeros());
            }
        }
        self.reference.set_speed_share(self.speed_share);
        self.reference.set_acceleration_share(self.joint_control.acceleration_share());
        let before = *self.reference.state();
        let after = self.reference.advance(&requested_qd, TICK);
        let now = ReferenceState { q: before.q, qd: before.qd, ..*after };
        let way = now.qd * TICK.as_s();
        // Limits in space come behind the joints': a command that they slow down is no quicker than the joints can, whatever it was before.
        if after.limits.joints(Limit::Workspace) != 0 {
            limits = limits.without(Limit::Velocity);
        }
        TickMotion { now, limits: limits.with(&after.limits), follows: true, way }
    }

    /// What a law of torques whose damping is too quick to be followed tick by tick comes to: a velocity on the way to its goal.
    fn settled(&self, state: &DriveState<N>, motion_command: &MotionCommand<N>) -> Option<MotionCommand<N>> {
        let MotionCommand::Torque(tau, damping, convergence) = motion_command else { return None };
        let qd = settled_velocity(&self.arm, (&state.q, &state.qd), tau, damping)?;
        let rate_1_s = if convergence.rate_1_s > 0.0 { convergence.rate_1_s } else { UNKNOWN_RATE_1_S };
        Some(MotionCommand::Velocity(qd, Convergence::at(rate_1_s)))
    }

    /// For a law that outputs torques: the reference starts at the measured arm and moves with the acceleration that the torques cause.
    fn pushed(&mut self, state: &DriveState<N>, tau: &SVector<f64, N>, confidence: f64) -> TickMotion<N> {
        let robot = &self.arm.robot;
        let within = SVector::from_fn(|i, _| {
            let effort = robot.limits().get(i).map_or(0.0, |limit| limit.effort);
            tau[i].clamp(-effort, effort)
        });
        // Friction is compensated separately, because the torque laws assume a model without friction.
        let (_, J_C) = self.servo.settings().mount.camera(robot, &state.q);
        let stilled = stilled(&state.qd, &J_C);
        let qdd = robot.forward_dynamics(&state.q, &state.qd, &within) + stilled;
        let trusted = qdd * confidence - state.qd * (BRAKE_1_S * (1.0 - confidence));
        self.reference.track_measured(&state.q, &state.qd);
        let after = *self.reference.accelerate(&trusted, TICK);
        let mut limits = after.limits;
        if confidence < 1.0 {
            (0..N).for_each(|i| limits.set(Limit::View, i));
        }
        for i in (0..N).filter(|i| within[*i] != tau[*i]) {
            limits.set(Limit::Effort, i);
        }
        // A joint at rest is expected to move only when it is pushed with more than twice its friction, and than what its load is not known by.
        let stiction = robot.friction_torque(&qdd.map(|a| MOVES * a.signum())) * 2.0;
        let unknown =
            self.learnt_torque(&state.q).zip_map(&qdd, |learnt, a| (LOAD_DOUBT * learnt).abs() * a.signum());
        let loose = within - stiction - unknown;
        let loose = robot.forward_dynamics(&state.q, &state.qd, &loose) + stilled;
        // Nor farther than the limits let it: they act joint by joint, and may hold one back that its torque would drive away. Of a joint that moves it is
        // seen that nothing holds it, also where it is braked and turns back.
        let pushed = SVector::from_fn(|i, _| {
            let agree = loose[i] * qdd[i] > 0.0 && after.qdd[i] * qdd[i] > 0.0;
            let stands = state.qd[i].abs() < MOVES;
            if agree && stands { loose[i].abs().min(after.qdd[i].abs()) * loose[i].signum() } else { 0.0 }
        });
        let way = self.pushes.way(&pushed);
        TickMotion { now: ReferenceState { q: state.q, qd: state.qd, ..after }, limits, follows: false, way }
    }

    /// What the joints take beyond the model of the arm as it is told, as it was learnt by now, N m or N: the load that is carried, and what disturbs them.
    fn learnt_torque(&self, q: &SVector<f64, N>) -> SVector<f64, N> {
        let (acceleration, torque) = self.joint_control.disturbance();
        let robot = &self.arm.robot;
        let load = self.joint_control.carrying(robot).gravity(q) - robot.gravity(q);
        load - torque - acceleration.component_mul(self.joint_control.inertia())
    }

    /// The motion command, slowed down so that the arm can brake before the goal, while the view is old or uncertain, in the first motion, and
    /// near singular postures and ends of ranges.
    fn held_back(
        &mut self,
        q: &SVector<f64, N>,
        requested_qd: &SVector<f64, N>,
        convergence: &Convergence<N>,
        confidence: f64,
    ) -> (SVector<f64, N>, ActingLimits) {
        let ArmModel { robot, limits } = &self.arm;
        let strength = self.joint_control.strength();
        let (mut requested_qd, mut acting) = brakeable(
            requested_qd,
            convergence,
            self.reference.state(),
            limits,
            self.joint_control.acceleration_share(),
        );
        if strength < 1.0 {
            requested_qd *= strength;
            (0..N).for_each(|i| acting.set(Limit::Effort, i));
        }
        let (X_WC, J_C) = self.servo.settings().mount.camera(robot, q);
        let first = match self.state {
            State::Servoing => self.first_motion_share(q, &requested_qd, (&X_WC, &J_C)),
            _ => 1.0,
        };
        let trusted = confidence * first;
        if trusted < 1.0 {
            requested_qd *= trusted;
            (0..N).for_each(|i| acting.set(Limit::View, i));
        }
        // A way back is one of all joints, also of those that the camera does not feel.
        let of_joints = self.state == State::Returning && !self.returning.is_searching();
        let free = if of_joints { requested_qd } else { convergence.null_space };
        let (requested_qd, damping) =
            damp_singularity(&self.arm.robot, q, J_C.matrix(), &requested_qd, &free);
        (requested_qd, acting.with(&damping))
    }

    /// The torque for the time until the next tick, N m or N.
    pub(super) fn torque(
        &mut self,
        state: &DriveState<N>,
        motion: &TickMotion<N>,
        seen: bool,
        limits: &mut ActingLimits,
    ) -> SVector<f64, N> {
        let robot = &self.arm.robot;
        let torque = match (seen, motion.follows) {
            (false, _) => self.joint_control.blind_torque(robot, &motion.now),
            (true, true) => self.joint_control.torque(robot, &state.q, &state.qd, &motion.now),
            (true, false) => self.joint_control.torque_for(robot, &state.q, &state.qd, &motion.now.qdd),
        };
        limits.add(Limit::Effort, torque.saturated);
        limits.add(Limit::Stall, torque.stalled);
        torque.tau
    }
}
