//! The joint reference `q_r(t)` of (10.75): the integral of the requested velocity, kept within the limits on
//! position, velocity, acceleration and jerk.
//!
//! ```text
//! motion command ─► scaled to the velocity limits ─► a* = g (motion command - qd) ─► scaled to the jerk limits ─► can it still brake? ─► q_r
//!         (all joints together)            (all joints together)   (all joints together)        (each joint)
//! ```
//! All joints are scaled by the same factor, so that the camera keeps its direction of motion. The last stage guarantees the limits:
//! a joint takes a step only if it can brake from the end of that step within all limits (`braking`). Otherwise it takes the
//! part of the step from which it can. Since braking can always be continued, no limit is ever exceeded, whatever is requested.
//! Limits in space (`workspace`), where there are some, bend and slow the motion command first, and hold all joints together last.

use super::braking::{Bounds, Breach, JointMotionState, braked, braking_time_s, breach};
use super::limits::{ActingLimits, Limit};
use super::motion_limits::MotionLimits;
use super::workspace::Workspace;
use crate::time::SpanNs;
use nalgebra::SVector;

/// The acceleration falls with the velocity error along `sqrt(2 share J e)`. Chosen by hand: with 1 the whole jerk would be needed on that
/// curve, and a tick that begins beside it could not correct; with half of the value a change of velocity takes up to `sqrt 2` times as long.
const JERK_SHARE: f64 = 0.8;
/// Gain from velocity error to acceleration near the end of a velocity change, times the tick T. Derived: with `a' = g e / T` and
/// `e' = e - T (a + a') / 2` the characteristic polynomial is `z^2 - (1 - g / 2) z + g / 2`, which has a double root (critical damping)
/// where `g^2 - 12 g + 4 = 0`: `g = 6 - sqrt(32) = 0.3431`. Twice the value would oscillate.
const LAST_GAIN: f64 = 0.343;
/// Velocity errors (rad/s or m/s) and accelerations below these count as zero, so that rounding is not followed. Chosen by hand: far
/// above the rounding of a speed of 10 rad/s (2e-15), and far below what an encoder resolves.
const VELOCITY_DUST: f64 = 1e-12;
const ACCELERATION_DUST: f64 = 1e-9;
/// Bisections in search of the largest part of a step from which a joint can brake: it is found to `2^-6`, 1.6 % of a step, so that
/// at most that much of a tick's acceleration is lost. Chosen by hand; each one costs a closed-form braking distance.
const HALVINGS: u32 = 6;

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
    /// Shares of the velocity and acceleration limits that are used to follow motion commands.
    speed_share: f64,
    acceleration_share: f64,
    /// The limits in space, where there are some.
    space: Option<Box<Workspace<N>>>,
}

impl<const N: usize> Reference<N> {
    /// A reference at rest in `q`.
    #[must_use]
    pub fn new(limits: MotionLimits<N>, q: SVector<f64, N>) -> Self {
        let zero = SVector::zeros();
        let state = ReferenceState { q, qd: zero, qdd: zero, a: zero, limits: ActingLimits::default() };
        Self { limits, state, speed_share: 1.0, acceleration_share: 1.0, space: None }
    }

    /// The same within limits in space.
    #[must_use]
    pub fn within(self, space: Workspace<N>) -> Self {
        Self { space: Some(Box::new(space)), ..self }
    }

    /// The limits in space, and what they did at the last tick; `None` where there are none.
    #[must_use]
    pub fn space(&self) -> Option<&Workspace<N>> {
        self.space.as_deref()
    }

    /// Follows motion commands with the share `share` (above 0, up to 1) of the acceleration limits from now on: an arm whose efforts do not
    /// suffice for more. It still brakes with all of them: one that became less while the arm moves must not lengthen its way.
    pub fn set_acceleration_share(&mut self, share: f64) {
        self.acceleration_share = share;
    }

    /// Follows motion commands with the share `share` (above 0, up to 1) of the velocity limits from now on, to which it slows down within the others: a robot whose own limits are lower for a while.
    pub fn set_speed_share(&mut self, share: f64) {
        self.speed_share = share;
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

    /// Sets the reference to the measured position and velocity, the latter clamped to the velocity limits.
    pub fn reset_to_measured(&mut self, q: &SVector<f64, N>, qd: &SVector<f64, N>) {
        let limits = ActingLimits::default();
        let qd = SVector::from_fn(|i, _| qd[i].clamp(-self.limits.velocity[i], self.limits.velocity[i]));
        let zero = SVector::zeros();
        self.state = ReferenceState { q: *q, qd, qdd: zero, a: zero, limits };
    }

    /// Sets the reference to the measured position and velocity and keeps its acceleration: for laws that output torques.
    pub fn track_measured(&mut self, q: &SVector<f64, N>, qd: &SVector<f64, N>) {
        let a = self.state.a;
        self.reset_to_measured(q, qd);
        let limits = &self.limits;
        self.state.a = SVector::from_fn(|i, _| {
            // No more than can be reduced to zero before the velocity limit is reached.
            let room = (limits.velocity[i] - self.state.qd[i] * a[i].signum()).max(0.0);
            let most = (2.0 * limits.jerk[i] * room).sqrt();
            a[i].clamp(-most, most)
        });
    }

    /// Moves the reference to `q`, clamped to the joints' ranges, without a change of its velocity and acceleration. A `q` that is not
    /// finite is ignored.
    pub fn relocate(&mut self, q: &SVector<f64, N>) {
        if q.iter().all(|q| q.is_finite()) {
            self.state.q = SVector::from_fn(|i, _| q[i].max(self.limits.lower[i]).min(self.limits.upper[i]));
        }
    }

    /// Advances by `dt` with the constant acceleration `qdd` (rad/s^2 or m/s^2), within the limits. A value that is not finite counts as zero.
    pub fn accelerate(&mut self, qdd: &SVector<f64, N>, dt: SpanNs) -> &ReferenceState<N> {
        let dt_s = dt.as_s();
        if dt_s <= 0.0 {
            return &self.state;
        }
        let mut acting = ActingLimits::default();
        let before = self.state;
        let bent = self.bent_acceleration(qdd, &mut acting);
        let qdd = bent.as_ref().unwrap_or(qdd);
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
        if self.is_held_in_space(&before, dt_s, &mut acting) {
            self.state.qdd = (self.state.qd - before.qd) / dt_s;
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
        let before = self.state;
        let bent = self.bent(requested_qd, &mut acting);
        let wanted = self.wanted_acceleration(bent.as_ref().unwrap_or(requested_qd), dt_s, &mut acting);
        let previous = self.state.qd;
        for i in 0..N {
            let now = JointMotionState { q: self.state.q[i], v: previous[i], a: self.state.a[i] };
            let step = now.after((wanted[i] - now.a) / dt_s, dt_s);
            self.take(i, step, dt_s, &mut acting);
        }
        self.is_held_in_space(&before, dt_s, &mut acting);
        self.state.qdd = (self.state.qd - previous) / dt_s;
        self.state.limits = acting;
        &self.state
    }

    /// Joint `i` takes `step`, or the part of it from which it can still brake. Returns the new state.
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
        requested_qd *= shrink(&requested_qd, &(limits.velocity * self.speed_share), Limit::Velocity, acting);
        let error = requested_qd - self.state.qd;
        if error.amax() < VELOCITY_DUST && self.state.a.amax() < ACCELERATION_DUST {
            return SVector::zeros();
        }
        let mut gain = LAST_GAIN / dt_s;
        let mut slowest = None;
        for i in 0..N {
            let e = error[i].abs();
            let brakes = error[i] * self.state.qd[i] < 0.0;
            let share = if brakes { 1.0 } else { self.acceleration_share };
            for (limit, largest) in [
                (Limit::Acceleration, limits.acceleration[i] * share),
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

/// The step, if the joint can brake from its end within all limits; otherwise the largest part of it from which it can, and the limit that
/// was in the way. Parts of a step are interpolated between braking and the step: the limits are convex, so that they hold there too.
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

/// The factor that brings the whole vector within `largest`; the joint that determines it is noted in `acting`.
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

mod in_space;

#[cfg(test)]
mod tests;
