//! Scalar gain lambda of the resolved-velocity laws, 1/s: constant, or adaptive, growing as the error shrinks (as ViSP's `vpAdaptiveGain`).
//!
//! A law multiplies its gain matrix (K of B, K_s of D, K_p and K_o of the hybrid law) by it at every law output.

/// The scalar gain lambda of a resolved-velocity law.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Gain {
    /// The same for every error, 1/s.
    Constant(f64),
    /// `lambda(x) = (l_0 - l_inf) exp(-slope x / (l_0 - l_inf)) + l_inf` for the error norm x: slow while the error is
    /// large, fast near the goal.
    Adaptive {
        /// l_0, at zero error, 1/s.
        at_zero_1_s: f64,
        /// l_inf, for large errors, 1/s.
        at_infinity_1_s: f64,
        /// Descent of lambda at zero error, 1/s per unit of the error norm.
        slope_1_s: f64,
    },
}

impl Gain {
    /// lambda for an error of norm `error` (m and rad for B, normalized units for D), 1/s.
    #[must_use]
    pub fn at(&self, error: f64) -> f64 {
        match *self {
            Self::Constant(gain) => gain,
            Self::Adaptive { at_zero_1_s, at_infinity_1_s, slope_1_s } => {
                let span = at_zero_1_s - at_infinity_1_s;
                // The slope is divided by the span; gains as equal as this are one gain, because lambda stays between the two.
                if span.abs() < 1e-12 {
                    return at_infinity_1_s;
                }
                span * (-slope_1_s * error / span).exp() + at_infinity_1_s
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn adaptive_gain_has_the_ends_and_the_slope_that_it_is_given() {
        let g = Gain::Adaptive { at_zero_1_s: 4.0, at_infinity_1_s: 0.4, slope_1_s: 30.0 };
        assert!((g.at(0.0) - 4.0).abs() < 1e-12);
        assert!((g.at(1e3) - 0.4).abs() < 1e-12);
        let h = 1e-6;
        assert!(((g.at(h) - g.at(0.0)) / h + 30.0).abs() < 1e-3);
        assert!((1..100).all(|i| g.at(0.01 * f64::from(i)) < g.at(0.01 * f64::from(i - 1))));
        let flat = Gain::Adaptive { at_zero_1_s: 2.0, at_infinity_1_s: 2.0, slope_1_s: 30.0 };
        assert_eq!((flat.at(0.3), Gain::Constant(2.0).at(0.3)), (2.0, 2.0));
    }
}
