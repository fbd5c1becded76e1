//! The joint reference `q_r(t)` of (10.75): the integral of the wished velocity, kept within the limits on
//! position, velocity, acceleration and jerk.
//!
//! ```text
//! wish ─► scaled to the velocity limits ─► a* = g (wish - qd) ─► scaled to the jerk limits ─► can it still brake? ─► q_r
//!         (all joints together)            (all joints together)   (all joints together)        (each joint)
//! ```
//! Scaling acts on all joints together, so that the camera keeps its direction. The last stage makes the limits
//! certain: a joint takes a step only if it can brake from there within all limits (`braking`); else it takes the
//! part of the step that it can. Since it can always go on braking, no limit is ever passed, whatever is wished.

use super::braking::{Bounds, Breach, Point, braked, braking_time_s, breach};
use super::limits::{ActingLimits, Limit};
use crate::time::SpanNs;
use nalgebra::SVector;

/// The acceleration falls with the velocity error along `sqrt(2 share J e)`: the rest of the jerk is for corrections.
const JERK_SHARE: f64 = 0.8;
/// Gain of the last bit of a velocity change times the tick: critical damping, `6 - sqrt(32)`.
const LAST_GAIN: f64 = 0.343;
/// Velocity errors (rad/s or m/s) and accelerations that are no longer worked off.
const VELOCITY_DUST: f64 = 1e-12;
const ACCELERATION_DUST: f64 = 1e-9;
/// Times its limit that nothing about a joint is, however wrong.
const ABSURD: f64 = 100.0;
/// What stands for a range or a speed limit that there is not, rad or m, rad/s or m/s.
const LONGEST_RANGE: f64 = 1e6;
const FASTEST: f64 = 1e3;
/// Halvings in search of the largest part of a step from which a joint can brake.
const HALVINGS: u32 = 6;

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
    /// Largest jerk.
    pub jerk: SVector<f64, N>,
}

impl<const N: usize> MotionLimits<N> {
    /// Whether an arm that moves like this is within its speed limits and can still stop within its range.
    #[must_use]
    pub fn can_stop(&self, q: &SVector<f64, N>, qd: &SVector<f64, N>) -> bool {
        (0..N).all(|i| breach(Point { q: q[i], v: qd[i], a: 0.0 }, &self.bounds(i), q[i]).is_none())
    }

    /// Upper bound of the time in which every joint comes to rest from whatever motion within these limits, s.
    #[must_use]
    pub fn longest_braking_s(&self) -> f64 {
        // From full speed at full acceleration: first that acceleration ends, then v / a + a / j, and some speed was won.
        let joint =
            |i: usize| self.velocity[i] / self.acceleration[i] + 3.0 * self.acceleration[i] / self.jerk[i];
        (0..N).map(joint).fold(0.0, f64::max)
    }

    /// Whether an arm can be like this at all: no joint a hundred times faster than its limit, or a hundred ranges away
    /// from its range. Far beyond everything that a fault of the arm or noisy encoders bring about (where a limit is small,
    /// a hundred rad/s, rad, or m count), and far below the numbers whose squares are infinite.
    #[must_use]
    pub fn is_plausible(&self, q: &SVector<f64, N>, qd: &SVector<f64, N>) -> bool {
        let within = |value: f64, largest: f64| value.abs() <= ABSURD * largest.max(1.0);
        (0..N).all(|i| {
            let (lower, upper) = (self.lower[i], self.upper[i]);
            let is_near = if (upper - lower).is_finite() {
                within((q[i] - upper).max(lower - q[i]).max(0.0), upper - lower)
            } else {
                within(q[i], LONGEST_RANGE)
            };
            is_near && within(qd[i], self.velocity[i].min(FASTEST))
        })
    }

    /// The limits of joint `i`, counted from 0.
    pub(super) fn bounds(&self, i: usize) -> Bounds {
        Bounds {
            lower: self.lower[i],
            upper: self.upper[i],
            velocity: self.velocity[i],
            acceleration: self.acceleration[i],
            jerk: self.jerk[i],
        }
    }
}

/// One point of the reference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReferenceState<const N: usize> {
    /// Position, rad or m.
    pub q: SVector<f64, N>,
    /// Velocity.
    pub qd: SVector<f64, N>,
    /// Mean acceleration since the previous point.
    pub qdd: SVector<f64, N>,
    /// The limits that held the wish back.
    pub limits: ActingLimits,
}

/// Generator of the reference.
#[derive(Debug, Clone)]
pub struct Reference<const N: usize> {
    limits: MotionLimits<N>,
    state: ReferenceState<N>,
    /// Acceleration at the point.
    a: SVector<f64, N>,
}

impl<const N: usize> Reference<N> {
    /// A reference at rest in `q`.
    #[must_use]
    pub fn new(limits: MotionLimits<N>, q: SVector<f64, N>) -> Self {
        let zero = SVector::zeros();
        let state = ReferenceState { q, qd: zero, qdd: zero, limits: ActingLimits::default() };
        Self { limits, state, a: zero }
    }

    /// The current point.
    #[must_use]
    pub fn state(&self) -> &ReferenceState<N> {
        &self.state
    }

    /// Whether every joint of it can come to rest within `span`.
    #[must_use]
    pub fn rests_within(&self, span: SpanNs) -> bool {
        (0..N).all(|i| {
            let point = Point { q: self.state.q[i], v: self.state.qd[i], a: self.a[i] };
            braking_time_s(point, &self.limits.bounds(i)) <= span.as_s()
        })
    }

    /// Places the reference where the arm is, moving as it moves: for laws that command torques past it.
    pub fn reseat(&mut self, q: &SVector<f64, N>, qd: &SVector<f64, N>) {
        let limits = ActingLimits::default();
        self.state = ReferenceState { q: *q, qd: *qd, qdd: SVector::zeros(), limits };
        self.a = SVector::zeros();
    }

    /// Advances by `dt` towards the velocity `wish` (rad/s or m/s). A wish that is not finite counts as standstill.
    pub fn advance(&mut self, wish: &SVector<f64, N>, dt: SpanNs) -> &ReferenceState<N> {
        let dt_s = dt.as_s();
        if dt_s <= 0.0 {
            return &self.state;
        }
        let mut acting = ActingLimits::default();
        let wanted = self.wanted_acceleration(wish, dt_s, &mut acting);
        let previous = self.state.qd;
        for i in 0..N {
            let bounds = self.limits.bounds(i);
            let now = Point { q: self.state.q[i], v: previous[i], a: self.a[i] };
            let step = now.after((wanted[i] - now.a) / dt_s, dt_s);
            let (taken, breach) = admissible(now, step, &bounds, dt_s);
            match breach {
                Some(Breach::Position) => acting.set(Limit::Position, i),
                Some(Breach::Velocity) => acting.set(Limit::Velocity, i),
                None => {}
            }
            self.state.q[i] = taken.q;
            self.state.qd[i] = taken.v;
            self.a[i] = taken.a;
        }
        self.state.qdd = (self.state.qd - previous) / dt_s;
        self.state.limits = acting;
        &self.state
    }

    /// The acceleration at the end of the step that leads towards the wish, within acceleration and jerk limits.
    fn wanted_acceleration(
        &self,
        wish: &SVector<f64, N>,
        dt_s: f64,
        acting: &mut ActingLimits,
    ) -> SVector<f64, N> {
        let limits = &self.limits;
        let mut wish = if wish.iter().all(|v| v.is_finite()) { *wish } else { SVector::zeros() };
        wish *= shrink(&wish, &limits.velocity, Limit::Velocity, acting);
        let error = wish - self.state.qd;
        if error.amax() < VELOCITY_DUST && self.a.amax() < ACCELERATION_DUST {
            return SVector::zeros();
        }
        let mut gain = LAST_GAIN / dt_s;
        let mut slowest = None;
        for i in 0..N {
            let e = error[i].abs();
            for (limit, largest) in [
                (Limit::Acceleration, limits.acceleration[i]),
                (Limit::Jerk, (2.0 * JERK_SHARE * limits.jerk[i] * e).sqrt()),
            ] {
                if gain * e > largest {
                    gain = largest / e;
                    slowest = Some((limit, i));
                }
            }
        }
        if let Some((limit, i)) = slowest {
            acting.set(limit, i);
        }
        let change = error * gain - self.a;
        self.a + change * shrink(&change, &(limits.jerk * dt_s), Limit::Jerk, acting)
    }
}

/// The step, if the joint can brake from its end within all limits; else as much of it as lets it, and what stood in
/// its way. Parts of a step lie between braking and the step: the limits are convex, so they are kept on the way too.
fn admissible(now: Point, step: Point, bounds: &Bounds, dt_s: f64) -> (Point, Option<Breach>) {
    let Some(reason) = breach(step, bounds, now.q) else { return (step, None) };
    let brake = braked(now, bounds, dt_s);
    let (mut best, mut low, mut high) = (brake, 0.0, 1.0);
    for _ in 0..HALVINGS {
        let share = 0.5 * (low + high);
        let part = brake.towards(step, share);
        if breach(part, bounds, now.q).is_none() {
            (best, low) = (part, share);
        } else {
            high = share;
        }
    }
    (best, Some(reason))
}

/// The factor that makes the whole vector fit, and the joint that asks for it.
fn shrink<const N: usize>(
    v: &SVector<f64, N>,
    largest: &SVector<f64, N>,
    limit: Limit,
    acting: &mut ActingLimits,
) -> f64 {
    let (mut scale, mut joint) = (1.0_f64, None);
    for i in 0..N {
        if v[i].abs() * scale > largest[i] {
            (scale, joint) = (largest[i] / v[i].abs(), Some(i));
        }
    }
    if let Some(joint) = joint {
        acting.set(limit, joint);
    }
    scale
}

#[cfg(test)]
mod tests;
