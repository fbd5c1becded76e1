//! The joint reference `q_r(t)` of (10.75): the integral of the wished velocity, kept within the limits on
//! position, velocity and acceleration.
//!
//! Velocity and acceleration are reduced for all joints together, so that the camera keeps its direction.
//! Near the end of a joint's range its velocity is bound by the distance in which it can still stop.

use crate::time::SpanNs;
use nalgebra::SVector;

/// Limits of the reference; rad or m, per second.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionLimits<const N: usize> {
    /// Lower end of each joint's range.
    pub lower: SVector<f64, N>,
    /// Upper end of each joint's range.
    pub upper: SVector<f64, N>,
    /// Largest speed.
    pub velocity: SVector<f64, N>,
    /// Largest acceleration.
    pub acceleration: SVector<f64, N>,
}

/// One point of the reference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReferenceState<const N: usize> {
    /// Position, rad or m.
    pub q: SVector<f64, N>,
    /// Velocity.
    pub qd: SVector<f64, N>,
    /// Acceleration since the previous point.
    pub qdd: SVector<f64, N>,
    /// Whether a limit changed the wished velocity.
    pub limited: bool,
}

/// Generator of the reference.
#[derive(Debug, Clone)]
pub struct Reference<const N: usize> {
    limits: MotionLimits<N>,
    state: ReferenceState<N>,
}

impl<const N: usize> Reference<N> {
    /// A reference at rest in `q`.
    #[must_use]
    pub fn new(limits: MotionLimits<N>, q: SVector<f64, N>) -> Self {
        let zero = SVector::zeros();
        Self { limits, state: ReferenceState { q, qd: zero, qdd: zero, limited: false } }
    }

    /// The current point.
    #[must_use]
    pub fn state(&self) -> &ReferenceState<N> {
        &self.state
    }

    /// Advances by `dt` towards the velocity `wish` (rad/s or m/s). A wish that is not finite counts as standstill.
    pub fn advance(&mut self, wish: &SVector<f64, N>, dt: SpanNs) -> &ReferenceState<N> {
        let dt_s = dt.as_s();
        if dt_s <= 0.0 {
            return &self.state;
        }
        let limits = &self.limits;
        let mut wish = if wish.iter().all(|v| v.is_finite()) { *wish } else { SVector::zeros() };

        let mut limited = scale_to_fit(&mut wish, &limits.velocity);
        let mut change = wish - self.state.qd;
        limited |= scale_to_fit(&mut change, &(limits.acceleration * dt_s));

        let previous = self.state.qd;
        let mut qd = previous + change;
        for i in 0..N {
            let (a, q) = (limits.acceleration[i], self.state.q[i]);
            // What one tick of full acceleration can reach; braking for the range's end may need all of it.
            let reachable = (previous[i] - a * dt_s, previous[i] + a * dt_s);
            let slowest = -stopping_speed(q - limits.lower[i], a, dt_s);
            let fastest = stopping_speed(limits.upper[i] - q, a, dt_s);
            let bounded = qd[i].clamp(slowest, fastest).clamp(reachable.0, reachable.1);
            limited |= bounded != qd[i];
            qd[i] = bounded;
        }
        let state = &mut self.state;
        state.qdd = (qd - previous) / dt_s;
        state.qd = qd;
        state.q += qd * dt_s;
        state.limited = limited;
        state
    }
}

/// Shrinks the whole vector until every entry fits; true when it had to.
fn scale_to_fit<const N: usize>(v: &mut SVector<f64, N>, largest: &SVector<f64, N>) -> bool {
    let mut scale = 1.0_f64;
    for i in 0..N {
        if v[i].abs() > largest[i] {
            scale = scale.min(largest[i] / v[i].abs());
        }
    }
    if scale < 1.0 {
        *v *= scale;
    }
    scale < 1.0
}

/// The largest speed from which a joint still stops within `distance`, braking with `a` in steps of `dt_s`.
///
/// A step moves by `v dt` and later steps by `v^2 / 2a - v dt / 2` at most plus the rounding `a dt^2 / 8`.
fn stopping_speed(distance: f64, a: f64, dt_s: f64) -> f64 {
    if distance == f64::INFINITY {
        return f64::INFINITY;
    }
    let room = (distance - a * dt_s * dt_s / 8.0).max(0.0);
    a * ((dt_s * dt_s / 4.0 + 2.0 * room / a).sqrt() - dt_s / 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;
    use proptest::prelude::*;

    fn limits() -> MotionLimits<2> {
        MotionLimits {
            lower: Vector2::new(-0.5, -0.1),
            upper: Vector2::new(0.8, 0.2),
            velocity: Vector2::new(1.0, 0.3),
            acceleration: Vector2::new(4.0, 2.0),
        }
    }

    proptest! {
        #[test]
        fn no_limit_is_ever_passed(
            start in (-0.5..0.8f64, -0.1..0.2f64),
            wishes in prop::collection::vec((-5.0..5.0f64, -5.0..5.0f64, 1usize..300), 1..12)
        ) {
            let l = limits();
            let mut r = Reference::new(l.clone(), Vector2::new(start.0, start.1));
            for (a, b, ticks) in wishes {
                for _ in 0..ticks {
                    let before = r.state().qd;
                    let s = *r.advance(&Vector2::new(a, b), SpanNs::MILLISECOND);
                    for i in 0..2 {
                        prop_assert!(s.q[i] >= l.lower[i] - 1e-9 && s.q[i] <= l.upper[i] + 1e-9, "position {}", s.q);
                        prop_assert!(s.qd[i].abs() <= l.velocity[i] + 1e-12);
                        prop_assert!((s.qd[i] - before[i]).abs() <= l.acceleration[i] * 1e-3 + 1e-12);
                        prop_assert!((s.qdd[i] - (s.qd[i] - before[i]) * 1e3).abs() < 1e-9);
                    }
                }
            }
        }
    }

    #[test]
    fn an_easy_wish_is_followed_exactly() {
        let mut r = Reference::new(limits(), Vector2::zeros());
        let s = r.advance(&Vector2::new(0.003, -0.001), SpanNs::MILLISECOND);
        assert!(!s.limited);
        assert_eq!(s.qd, Vector2::new(0.003, -0.001));
    }

    #[test]
    fn direction_is_kept_when_speed_is_cut() {
        let mut r = Reference::new(limits(), Vector2::zeros());
        for _ in 0..150 {
            r.advance(&Vector2::new(4.0, 0.8), SpanNs::MILLISECOND);
        }
        let s = r.state();
        assert!(s.limited);
        assert!((s.qd[1] / s.qd[0] - 0.2).abs() < 1e-9);
    }

    #[test]
    fn nonsense_stops_the_reference() {
        let mut r = Reference::new(limits(), Vector2::zeros());
        for _ in 0..500 {
            r.advance(&Vector2::new(0.2, 0.1), SpanNs::MILLISECOND);
        }
        for _ in 0..500 {
            r.advance(&Vector2::new(f64::NAN, 0.1), SpanNs::MILLISECOND);
        }
        assert_eq!(r.state().qd, Vector2::zeros());
        assert!(r.state().q.iter().all(|q| q.is_finite()));
    }
}
