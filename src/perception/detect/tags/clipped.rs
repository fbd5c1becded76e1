//! Clipped pixels in a least-squares fit: a pixel at the last grey level only says that its level is there or above.
//!
//! With the level `m` that a model predicts, noise of deviation `s` and the end of levels at `c`, the log likelihood of "at the end" is
//! `ln(1 - F(z))`, `z = (c - m) / s`, `F` the normal distribution. Newton's step for it is that of least squares with
//!
//! ```text
//! residual s / (h - z), weight w = h (h - z)      h = f(z) / (1 - F(z)), the hazard; w: 0 far above the end, 1 far below
//! ```
//! so that such pixels are further rows of the fit (Tobin's model). The mean weighted square of those residuals is that of `w s^2`, as that of the score is the
//! information, so that the noise may be estimated from all rows together, each counted by `w`.

use crate::imaging::MAX_LEVEL;
use crate::linalg::normal;

/// From here on a level is rounded to the last one.
const END: f64 = MAX_LEVEL - 0.5;
/// Deviations beyond which pixels say nothing, below which they lie on the tail: a predicted level six deviations above the end is below it
/// once in 1e9, as the normal distribution has it.
const SURE_SDS: f64 = 6.0;
/// From here on the hazard is computed by its continued fraction, to 3e-4 of itself, which follows from its next term; the normal distribution's own tail is as exact there.
const TAIL_SDS: f64 = 3.0;

/// Residual, levels, and root of the weight of a pixel at the last level for which `meant` is predicted.
pub(super) fn clipped_residual(meant: f64, noise: f64) -> (f64, f64) {
    let z = (END - meant) / noise;
    if z < -SURE_SDS {
        return (0.0, 0.0);
    }
    let hazard = hazard(z);
    let weight = hazard * (hazard - z);
    (noise / (hazard - z), weight.sqrt())
}

/// Density of the normal distribution over what it has beyond `z`.
fn hazard(z: f64) -> f64 {
    if z > TAIL_SDS {
        return z + 1.0 / (z + 2.0 / (z + 3.0 / (z + 4.0 / z)));
    }
    let (below, density) = normal(z);
    density / (1.0 - below)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Score and information are the derivatives of the log likelihood.
    #[test]
    fn residuals_are_derivatives_of_the_likelihood() {
        let log_likelihood = |meant: f64, noise: f64| {
            // by Simpson's rule over the density, since differences of it are taken
            let (n, z) = (4000, (END - meant) / noise);
            let h = 12.0 / f64::from(n);
            let f = |i: i32| (-0.5 * (z + h * f64::from(i)).powi(2)).exp();
            let sum: f64 = (0..n).step_by(2).map(|i| f(i) + 4.0 * f(i + 1) + f(i + 2)).sum();
            (sum * h / 3.0).ln()
        };
        for noise in [0.5, 2.0, 5.0] {
            for sds in [-4.0, -2.0, -0.5, 0.0, 1.0, 2.5, 3.5, 6.0] {
                let (meant, step) = (END + sds * noise, 1e-2 * noise);
                let [low, at, high] = [-step, 0.0, step].map(|by| log_likelihood(meant + by, noise));
                let (residual, root) = clipped_residual(meant, noise);
                let (score, information) =
                    ((high - low) / (2.0 * step), (2.0 * at - low - high) / step.powi(2));
                let near = |a: f64, b: f64| (a - b).abs() < 4e-3 * b.abs() + 1e-6;
                assert!(
                    near(root * root * residual, score * noise * noise),
                    "{sds}: {residual} {root} {score}"
                );
                assert!(near(root * root, information * noise * noise), "{sds}: {root} {information}");
            }
        }
        assert_eq!(clipped_residual(END + 100.0, 2.0), (0.0, 0.0));
        let (residual, root) = clipped_residual(100.0, 2.0);
        assert!((residual - 154.5).abs() < 0.1 && (root - 1.0).abs() < 1e-3, "{residual} {root}");
    }
}
