//! The homography from a square to a quadrilateral, in closed form.

use super::quad::Quad;
use nalgebra::{Matrix2, Vector2};

/// `x -> (a x + b y + c, d x + e y + f) / (g x + h y + 1)`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct PlaneMap([f64; 8]);

impl PlaneMap {
    /// Takes the corners `(0, 0), (side, 0), (side, side), (0, side)` to those of `quad`; `None` when three of them lie in a line.
    pub(super) fn of_square(quad: &Quad, side: f64) -> Option<Self> {
        let [p0, p1, p2, p3] = *quad;
        // two points at infinity, from what is missing to a parallelogram
        let (d1, d2, s) = (p1 - p2, p3 - p2, p0 - p1 + p2 - p3);
        let det = d1.x * d2.y - d1.y * d2.x;
        // Twice the area of a triangle of corners, px^2: anything above rounding would do, since quadrilaterals have sides of 6 px at least.
        if !(det.abs() > 1e-9) {
            return None;
        }
        let g = (s.x * d2.y - s.y * d2.x) / det;
        let h = (d1.x * s.y - d1.y * s.x) / det;
        let (u, v) = (p1 - p0 + g * p1, p3 - p0 + h * p3);
        let per = 1.0 / side;
        Some(Self([u.x * per, v.x * per, p0.x, u.y * per, v.y * per, p0.y, g * per, h * per]))
    }

    /// The map back; `None` where there is none.
    pub(super) fn inverse(&self) -> Option<Self> {
        let [a, b, c, d, e, f, g, h] = self.0;
        let whole = a * e - b * d;
        // About the area of a cell, px^2: anything above rounding would do.
        if !(whole.abs() > 1e-12) {
            return None;
        }
        let adjoint = [
            e - f * h,
            c * h - b,
            b * f - c * e,
            f * g - d,
            a - c * g,
            c * d - a * f,
            d * h - e * g,
            b * g - a * h,
        ];
        Some(Self(adjoint.map(|v| v / whole)))
    }

    /// The same map of `p - origin` for `p`: the nine numbers `a` to `i`, `i` below the line not 1 any longer.
    pub(super) fn about(&self, origin: Vector2<f64>) -> [f64; 9] {
        let [a, b, c, d, e, f, g, h] = self.0;
        let carry = |x: f64, y: f64, z: f64| x * origin.x + y * origin.y + z;
        [a, b, carry(a, b, c), d, e, carry(d, e, f), g, h, carry(g, h, 1.0)]
    }

    /// The image of a point, and its derivatives by the point.
    #[inline]
    pub(super) fn at_with_slope(&self, p: Vector2<f64>) -> (Vector2<f64>, Matrix2<f64>) {
        let [a, b, c, d, e, f, g, h] = self.0;
        let w = 1.0 / (g * p.x + h * p.y + 1.0);
        let q = Vector2::new((a * p.x + b * p.y + c) * w, (d * p.x + e * p.y + f) * w);
        (q, Matrix2::new((a - g * q.x) * w, (b - h * q.x) * w, (d - g * q.y) * w, (e - h * q.y) * w))
    }

    /// The image of a point.
    #[inline]
    pub(super) fn at(&self, p: Vector2<f64>) -> Vector2<f64> {
        let [a, b, c, d, e, f, g, h] = self.0;
        let w = 1.0 / (g * p.x + h * p.y + 1.0);
        Vector2::new((a * p.x + b * p.y + c) * w, (d * p.x + e * p.y + f) * w)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_and_middle() {
        let v = Vector2::new;
        let quad = [v(10.0, 20.0), v(60.0, 25.0), v(70.0, 90.0), v(5.0, 70.0)];
        let map = PlaneMap::of_square(&quad, 8.0).unwrap();
        for (corner, p) in quad.iter().zip([v(0.0, 0.0), v(8.0, 0.0), v(8.0, 8.0), v(0.0, 8.0)]) {
            assert!((map.at(p) - corner).norm() < 1e-9);
        }
        // the middle is where the diagonals meet
        let m = map.at(v(4.0, 4.0));
        let off = |a: Vector2<f64>, b: Vector2<f64>| (b - a).normalize().perp(&(m - a)).abs();
        assert!(off(quad[0], quad[2]) < 1e-9 && off(quad[1], quad[3]) < 1e-9);
        let back = map.inverse().unwrap();
        let (p, d) = (v(33.0, 41.0), 1e-5);
        let (q, slope) = back.at_with_slope(p);
        assert!((map.at(q) - p).norm() < 1e-9 && (back.at(p) - q).norm() < 1e-12);
        let column = |e: Vector2<f64>| (back.at(p + e * d) - back.at(p - e * d)) / (2.0 * d);
        assert!((slope.column(0) - column(Vector2::x())).norm() < 1e-6);
        assert!((slope.column(1) - column(Vector2::y())).norm() < 1e-6);
        assert_eq!(PlaneMap::of_square(&[v(0.0, 0.0), v(1.0, 1.0), v(2.0, 2.0), v(3.0, 3.0)], 1.0), None);
    }
}
