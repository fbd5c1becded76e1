//! The limits of the joint reference: positions, velocities, accelerations and jerks of all joints.

use super::braking::Bounds;
use crate::robot::Robot;
use nalgebra::SVector;

/// What replaces an infinite range when a state is checked for plausibility, rad or m. Chosen by hand, beyond every robot: a joint that has turned 160 000 times.
const LONGEST_RANGE: f64 = 1e6;
/// The same of a speed limit, rad/s or m/s. Chosen by hand, likewise: 160 turns a second.
const FASTEST: f64 = 1e3;

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

    /// Whether a state is physically plausible: no joint is more than `times` as fast as its limit, or farther outside its range than
    /// the range is long. The bounds lie outside of what faults of the arm or noisy encoders cause (where a limit is small, one rad/s,
    /// rad or m counts instead), and far below the numbers whose squares overflow.
    #[must_use]
    pub fn is_plausible(&self, q: &SVector<f64, N>, qd: &SVector<f64, N>, times: f64) -> bool {
        (0..N).all(|i| self.is_near_range(i, q[i]) && qd[i].abs() <= times * self.speed(i))
    }

    /// Whether `q` (rad or m) is no farther outside the range of joint `i`, counted from 0, than the range is long.
    #[must_use]
    pub fn is_near_range(&self, i: usize, q: f64) -> bool {
        let (lower, upper) = (self.lower[i], self.upper[i]);
        if (upper - lower).is_finite() {
            (q - upper).max(lower - q) <= (upper - lower).max(1.0)
        } else {
            q.abs() <= LONGEST_RANGE
        }
    }

    /// The velocity limit of joint `i`, counted from 0, for plausibility checks: at least 1 rad/s or m/s, and finite.
    #[must_use]
    pub fn speed(&self, i: usize) -> f64 {
        self.velocity[i].clamp(1.0, FASTEST)
    }

    /// The distance of joint `i`, counted from 0, from `q` to the end of its range in the direction of `sign`, rad or m.
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
