//! The joint reference `q_r(t)` of (10.75): the integral of the requested velocity, kept within the limits on
//! position, velocity, acceleration and jerk.
//!
//! ```text
//! motion command ─► scaled to the velocity limits ─► a* = g (motion command - qd) ─► scaled to the jerk limits ─► can it still brake? ─► q_r
//!         (all joints together)            (all joints together)   (all joints together)        (each joint)
//! ```
//! Scaling acts on all joints together, so that the camera keeps its direction. The last stage makes the limits
//! certain: a joint takes a step only if it can brake from there within all limits (`braking`); else it takes the
//! part of the step that it can. Since it can always go on braking, no limit is ever passed, whatever is requested.

use super::braking::{Bounds, Breach, JointMotionState, braked, braking_time_s, breach};
use super::limits::{ActingLimits, Limit};
use crate::robot::Robot;
use crate::time::SpanNs;
use nalgebra::SVector;

/// The acceleration falls with the velocity error along `sqrt(2 share J e)`: the rest of the jerk is for corrections.
const JERK_SHARE: f64 = 0.8;
/// Gain of the last bit of a velocity change times the tick: critical damping, `6 - sqrt(32)`.
const LAST_GAIN: f64 = 0.343;
/// Velocity errors (rad/s or m/s) and accelerations that are no longer worked off.
const VELOCITY_DUST: f64 = 1e-12;
const ACCELERATION_DUST: f64 = 1e-9;
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
    /// The ranges and speeds of `robot`, with these accelerations and jerks, rad/s^2, rad/s^3 or m/s^2, m/s^3.
    #[must_use]
    pub fn of(robot: &Robot<N>, acceleration: SVector<f64, N>, jerk: SVector<f64, N>) -> Self {
        let limits = robot.limits();
        Self {
            lower: SVector::from_fn(|i, _| limits[i].lower),
            upper: SVector::from_fn(|i, _| limits[i].upper),
            velocity: SVector::from_fn(|i, _| limits[i].velocity),
            acceleration,
            jerk,
        }
    }

    /// Upper bound of the time in which every joint comes to rest from whatever motion within these limits, s.
    #[must_use]
    pub fn longest_braking_s(&self) -> f64 {
        // From full speed at full acceleration: first that acceleration ends, then v / a + a / j, and some speed was won.
        let joint =
            |i: usize| self.velocity[i] / self.acceleration[i] + 3.0 * self.acceleration[i] / self.jerk[i];
        (0..N).map(joint).fold(0.0, f64::max)
    }

    /// Whether an arm can be like this at all: no joint `times` faster than its limit, or a whole range away from its
    /// range. Beyond everything that a fault of the arm or noisy encoders bring about (where a limit is small, one rad/s,
    /// rad, or m counts), and far below the numbers whose squares are infinite.
    #[must_use]
    pub fn is_plausible(&self, q: &SVector<f64, N>, qd: &SVector<f64, N>, times: f64) -> bool {
        (0..N).all(|i| {
            let (lower, upper) = (self.lower[i], self.upper[i]);
            let is_near = if (upper - lower).is_finite() {
                (q[i] - upper).max(lower - q[i]) <= (upper - lower).max(1.0)
            } else {
                q[i].abs() <= LONGEST_RANGE
            };
            is_near && qd[i].abs() <= times * self.speed(i)
        })
    }

    /// The velocity limit of joint `i`, counted from 0, in judging what can be: never less than 1, and never absurd.
    #[must_use]
    pub fn speed(&self, i: usize) -> f64 {
        self.velocity[i].clamp(1.0, FASTEST)
    }

    /// The way of joint `i`, counted from 0, from `q` to that end of its range that lies in the direction of `sign`, rad or m.
    #[must_use]
    pub fn room(&self, i: usize, q: &SVector<f64, N>, sign: f64) -> f64 {
        if sign < 0.0 { q[i] - self.lower[i] } else { self.upper[i] - q[i] }
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
    /// Acceleration at the point.
    pub a: SVector<f64, N>,
    /// The limits that held the motion command back.
    pub limits: ActingLimits,
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
        let state = ReferenceState { q, qd: zero, qdd: zero, a: zero, limits: ActingLimits::default() };
        Self { limits, state }
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
            let point = JointMotionState { q: self.state.q[i], v: self.state.qd[i], a: self.state.a[i] };
            braking_time_s(point, &self.limits.bounds(i)) <= span.as_s()
        })
    }

    /// Places the reference where the arm is, moving as it moves, as far as the velocity limits let it.
    pub fn reset_to_measured(&mut self, q: &SVector<f64, N>, qd: &SVector<f64, N>) {
        let limits = ActingLimits::default();
        let qd = SVector::from_fn(|i, _| qd[i].clamp(-self.limits.velocity[i], self.limits.velocity[i]));
        let zero = SVector::zeros();
        self.state = ReferenceState { q: *q, qd, qdd: zero, a: zero, limits };
    }

    /// Places the reference where the arm is, moving as it moves, and accelerating as before: under laws that ask for
    /// accelerations.
    pub fn track_measured(&mut self, q: &SVector<f64, N>, qd: &SVector<f64, N>) {
        let a = self.state.a;
        self.reset_to_measured(q, qd);
        let limits = &self.limits;
        self.state.a = SVector::from_fn(|i, _| {
            // No more than can be taken back before the velocity limit.
            let room = (limits.velocity[i] - self.state.qd[i] * a[i].signum()).max(0.0);
            let most = (2.0 * limits.jerk[i] * room).sqrt();
            a[i].clamp(-most, most)
        });
    }

    /// Puts the reference in `q`, or at the end of the range that is nearest to it; velocity and acceleration go on. A `q` that is not
    /// finite changes nothing.
    pub fn relocate(&mut self, q: &SVector<f64, N>) {
        if q.iter().all(|q| q.is_finite()) {
            self.state.q = SVector::from_fn(|i, _| q[i].max(self.limits.lower[i]).min(self.limits.upper[i]));
        }
    }

    /// Advances by `dt` with the acceleration `qdd` (rad/s^2 or m/s^2), the same throughout, as far as the limits let it. One
    /// that is not finite counts as none.
    pub fn accelerate(&mut self, qdd: &SVector<f64, N>, dt: SpanNs) -> &ReferenceState<N> {
        let dt_s = dt.as_s();
        if dt_s <= 0.0 {
            return &self.state;
        }
        let mut acting = ActingLimits::default();
        for i in 0..N {
            let bounds = self.limits.bounds(i);
            let now = JointMotionState { q: self.state.q[i], v: self.state.qd[i], a: self.state.a[i] };
            let wanted = if qdd[i].is_finite() { qdd[i] } else { 0.0 };
            let held = wanted.clamp(-bounds.acceleration, bounds.acceleration);
            if held != wanted {
                acting.set(Limit::Acceleration, i);
            }
            let most = bounds.jerk * dt_s;
            let change = (held - now.a).clamp(-most, most);
            if change != held - now.a {
                acting.set(Limit::Jerk, i);
            }
            let a = now.a + change;
            let step =
                JointMotionState { q: now.q + dt_s * (now.v + dt_s * a / 2.0), v: now.v + dt_s * a, a };
            let taken = self.take(i, step, dt_s, &mut acting);
            self.state.qdd[i] = (taken.v - now.v) / dt_s;
        }
        self.state.limits = acting;
        &self.state
    }

    /// Advances by `dt` towards the velocity `requested_qd` (rad/s or m/s). A motion command that is not finite counts as standstill.
    pub fn advance(&mut self, requested_qd: &SVector<f64, N>, dt: SpanNs) -> &ReferenceState<N> {
        let dt_s = dt.as_s();
        if dt_s <= 0.0 {
            return &self.state;
        }
        let mut acting = ActingLimits::default();
        let wanted = self.wanted_acceleration(requested_qd, dt_s, &mut acting);
        let previous = self.state.qd;
        for i in 0..N {
            let now = JointMotionState { q: self.state.q[i], v: previous[i], a: self.state.a[i] };
            let step = now.after((wanted[i] - now.a) / dt_s, dt_s);
            self.take(i, step, dt_s, &mut acting);
        }
        self.state.qdd = (self.state.qd - previous) / dt_s;
        self.state.limits = acting;
        &self.state
    }

    /// Joint `i` takes `step`, or what of it lets it brake; where it then is.
    fn take(
        &mut self,
        i: usize,
        step: JointMotionState,
        dt_s: f64,
        acting: &mut ActingLimits,
    ) -> JointMotionState {
        let now = JointMotionState { q: self.state.q[i], v: self.state.qd[i], a: self.state.a[i] };
        let (taken, breach) = admissible(now, step, &self.limits.bounds(i), dt_s);
        match breach {
            Some(Breach::Position) => acting.set(Limit::Position, i),
            Some(Breach::Velocity) => acting.set(Limit::Velocity, i),
            None => {}
        }
        (self.state.q[i], self.state.qd[i], self.state.a[i]) = (taken.q, taken.v, taken.a);
        taken
    }

    /// The acceleration at the end of the step that leads towards the motion command, within acceleration and jerk limits.
    fn wanted_acceleration(
        &self,
        requested_qd: &SVector<f64, N>,
        dt_s: f64,
        acting: &mut ActingLimits,
    ) -> SVector<f64, N> {
        let limits = &self.limits;
        let mut requested_qd =
            if requested_qd.iter().all(|v| v.is_finite()) { *requested_qd } else { SVector::zeros() };
        requested_qd *= shrink(&requested_qd, &limits.velocity, Limit::Velocity, acting);
        let error = requested_qd - self.state.qd;
        if error.amax() < VELOCITY_DUST && self.state.a.amax() < ACCELERATION_DUST {
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
        let change = error * gain - self.state.a;
        self.state.a + change * shrink(&change, &(limits.jerk * dt_s), Limit::Jerk, acting)
    }
}

/// The step, if the joint can brake from its end within all limits; else as much of it as lets it, and what stood in
/// its way. Parts of a step lie between braking and the step: the limits are convex, so they are kept on the way too.
fn admissible(
    now: JointMotionState,
    step: JointMotionState,
    bounds: &Bounds,
    dt_s: f64,
) -> (JointMotionState, Option<Breach>) {
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
