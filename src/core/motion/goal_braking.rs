//! Motion commands that the arm can still brake from: what makes high gains usable under limits on acceleration and jerk.
//!
//! A law of gain lambda asks for the velocity `v = lambda d` at the distance `d` from its goal. Far from the goal the arm cannot brake
//! from that velocity in time and would overshoot. Therefore the motion command is limited to the speed from which braking over the distance
//! `d` ends at rest. Near the goal the law itself asks for less than that, and the command passes unchanged.

use super::braking::{Bounds, JointMotionState, braking_speed};
use super::limits::{ActingLimits, Limit};
use super::motion_limits::MotionLimits;
use super::reference::ReferenceState;
use crate::servo::Convergence;
use nalgebra::SVector;

/// Scales `requested_qd` (rad/s or m/s) down to what an arm whose reference is in `state` can brake from before the goal. All joints are
/// scaled by the same factor, so that the direction of the motion is kept. Of the acceleration limits the share `acceleration_share` is
/// used. Also returns the limits that acted.
#[must_use]
pub fn brakeable<const N: usize>(
    requested_qd: &SVector<f64, N>,
    convergence: &Convergence<N>,
    state: &ReferenceState<N>,
    limits: &MotionLimits<N>,
    acceleration_share: f64,
) -> (SVector<f64, N>, ActingLimits) {
    let mut acting = ActingLimits::default();
    let kept = convergence.feed_forward + convergence.null_space;
    let towards = requested_qd - kept;
    let (mut factor, mut slowest) = (1.0_f64, None);
    for i in 0..N {
        let speed = towards[i].abs();
        let now = JointMotionState {
            q: (speed / convergence.rate_1_s).max(convergence.remaining[i] * towards[i].signum()),
            v: (state.qd[i] - kept[i]) * towards[i].signum(),
            a: state.qdd[i] * towards[i].signum(),
        };
        let bounds = limits.bounds(i);
        let acceleration = bounds.acceleration * acceleration_share;
        let largest = braking_speed(now, &Bounds { acceleration, ..bounds });
        if speed * factor > largest {
            (factor, slowest) = (largest / speed, Some(i));
        }
    }
    if let Some(joint) = slowest {
        acting.set(Limit::Acceleration, joint);
    }
    (kept + towards * factor, acting)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::Reference;
    use crate::time::SpanNs;
    use nalgebra::{Vector1, Vector2};
    use proptest::prelude::*;

    fn limits<const N: usize>(acceleration: f64, jerk: f64) -> MotionLimits<N> {
        MotionLimits {
            lower: SVector::repeat(-10.0),
            upper: SVector::repeat(10.0),
            velocity: SVector::repeat(3.0),
            acceleration: SVector::repeat(acceleration),
            jerk: SVector::repeat(jerk),
        }
    }

    proptest! {
        /// A law of any gain brings the reference to its goal without running past it.
        #[test]
        fn the_goal_is_reached_and_not_passed(
            rate_1_s in 0.5..60.0f64, distance in -3.0..3.0f64, acceleration in 2.0..20.0f64, jerk in 100.0..2000.0f64
        ) {
            let limits = limits::<1>(acceleration, jerk);
            let mut r = Reference::new(limits.clone(), Vector1::new(-distance));
            // Braking from 3 rad takes less than 3 s; `exp(-12)` of them is less than what counts as there.
            let longest = ((3.0 + 12.0 / rate_1_s) * 1e3) as u32;
            let (mut farthest, mut tick) = (0.0_f64, 0);
            while tick < longest && !(r.state().q[0].abs() < 1e-4 && r.state().qd[0].abs() < 1e-4) {
                let requested_qd = Vector1::new(-rate_1_s * r.state().q[0]);
                let (cut, _) = brakeable(&requested_qd, &Convergence::at(rate_1_s), r.state(), &limits, 1.0);
                r.advance(&cut, SpanNs::MILLISECOND);
                farthest = farthest.max(r.state().q[0] * distance.signum());
                tick += 1;
            }
            prop_assert!(tick < longest, "never there: {:?}", r.state());
            prop_assert!(farthest < 0.02 * distance.abs() + 2e-3, "passed by {farthest}");
        }

        #[test]
        fn the_cut_request_keeps_its_direction_and_is_never_longer(
            v in prop::array::uniform2(-5.0..5.0f64), follow in prop::array::uniform2(-1.0..1.0f64), rate_1_s in 0.1..200.0f64
        ) {
            let (v, follow) = (Vector2::from(v), Vector2::from(follow));
            let limits = limits::<2>(10.0, 500.0);
            let r = Reference::new(limits.clone(), Vector2::zeros());
            let (cut, acting) = brakeable(&v, &Convergence { feed_forward: follow, ..Convergence::at(rate_1_s) }, r.state(), &limits, 1.0);
            let (before, after) = (v - follow, cut - follow);
            prop_assert!(after.norm() <= before.norm() * (1.0 + 1e-12));
            prop_assert!((after.normalize() - before.normalize()).norm() < 1e-9);
            prop_assert_eq!(acting == ActingLimits::default(), after.norm() >= before.norm() * (1.0 - 1e-12));
        }
    }

    /// A motion command that was slowed down for another reason is not taken for one that is nearly there.
    #[test]
    fn slowing_a_motion_down_keeps_its_distance_to_the_goal() {
        let limits = limits::<2>(10.0, 500.0);
        let r = Reference::new(limits.clone(), Vector2::zeros());
        let slowed = Vector2::new(0.5, -0.25);
        let convergence = Convergence { remaining: Vector2::new(0.4, -0.2), ..Convergence::at(100.0) };
        assert_eq!(brakeable(&slowed, &convergence, r.state(), &limits, 1.0).0, slowed);
        assert!(
            brakeable(&slowed, &Convergence::at(100.0), r.state(), &limits, 1.0).0.norm()
                < 0.9 * slowed.norm()
        );
    }

    #[test]
    fn low_gains_are_left_alone() {
        let v = Vector2::new(2.0, -1.0);
        let limits = limits::<2>(10.0, 500.0);
        let r = Reference::new(limits.clone(), Vector2::zeros());
        let (cut, acting) = brakeable(&v, &Convergence::at(2.0), r.state(), &limits, 1.0);
        assert_eq!((cut, acting), (v, ActingLimits::default()));
    }
}
