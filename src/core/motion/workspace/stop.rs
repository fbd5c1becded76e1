//! Whether an arm that brakes from a state stays inside its limits in space, and as slow as they ask for.
//!
//! Every joint brakes as fast as it can (`braking`), in closed form. The arm is looked at on the way, as often as its path needs, and where it stands
//! in the end. Far from all limits that need not be done: no part moves farther than `sum_i |dq_i| reach_i`, nor faster than `sum_i |qd_i| reach_i`. Joints that brake each by
//! themselves can make the camera faster for a while, where their motions cancelled each other: a step after which they would is not taken either.

use super::parts::ArmPlaces;
use super::{Clearance, Workspace};
use crate::motion::braking::{JointMotionState, braked, braking_time_s, extent, peak_speed};
use crate::motion::motion_limits::MotionLimits;
use nalgebra::SVector;

/// How far a part moves at most between two looks at the braking arm, m. Derived: a part that goes round by 0.06 rad meanwhile, 1 m away from the axis, leaves its chord by `0.06^2 / 8` of
/// that, half a millimetre.
const LOOK_EVERY_M: f64 = 0.06;
/// Most looks. Derived: the longest brakings, of a SCARA with 5 rad/s in two joints, go 1.9 m, so that 0.08 m lie between two of them: 1 to 2 mm. Each takes a microsecond, near a limit and
/// at full speed alone, and a step that is held is tried seven times.
const MOST_LOOKS: f64 = 24.0;
/// Looks at the speeds of a braking arm. Derived: they lie closer at the begin, where the joints turn their accelerations round: of a braking of 0.3 s at 1, 5, 10 and 19 ms; a joint with
/// 10 rad/s2 and 500 rad/s3 needs 40 ms for that.
const SPEED_LOOKS: u32 = 16;

impl<const N: usize> Workspace<N> {
    /// Rounding of distances, m. Chosen by hand: far above that of their sums, 1e-15, so that an arm at rest at a limit may stay there.
    pub(super) const ROUNDING: f64 = 1e-9;

    /// Whether no part of an arm that brakes from `next`, one tick after the reference of [`Self::bend`], leaves its limits or becomes too fast; or goes farther beyond
    /// those that it is beyond already.
    pub(in crate::motion) fn can_stop(
        &self,
        next: &[JointMotionState; N],
        limits: &MotionLimits<N>,
        q_now: &SVector<f64, N>,
    ) -> bool {
        let (mut way_m, mut braking_s) = (0.0, 0.0_f64);
        for (i, state) in next.iter().enumerate() {
            let bounds = limits.bounds(i);
            let (low, high) = extent(*state, &bounds);
            way_m += self.reach[i] * (high - q_now[i]).max(q_now[i] - low).max(0.0);
            braking_s = braking_s.max(braking_time_s(*state, &bounds));
        }
        self.stays_slow(next, limits, braking_s) && self.stays_inside(next, limits, (way_m, braking_s))
    }

    /// Whether camera and flange of an arm that brakes from `next` for `braking_s` seconds are no faster than they may be, or than they are.
    fn stays_slow(&self, next: &[JointMotionState; N], limits: &MotionLimits<N>, braking_s: f64) -> bool {
        let most = self.settings.speeds();
        if most.iter().all(|most| most.is_infinite()) {
            return true;
        }
        for look in 0..=SPEED_LOOKS {
            let t_s = braking_s * (f64::from(look) / f64::from(SPEED_LOOKS)).powi(2);
            let at: [_; N] = std::array::from_fn(|i| braked(next[i], &limits.bounds(i), t_s));
            // All that comes later is slower than these.
            let peaks = SVector::<f64, N>::from_fn(|i, _| peak_speed(at[i], &limits.bounds(i)));
            let (way, turn) = (peaks.dot(&self.reach), peaks.sum());
            if [way, turn, way].iter().zip(&most).all(|(peak, most)| peak <= most) {
                return true;
            }
            let (q, qd) = (SVector::from_fn(|i, _| at[i].q), SVector::from_fn(|i, _| at[i].v));
            let speeds = self.speeds(&ArmPlaces::of(&self.robot, &self.settings, &q), &qd);
            let now = most.iter().zip(&self.speeds_now);
            if speeds.iter().zip(now).any(|(speed, (most, now))| *speed > most.max(*now) + Self::ROUNDING) {
                return false;
            }
        }
        true
    }

    /// Whether an arm that brakes from `next` for `braking_s` seconds, whose parts go by at most `way_m` meanwhile, leaves no limit.
    fn stays_inside(
        &self,
        next: &[JointMotionState; N],
        limits: &MotionLimits<N>,
        (way_m, braking_s): (f64, f64),
    ) -> bool {
        if self.now.is_empty() || way_m < self.least + self.reserve_m() {
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
