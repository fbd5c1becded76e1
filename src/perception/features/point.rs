//! The image point, (10.3), (10.27), and its image Jacobian.

use super::Feature;
use crate::linalg::Number;
use nalgebra::{SMatrix, Vector2, Vector3};

/// An image point with the depth of the point that it shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointFeature {
    /// Normalized coordinates (X, Y).
    pub s: Vector2<f64>,
    /// Depth z_c along the optical axis, m; an estimate or the value at the goal will do (Sect. 10.8.1).
    pub z_m: f64,
}

impl Feature<2> for PointFeature {
    fn value(&self) -> Vector2<f64> {
        self.s
    }

    fn interaction(&self) -> Option<SMatrix<f64, 2, 6>> {
        (self.z_m > 0.0).then(|| point_rows(&self.s, self.z_m))
    }
}

/// Two rows over twists `[v; w]` that one point brings into a matrix: `[d, 0, x...]` and `[0, d, y...]`.
///
/// The only place where they are written down, for whatever number: laws and studies take f64, the refinement of poses
/// takes the points two at a time.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PointRows<T> {
    /// The one entry before column 2 that is not zero.
    pub(crate) d: T,
    /// Columns 2..6 of the first row.
    pub(crate) x: [T; 4],
    /// Columns 2..6 of the second row.
    pub(crate) y: [T; 4],
}

impl<T: Number> PointRows<T> {
    /// The interaction matrix (10.27) at `(X, Y)`, with `a` = 1/z_c.
    #[inline(always)]
    pub(crate) fn interaction([X, Y]: [T; 2], a: T) -> Self {
        let (one, XY) = (T::splat(1.0), X * Y);
        Self { d: -a, x: [X * a, XY, -(one + X * X), Y], y: [Y * a, one + Y * Y, -XY, -X] }
    }

    /// The image Jacobian, (10.21) with (10.27), at `(X, Y)` of a point that lies at `r` = r_o_C from O; `a` = 1/z_c.
    #[inline(always)]
    pub(crate) fn image_jacobian([X, Y]: [T; 2], a: T, r: [T; 3]) -> Self {
        let [x, y, z] = r;
        let (aX, aY, az) = (-(a * X), -(a * Y), a * z);
        Self { d: a, x: [aX, aX * y, az - aX * x, -(a * y)], y: [aY, aY * y - az, -(aY * x), a * x] }
    }
}

impl PointRows<f64> {
    #[inline(always)]
    fn matrix(&self) -> SMatrix<f64, 2, 6> {
        let (d, [x2, x3, x4, x5], [y2, y3, y4, y5]) = (self.d, self.x, self.y);
        SMatrix::<f64, 2, 6>::new(d, 0.0, x2, x3, x4, x5, 0.0, d, y2, y3, y4, y5)
    }
}

/// The interaction matrix of a point, (10.27): `s_dot = L_s V_BC_C` for a fixed object.
///
/// `s` normalized, `z_m` the depth in m (not zero). Columns 0..3 in 1/m, 3..6 in 1/rad.
#[must_use]
#[inline]
pub fn point_rows(s: &Vector2<f64>, z_m: f64) -> SMatrix<f64, 2, 6> {
    PointRows::interaction([s.x, s.y], 1.0 / z_m).matrix()
}

/// The image Jacobian of a point, (10.21) with (10.27): `s_dot = J_s V` for the twist V of O relative to C, (10.16).
///
/// `r_o_C`: position of the point from O, expressed in C, m.
#[must_use]
#[inline]
pub fn point_image_jacobian(s: &Vector2<f64>, z_m: f64, r_o_C: &Vector3<f64>) -> SMatrix<f64, 2, 6> {
    PointRows::image_jacobian([s.x, s.y], 1.0 / z_m, (*r_o_C).into()).matrix()
}
