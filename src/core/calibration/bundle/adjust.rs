//! Levenberg and Marquardt's rule on the bordered equations.

use super::equations::BundleSums;
use super::problem::{BundleProblem, BundleState};
use crate::pose::Loss;

/// So that a start from which nothing converges ends.
const MAX_ITERATIONS: u32 = 100;
/// Chosen by hand, as Marquardt's rule is: a start from homographies is near, so that little damping is needed.
const FIRST_DAMPING: f64 = 1e-4;
/// A damping at which the equations are given up: a step of 1e-12 of what is wanted changes no loss any more, since that rounds to 1e-16 of sums
/// of its squares.
const MAX_DAMPING: f64 = 1e12;
/// The promised fall, relative to the loss by degree of freedom, that ends it. The promise over that is the square of the step in standard
/// deviations, so that the last steps are less than a thousandth of one.
const LAST_PROMISE: f64 = 1e-7;
/// A loss by degree of freedom that is none, what is left of exact data: residuals of 1e-5 standard deviations, without which the promise would
/// be measured by rounding.
const NOTHING: f64 = 1e-10;
/// As good as the end, where the last steps crawl: by the same derivation a hundredth of a standard deviation.
const GOOD_ENOUGH: f64 = 1e-4;

/// Why there is no minimum.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum BundleFailure {
    /// At the start a corner lies behind a camera.
    BadStart,
    /// The images do not tell every unknown.
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
    let run = Adjustment::new(problem, start, loss)?.steps(MAX_ITERATIONS)?;
    if run.settled {
        return Ok(run.end);
    }
    Err(BundleFailure::NotConverged { iterations: MAX_ITERATIONS })
}

/// A state of less loss near `start`, after so many steps or at the minimum: where it only serves to look at the errors.
pub(crate) fn approach(
    problem: &BundleProblem,
    start: BundleState,
    loss: Loss,
    iterations: u32,
) -> Result<BundleState, BundleFailure> {
    Ok(Adjustment::new(problem, start, loss)?.steps(iterations)?.end.state)
}

/// Steps on their way.
struct Adjustment<'a> {
    problem: &'a BundleProblem,
    loss: Loss,
    dof: f64,
    end: BundleEnd,
    settled: bool,
}

impl<'a> Adjustment<'a> {
    fn new(problem: &'a BundleProblem, state: BundleState, loss: Loss) -> Result<Self, BundleFailure> {
        let dof = problem.degrees_of_freedom();
        if dof == 0 {
            return Err(BundleFailure::Degenerate);
        }
        let sums = BundleSums::at(problem, &state, loss).ok_or(BundleFailure::BadStart)?;
        let end = BundleEnd { state, sums, iterations: 0 };
        Ok(Self { problem, loss, dof: dof as f64, end, settled: false })
    }

    fn steps(mut self, most: u32) -> Result<Self, BundleFailure> {
        let mut damping = FIRST_DAMPING;
        let mut crawling = false;
        for _ in 0..most {
            self.end.iterations += 1;
            let size = (self.end.sums.loss / self.dof).max(NOTHING);
            let Some(step) = self.end.sums.step(damping) else {
                damping *= 10.0;
                if damping > MAX_DAMPING {
                    return Err(BundleFailure::Degenerate);
                }
                continue;
            };
            let candidate = self.problem.moved(&self.end.state, &step.shared, &step.poses);
            let next = BundleSums::at(self.problem, &candidate, self.loss)
                .filter(|next| next.loss <= self.end.sums.loss);
            // A small predicted decrease under strong damping says nothing, because the step is short. The damping follows Levenberg and
            // Marquardt with the usual factors of ten, chosen by hand.
            let last = step.promise < LAST_PROMISE * size && damping < 1e-2;
            crawling = step.promise < GOOD_ENOUGH * size && damping < 1.0;
            match next {
                Some(next) => {
                    (self.end.state, self.end.sums) = (candidate, next);
                    // below rounding it damps nothing
                    damping = (damping * 0.1).max(1e-15);
                }
                // chosen by hand: from nearly nothing back to what shortens a step within a few attempts
                None => damping = (damping * 10.0).max(1e-6),
            }
            // at the minimum rounding alone decides whether the loss falls
            if last || (crawling && damping > 1e3) {
                self.settled = true;
                return Ok(self);
            }
            if damping > MAX_DAMPING {
                return Err(BundleFailure::Degenerate);
            }
        }
        self.settled = crawling;
        Ok(self)
    }
}
