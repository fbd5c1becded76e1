//! Joint control: from the reference to the command of the drive.
//!
//! | law | gives | closed loop, with `e = q_r - q` |
//! | --- | --- | --- |
//! | inverse dynamics | torque | `u = qdd_r + K_D e' + K_P e`: the arm behaves as double integrators, `e'' + 2 zeta omega e' + omega^2 e = 0` |
//! | the same in operational space | torque | of the flange's pose: `x~'' + 2 zeta omega x~' + omega^2 x~ = 0` (`operational_space.rs`) |
//! | PD with gravity compensation | torque | `u = qdd_r`, `f = K_P e + K_D e'` |
//! | pass-through | no torque | `q_r`, `qd_r` as they are, for drives that close their own loop |
//!
//! ```text
//! tau = B(q) (u - p) + C(q, qd) qd + g(q) + F(qd_r) + D rate e + f - t
//! ```
//! The friction `F` of the robot file is evaluated at the reference's velocity, which does not chatter about zero as
//! a measured one does. Its viscous part `D` is also compensated for the velocity `rate e` at which an error is to decay (for joints that stick, four times that,
//! with half of `D` as damping, and `F` by the sign of the error beside that of the reference's velocity; for the others, where the reference jitters, Coulomb friction is compensated for a tenth of `rate e`): a light wrist
//! with much friction is moved against its friction, not against its inertia. `B p + t` is the disturbance that
//! the [observer](super::joint_observer) estimates. The model is evaluated at the posture in the middle of the step.

mod damping;
mod laden;
mod law;
mod operational_space;
mod stall;
mod sticking;
mod torque;

pub use law::{InverseDynamicsControl, JointLaw, PdGravityControl};
pub use torque::JointTorque;

use super::ReferenceState;
use super::joint_observer::{Commanded, JointObserver, ObserverSettings};
use super::payload_estimator::{JointTick, PayloadEstimator, WINDOW};
use super::rotor_estimator::RotorEstimator;
use crate::robot::Robot;
use crate::servo::UnobservedMotion;
use crate::time::{MonoNs, TICK};
use law::Feedback;
use nalgebra::SVector;
use stall::StallGuard;
use torque::{acceleration, cut};

/// Rate at which the velocity for which a torque law's friction is compensated follows the measured one, 1/s.
const FOLLOWS_1_S: f64 = 10.0;

/// Share of its natural frequency that a softened controller keeps, after a fault. Chosen by hand: the stiffness falls to 4 %, because it
/// goes with the square, and the damping to 20 %, so that an arm that a stiff controller made oscillate can come to rest.
const SOFT_SHARE: f64 = 0.2;

/// Ticks of control in which joints whose torque is bounded, because they do not move, still tell of a payload. Chosen by hand: an xArm7 that begins with
/// its rated payload, which is not known, gives way within 20, and the payload is found within 80.
const START_TICKS: u32 = 100;

/// A joint controller.
#[derive(Debug, Clone)]
pub struct JointController<const N: usize> {
    law: JointLaw<N>,
    observer: JointObserver<N>,
    /// The velocity at the end of the step that a requested acceleration leads to, while accelerations are what is requested.
    requested_velocity: Option<SVector<f64, N>>,
    /// Whether the controller is softened, after a fault.
    soft: bool,
    /// Whether the controller only damps motion.
    damps: bool,
    /// Where each joint is braked by itself, rad or m, if it is.
    braked_at: Option<SVector<f64, N>>,
    /// The kinetic energy above which it is so again, J, since its model was tried once more in this fault; 0 where that is not to be.
    energy: Option<f64>,
    /// Bounds the torque on joints that do not move.
    stall: StallGuard<N>,
    /// Estimates what the arm carries beyond its model.
    payload: Option<Box<PayloadEstimator<N>>>,
    /// Estimates the inertia of rotors beyond its model.
    rotors: Option<Box<RotorEstimator<N>>>,
    /// Inertia of rotors that the model has more since this was asked last, kg m^2 or kg.
    rotor_change: Option<SVector<f64, N>>,
    /// The torque that acts until the next tick, N m or N.
    applied: Option<SVector<f64, N>>,
    /// The velocity of the reference that is followed in this tick, rad/s or m/s.
    followed: Option<SVector<f64, N>>,
    /// Whether the state of this tick came before.
    hears_old: bool,
    /// Ticks of control so far.
    ticks: u32,
    /// The acceleration limits of the reference, rad/s^2 or m/s^2, and the share of them for which the efforts of the arm suffice with its payload.
    acceleration: SVector<f64, N>,
    acceleration_share: f64,
    /// The same, less since the model's torque for the reference was more than the efforts.
    effort_share: f64,
    /// Share of velocities with which the arm may move on, less than 1 where it can hardly hold its payload.
    strength: f64,
    /// Whether the arm carries a payload, told or found, so that its efforts may not suffice for its accelerations.
    is_laden: bool,
    /// Whether it was found to carry more than it can hold.
    is_overloaded: bool,
    /// What gravity takes more in a model that has changed in this tick, N m or N.
    model_change: Option<SVector<f64, N>>,
}

impl<const N: usize> JointController<N> {
    /// A controller with a zero disturbance estimate.
    #[must_use]
    pub fn new(law: JointLaw<N>, observer: ObserverSettings<N>) -> Self {
        Self {
            law,
            observer: JointObserver::new(observer),
            requested_velocity: None,
            soft: false,
            damps: false,
            braked_at: None,
            energy: None,
            stall: StallGuard::default(),
            payload: None,
            rotors: None,
            rotor_change: None,
            applied: None,
            followed: None,
            hears_old: false,
            ticks: 0,
            acceleration: SVector::zeros(),
            acceleration_share: 1.0,
            effort_share: 1.0,
            strength: 1.0,
            is_laden: false,
            is_overloaded: false,
            model_change: None,
        }
    }

    /// Resets position and velocity to the measured ones; the disturbance estimate is kept.
    pub fn reset_to_measured(&mut self, q: &SVector<f64, N>, qd: &SVector<f64, N>) {
        self.observer.reset_to_measured(q, qd);
        self.requested_velocity = None;
        self.stall.forget();
    }

    /// Softens the controller and freezes the disturbance estimate, or ends that: what made an arm oscillate (a delay, a load, a
    /// wrong model) would keep a stiff controller oscillating.
    pub fn soften(&mut self, soft: bool) {
        if soft != self.soft {
            self.soft = soft;
            (self.damps, self.braked_at, self.energy) = (false, None, None);
            self.observer.settle(soft);
        }
    }

    /// Stops learning disturbances while something touches the arm, or goes on.
    pub fn pause_learning(&mut self, paused: bool) {
        if !self.soft {
            self.observer.pause(paused);
        }
    }

    /// Scales the rate of disturbance estimation by `share`: with a load that makes a joint much
    /// heavier than modelled, the estimate makes the joint oscillate.
    pub fn learn_at(&mut self, share: f64) {
        self.observer.learn_at(share);
    }

    /// While soft: goes on learning disturbances, or keeps them as they are.
    pub fn learn_in_fault(&mut self, learns: bool) {
        if self.soft {
            self.observer.pause(!learns);
        }
    }

    /// Estimated position and velocity of the joints at this tick; called once a tick, before the torque.
    pub fn observe(
        &mut self,
        robot: &Robot<N>,
        q: &SVector<f64, N>,
        qd: &SVector<f64, N>,
    ) -> (SVector<f64, N>, SVector<f64, N>) {
        if self.law == JointLaw::PassThrough {
            return (*q, *qd);
        }
        let robot = self.payload.as_deref().map_or(robot, PayloadEstimator::robot);
        let (q_measured, is_new) = (Some(q), !std::mem::take(&mut self.hears_old));
        let (q, qd) = self.observer.observe(robot, q, qd);
        if let (Some(payload), Some(rotors)) = (&mut self.payload, &mut self.rotors) {
            match self.applied.filter(|_| !self.soft && !self.is_overloaded) {
                Some(tau) => {
                    let scale = (self.observer.inertia(), self.observer.encoder_step());
                    let model = (payload.robot(), payload.derivatives());
                    if rotors.note(model, &tau, q_measured.filter(|_| is_new), scale) {
                        let first = rotors.believed().amax() == 0.0;
                        let change = rotors.adopt();
                        self.observer.change_rotors(&q, payload, &change, first);
                        self.is_laden = true;
                        *self.rotor_change.get_or_insert(SVector::zeros()) += change;
                    }
                }
                None if (self.soft || self.is_overloaded) && rotors.believed().amax() > 0.0 => {
                    // What made the arm thrash, or an overload that is not in the model, may have been taken for rotors.
                    let change = -rotors.forget(payload.robot(), self.observer.inertia());
                    self.observer.change_rotors(&q, payload, &change, false);
                    *self.rotor_change.get_or_insert(SVector::zeros()) += change;
                }
                None => rotors.skip(),
            }
        }
        if let Some(payload) = &mut self.payload {
            let motion = JointTick { q, qd, is_new, noise: self.observer.hidden_torque(WINDOW) };
            match self.applied.take() {
                Some(tau) if !self.soft => {
                    let is_found = payload.note(&tau, &motion);
                    if is_found {
                        self.is_overloaded = !payload.is_held_in(&q);
                    }
                    if is_found && !self.is_overloaded {
                        let before = payload.robot().gravity(&q);
                        let more = self.observer.change_model(&q, payload);
                        self.rotors.iter_mut().for_each(|rotors| rotors.payload_changed(&more));
                        self.model_change = Some(payload.robot().gravity(&q) - before);
                        self.is_laden = true;
                    }
                    if self.is_laden && payload.has_finished_window() {
                        (self.acceleration_share, self.strength) =
                            payload.shares_of_effort(&q, &self.acceleration);
                    }
                }
                _ => payload.skip(),
            }
        }
        (q, qd)
    }

    /// Lets the friction of an arm be probed that stands and is to move next, or not; whether that is still to be done, so that the arm is
    /// to stand.
    pub fn probe(&mut self, wanted: bool) -> bool {
        self.law != JointLaw::PassThrough && self.observer.probe(wanted)
    }

    /// Whether joints are about to be probed that were found to resist, so that the reference is to be set to the standing arm: true once.
    pub fn begins_anew(&mut self) -> bool {
        self.observer.begins_anew()
    }

    /// Corrects the velocities, at `now`, by the `drift` that a camera measured and coarse encoders do not resolve.
    pub fn learn(&mut self, drift: &UnobservedMotion<N>, now: MonoNs) {
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
        let mut feedback = self.law.feedback(&e, &ed, reference);
        if let (JointLaw::InverseDynamics(control), false) = (&self.law, self.soft) {
            let inertia = self.observer.sticking_inertia(self.carrying(robot), control.omega_rad_s);
            feedback.torque += sticking::torque(&inertia, control, (&e, &ed));
        }
        if let (JointLaw::OperationalSpace(control), false) = (&self.law, self.soft) {
            feedback.u = control.in_operational_space(robot, (q, qd), reference, &feedback.u);
        }
        if !self.soft && reference.qd.amax() == 0.0 && reference.qdd.amax() == 0.0 {
            let probe = self.observer.probe_velocity(&e);
            feedback.velocity += probe;
            feedback.slip.zip_apply(&probe, |slip, probe| *slip = if probe == 0.0 { *slip } else { 0.0 });
        }
        self.followed = Some(reference.qd);
        self.of_carrying(robot, |control, robot| control.compensated(robot, q, qd, &feedback))
    }

    /// The torque that gives the arm the acceleration `qdd` (rad/s^2 or m/s^2), with friction and disturbance compensated, cut
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
        // Without a reference nothing tells a joint that lags behind from one that is held: friction cannot be confirmed.
        self.observer.believe_friction();
        let h = TICK.as_s();
        // Friction that is compensated at the measured velocity drives an arm that has less friction than its model.
        let before = self.requested_velocity.unwrap_or(*qd);
        let after = before + (qdd + (qd - before) * FOLLOWS_1_S) * h;
        self.requested_velocity = Some(after);
        let zero = SVector::zeros();
        let feedback = Feedback { u: *qdd, expected: *qdd, torque: zero, velocity: after, slip: zero };
        self.of_carrying(robot, |control, robot| control.compensated(robot, q, qd, &feedback))
    }

    /// Takes note that `tau` acts until the next tick, N m or N, because the gate has changed what was asked for: what is missing is neither a disturbance nor a
    /// payload nor a rotor.
    pub fn note_given(&mut self, robot: &Robot<N>, q: &SVector<f64, N>, tau: &SVector<f64, N>) {
        let Some(asked) = self.applied.filter(|asked| asked != tau) else { return };
        self.applied = Some(*tau);
        let missing = acceleration(self.carrying(robot), q, &(tau - asked));
        if missing.iter().all(|missing| missing.is_finite()) {
            self.observer.add_to_command(&missing);
        }
    }

    /// The torque for an arm that is assumed to be on the reference, with the last estimate of its disturbance: for
    /// braking without a usable state.
    #[must_use]
    pub fn blind_torque(&self, robot: &Robot<N>, reference: &ReferenceState<N>) -> JointTorque<N> {
        if self.law == JointLaw::PassThrough {
            return JointTorque { tau: SVector::zeros(), saturated: 0, stalled: 0 };
        }
        let zero = SVector::zeros();
        let feedback = self.law.feedback(&zero, &zero, reference);
        let robot = self.carrying(robot);
        cut(robot, &self.torques(robot, &reference.q, &reference.qd, &feedback).wanted)
    }

    /// The estimated disturbance: its part as accelerations, rad/s^2 or m/s^2, and its part as torques, N m or N.
    #[must_use]
    pub fn disturbance(&self) -> (&SVector<f64, N>, &SVector<f64, N>) {
        self.observer.disturbance()
    }

    /// The torque of a feedback, limited, and noted as the command until the next tick.
    fn compensated(
        &mut self,
        robot: &Robot<N>,
        q: &SVector<f64, N>,
        qd: &SVector<f64, N>,
        feedback: &Feedback<N>,
    ) -> JointTorque<N> {
        let Torques { wanted, expected, friction } = self.torques(robot, q, qd, feedback);
        let exceeds = expected.iter().zip(robot.limits()).any(|(torque, limit)| torque.abs() > limit.effort);
        self.effort_share = laden::share_after(self.effort_share, exceeds);
        let (beyond, stalled) = self.stall.bound(
            robot,
            (q, qd),
            &feedback.velocity,
            self.observer.encoder_step(),
            &(wanted - expected),
        );
        let given = if stalled == 0 { wanted } else { expected + beyond };
        let compensated = friction.component_mul(&self.friction_share());
        let extra = sticking::extra_velocity(&self.observer.slip_share(), qd, feedback);
        let torque = self.commanded(robot, q, &wanted, &given, feedback, (friction, compensated, extra));
        // What holds a joint is no payload; but one that is not known holds joints when control begins, until they give way.
        self.ticks = self.ticks.saturating_add(1);
        if stalled != 0 && self.ticks > START_TICKS {
            self.applied = None;
        }
        JointTorque { stalled, ..torque }
    }

    /// Cuts the torque that is `given` of the one that is `wanted`, and notes what acts until the next tick, with the `friction` of the model,
    /// the part of it that was compensated, and the velocity beyond the requested one for which it was.
    fn commanded(
        &mut self,
        robot: &Robot<N>,
        q: &SVector<f64, N>,
        wanted: &SVector<f64, N>,
        given: &SVector<f64, N>,
        feedback: &Feedback<N>,
        (friction, compensated, extra): (SVector<f64, N>, SVector<f64, N>, SVector<f64, N>),
    ) -> JointTorque<N> {
        let torque = cut(robot, given);
        self.applied = Some(torque.tau);
        let mean = feedback.velocity - feedback.u * (0.5 * TICK.as_s());
        let smooth = self.smooth_slips(feedback);
        self.observer.command(Commanded {
            u: feedback.u + acceleration(robot, q, &(torque.tau - wanted)),
            w: mean + feedback.slip,
            w_coulomb: mean + SVector::from_fn(|i, _| smooth[i].unwrap_or(feedback.slip[i])),
            velocity: feedback.velocity,
            feedback: feedback.torque,
            friction,
            compensated,
            slip: feedback.slip,
            extra,
            reference: self.followed.take(),
        });
        torque
    }

    /// The share of the model's friction that is compensated: none, in a fault, of a joint that is not seen, whose friction may have been learnt while its encoder stood.
    fn friction_share(&self) -> SVector<f64, N> {
        let (share, unheard) = (self.observer.friction_share(), self.observer.unheard());
        SVector::from_fn(|i, _| if self.soft && unheard[i] { 0.0 } else { share[i] })
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
        let share = self.friction_share();
        let joints = self.observer.friction(robot);
        let model = SVector::<f64, N>::from_fn(|i, _| joints[i].torque(feedback.velocity[i]));
        let extra = sticking::extra_velocity(&self.observer.slip_share(), qd, feedback);
        let mut friction = model;
        let (coulomb, smooth) = (self.observer.coulomb_share(), self.smooth_slips(feedback));
        let steps = self.observer.encoder_step();
        for (i, joint) in joints.iter().enumerate() {
            let (velocity, slip) = (feedback.velocity[i], feedback.slip[i]);
            friction[i] += joint.viscous * (slip + extra[i]);
            friction[i] += match (coulomb[i], smooth[i]) {
                (Some(share), _) if !self.soft => {
                    share * sticking::towards_reference(joint, velocity, slip, steps[i])
                }
                (_, Some(slip)) => sticking::beyond_reference(joint, velocity, slip),
                _ => 0.0,
            };
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

/// Unlimited torques or forces of a tick, N m or N.
struct Torques<const N: usize> {
    /// The requested torque, before limits.
    wanted: SVector<f64, N>,
    /// The torque of the model for the reference, without error or disturbance.
    expected: SVector<f64, N>,
    /// The friction of the model, including that of the error's decay.
    friction: SVector<f64, N>,
}

#[cfg(test)]
mod tests;
