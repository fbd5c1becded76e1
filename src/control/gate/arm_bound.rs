//! One joint of the measured arm, before a drive that obeys torques. There the bounds on the reference bound nothing that moves: an arm
//! that does what its model does not know may be faster than its reference, or leave its range.
//!
//! Where the joint is too fast, or outside of its range and not on its way back, no torque passes that drives it farther than its weight
//! does: with `s` the direction in which it goes too fast or too far,
//! ```text
//! s (tau - g(q)) <= 0
//! ```
//! What carries the arm's weight and what brakes passes as it is. This is neither a brake nor a stop; the watches
//! ([`ArmWatch`](crate::control::safety::ArmWatch)) end the run soon after.

/// Times the limit of velocity from which on a joint is too fast: half-way from the limit, at which a reference may go, to the 1.5 times
/// at which the watches call it a fault, so that it acts before them. Chosen by hand.
const TOO_FAST: f64 = 1.25;

/// What the measured joint may do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ArmBound {
    /// Ends of its range, rad or m, with what it may be off its reference.
    pub(super) range: (f64, f64),
    /// Largest velocity, positive.
    pub(super) v: f64,
}

impl ArmBound {
    /// The direction in which the joint, measured at `q` with the velocity `v`, may not be driven; 0 where there is none, as for what is
    /// no number.
    pub(super) fn forbidden(&self, q: f64, v: f64) -> f64 {
        if v.abs() > TOO_FAST * self.v {
            v.signum()
        } else if q > self.range.1 && v >= 0.0 {
            1.0
        } else if q < self.range.0 && v <= 0.0 {
            -1.0
        } else {
            0.0
        }
    }
}

/// As much of the torque `tau` as does not drive a joint in the `forbidden` direction, where `gravity` carries its weight.
pub(super) fn not_driving(forbidden: f64, tau: f64, gravity: f64) -> f64 {
    if forbidden > 0.0 {
        tau.min(gravity)
    } else if forbidden < 0.0 {
        tau.max(gravity)
    } else {
        tau
    }
}
