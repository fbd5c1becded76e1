//! The bound on one joint of the measured arm, for a drive in torque mode. In that mode the bounds on the reference do not bound the arm
//! itself: an arm that deviates from its model may be faster than its reference, or leave its range.
//!
//! Where the joint is too fast, or outside of its range and moving farther out, a torque passes only as far as it drives the joint no
//! farther than its weight does. With `s` the direction in which it moves too fast or too far,
//! ```text
//! s (tau - g(q)) <= 0
//! ```
//! Torques that carry the arm's weight, and torques that brake, pass unchanged. This is neither a brake nor a stop: the supervision of the arm
//! ([`ArmWatch`](crate::control::safety::ArmWatch)) ends the run soon after. A joint that trembles covers no distance by which that supervision
//! could notice it; there [`Overspeed`] ends the run.

/// Factor of the velocity limit above which a joint is too fast: half-way from the limit, at which a reference may move, to the factor of 1.5
/// from which on the supervision reports a fault, so that this bound acts before it. Chosen by hand.
const TOO_FAST: f64 = 1.25;
/// Speed above which a joint counts as moving, rad/s or m/s: an arm at rest is slower. A joint that stands outside of its range must still be
/// held, also by a torque that carries a load unknown to the model (tested: `an_overloaded_arm_is_brought_to_rest`).
const MOVES: f64 = 0.02;
/// Weight of a tick in which a joint is too fast, against one in which it is not. Chosen by hand: a joint that trembles is slow at each
/// reversal, so that a tenth of the ticks is already too many; noise of encoders does not make that many of a velocity near its limit.
const WEIGHT: u32 = 9;
/// Ticks in a row with a joint too fast that are a fault: five times the 20 ms over which the supervision takes its mean. Chosen by
/// hand. A wrist that trembled at up to four times its limit, above this bound in a third of the ticks, is a fault after 0.4 s.
const PATIENCE: u32 = 100;

/// What the measured joint may do.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct ArmBound {
    /// Ends of its range, rad or m, widened by the distance that it may have from its reference.
    pub(super) range: (f64, f64),
    /// Largest velocity, positive.
    pub(super) v: f64,
}

/// How often a joint has recently been too fast.
#[derive(Debug, Clone, Default)]
pub(super) struct Overspeed(u32);

impl Overspeed {
    /// Takes in a tick. Returns whether the joint has been too fast too often.
    pub(super) fn note(&mut self, is_too_fast: bool) -> bool {
        self.0 =
            if is_too_fast { (self.0 + WEIGHT).min(WEIGHT * PATIENCE) } else { self.0.saturating_sub(1) };
        self.0 == WEIGHT * PATIENCE
    }
}

impl ArmBound {
    /// Whether `v` is too fast; NaN is not.
    pub(super) fn is_too_fast(&self, v: f64) -> bool {
        v.abs() > TOO_FAST * self.v
    }

    /// The direction in which the joint, measured at `q` with the velocity `v`, must not be driven; 0 where there is none, and for NaN.
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

/// The part of the torque `tau` that does not drive a joint in the `forbidden` direction; the torque `gravity` carries the joint's weight.
pub(super) fn not_driving(forbidden: f64, tau: f64, gravity: f64) -> f64 {
    if forbidden > 0.0 {
        tau.min(gravity)
    } else if forbidden < 0.0 {
        tau.max(gravity)
    } else {
        tau
    }
}
