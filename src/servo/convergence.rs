//! What a requested joint velocity says about its goal.

use nalgebra::SVector;

/// How a requested joint velocity leads to its goal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Convergence<const N: usize> {
    /// Rate at which the distance to the goal shrinks if the law output is obeyed, 1/s.
    pub rate_1_s: f64,
    /// How far each joint is from the goal as the law has it, rad or m, where the law output was slowed down or bent since; zero where it
    /// was not.
    pub to_go: SVector<f64, N>,
    /// The part of the law output that follows a goal in motion, rad/s or m/s: what remains when the goal is reached.
    pub follow: SVector<f64, N>,
    /// The part of the law output that the task does not feel: a secondary motion of joints, which has no goal, rad/s or m/s.
    pub free: SVector<f64, N>,
}

impl<const N: usize> Convergence<N> {
    /// To a goal at rest.
    #[must_use]
    pub fn at(rate_1_s: f64) -> Self {
        Self { rate_1_s, to_go: SVector::zeros(), follow: SVector::zeros(), free: SVector::zeros() }
    }
}
