//! Damping of an arm that does not brake as it is commanded: by its model, and where that has failed by each joint alone.
//!
//! The damping `-c B qd` takes the same share of every motion, as long as every motor does what it is told. One that does nothing leaves its joint what `B` couples into it: of two joints
//! with nearly the same axis, which turn against each other, `B qd` is nearly zero, and neither is braked; and what is learnt as its disturbance drives the others.
//! So an arm that becomes faster than its limits meanwhile is damped by `-D qd` with a diagonal `D`: a working motor then takes energy out of the arm whatever the others do,
//! and only the weight that a dead one should carry brings some in.

use super::torque::{JointTorque, cut};
use super::{Feedback, JointController, SOFT_SHARE};
use crate::linalg::Ldlt;
use crate::motion::{ActingLimits, ReferenceState};
use crate::robot::Robot;
use crate::time::TICK;
use nalgebra::SVector;

/// Damping of each joint by the inertia that it has while the others are free, 1/s. Derived: the fastest decay of all motions is at most so many times the number of joints, 0.14 in a
/// tick of 1 ms, and 0.7 in a delay of 5 ms, which is stable.
const JOINTS_1_S: f64 = 20.0;

impl<const N: usize> JointController<N> {
    /// While soft: compensates gravity and damps motion, whatever the reference, or ends that. Inertia in
    /// motion and friction of the model are left out, because a wrong model could drive the arm.
    pub fn damp(&mut self, damps: bool) {
        self.damps = (damps || self.by_joint) && self.soft;
    }

    /// While soft: damps each joint by itself, until the fault is over.
    pub fn damp_by_joint(&mut self) {
        self.by_joint = self.soft;
        self.damp(true);
    }

    /// Whether motion is damped, whatever the reference.
    #[must_use]
    pub fn damps(&self) -> bool {
        self.damps
    }

    /// Gravity, the estimated disturbance, and `-c B qd` or the damping of the PD law; or gravity and `-D qd`.
    pub(super) fn damped(
        &mut self,
        robot: &Robot<N>,
        q: &SVector<f64, N>,
        qd: &SVector<f64, N>,
    ) -> JointTorque<N> {
        let zero = SVector::zeros();
        let carried = self.carrying(robot).gravity(q);
        if self.by_joint {
            let factors = Ldlt::of(&robot.mass_matrix(q));
            let inverse = factors.map(|factors| factors.inverse());
            let inertia = |i: usize| inverse.as_ref().map_or(0.0, |inverse| inverse[i][i].recip());
            let torque = cut(robot, &SVector::from_fn(|i, _| carried[i] - JOINTS_1_S * inertia(i) * qd[i]));
            self.applied = Some(torque.tau);
            return torque;
        }
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
