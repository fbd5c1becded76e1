//! One joint of the measured arm, before a drive that obeys torques. There the bounds on the reference bound nothing that moves: an arm
//! that does what its model does not know may be faster than its reference, or leave its range.
//!
//! Where the joint is too fast, or outside of its range and on its way farther out, no torque passes that drives it farther than its weight
//! does: with `s` the direction in which it goes too fast or too far,
//! ```text
//! s (tau - g(q)) <= 0
//! ```
//! What carries the arm's weight and what brakes passes as it is. This is neither a brake nor a stop: the watches
//! ([`ArmWatch`](crate::control::safety::ArmWatch)) end the run soon after, and where a joint trembles, of which they see no distance,
//! [`Overspeed`] does.

/// Times the limit of velocity from which on a joint is too fast: half-way from the limit, at which a reference may go, to the 1.5 times
/// at which the watches call it a fault, so that it acts before them. Chosen by hand.
const TOO_FAST: f64 = 1.25;
/// Speed from which on a joint is on its way, rad/s or m/s: that of an arm at rest at the most. One that stands out there must be held, also
/// by what carries a load that the model does not know (tested: `an_overloaded_arm_is_brought_to_rest`).
const MOVES: f64 = 0.02;
/// What a tick with a joint too fast weighs against one without. Chosen by hand: a joint that trembles is slow at each turn, and a tenth of
/// the ticks is too many; no noise of encoders makes as much of a velocity near its limit.
const WEIGHT: u32 = 9;
/// Ticks with a joint too fast, all in a row, that are a fault: five times the 20 ms over which the watches take their mean. Chosen by
/// hand. A wrist that trembled at up to four times its limit, above this bound in a third of the ticks, is a fault after 0.4 s.
const PATIENCE: u32 = 100;

/// What the measured joint may do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ArmBound {
    /// Ends of its range, rad or m, with what it may be off its reference.
    pub(super) range: (f64, f64),
    /// Largest velocity, positive.
    pub(super) v: f64,
}

/// How often a joint has been too fast of late.
#[derive(Debug, Clone, Default)]
pub(super) struct Overspeed(u32);

impl Overspeed {
    /// Takes in a tick; whether it was too often.
    pub(super) fn note(&mut self, is_too_fast: bool) -> bool {
        self.0 =
            if is_too_fast { (self.0 + WEIGHT).min(WEIGHT * PATIENCE) } else { self.0.saturating_sub(1) };
        self.0 == WEIGHT * PATIENCE
    }
}

impl ArmBound {
    /// Whether `v` is too fast; what is no number is not.
    pub(super) fn is_too_fast(&self, v: f64) -> bool {
        v.abs() > TOO_FAST * self.v
    }

    /// The direction in which the joint, measured at `q` with the velocity `v`, may not be driven; 0 where there is none, as for what is
    /// no number.
    pub(super) fn forbidden(&self, q: f64, v: f64) -> f64 {
        if self.is_too_fast(v) {
            v.signum()
        } else if q > self.range.1 && v > MOVES {
            1.0
        } else if q < self.range.0 && v < -MOVES {
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
