//! What clipping leaves of a rim: levels that end in the middle of an edge.
//!
//! Where the plate, or a lighter dot, is beyond the last grey level, an edge rises steeply up to that level and is flat from there on. The sum over
//! pixels of a profile `w(x)` whose slope leaps by `J` depends on where the leap lies between pixels. By Poisson's formula each wave vector `k` of the
//! grid of pixels contributes what the profile has of it, `J / (2 pi k)^2`, at the two places of the rim whose normal is along `k`. For an ellipse that reaches `X` to either
//! side of its centre, over random places,
//!
//! ```text
//! k = (1, 0):     var x = J^2 / (4 pi^6 X)     var y = var x (S_xy / S_xx)^2     S: second moments
//! all others:     1/4 as much in the sum over k of |k|^-5 k_x^2 / |k|^2
//! ```
//! The leap is measured: as the density of pixels just before the end.

use std::f64::consts::PI;

/// Part of the weights, just before the end, in which pixels are counted. Chosen by hand: some 40 pixels on four dots of 9 px; half has too few, over
/// the double the slope of an edge that is hardly clipped changes.
pub(super) const END_SHARE: f64 = 0.1;
/// Sum over all wave vectors of pixels, in that of the shortest. Derived: (1, 0) 1, (1, 1) and (1, -1) 0.177, (2, 0) 0.031, (2, 1) and alike 0.036.
const WAVES: f64 = 1.25;

/// The leap of the slope at a clipped end, beyond that which an end that is not clipped has by its dead zone.
#[derive(Debug, Clone, Copy)]
pub(super) struct EndSlope {
    /// Its square, of weights from 0 to 1, 1/px^2.
    square: f64,
}

impl EndSlope {
    /// Of rims with that `length`, px, and so many pixels `at_end`. An end that is not clipped would lie `deviate` deviations `blur_px` beyond the middle.
    pub(super) fn of(at_end: f64, length: f64, deviate: f64, blur_px: f64) -> Self {
        // half a pixel for what rounding leaves out
        let slope = END_SHARE * length / (at_end + 0.5);
        let usual = (-0.5 * deviate * deviate).exp() / ((2.0 * PI).sqrt() * blur_px);
        Self { square: (slope * slope - usual * usual).max(0.0) }
    }

    /// Standard deviation, per coordinate, px, of the centroid of a dot with these second moments `[xx, xy, yy]`, px^2.
    pub(super) fn sd_px(&self, [xx, xy, yy]: &[f64; 3]) -> f64 {
        // the moments of an ellipse are a quarter of its half axes' squares
        let along = |own: f64| (1.0 + (xy / own).powi(2)) / (2.0 * own.sqrt());
        (0.5 * WAVES * self.square * (along(*xx) + along(*yy)) / (4.0 * PI.powi(6))).sqrt()
    }
}
