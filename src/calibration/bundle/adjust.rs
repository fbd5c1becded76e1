//! Levenberg and Marquardt's rule on the bordered equations.

use super::equations::BundleSums;
use super::problem::{BundleProblem, BundleState};
use crate::pose::Loss;

const MAX_ITERATIONS: u32 = 100;
const FIRST_DAMPING: f64 = 1e-3;
/// A damping at which the equations are given up.
const LARGEST_DAMPING: f64 = 1e12;
/// The promised fall, relative to the loss by degree of freedom, that ends it: steps of a thousandth of a standard deviation.
const LAST_PROMISE: f64 = 1e-9;
/// A loss by degree of freedom that is none: what is left of exact data.
const NOTHING: f64 = 1e-10;
/// As good as the end, where the last steps crawl.
const GOOD_ENOUGH: f64 = 1e-4;

/// Why there is no minimum.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum BundleFailure {
    /// At the start a corner lies behind a camera.
    BadStart,
    /// The pictures do not tell every unknown.
    Degenerate,
    /// It did not settle.
    NotConverged { iterations: u32 },
}

/// The minimum.
#[derive(Debug, Clone)]
pub(crate) struct BundleEnd {
    /// Where it is.
    pub(crate) state: BundleState,
    /// The equations there.
    pub(crate) sums: BundleSums,
    /// Steps tried.
    pub(crate) iterations: u32,
}

/// The state of least loss near `start`.
pub(crate) fn adjust(
    problem: &BundleProblem,
    start: BundleState,
    loss: Loss,
) -> Result<BundleEnd, BundleFailure> {
    let dof = problem.degrees_of_freedom();
    if dof == 0 {
        return Err(BundleFailure::Degenerate);
    }
    let mut state = start;
    let mut sums = BundleSums::at(problem, &state, loss).ok_or(BundleFailure::BadStart)?;
    let mut damping = FIRST_DAMPING;
    let mut crawling = false;
    for iterations in 1..=MAX_ITERATIONS {
        let size = (sums.loss / dof as f64).max(NOTHING);
        let Some(step) = sums.step(damping) else {
            damping *= 10.0;
            if damping > LARGEST_DAMPING {
                return Err(BundleFailure::Degenerate);
            }
            continue;
        };
        let candidate = problem.moved(&state, &step.shared, &step.poses);
        let next = BundleSums::at(problem, &candidate, loss).filter(|next| next.loss <= sums.loss);
        // a small promise under strong damping says nothing
        let last = step.promise < LAST_PROMISE * size && damping < 1e-2;
        crawling = step.promise < GOOD_ENOUGH * size && damping < 1.0;
        match next {
            Some(next) => {
                (state, sums) = (candidate, next);
                damping = (damping * 0.1).max(1e-15);
            }
            None => damping = (damping * 10.0).max(1e-6),
        }
        // at the minimum rounding alone decides whether the loss falls
        if last || (crawling && damping > 1e3) {
            return Ok(BundleEnd { state, sums, iterations });
        }
        if damping > LARGEST_DAMPING {
            return Err(BundleFailure::Degenerate);
        }
    }
    if crawling {
        return Ok(BundleEnd { state, sums, iterations: MAX_ITERATIONS });
    }
    Err(BundleFailure::NotConverged { iterations: MAX_ITERATIONS })
}
