//! The motion from which the image Jacobian is learnt: all joints at once, to both sides of where the arm is, back to where it began.
//!
//! ```text
//! q(t) = q(0) + sum_k a_k w(t) sin(n_k W t)  or  a_k w(t) cos(n_k W t),   w = ((1 - cos W t) / 2)^2,   W = 2 pi / T,   n_k = 1, 1, 2, 2, ...
//! ```
//! Each a_k is a motion of all joints. Two share a number n, one with the sine and one with the cosine, so that the fastest of seven has n = 4. The window makes
//! neighbours alike: what tells the most similar parts apart has a twenty-fifth of the amplitude of the strongest (tested), and is seen in 50 frames all the same. Position, velocity and acceleration begin and end with zero.

use crate::time::SpanNs;
use nalgebra::{SMatrix, SVector};
use std::f64::consts::TAU;

/// A motion of `N` joints.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LearningMotion<const N: usize> {
    parts: SMatrix<f64, N, N>,
    duration: SpanNs,
    elapsed: SpanNs,
}

impl<const N: usize> LearningMotion<N> {
    /// A motion of these parts a_k, the columns, rad or m, slow ones first, that takes the time `duration`.
    pub(super) fn new(parts: SMatrix<f64, N, N>, duration: SpanNs) -> Self {
        Self { parts, duration, elapsed: SpanNs(0) }
    }

    /// The velocity of the next `dt`, rad/s or m/s.
    pub(super) fn advance(&mut self, dt: SpanNs) -> SVector<f64, N> {
        let from = self.displacement(self.elapsed);
        self.elapsed = SpanNs(self.elapsed.0.saturating_add(dt.0));
        (self.displacement(self.elapsed) - from) / dt.as_s()
    }

    /// Whether it has come to its end.
    pub(super) fn is_over(&self) -> bool {
        self.elapsed >= self.duration
    }

    /// How far each joint goes at most, rad or m.
    pub(super) fn amplitude(&self) -> SVector<f64, N> {
        amplitude(&self.parts)
    }

    fn displacement(&self, time: SpanNs) -> SVector<f64, N> {
        if time >= self.duration {
            return SVector::zeros();
        }
        let phase = TAU * time.as_s() / self.duration.as_s();
        let window = (0.5 * (1.0 - phase.cos())).powi(2);
        self.parts
            * SVector::from_fn(|k, _| {
                let (sin, cos) = ((k / 2 + 1) as f64 * phase).sin_cos();
                window * if k % 2 == 0 { sin } else { cos }
            })
    }
}

/// Angular frequency n_k W of part `k` of a motion that takes the time `duration`, rad/s.
pub(super) fn fastest_rad_s(k: usize, duration: SpanNs) -> f64 {
    (k / 2 + 1) as f64 * TAU / duration.as_s()
}

/// Sum of the absolute values of each row.
pub(super) fn amplitude<const N: usize>(parts: &SMatrix<f64, N, N>) -> SVector<f64, N> {
    SVector::from_fn(|i, _| parts.row(i).iter().map(|a| a.abs()).sum())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::TICK;

    #[test]
    fn all_joints_move_apart_and_come_back() {
        let mut motion = LearningMotion::<7>::new(SMatrix::identity() * 0.01, SpanNs(2_000_000_000));
        let (mut q, mut before) = (SVector::<f64, 7>::zeros(), SVector::<f64, 7>::zeros());
        let mut sums = nalgebra::SMatrix::<f64, 7, 7>::zeros();
        while !motion.is_over() {
            let qd = motion.advance(TICK);
            assert!((qd - before).amax() / 1e-3 < 3.0, "acceleration {}", (qd - before).amax() / 1e-3);
            q += qd * 1e-3;
            sums += q * q.transpose();
            before = qd;
        }
        assert!(q.amax() < 1e-12 && before.amax() < 1e-4, "{q} {before}");
        let largest = sums.symmetric_eigenvalues().max();
        // Of motions that depend on each other the smallest eigenvalue would vanish; these leave the weakest a twenty-fifth of the strongest amplitude.
        assert!(sums.symmetric_eigenvalues().min() > 1e-3 * largest, "{}", sums.symmetric_eigenvalues());
    }
}
