//! From the reference to what a drive obeys.
//!
//! | law | gives | closed loop, with `e = q_r - q` |
//! | --- | --- | --- |
//! | inverse dynamics | torque | `u = qdd_r + K_D e' + K_P e`: the arm behaves as double integrators, `e'' + 2 zeta omega e' + omega^2 e = 0` |
//! | PD with gravity compensation | torque | `u = qdd_r`, `f = K_P e + K_D e'` |
//! | pass-through | no torque | `q_r`, `qd_r` as they are, for drives that close their own loop |
//!
//! ```text
//! tau = B(q) (u - p) + C(q, qd) qd + g(q) + F(qd_r) + D rate e + f - t
//! ```
//! The friction that the robot file states, `F`, is that of the reference's velocity, which does not chatter about zero as
//! a measured one does; its viscous part `D` also that of the velocity `rate e` at which an error shall go: a light wrist
//! with much friction has to be pushed through its friction, not through its inertia. `B p + t` is the disturbance that
//! the [observer](super::joint_observer) has learnt. The model is evaluated where the arm is in the middle of the step.

mod law;
mod stall;

pub use law::{InverseDynamicsControl, JointLaw, PdGravityControl};

use super::joint_observer::{Commanded, JointObserver, ObserverSettings};
use super::{ActingLimits, ReferenceState};
use crate::linalg::Ldlt;
use crate::robot::Robot;
use crate::servo::Drift;
use crate::time::{MonoNs, TICK};
use law::Feedback;
use nalgebra::SVector;
use stall::StallGuard;

/// Rate at which the velocity for which a torque law's friction is made up follows the measured one, 1/s.
const FOLLOWS_1_S: f64 = 10.0;

/// Share of its natural frequency that a soft controller has.
const SOFT_SHARE: f64 = 0.2;

/// A joint controller.
#[derive(Debug, Clone)]
pub struct JointController<const N: usize> {
    law: JointLaw<N>,
    observer: JointObserver<N>,
    /// The velocity at the end of the step that a requested acceleration leads to, while accelerations are what is requested.
    requested_velocity: Option<SVector<f64, N>>,
    /// Whether errors are worked off gently.
    soft: bool,
    /// Whether nothing is done but to take motion away.
    damps: bool,
    /// What a joint that does not move is pushed with.
    stall: StallGuard<N>,
}

/// Torques or forces, N m or N.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointTorque<const N: usize> {
    /// What to apply.
    pub tau: SVector<f64, N>,
    /// The joints whose effort limit cut it, as a mask.
    pub saturated: u8,
    /// The joints that do not move and are not pushed with all that was asked for, as a mask.
    pub stalled: u8,
}

impl<const N: usize> JointController<N> {
    /// A controller that knows of no disturbance yet.
    #[must_use]
    pub fn new(law: JointLaw<N>, observer: ObserverSettings<N>) -> Self {
        Self {
            law,
            observer: JointObserver::new(observer),
            requested_velocity: None,
            soft: false,
            damps: false,
            stall: StallGuard::default(),
        }
    }

    /// Begins anew on an arm that moves like this; what was learnt of its disturbance stays.
    pub fn reset_to_measured(&mut self, q: &SVector<f64, N>, qd: &SVector<f64, N>) {
        self.observer.reset_to_measured(q, qd);
        self.requested_velocity = None;
        self.stall.forget();
    }

    /// From now on errors are worked off gently, and no disturbance is learnt: what made an arm thrash (a delay, a load, a
    /// model that is another's) makes a stiff controller thrash on. Or no more so.
    pub fn soften(&mut self, soft: bool) {
        if soft != self.soft {
            self.soft = soft;
            self.damps = false;
            self.observer.settle(soft);
        }
    }

    /// From now on what disturbs the joints is learnt at `share` of the rate: what is learnt of a load that makes a joint much
    /// heavier than believed makes it swing.
    pub fn learn_at(&mut self, share: f64) {
        self.observer.learn_at(share);
    }

    /// While soft: from now on weight is carried and motion taken away, whatever the reference; what the model says of inertia in
    /// motion and of friction is left out, as it may drive an arm that is another's. Or no more so.
    pub fn damp(&mut self, damps: bool) {
        self.damps = damps && self.soft;
        if self.soft {
            self.observer.pause(!self.damps);
        }
    }

    /// Whether motion is taken away, whatever the reference.
    #[must_use]
    pub fn damps(&self) -> bool {
        self.damps
    }

    /// Position and velocity of the joints at this tick as far as the encoders tell, once a tick and before its torque.
    pub fn observe(
        &mut self,
        robot: &Robot<N>,
        q: &SVector<f64, N>,
        qd: &SVector<f64, N>,
    ) -> (SVector<f64, N>, SVector<f64, N>) {
        if self.law == JointLaw::PassThrough { (*q, *qd) } else { self.observer.observe(robot, q, qd) }
    }

    /// Learns from `drift`, at `now`, what coarse encoders do not tell.
    pub fn learn(&mut self, drift: &Drift<N>, now: MonoNs) {
        self.observer.learn(drift, now);
    }

    /// The torque that follows the reference, cut at the effort limits; zero from the pass-through. Of the reference, `q`
    /// and `qd` are those of the measured state's instant, `qdd` is the mean of the step that follows.
    pub fn torque(
        &mut self,
        robot: &Robot<N>,
        q: &SVector<f64, N>,
        qd: &SVector<f64, N>,
        reference: &ReferenceState<N>,
    ) -> JointTorque<N> {
        if self.law == JointLaw::PassThrough {
            return JointTorque { tau: SVector::zeros(), saturated: 0, stalled: 0 };
        }
        self.requested_velocity = None;
        if self.damps {
            return self.damped(robot, q, qd);
        }
        let share = if self.soft { SOFT_SHARE } else { 1.0 };
        let (e, ed) = ((reference.q - q) * (share * share), (reference.qd - qd) * share);
        let feedback = self.law.feedback(&e, &ed, reference);
        self.compensated(robot, q, qd, &feedback)
    }

    /// The torque that gives the arm the acceleration `qdd` (rad/s^2 or m/s^2), friction and disturbance made up for, cut
    /// at the effort limits; zero from the pass-through.
    pub fn torque_for(
        &mut self,
        robot: &Robot<N>,
        q: &SVector<f64, N>,
        qd: &SVector<f64, N>,
        qdd: &SVector<f64, N>,
    ) -> JointTorque<N> {
        if self.law == JointLaw::PassThrough {
            return JointTorque { tau: SVector::zeros(), saturated: 0, stalled: 0 };
        }
        let h = TICK.as_s();
        // Friction made up for at a measured velocity drives an arm that has less of it than believed.
        let before = self.requested_velocity.unwrap_or(*qd);
        let after = before + (qdd + (qd - before) * FOLLOWS_1_S) * h;
        self.requested_velocity = Some(after);
        let zero = SVector::zeros();
        let feedback = Feedback { u: *qdd, expected: *qdd, torque: zero, velocity: after, slip: zero };
        self.compensated(robot, q, qd, &feedback)
    }

    /// The torque for an arm that is thought to be on the reference, with the last estimate of its disturbance: for
    /// braking without a usable state.
    #[must_use]
    pub fn blind_torque(&self, robot: &Robot<N>, reference: &ReferenceState<N>) -> JointTorque<N> {
        if self.law == JointLaw::PassThrough {
            return JointTorque { tau: SVector::zeros(), saturated: 0, stalled: 0 };
        }
        let zero = SVector::zeros();
        let feedback = self.law.feedback(&zero, &zero, reference);
        cut(robot, &self.torques(robot, &reference.q, &reference.qd, &feedback).wanted)
    }

    /// What is thought to disturb the joints: as accelerations, rad/s^2 or m/s^2, and beside them as torques, N m or N.
    #[must_use]
    pub fn disturbance(&self) -> (&SVector<f64, N>, &SVector<f64, N>) {
        self.observer.disturbance()
    }

    /// The torque of a feedback, cut, and noted as what acts until the next tick.
    fn compensated(
        &mut self,
        robot: &Robot<N>,
        q: &SVector<f64, N>,
        qd: &SVector<f64, N>,
        feedback: &Feedback<N>,
    ) -> JointTorque<N> {
        let Torques { wanted, expected, friction } = self.torques(robot, q, qd, feedback);
        let (beyond, stalled) = self.stall.bound(
            robot,
            q,
            &feedback.velocity,
            self.observer.encoder_step(),
            &(wanted - expected),
        );
        let given = if stalled == 0 { wanted } else { expected + beyond };
        let torque = self.commanded(robot, q, &wanted, &given, feedback, friction);
        JointTorque { stalled, ..torque }
    }

    /// The weight of the arm, what is known to disturb it, and `-c B qd` or the damping of the PD law: whatever its inertia, the arm
    /// loses energy by it.
    fn damped(&mut self, robot: &Robot<N>, q: &SVector<f64, N>, qd: &SVector<f64, N>) -> JointTorque<N> {
        let zero = SVector::zeros();
        let (p, t) = self.observer.disturbance();
        let rest = ReferenceState { q: *q, qd: zero, qdd: zero, a: zero, limits: ActingLimits::default() };
        let feedback = self.law.feedback(&zero, &(-qd * SOFT_SHARE), &rest);
        let wanted = robot.inverse_dynamics(q, &zero, &(feedback.u - p)) + feedback.torque - t;
        let unheld = Feedback { velocity: feedback.u * (0.5 * TICK.as_s()), ..feedback };
        self.commanded(robot, q, &wanted, &wanted, &unheld, zero)
    }

    /// Cuts the torque that is `given` of the one that is `wanted`, and notes what acts until the next tick.
    fn commanded(
        &mut self,
        robot: &Robot<N>,
        q: &SVector<f64, N>,
        wanted: &SVector<f64, N>,
        given: &SVector<f64, N>,
        feedback: &Feedback<N>,
        friction: SVector<f64, N>,
    ) -> JointTorque<N> {
        let torque = cut(robot, given);
        let missing = if torque.tau == *wanted {
            SVector::zeros()
        } else {
            let B = robot.mass_matrix(q);
            Ldlt::of(&B)
                .map_or(SVector::zeros(), |factors| factors.solve(&(torque.tau - wanted).into()).into())
        };
        self.observer.command(Commanded {
            u: feedback.u + missing,
            w: feedback.velocity + feedback.slip - feedback.u * (0.5 * TICK.as_s()),
            velocity: feedback.velocity,
            feedback: feedback.torque,
            friction,
        });
        torque
    }

    /// What a feedback asks for, and what the model expects of it, for the posture in the middle of the step.
    fn torques(
        &self,
        robot: &Robot<N>,
        q: &SVector<f64, N>,
        qd: &SVector<f64, N>,
        feedback: &Feedback<N>,
    ) -> Torques<N> {
        let half = 0.5 * TICK.as_s();
        let (p, t) = self.observer.disturbance();
        let qd_mid = qd + feedback.u * half;
        let q_mid = q + (qd + qd_mid) * (0.5 * half);
        let share = self.observer.friction_share().add_scalar(1.0);
        let model = robot.friction_torque(&feedback.velocity);
        let mut friction = model;
        for (i, joint) in robot.friction().iter().enumerate() {
            friction[i] += joint.viscous * feedback.slip[i];
        }
        let accelerations = [&(feedback.u - p), &self.stall.expected(&feedback.expected)];
        let [wanted, expected] = robot.inverse_dynamics_of(&q_mid, &qd_mid, accelerations);
        Torques {
            wanted: wanted + friction.component_mul(&share) + feedback.torque - t,
            expected: expected + model.component_mul(&share),
            friction,
        }
    }
}

/// Torques or forces of a tick, N m or N.
struct Torques<const N: usize> {
    /// What is asked for, whatever it is limited to.
    wanted: SVector<f64, N>,
    /// What the model expects the reference to take, without any error or disturbance.
    expected: SVector<f64, N>,
    /// The friction that the model expects, that of the errors' way included.
    friction: SVector<f64, N>,
}

/// Cuts torques at the effort limits.
fn cut<const N: usize>(robot: &Robot<N>, wanted: &SVector<f64, N>) -> JointTorque<N> {
    let (mut tau, mut saturated) = (*wanted, 0);
    for (i, (tau, limit)) in tau.iter_mut().zip(robot.limits()).enumerate() {
        let within = tau.clamp(-limit.effort, limit.effort);
        if within != *tau {
            saturated |= 1 << i;
        }
        *tau = within;
    }
    JointTorque { tau, saturated, stalled: 0 }
}

#[cfg(test)]
mod tests;
