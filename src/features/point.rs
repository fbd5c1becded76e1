//! The image point, (10.3), (10.27), and its image Jacobian.

use super::Feature;
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

/// The interaction matrix of a point, (10.27): `s_dot = L_s V_BC_C` for a fixed object.
///
/// `s` normalized, `z_m` the depth in m (not zero). Columns 0..3 in 1/m, 3..6 in 1/rad.
#[must_use]
#[inline]
pub fn point_rows(s: &Vector2<f64>, z_m: f64) -> SMatrix<f64, 2, 6> {
    let (X, Y, a) = (s.x, s.y, 1.0 / z_m);
    SMatrix::<f64, 2, 6>::new(
        -a,
        0.0,
        X * a,
        X * Y,
        -(1.0 + X * X),
        Y, //
        0.0,
        -a,
        Y * a,
        1.0 + Y * Y,
        -X * Y,
        -X,
    )
}

/// The image Jacobian of a point, (10.21) with (10.27): `s_dot = J_s V` for the twist V of O relative to C, (10.16).
///
/// `r_o_C`: position of the point from O, expressed in C, m.
#[must_use]
#[inline]
pub fn point_image_jacobian(s: &Vector2<f64>, z_m: f64, r_o_C: &Vector3<f64>) -> SMatrix<f64, 2, 6> {
    let (X, Y) = (s.x, s.y);
    let r = r_o_C;
    SMatrix::<f64, 2, 6>::new(
        1.0,
        0.0,
        -X,
        -r.y * X,
        r.z + r.x * X,
        -r.y, //
        0.0,
        1.0,
        -Y,
        -(r.z + r.y * Y),
        r.x * Y,
        r.x,
    ) / z_m
}
