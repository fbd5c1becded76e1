//! Damping of an arm that does not brake as it is commanded: by its model, and where that has failed by each joint alone.
//!
//! The damping `-c B qd` takes the same share of every motion, as long as every motor does what it is told. One that does nothing leaves its joint what `B` couples into it: of two joints
//! with nearly the same axis, which turn against each other, `B qd` is nearly zero, and neither is braked; and what is learnt as its disturbance drives the others.
//! So an arm that becomes faster than its limits meanwhile is braked by each motor alone, as by a brake with a little give: `-D qd - K (q - a)` with diagonal `D` and `K`, where `a` is where
//! the joint was, and is dragged along where that would be more than the effort. Damper, spring and drag take energy out of the arm whatever the other motors do,
//! and only the weight that a dead one should carry brings some in; what an unknown load weighs is held. A joint whose encoder says nothing is carried as it
//! was then, and gets nothing besides: damper and spring about what is believed of it would drive it.
//!
//! Springs and dampers that are stable for the lightest motion are weak for the heaviest: a Panda whose first and third axes nearly coincide swings as a whole for seconds about `a`. So an arm that was made too
//! fast by a push is braked by its model again as soon as nothing pushes it: `-c B qd` lets every motion decay at the same rate `c`, 16 1/s by default, which is stable with late commands too.
//! Where no contact was told, as where a push made it too fast at once, that is tried a single time, when it has slowed down and should rest: what brakes an arm lets its kinetic energy fall, and where that
//! rises, a motor is dead or the model wrong, and each joint is braked by itself again.

use super::torque::JointTorque;
use super::{Feedback, JointController, SOFT_SHARE};
use crate::linalg::Ldlt;
use crate::motion::{ActingLimits, ReferenceState};
use crate::robot::Robot;
use crate::time::TICK;
use nalgebra::SVector;

/// Rate of the springs, 1/s, by the inertia that a joint has while the others are free: `K = rate^2 I`. Chosen by hand: 40 N m of weight that no model tells turn a shoulder of 1 kg m^2 by 0.4 rad.
const SPRING_1_S: f64 = 10.0;
/// That of the dampers: `D = 2 rate I`, without overshoot. Derived: the fastest decay of all motions is at most so many times the number of joints, 0.14 in a tick of 1 ms, and 0.7 in a delay
/// of 5 ms, which is stable.
const DAMPER_1_S: f64 = 2.0 * SPRING_1_S;

/// Share of the kinetic energy with which an arm begins to be braked by its model once more, from which on that has failed. Chosen by hand: velocities that are off by a twentieth make as much.
const MORE_ENERGY: f64 = 1.1;

impl<const N: usize> JointController<N> {
    /// While soft: compensates gravity and damps motion, whatever the reference, or ends that. Inertia in
    /// motion and friction of the model are left out, because a wrong model could drive the arm.
    pub fn damp(&mut self, damps: bool) {
        self.damps = (damps || self.braked_at.is_some()) && self.soft;
    }

    /// While soft: brakes each joint by itself, about where it is, `q`, until the fault is over.
    pub fn brake_by_joint(&mut self, q: &SVector<f64, N>) {
        if self.soft && self.braked_at.is_none() {
            (self.braked_at, self.damps) = (Some(*q), true);
        }
    }

    /// The same where its model has braked it so far, which has had its time and is not tried again; nothing where it is tried once more already.
    pub fn brake_by_joint_for_good(&mut self, q: &SVector<f64, N>) {
        if self.energy.is_none() {
            self.brake_by_joint(q);
            self.energy = Some(0.0);
        }
    }

    /// Brakes by the model again, unless that was tried in this fault, and as long as the arm at `q` with the velocities `qd` gets no more kinetic energy by it.
    pub fn brake_by_model_once(&mut self, robot: &Robot<N>, q: &SVector<f64, N>, qd: &SVector<f64, N>) {
        if self.braked_at.is_some() && self.energy.is_none() {
            self.energy = Some(MORE_ENERGY * kinetic_energy(robot, q, qd));
            self.braked_at = None;
        }
    }

    /// Whether each joint is braked by itself.
    #[must_use]
    pub fn brakes_by_joint(&self) -> bool {
        self.braked_at.is_some()
    }

    /// Brakes by the model again: what made the joints move otherwise acts no more.
    pub fn brake_by_model(&mut self) {
        (self.braked_at, self.energy) = (None, None);
    }

    /// Whether motion is damped, whatever the reference.
    #[must_use]
    pub fn damps(&self) -> bool {
        self.damps
    }

    /// Gravity, the estimated disturbance, and `-c B qd` or the damping of the PD law; or gravity and `-D qd - K (q - a)`.
    pub(super) fn damped(
        &mut self,
        robot: &Robot<N>,
        q: &SVector<f64, N>,
        qd: &SVector<f64, N>,
    ) -> JointTorque<N> {
        let zero = SVector::zeros();
        if self.energy.is_some_and(|most| kinetic_energy(robot, q, qd) > most) {
            self.brake_by_joint(q);
        }
        let unheard = self.observer.unheard();
        if let Some(anchor) = self.braked_at {
            // What is believed of a joint whose encoder says nothing drifts off: it is taken for where it was.
            let q = &SVector::from_fn(|i, _| if unheard[i] { anchor[i] } else { q[i] });
            let carried = self.carrying(robot).gravity(q);
            let mut anchor = anchor;
            let factors = Ldlt::of(&robot.mass_matrix(q));
            let inverse = factors.map(|factors| factors.inverse());
            let wanted = SVector::from_fn(|i, _| {
                if unheard[i] {
                    return carried[i];
                }
                let inertia = inverse.as_ref().map_or(0.0, |inverse| inverse[i][i].recip());
                let effort = robot.limits().get(i).map_or(0.0, |limit| limit.effort);
                let stiffness = SPRING_1_S * SPRING_1_S * inertia;
                let spring = (stiffness * (q[i] - anchor[i])).max(-effort).min(effort);
                anchor[i] = if stiffness > 0.0 { q[i] - spring / stiffness } else { q[i] };
                carried[i] - DAMPER_1_S * inertia * qd[i] - spring
            });
            self.braked_at = Some(anchor);
            // What it does to the arm beyond carrying it, the observer has to know.
            let none = Feedback { u: zero, expected: zero, torque: zero, velocity: zero, slip: zero };
            return self.commanded(robot, q, &carried, &wanted, &none, (zero, zero, zero));
        }
        let carried = self.carrying(robot).gravity(q);
        let (p, t) = self.observer.disturbance();
        let rest = ReferenceState { q: *q, qd: zero, qdd: zero, a: zero, limits: ActingLimits::default() };
        let feedback = self.law.feedback(&zero, &(-qd * SOFT_SHARE), &rest);
        // The payload counts by its weight alone: motion is damped for the arm's own inertia, which is certain.
        let payload = carried - robot.gravity(q);
        let wanted = robot.inverse_dynamics(q, &zero, &(feedback.u - p)) + feedback.torque + payload - t;
        let unheld = Feedback { velocity: feedback.u * (0.5 * TICK.as_s()), ..feedback };
        self.commanded(robot, q, &wanted, &wanted, &unheld, (zero, zero, zero))
    }
}

/// That of an arm at `q` with the velocities `qd`, J.
fn kinetic_energy<const N: usize>(robot: &Robot<N>, q: &SVector<f64, N>, qd: &SVector<f64, N>) -> f64 {
    0.5 * qd.dot(&(robot.mass_matrix(q) * qd))
}
