//! The excitation motion: a gentle motion of all joints at once, from rest back to the same rest, that shows in the image how each moves.
//!
//! ```text
//! q_i(t) = q_i(0) + a_i (1 - cos W t) / 2 (1 - cos n_i W t) / 2,   W = 2 pi / T,   n_i = 3, 4, ...
//! ```
//! Each joint has a whole number n_i of its own, so that after T all are back where they began, and the motion of one is
//! not taken for that of another. Position, velocity, acceleration and jerk begin and end with zero. A joint moves to one
//! side only, a_i of either sign. Over the whole motion, position and velocity are orthogonal: an error of the hand-eye pose, which
//! goes with the first, is not taken for a delay, which goes with the second.

use super::MotionLimits;
use crate::time::SpanNs;
use nalgebra::SVector;
use std::f64::consts::TAU;

/// T: how long the motion takes. Chosen by hand: 200 frames of a camera at 25 Hz. The velocity limit bounds the amplitude to
/// `2 share v_max / ((n + 1) 2 pi / T)`, which is proportional to T.
const DURATION: SpanNs = SpanNs(8_000_000_000);
/// n of the first joint. Derived: the spectrum of the windowed cosine has lines at n - 1, n and n + 1, and the window, which all joints
/// share, has one at 1. So n must be more than 2. A larger n makes the motion faster, and the limits then bound its amplitude.
const FIRST_CYCLES: usize = 3;
/// Share of a joint's limits on velocity, acceleration and jerk that the motion may use. Chosen by hand, as for waypoints: the reference,
/// which may use all of them, must never cut the motion (tested).
const LIMIT_SHARE: f64 = 0.25;
/// Share of the distance to the end of its range that a joint may go. Chosen by hand: half of it stays free for overshoot.
const RANGE_SHARE: f64 = 0.5;
/// Largest amplitude of a joint, however little of its motion the image shows, rad or m. Chosen by hand: 0.15 rad is 9 degrees.
pub const MAX_EXCITATION: f64 = 0.15;

/// The motion of `N` joints.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExcitationMotion<const N: usize> {
    amplitude: SVector<f64, N>,
    elapsed: SpanNs,
}

impl<const N: usize> ExcitationMotion<N> {
    /// A motion that begins in `q` and goes no farther than by `reach`, of either sign; both rad or m. It goes less far
    /// where that keeps a joint well within its range and its limits on velocity, acceleration and jerk.
    #[must_use]
    pub fn new(q: &SVector<f64, N>, reach: &SVector<f64, N>, limits: &MotionLimits<N>) -> Self {
        let amplitude = SVector::from_fn(|i, _| {
            // A sum of cosines of up to n + 1 cycles within +-a/2 of its middle: its k-th derivative is at most
            // a/2 ((n + 1) W)^k (Bernstein).
            let fastest_rad_s = (cycles(i) + 1.0) * base_rad_s();
            let largest = [
                MAX_EXCITATION,
                RANGE_SHARE * limits.room(i, q, reach[i]),
                2.0 * LIMIT_SHARE * limits.velocity[i] / fastest_rad_s,
                2.0 * LIMIT_SHARE * limits.acceleration[i] / fastest_rad_s.powi(2),
                2.0 * LIMIT_SHARE * limits.jerk[i] / fastest_rad_s.powi(3),
            ];
            largest.into_iter().fold(reach[i].abs(), f64::min).max(0.0).copysign(reach[i])
        });
        Self { amplitude, elapsed: SpanNs(0) }
    }

    /// The velocity for the next `dt`, rad/s or m/s. The motion advances only here: a missed tick delays the motion, but
    /// no part of it is skipped.
    pub fn advance(&mut self, dt: SpanNs) -> SVector<f64, N> {
        let qd = self.velocity(self.elapsed);
        self.elapsed = SpanNs(self.elapsed.0.saturating_add(dt.0));
        qd
    }

    /// Whether the motion has come to its end.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.elapsed >= DURATION
    }

    /// How far each joint goes from where it began, rad or m.
    #[must_use]
    pub fn amplitude(&self) -> &SVector<f64, N> {
        &self.amplitude
    }

    fn velocity(&self, time: SpanNs) -> SVector<f64, N> {
        if time >= DURATION {
            return SVector::zeros();
        }
        let phase = base_rad_s() * time.as_s();
        let (window, window_slope) = (0.5 * (1.0 - phase.cos()), 0.5 * phase.sin());
        SVector::from_fn(|i, _| {
            let (sin, cos) = (cycles(i) * phase).sin_cos();
            self.amplitude[i] * base_rad_s() * 0.5 * (window_slope * (1.0 - cos) + window * cycles(i) * sin)
        })
    }
}

fn cycles(joint: usize) -> f64 {
    (FIRST_CYCLES + joint) as f64
}

fn base_rad_s() -> f64 {
    TAU / DURATION.as_s()
}

#[cfg(test)]
mod tests;
