//! How badly a model may explain what was measured before it is not believed.

/// Largest misfit of four good dots: `T = 4 rms^2 / sigma^2`, the sum of squares of the 8 reprojection errors over
/// the mean variance of a coordinate. With 6 parameters of the pose it has a chi-square distribution with 2 degrees of
/// freedom, which exceeds 20 once in 22 000 times; in strong blur the stated variances are a few times too small.
pub(super) const LARGEST_MISFIT: f64 = 50.0;
/// The normal deviate of that probability.
const MISFIT_DEVIATE: f64 = 3.91;

/// Largest misfit with `freedom` degrees of freedom: the quantile of the chi-square distribution (Wilson and Hilferty's
/// approximation) that is as improbable as that of four dots, and as much room above it.
pub(super) fn largest(freedom: f64) -> f64 {
    let quantile = |freedom: f64| {
        let spread = 2.0 / (9.0 * freedom);
        freedom * (1.0 - spread + MISFIT_DEVIATE * spread.sqrt()).powi(3)
    };
    LARGEST_MISFIT * quantile(freedom) / quantile(2.0)
}
