//! An ellipse by its centre and the matrix `S = [xx, xy, yy]` of `(x - centre)^T S^-1 (x - centre) = 1`, px: no axis is preferred, a
//! circle is as good as any.

use nalgebra::Vector2;

/// An ellipse.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ellipse {
    /// Centre, px.
    pub centre_px: Vector2<f64>,
    /// `[xx, xy, yy]` of `S`, px^2: `(x - centre)^T S^-1 (x - centre) = 1` on the rim.
    pub shape_px2: [f64; 3],
}

impl Ellipse {
    /// The ellipse with half axes `a_px`, `b_px`, the first turned by `angle_rad` from x towards y.
    #[must_use]
    pub fn new(centre_px: Vector2<f64>, a_px: f64, b_px: f64, angle_rad: f64) -> Self {
        let (sin, cos) = angle_rad.sin_cos();
        let (aa, bb) = (a_px * a_px, b_px * b_px);
        let shape_px2 =
            [aa * cos * cos + bb * sin * sin, (aa - bb) * sin * cos, aa * sin * sin + bb * cos * cos];
        Self { centre_px, shape_px2 }
    }

    /// Half axes, px, the greater first.
    #[must_use]
    pub fn axes_px(&self) -> (f64, f64) {
        let [xx, xy, yy] = self.shape_px2;
        let (mean, size) = (0.5 * (xx + yy), (0.5 * (xx - yy)).hypot(xy));
        ((mean + size).max(0.0).sqrt(), (mean - size).max(0.0).sqrt())
    }

    /// Angle of the greater axis from x towards y, rad, -π/2..=π/2; of a circle any.
    #[must_use]
    pub fn angle_rad(&self) -> f64 {
        let [xx, xy, yy] = self.shape_px2;
        0.5 * (2.0 * xy).atan2(xx - yy)
    }

    /// Whether it is an ellipse at all: finite numbers, and both axes greater than 0.
    #[must_use]
    pub fn is_real(&self) -> bool {
        let [xx, xy, yy] = self.shape_px2;
        xx > 0.0
            && yy > 0.0
            && xx * yy - xy * xy > 0.0
            && (xx + yy + self.centre_px.x + self.centre_px.y).is_finite()
    }

    /// The point of the rim at parameter `t` (rad, a full turn around), and the outward normal there, of length 1.
    #[must_use]
    pub fn rim(&self, t: f64) -> (Vector2<f64>, Vector2<f64>) {
        let (sin, cos) = t.sin_cos();
        let [xx, xy, yy] = self.shape_px2;
        // L (cos, sin) with S = L L^T
        let l11 = xx.max(1e-300).sqrt(); // not 0, else the next line would divide by it
        let l21 = xy / l11;
        let l22 = (yy - l21 * l21).max(0.0).sqrt();
        let d = Vector2::new(l11 * cos, l21 * cos + l22 * sin);
        (self.centre_px + d, self.gradient(&d).try_normalize(0.0).unwrap_or(Vector2::x()))
    }

    /// Where a row (`y`) or column crosses the rim: both positions along it, the smaller first. `None` where it passes by.
    #[must_use]
    pub fn crossings(&self, line: f64, row: bool) -> Option<[f64; 2]> {
        let [xx, xy, yy] = self.shape_px2;
        let (c, along, across) = if row {
            (self.centre_px, xx, yy)
        } else {
            (Vector2::new(self.centre_px.y, self.centre_px.x), yy, xx)
        };
        let d = line - c.y;
        let square = 1.0 - d * d / across;
        let half = (along - xy * xy / across).max(0.0).sqrt() * square.max(0.0).sqrt();
        let middle = c.x + xy / across * d;
        (square > 0.0).then_some([middle - half, middle + half])
    }

    /// Second derivative of the greater of both [`Self::crossings`] by the line, 1/px; that of the smaller is its opposite.
    #[must_use]
    pub fn bend(&self, line: f64, row: bool) -> f64 {
        let [xx, xy, yy] = self.shape_px2;
        let (c, along, across) = if row { (self.centre_px.y, xx, yy) } else { (self.centre_px.x, yy, xx) };
        let square = 1.0 - (line - c).powi(2) / across;
        let half = (along - xy * xy / across).max(0.0).sqrt();
        if square > 0.0 { -half / across * square.powf(-1.5) } else { 0.0 }
    }

    /// The outward normal of length 1 of the ellipse of this shape and centre through a point.
    #[must_use]
    pub fn normal_at(&self, px: &Vector2<f64>) -> Vector2<f64> {
        self.gradient(&(px - self.centre_px)).try_normalize(0.0).unwrap_or(Vector2::x())
    }

    /// Distance of a point from the rim, px, to first order; greater than 0 outside.
    #[must_use]
    pub fn distance_px(&self, px: &Vector2<f64>) -> f64 {
        let d = px - self.centre_px;
        let g = self.gradient(&d);
        let value = d.dot(&g) * 0.5 - 1.0;
        if g.norm() > 0.0 { value / g.norm() } else { -self.axes_px().1 }
    }

    /// Gradient of `d^T S^-1 d`.
    pub(super) fn gradient(&self, d: &Vector2<f64>) -> Vector2<f64> {
        let [xx, xy, yy] = self.shape_px2;
        let det = xx * yy - xy * xy;
        Vector2::new(yy * d.x - xy * d.y, xx * d.y - xy * d.x) * (2.0 / det)
    }
}
