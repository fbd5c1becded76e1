//! The homography from the unit square to four image points, in closed form.

use nalgebra::{Matrix2, Vector2};

/// Greatest difference from orthogonal columns of equal length: cosine, and half the logarithm of their squares' ratio. Chosen by hand: centres of
/// small tilted dots and an inaccurate lens model leave some tenths; most accidental quadrilaterals are further off.
pub(super) const ORTHOGONALITY: f64 = 0.35;
/// The same where the lens is not known. Derived: half or twice the focal length makes the squares' ratio up to 3.3 for a target that is tilted by 60 degrees, which
/// is half a logarithm of 0.6.
pub(super) const ORTHOGONALITY_OF_UNKNOWN_LENS: f64 = 0.7;

/// Homography of the unit square (0,0), (1,0), (1,1), (0,1) to a convex quadrilateral:
/// `x = (a u + b v + c) / w`, `y = (d u + e v + f) / w`, `w = g u + h v + 1`.
#[derive(Debug, Clone, Copy)]
pub(super) struct UnitSquare {
    a: f64,
    b: f64,
    d: f64,
    e: f64,
    g: f64,
    h: f64,
}

impl UnitSquare {
    pub(super) fn to([p0, p1, p2, p3]: &[Vector2<f64>; 4]) -> Option<Self> {
        let (d1, d2, sum) = (p1 - p2, p3 - p2, p0 - p1 + p2 - p3);
        let den = d1.x * d2.y - d2.x * d1.y;
        if den == 0.0 {
            return None;
        }
        let g = (sum.x * d2.y - d2.x * sum.y) / den;
        let h = (d1.x * sum.y - sum.x * d1.y) / den;
        Some(Self {
            a: p1.x - p0.x + g * p1.x,
            b: p3.x - p0.x + h * p3.x,
            d: p1.y - p0.y + g * p1.y,
            e: p3.y - p0.y + h * p3.y,
            g,
            h,
        })
    }

    /// Of `[r1 r2 p]` the first two columns are orthogonal and of equal length, as far as `orthogonality` goes ([`ORTHOGONALITY`]).
    pub(super) fn is_view_of_a_square(&self, orthogonality: f64) -> bool {
        let (n1, n2) = (
            self.a * self.a + self.d * self.d + self.g * self.g,
            self.b * self.b + self.e * self.e + self.h * self.h,
        );
        let dot = self.a * self.b + self.d * self.e + self.g * self.h;
        let longest = (2.0 * orthogonality).exp();
        dot * dot < orthogonality * orthogonality * n1 * n2 && n1 < longest * n2 && n2 < longest * n1
    }

    /// Derivative of the image point `s` by the unit square's coordinates, at a corner.
    pub(super) fn jacobian(&self, s: &Vector2<f64>, (u, v): (f64, f64)) -> Option<Matrix2<f64>> {
        let w = self.g * u + self.h * v + 1.0;
        let m = Matrix2::new(
            self.a - s.x * self.g,
            self.b - s.x * self.h,
            self.d - s.y * self.g,
            self.e - s.y * self.h,
        );
        // else the corner lies at infinity or behind the camera
        (w > 1e-9).then(|| m / w)
    }
}
