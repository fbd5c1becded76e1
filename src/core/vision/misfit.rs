//! Bounds on the misfit (the reprojection error over its stated variance, chi-square distributed): up to where it is chance, and where a measurement is
//! rejected. For single images, which are not rejected, a misfit beyond chance enlarges the stated covariances ([`Growth`]).

/// Largest misfit of four dots that is accepted: `T = 4 rms^2 / sd^2`, the sum of squares of the 8 reprojection errors over
/// the mean variance of a coordinate. With 6 parameters of the pose it has a chi-square distribution with 2 degrees of
/// freedom, which exceeds 20 once in 22 000 times; in strong blur the stated variances are a few times too small.
pub(super) const MAX_MISFIT: f64 = 50.0;
/// Share of a variance that was learnt from images, in place of stated, in the one that the limits are for. Derived: these leave two and a half times the quantile of 20 because stated variances
/// may be too small; learnt ones contain all that there is.
pub(super) const LEARNT_SHARE: f64 = 20.0 / MAX_MISFIT;
/// The normal deviate of that probability, exp(-10), by the normal distribution's quantile.
const MISFIT_DEVIATE: f64 = 3.91;

/// Largest misfit with `freedom` degrees of freedom: the quantile of the chi-square distribution (Wilson and Hilferty's
/// approximation) that is as improbable as that of four dots, and as much room above it.
pub(super) fn largest(freedom: f64) -> f64 {
    MAX_MISFIT * quantile(freedom, MISFIT_DEVIATE) / quantile(2.0, MISFIT_DEVIATE)
}

/// Quantile of the chi-square distribution for the probability of a normal deviate (Wilson and Hilferty's approximation).
fn quantile(freedom: f64, deviate: f64) -> f64 {
    let spread = 2.0 / (9.0 * freedom);
    freedom * (1.0 - spread + deviate * spread.sqrt()).powi(3)
}

/// Normal deviate of the quantile above which a misfit is not chance: one image in a thousand.
const CHANCE_DEVIATE: f64 = 3.09;
/// Factor by which the variance of points may exceed the stated one without a misfit. Chosen by hand: stated variances are right to a
/// quarter, and the rest is margin.
const NOISE: f64 = 1.5;
/// From so many points on some may be left out: four of six are left at least, because four are the fewest with redundancy.
pub(super) const ENOUGH_TO_CHOOSE: usize = 6;

/// Factors on variances by the misfit of one image's pose: 1 where the misfit is within chance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Growth {
    /// Factor on the stated variance of a point.
    pub points: f64,
    /// Factor on the covariance of the pose that follows from the stated variances of the points.
    pub pose: f64,
}

impl Growth {
    /// A misfit within chance: nothing is enlarged.
    pub const NONE: Self = Self { points: 1.0, pose: 1.0 };

    /// Of `count` points whose squares of reprojection errors over their variance have the sum `misfit`.
    ///
    /// What moves points beyond their stated deviations and what [`NOISE`] allows for (a lens that is another, rows that were exposed one
    /// after the other, a bent plate) moves neighbours alike: it is one error, however many points show it, of which the pose takes
    /// about as much as it leaves.
    pub(super) fn of(count: usize, misfit: f64) -> Self {
        let freedom = 2.0 * count as f64 - 6.0;
        // no number is no reason
        if !(freedom > 0.0 && misfit > quantile(freedom, CHANCE_DEVIATE)) {
            return Self::NONE;
        }
        let mean = misfit / freedom;
        // of few points none is left out: one of them may have all of it
        let points = if count < ENOUGH_TO_CHOOSE { misfit } else { mean };
        Self { points, pose: mean + (mean - NOISE).max(0.0) * freedom }
    }
}
