//! One motion to a posture that a client asked for: the arm comes to rest, and then all joints move as between two waypoints ([`Waypoints`]).
//!
//! The motion command is the velocity of that path, and what brings the reference back to it where it was held back on the way:
//! `qd = way s'(u) / T + k (q(u) - q_r)`.
//!
//! [`Waypoints`]: super::Waypoints

use super::MotionCommand;
use super::waypoints::Leg;
use crate::motion::{MotionLimits, ReferenceState};
use nalgebra::SVector;

/// Rate k at which the reference comes back to the path, 1/s. Chosen by hand: what is left falls to 5 % in 0.3 s, and an error of 10 mrad asks for 0.1 rad/s.
const TRACKING_1_S: f64 = 10.0;
/// Distance of the reference from the posture at which the motion is complete, rad or m. Chosen by hand: below what usual arms repeat.
const ARRIVED: f64 = 1e-4;
/// Time after the end of the path at which the motion is complete wherever the reference is, s: a drive in velocity mode with coarse encoders may never be
/// nearer. Chosen by hand: three times what the rate k takes to 5 %.
const PATIENCE_S: f64 = 1.0;
/// Ticks at rest before an arm that stands leaves its posture. Chosen by hand: one in which the joint controller says whether it still probes friction, and one in which that is known.
pub(super) const RESTS: u32 = 2;

/// The motion to one posture.
#[derive(Debug, Default)]
pub struct PostureMotion<const N: usize> {
    goal: Option<SVector<f64, N>>,
    rested: u32,
    leg: Option<Leg<N>>,
}

impl<const N: usize> PostureMotion<N> {
    /// The next posture, rad or m. An arm that moves comes to rest first.
    pub fn begin(&mut self, q: &SVector<f64, N>) {
        *self = Self { goal: Some(*q), rested: 0, leg: None };
    }

    /// No posture is wanted any more.
    pub fn end(&mut self) {
        *self = Self::default();
    }

    /// Whether the posture was set, and no tick has moved towards it.
    #[must_use]
    pub fn is_new(&self) -> bool {
        self.goal.is_some() && self.leg.is_none() && self.rested == 0
    }

    /// The motion command of this tick for a reference that `rests` or not; `ready` says whether the arm may leave its rest, and `pace` which part of the last
    /// command was left by limits in space.
    pub fn motion_command(
        &mut self,
        reference: &ReferenceState<N>,
        (rests, ready): (bool, bool),
        pace: f64,
        limits: &MotionLimits<N>,
    ) -> MotionCommand<N> {
        let Some(goal) = self.goal else { return MotionCommand::Stand };
        if self.leg.is_none() {
            self.rested = if rests && ready { self.rested + 1 } else { 0 };
            if self.rested > RESTS {
                self.leg = Some(Leg::new(goal - reference.q, limits));
            }
        }
        let Some(leg) = &mut self.leg else { return MotionCommand::Joints(SVector::zeros()) };
        let behind = goal - leg.remaining() - reference.q;
        let along = leg.advance(pace).unwrap_or_else(SVector::zeros);
        MotionCommand::Joints(along + behind * TRACKING_1_S)
    }

    /// Whether the reference at `q_r`, rad or m, is there.
    #[must_use]
    pub fn is_over(&self, q_r: &SVector<f64, N>) -> bool {
        let Some((goal, leg)) = self.goal.zip(self.leg) else { return false };
        let s = leg.ended_for_s();
        s > PATIENCE_S || (s >= 0.0 && (goal - q_r).amax() <= ARRIVED)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Reference;
    use crate::time::{SpanNs, TICK};
    use nalgebra::Vector2;

    fn limits() -> MotionLimits<2> {
        MotionLimits {
            lower: Vector2::repeat(-3.0),
            upper: Vector2::repeat(3.0),
            velocity: Vector2::new(2.0, 3.0),
            acceleration: Vector2::repeat(10.0),
            jerk: Vector2::repeat(500.0),
        }
    }

    /// Postures are set at any moment, also while the arm moves: it ends in the last one.
    #[test]
    fn an_arm_ends_in_the_last_posture_whenever_it_was_set() {
        let mut reference = Reference::new(limits(), Vector2::new(0.2, -0.1));
        let mut motion = PostureMotion::default();
        let (mut turned, mut ticks) = (0, 0);
        for (at, q) in [(0, [1.0, -1.0]), (300, [-0.5, 0.7]), (350, [0.4, 0.4])] {
            while ticks < at {
                let rests = reference.rests_within(SpanNs(2 * TICK.0));
                let command = motion.motion_command(reference.state(), (rests, true), 1.0, &limits());
                let before = reference.state().qd;
                let after = *reference.advance(&command.velocity(), TICK);
                turned += usize::from(before.dot(&after.qd) < 0.0);
                ticks += 1;
            }
            motion.begin(&q.into());
        }
        while !motion.is_over(&reference.state().q) {
            let rests = reference.rests_within(SpanNs(2 * TICK.0));
            let command = motion.motion_command(reference.state(), (rests, true), 1.0, &limits());
            reference.advance(&command.velocity(), TICK);
            ticks += 1;
            assert!(ticks < 20_000, "{}", reference.state().q);
        }
        assert!((reference.state().q - Vector2::repeat(0.4)).amax() <= ARRIVED, "{}", reference.state().q);
        assert!(turned <= 2, "it turns round only on its way to another posture");
    }
}
