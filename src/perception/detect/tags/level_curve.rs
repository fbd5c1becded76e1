//! Grey levels between ink and paper under a camera's gamma, as a function of the share of paper.
//!
//! For a pixel of which the share `w` is paper, a camera of `level = light^(1 / gamma)` shows `ink + contrast f(w)`,
//!
//! ```text
//! f(w) = ((1 + r w)^(1 / gamma) - 1) / ((1 + r)^(1 / gamma) - 1)          1 + r = (paper / ink)^gamma: their light
//!      = w + w (1 - w) q(w)
//! ```
//! `q` is smooth and is approximated by an interpolating polynomial through six points, because it is evaluated for each pixel.

use crate::linalg::Eight;

/// Points of the polynomial: with six its error is less than a thousandth of the contrast where paper has ten times the light of ink, and by six of them where
/// it has thirty times.
const COUNT: usize = 6;
/// Points at which `q` is evaluated: the roots of Chebyshev's polynomial of that degree, from 0 to 1, because between these it errs least.
const PLACES: [f32; COUNT] =
    [0.017_037_087, 0.146_446_6, 0.370_590_48, 0.629_409_5, 0.853_553_4, 0.982_962_9];
/// Printed ink still reflects a thirtieth of what paper does; where levels are lower the camera has subtracted a black level.
const MAX_PAPER_TO_INK: f64 = 30.0;
/// Step of the derivatives by logarithms.
const STEP: f64 = 1e-3;

/// `f`, and its derivatives by the logarithms of the gamma and of paper / ink: Newton's coefficients of the three `q`.
#[derive(Debug, Clone, Copy)]
pub(super) struct LevelCurve {
    q: [f32; COUNT],
    by_log_gamma: [f32; COUNT],
    by_log_ratio: [f32; COUNT],
}

/// Values of a curve at eight shares of paper, and its derivatives.
pub(super) struct CurveValues {
    pub(super) value: Eight,
    pub(super) slope: Eight,
    pub(super) by_log_gamma: Eight,
    pub(super) by_log_ratio: Eight,
}

impl LevelCurve {
    /// The curve for the logarithm of a gamma and the ratio of the levels of paper and ink.
    pub(super) fn new(log_gamma: f64, paper_to_ink: f64) -> Self {
        let log_ratio = paper_to_ink.max(1.0).ln();
        let change = |gamma: f64, ratio: f64| {
            let (mut by, less) =
                (newton(log_gamma + gamma, log_ratio + ratio), newton(log_gamma - gamma, log_ratio - ratio));
            by.iter_mut().zip(less).for_each(|(more, less)| *more = (*more - less) / (2.0 * STEP));
            by.map(|by| by as f32)
        };
        Self {
            q: newton(log_gamma, log_ratio).map(|q| q as f32),
            by_log_gamma: change(STEP, 0.0),
            by_log_ratio: change(0.0, STEP),
        }
    }

    #[inline(always)]
    pub(super) fn at(&self, w: Eight) -> CurveValues {
        let [mut q, mut slope, mut by_log_gamma, mut by_log_ratio] = [Eight::ZERO; 4];
        let coefficients = self.q.iter().zip(&self.by_log_gamma).zip(&self.by_log_ratio);
        for (((c, g), r), place) in coefficients.zip(PLACES).rev() {
            let off = w + (-place);
            slope = slope * off + q;
            q = q * off + *c;
            by_log_gamma = by_log_gamma * off + *g;
            by_log_ratio = by_log_ratio * off + *r;
        }
        let hump = w * (-w + 1.0);
        CurveValues {
            value: w + hump * q,
            slope: (w * -2.0 + 1.0) * q + hump * slope + 1.0,
            by_log_gamma: hump * by_log_gamma,
            by_log_ratio: hump * by_log_ratio,
        }
    }
}

/// Coefficients of `q` in Newton's form, by divided differences.
#[allow(clippy::indexing_slicing)] // indices below the length
fn newton(log_gamma: f64, log_ratio: f64) -> [f64; COUNT] {
    let gamma = log_gamma.exp();
    // for equal levels the curve would be 0 / 0
    let light = (gamma * log_ratio).exp().clamp(1.01, MAX_PAPER_TO_INK);
    let level = |w: f64| (1.0 + (light - 1.0) * w).powf(1.0 / gamma) - 1.0;
    let x = PLACES.map(f64::from);
    let mut q = x.map(|w| (level(w) / level(1.0) - w) / (w * (1.0 - w)));
    for order in 1..COUNT {
        for i in (order..COUNT).rev() {
            q[i] = (q[i] - q[i - 1]) / (x[i] - x[i - order]);
        }
    }
    q
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_is_that_of_the_powers() {
        for (gamma, ink, paper) in
            [(1.0, 40.0, 200.0), (1.4, 40.0, 200.0), (2.2, 80.0, 210.0), (2.4, 90.0, 230.0)]
        {
            let curve = LevelCurve::new(f64::ln(gamma), paper / ink);
            let light = |level: f64| f64::powf(level, gamma);
            for i in 0..=20 {
                let w = f64::from(i) / 20.0;
                let level = (light(ink) + w * (light(paper) - light(ink))).powf(1.0 / gamma);
                let at = |w: f64| curve.at(Eight([w as f32; 8]));
                let off = f64::from(at(w).value.0[3]) - (level - ink) / (paper - ink);
                assert!(off.abs() < 1e-3, "gamma {gamma} {w}: {off}");
                let h = 2e-3;
                let slope = f64::from(at(w + h).value.0[0] - at(w - h).value.0[0]) / (2.0 * h);
                assert!((f64::from(at(w).slope.0[0]) - slope).abs() < 2e-3, "gamma {gamma} {w}");
                let other = |log: f64| LevelCurve::new(log, paper / ink).at(Eight([w as f32; 8])).value.0[0];
                let by = f64::from(other(f64::ln(gamma) + 0.05) - other(f64::ln(gamma) - 0.05)) / 0.1;
                assert!((f64::from(at(w).by_log_gamma.0[0]) - by).abs() < 2e-3, "gamma {gamma} {w}");
                let other =
                    |ratio: f64| LevelCurve::new(f64::ln(gamma), ratio).at(Eight([w as f32; 8])).value.0[0];
                let by = f64::from(other(1.05 * paper / ink) - other(0.95 * paper / ink)) / 0.1;
                assert!((f64::from(at(w).by_log_ratio.0[0]) - by).abs() < 2e-3, "gamma {gamma} {w}");
            }
        }
    }

    #[test]
    fn curves_of_no_contrast_and_of_black_without_light_rise() {
        for (log_gamma, paper_to_ink) in
            [(0.8, 1.0), (0.8, 0.0), (0.8, f64::NAN), (1.6, 1e9), (-0.5, f64::INFINITY)]
        {
            let curve = LevelCurve::new(log_gamma, paper_to_ink);
            let values = [0.0, 0.3, 0.6, 1.0].map(|w| curve.at(Eight([w; 8])).value.0[0]);
            assert!(values.is_sorted() && values[0] == 0.0 && values[3] == 1.0, "{values:?}");
        }
    }
}
