//! How a joint velocity that a law requests is related to the goal: the rate of convergence, the remaining joint displacement, and the parts of
//! the velocity that do not serve to reduce the error (feed-forward for a moving object, null-space motion).

use nalgebra::SVector;

/// How a requested joint velocity leads to its goal. The braking before the goal (`motion`) computes from it
/// from which distance on the arm must slow down.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Convergence<const N: usize> {
    /// Rate at which the error falls exponentially where the arm follows the law output, 1/s.
    pub rate_1_s: f64,
    /// Remaining displacement of each joint to the goal according to the law, rad or m, where the law output was scaled or modified afterwards;
    /// zero where it was not.
    pub remaining: SVector<f64, N>,
    /// Feed-forward part of the law output, which follows a moving goal, rad/s or m/s: it remains when the goal is reached.
    pub feed_forward: SVector<f64, N>,
    /// Null-space part of the law output, which does not move the features: a secondary motion that has no goal, rad/s or m/s.
    pub null_space: SVector<f64, N>,
}

impl<const N: usize> Convergence<N> {
    /// For a goal at rest, with the rate in 1/s: no remaining displacement, feed-forward or null-space motion.
    #[must_use]
    pub fn at(rate_1_s: f64) -> Self {
        Self {
            rate_1_s,
            remaining: SVector::zeros(),
            feed_forward: SVector::zeros(),
            null_space: SVector::zeros(),
        }
    }
}
