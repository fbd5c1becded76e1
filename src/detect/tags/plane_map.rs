//! The projective map from a square to a quadrilateral.

use super::quad::Quad;
use nalgebra::Vector2;

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
        if !(det.abs() > 1e-9) {
            return None;
        }
        let g = (s.x * d2.y - s.y * d2.x) / det;
        let h = (d1.x * s.y - d1.y * s.x) / det;
        let (u, v) = (p1 - p0 + g * p1, p3 - p0 + h * p3);
        let per = 1.0 / side;
        Some(Self([u.x * per, v.x * per, p0.x, u.y * per, v.y * per, p0.y, g * per, h * per]))
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
        assert_eq!(PlaneMap::of_square(&[v(0.0, 0.0), v(1.0, 1.0), v(2.0, 2.0), v(3.0, 3.0)], 1.0), None);
    }
}
