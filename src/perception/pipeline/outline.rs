//! Lines that stand for moments and ellipses, in px.
//!
//! The numbers here are layout, in px of the drawing or shares of it, and were chosen by eye.

use crate::imaging::{Ellipse, Moments};
use nalgebra::Vector2;

/// Corners of an ellipse that is drawn.
const CORNERS: u32 = 90;

/// A polygon that looks like the ellipse.
pub(super) fn of_ellipse(ellipse: &Ellipse) -> Vec<Vector2<f64>> {
    (0..CORNERS).map(|i| ellipse.rim(std::f64::consts::TAU * f64::from(i) / f64::from(CORNERS)).0).collect()
}

/// Half axes of the ellipse with the same moments, the longer first: of a disc of radius r both are r long.
pub(super) fn half_axes(moments: &Moments) -> [Vector2<f64>; 2] {
    let p = moments.principal();
    let (sin, cos) = p.angle_rad.sin_cos();
    // an ellipse of half axis a has the second moment m00 a^2 / 4 along it
    let half = |moment: f64| 2.0 * (moment / moments.m00).max(0.0).sqrt();
    [Vector2::new(cos, sin) * half(p.greater), Vector2::new(-sin, cos) * half(p.smaller)]
}
