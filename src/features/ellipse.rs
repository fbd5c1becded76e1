//! The image of a disc, or of an ellipse, in a plane: `[x_g, y_g, n20, n11, n02]`.
//!
//! Centroid and normalized central moments `n_ij = mu_ij / a` of second order fix an ellipse: its half axes are twice the roots of the
//! eigenvalues of `[[n20, n11], [n11, n02]]`. Rates as in [`ImageMoments::rates`]; of an ellipse the central moments of third order,
//! which those of second order move with, are 0, and the area drops out.

use super::Feature;
use super::flow::Flow;
use super::moments::{Central, ImageMoments};
use nalgebra::{SMatrix, SVector, Vector2, Vector3, Vector5};

/// An ellipse in the image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EllipseFeature {
    /// Its centre, normalized coordinates.
    pub s: Vector2<f64>,
    /// `[n20, n11, n02]`, normalized coordinates squared.
    pub n: [f64; 3],
    /// `[A, B, C]` of the object's plane `1/z_c = A x + B y + C`, 1/m; an estimate or that of the goal will do.
    pub plane: Vector3<f64>,
}

impl EllipseFeature {
    /// An ellipse by half its axes and the angle from x to the first, rad, in normalized coordinates.
    #[must_use]
    pub fn new(s: Vector2<f64>, semi_axes: [f64; 2], turn_rad: f64, plane: Vector3<f64>) -> Self {
        let ((sin, cos), [a, b]) = (turn_rad.sin_cos(), semi_axes.map(|a| 0.25 * a * a));
        let n = [a * cos * cos + b * sin * sin, (a - b) * sin * cos, a * sin * sin + b * cos * cos];
        Self { s, n, plane }
    }
}

impl Feature<5> for EllipseFeature {
    fn value(&self) -> Vector5<f64> {
        let [n20, n11, n02] = self.n;
        Vector5::new(self.s.x, self.s.y, n20, n11, n02)
    }

    fn interaction(&self) -> Option<SMatrix<f64, 5, 6>> {
        let [n20, n11, n02] = self.n;
        let depth = self.plane.dot(&self.s.push(1.0));
        if !(n20 > 0.0 && n20 * n02 > n11 * n11 && depth > 0.0) {
            return None;
        }
        let c = Central::of(&ImageMoments::of_second_order(1.0, &self.s, self.n), &self.plane);
        let n = |mu: Flow| (mu / c.area).row;
        let rows: [SVector<f64, 6>; 5] = [c.x.row, c.y.row, n(c.mu20), n(c.mu11), n(c.mu02)];
        let L = SMatrix::<f64, 5, 6>::from_fn(|k, j| rows.get(k).map_or(0.0, |row| row[j]));
        L.iter().all(|x| x.is_finite()).then_some(L)
    }
}
