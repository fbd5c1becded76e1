//! Grey levels between ink and paper under a camera's gamma, as a function of the share of paper.
//!
//! For a pixel of which the share `w` is paper, a camera of `level = light^(1 / gamma)` shows `ink + contrast f(w)`,
//!
//! ```text
//! f(w) = ((1 + r w)^(1 / gamma) - 1) / ((1 + r)^(1 / gamma) - 1)          1 + r: light of paper / light of ink
//! ```
//! Where the camera subtracts no black level, `1 + r = (paper / ink)^gamma`; `1 + r` is a parameter of its own here, because a camera may subtract one.

use crate::linalg::Eight;

/// Least logarithm of the ratio of light. Derived: below it `f` differs from `w` by less than an eighth of it, a thousandth, and the formula would divide 0 by 0.
const MIN_LOG_LIGHT: f64 = 0.01;
/// The least that `1 + r w` may be: a model's share of paper lies outside of 0 to 1 by thousandths, which a large `r` multiplies. Chosen by hand: a power of
/// half of the ink's light is still a level of ink's kind.
const MIN_BASE: f32 = 0.5;

/// `f` with its constants, for one gamma and one ratio of light.
#[derive(Debug, Clone, Copy)]
pub(super) struct LevelCurve {
    /// 1 / gamma, and `r`.
    exponent: f32,
    r: f32,
    /// `1 / ((1 + r)^exponent - 1)`, and what the end of the curve moves by, per logarithm of gamma and of light, of itself.
    per_end: f32,
    end_by: [f32; 2],
}

/// Values of a curve at eight shares of paper, and its derivatives.
pub(super) struct CurveValues {
    pub(super) value: Eight,
    pub(super) slope: Eight,
    /// By the logarithm of the gamma where the ratio of light stays, and by the logarithm of that ratio where the gamma stays.
    pub(super) by_log_gamma: Eight,
    pub(super) by_log_light: Eight,
}

impl LevelCurve {
    /// The curve for the logarithm of a gamma and the logarithm of the ratio of the light of paper and ink.
    pub(super) fn new(log_gamma: f64, log_light: f64) -> Self {
        // NaN and less light than ink has count as none more
        let log_light = if log_light > MIN_LOG_LIGHT { log_light } else { MIN_LOG_LIGHT };
        let exponent = (-log_gamma).exp();
        let end = (exponent * log_light).exp_m1();
        let by_light = exponent * (end + 1.0) / end;
        Self {
            exponent: exponent as f32,
            r: log_light.exp_m1() as f32,
            per_end: (1.0 / end) as f32,
            end_by: [(-by_light * log_light) as f32, by_light as f32],
        }
    }

    #[inline(always)]
    pub(super) fn at(&self, w: Eight) -> CurveValues {
        let base = w.each(|w| (1.0 + self.r * w).max(MIN_BASE));
        let log2 = base.log2();
        let power = (log2 * self.exponent).two_to() * self.per_end;
        let value = power + (-self.per_end);
        // derivatives of the power by the base's logarithm, and of that by `w` and by the logarithm of light
        let by_base = power * self.exponent;
        let per_base = base.each(|base| 1.0 / base);
        let slope = by_base * per_base * self.r;
        let [by_gamma, by_light] = self.end_by;
        CurveValues {
            value,
            slope,
            by_log_gamma: -(by_base * log2 * std::f32::consts::LN_2) - value * by_gamma,
            by_log_light: by_base * w * per_base * (self.r + 1.0) - value * by_light,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_is_that_of_the_powers() {
        for (gamma, ink, paper) in [
            (1.0, 40.0, 200.0),
            (1.4, 40.0, 200.0),
            (2.2, 80.0, 210.0),
            (2.4, 90.0, 230.0),
            (2.2, 20.0, 230.0),
        ] {
            let log_light = gamma * f64::ln(paper / ink);
            let curve = LevelCurve::new(f64::ln(gamma), log_light);
            let light = |level: f64| f64::powf(level, gamma);
            for i in 0..=20 {
                let w = f64::from(i) / 20.0;
                let level = (light(ink) + w * (light(paper) - light(ink))).powf(1.0 / gamma);
                let at = |w: f64| curve.at(Eight([w as f32; 8]));
                let off = f64::from(at(w).value.0[0]) - (level - ink) / (paper - ink);
                assert!(off.abs() < 1e-5, "gamma {gamma} {w}: {off}");
                // differences of the curve written out in double precision
                let exact = |w: f64, log_gamma: f64, log_light: f64| {
                    let exponent = (-log_gamma).exp();
                    (exponent * (log_light.exp_m1() * w).ln_1p()).exp_m1() / (exponent * log_light).exp_m1()
                };
                let difference = |by: [f64; 3]| {
                    let moved = |sign: f64| {
                        exact(w + sign * by[0], f64::ln(gamma) + sign * by[1], log_light + sign * by[2])
                    };
                    (moved(1.0) - moved(-1.0)) / 2e-6
                };
                let close =
                    |got: f32, wanted: f64| (f64::from(got) - wanted).abs() < 1e-4 * wanted.abs().max(1.0);
                let got = at(w);
                assert!(close(got.slope.0[7], difference([1e-6, 0.0, 0.0])), "gamma {gamma} {w}");
                assert!(close(got.by_log_gamma.0[1], difference([0.0, 1e-6, 0.0])), "gamma {gamma} {w}");
                assert!(close(got.by_log_light.0[2], difference([0.0, 0.0, 1e-6])), "gamma {gamma} {w}");
            }
        }
    }

    #[test]
    fn curves_of_no_contrast_and_of_black_without_light_rise() {
        for (log_gamma, log_light) in [(0.8, 0.0), (0.8, -3.0), (0.8, f64::NAN), (1.4, 7.0), (-0.5, 7.0)] {
            let curve = LevelCurve::new(log_gamma, log_light);
            let values = [0.0, 0.3, 0.6, 1.0].map(|w| curve.at(Eight([w; 8])).value.0[0]);
            assert!(values.is_sorted(), "{values:?}");
            assert!(values[0].abs() < 1e-5 && (values[3] - 1.0).abs() < 1e-5, "{values:?}");
        }
    }
}
