//! Whether an arm that brakes from a state stays inside its limits in space.
//!
//! Every joint brakes as fast as it can (`braking`), in closed form. The arm is looked at on the way, as often as its path needs, and where it stands
//! in the end. Far from all limits that need not be done: no part moves farther than `sum_i |dq_i| reach_i`.

use super::parts::ArmPlaces;
use super::{Clearance, Workspace};
use crate::motion::braking::{JointMotionState, braked, braking_time_s, extent};
use crate::motion::motion_limits::MotionLimits;
use nalgebra::SVector;

/// How far a part moves at most between two looks at the braking arm, m. Derived: a part that goes round by 0.06 rad meanwhile, 1 m away from the axis, leaves its chord by `0.06^2 / 8` of
/// that, half a millimetre.
const LOOK_EVERY_M: f64 = 0.06;
/// Most looks. Derived: the longest brakings, of a SCARA with 5 rad/s in two joints, go 1.9 m, so that 0.08 m lie between two of them: 1 to 2 mm. Each takes a microsecond, near a limit and
/// at full speed alone, and a step that is held is tried seven times.
const MOST_LOOKS: f64 = 24.0;

impl<const N: usize> Workspace<N> {
    /// Rounding of distances, m. Chosen by hand: far above that of their sums, 1e-15, so that an arm at rest at a limit may stay there.
    pub(super) const ROUNDING: f64 = 1e-9;

    /// Whether no part of an arm that brakes from `next`, one tick after the reference of [`Self::bend`], leaves its limits; or goes farther beyond
    /// those that it is beyond already.
    pub(in crate::motion) fn can_stop(
        &self,
        next: &[JointMotionState; N],
        limits: &MotionLimits<N>,
        q_now: &SVector<f64, N>,
    ) -> bool {
        if self.now.is_empty() {
            return true;
        }
        let (mut way_m, mut braking_s) = (0.0, 0.0_f64);
        for (i, state) in next.iter().enumerate() {
            let bounds = limits.bounds(i);
            let (low, high) = extent(*state, &bounds);
            way_m += self.reach[i] * (high - q_now[i]).max(q_now[i] - low).max(0.0);
            braking_s = braking_s.max(braking_time_s(*state, &bounds));
        }
        if way_m < self.least + self.reserve_m() {
            return true;
        }
        let looks = (way_m / LOOK_EVERY_M).ceil().clamp(1.0, MOST_LOOKS) as u32;
        // Where it ends is what it mostly fails by. The step itself is looked at too: what has come too near would sink on with a motion along the limit, tick by tick.
        (0..=looks).rev().all(|look| {
            // Of a constant deceleration these are equal ways.
            let t_s = braking_s * (1.0 - (1.0 - f64::from(look) / f64::from(looks)).sqrt());
            let q = SVector::from_fn(|i, _| braked(next[i], &limits.bounds(i), t_s).q);
            self.is_inside(&q)
        })
    }

    /// How far the second stage lets the reference into the margin, m.
    fn reserve_m(&self) -> f64 {
        0.5 * self.settings.margin_m
    }

    fn is_inside(&self, q: &SVector<f64, N>) -> bool {
        let places = ArmPlaces::of(&self.robot, &self.settings, q);
        let floors = self.now.iter().enumerate();
        floors
            .into_iter()
            .all(|(k, now)| self.distance(k, &places) >= now.min(-self.reserve_m()) - Self::ROUNDING)
    }

    /// The part that is beyond a limit, if there is one: the margin is not counted.
    #[must_use]
    pub fn beyond(&self, q: &SVector<f64, N>) -> Option<Clearance> {
        self.nearest(q).filter(|nearest| nearest.room_m < 0.0)
    }
}
