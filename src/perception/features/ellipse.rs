//! The image of a disc, or of an ellipse, in a plane: `[x_g, y_g, n20, n11, n02]`.
//!
//! Centroid and normalized central moments `n_ij = mu_ij / a` of second order fix an ellipse: its half axes are twice the roots of the
//! eigenvalues of `[[n20, n11], [n11, n02]]`. Rates as in [`ImageMoments::rates`]; of an ellipse the central moments of third order,
//! which those of second order move with, are 0, and the area drops out.

use super::Feature;
use super::flow::Flow;
use super::moments::{AreaFeature, Central, ImageMoments, finite, rows, values};
use nalgebra::{SMatrix, Vector2, Vector3, Vector5};

/// Least product of the principal second moments, as a share of their sum squared: an ellipse a million times as long as wide. The
/// determinant is a difference that rounds to 1e-16, so that its width would have two digits left.
const MIN_WIDTH: f64 = 1e-12;

/// An ellipse in the image, or the ellipse with the second moments of an area in the image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EllipseFeature {
    moments: ImageMoments,
    plane: Vector3<f64>,
}

impl EllipseFeature {
    /// An ellipse by half its axes and the angle from x to the first, rad, in normalized coordinates; and `[A, B, C]` of the object's
    /// plane `1/z_c = A x + B y + C`, 1/m; an estimate or that of the goal suffices.
    #[must_use]
    pub fn new(s: Vector2<f64>, semi_axes: [f64; 2], turn_rad: f64, plane: Vector3<f64>) -> Self {
        let ((sin, cos), [a, b]) = (turn_rad.sin_cos(), semi_axes.map(|a| 0.25 * a * a));
        let n = [a * cos * cos + b * sin * sin, (a - b) * sin * cos, a * sin * sin + b * cos * cos];
        Self { moments: ImageMoments::of_second_order(1.0, &s, n), plane }
    }

    /// The centroid and the second moments of an area of any form.
    #[must_use]
    pub fn of_area(area: &AreaFeature) -> Self {
        Self { moments: area.moments, plane: area.plane }
    }

    fn flows(&self) -> [Flow; 5] {
        let c = Central::of(&self.moments, &self.plane);
        [c.x, c.y, c.mu20 / c.area, c.mu11 / c.area, c.mu02 / c.area]
    }
}

impl Feature<5> for EllipseFeature {
    fn value(&self) -> Vector5<f64> {
        values(self.flows())
    }

    fn interaction(&self) -> Option<SMatrix<f64, 5, 6>> {
        let [.., n20, n11, n02] = self.flows().map(|flow| flow.value);
        // the area of a line is rounding alone
        let wide = n20 * n02 - n11 * n11 > MIN_WIDTH * (n20 + n02) * (n20 + n02);
        if !(n20 > 0.0 && wide && self.moments.is_there(&self.plane)) {
            return None;
        }
        finite(rows(self.flows()))
    }
}
