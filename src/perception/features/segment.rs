//! The line segment between two image points, (10.28).

use super::{Feature, point_rows};
use nalgebra::{SMatrix, Vector2, Vector4};
use std::f64::consts::{PI, TAU};

/// A segment by the images of its ends and their depths.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SegmentFeature {
    /// Normalized coordinates of the ends P_1 and P_2.
    pub s: [Vector2<f64>; 2],
    /// Depths of the ends, m.
    pub z_m: [f64; 2],
}

impl Feature<4> for SegmentFeature {
    fn value(&self) -> Vector4<f64> {
        segment_features(&self.s)
    }

    fn interaction(&self) -> Option<SMatrix<f64, 4, 6>> {
        segment_rows(&self.s, self.z_m)
    }

    /// With alpha's difference wrapped to (-pi, pi].
    fn error(&self, desired: &Vector4<f64>) -> Vector4<f64> {
        let mut e = desired - self.value();
        e.w = wrap_rad(e.w);
        e
    }
}

/// The features `[x_mean, y_mean, L, alpha]` of (10.28); alpha in (-pi, pi], so that the ends are distinguished.
#[must_use]
pub fn segment_features(s: &[Vector2<f64>; 2]) -> Vector4<f64> {
    let mean = (s[0] + s[1]) * 0.5;
    let delta = s[1] - s[0];
    Vector4::new(mean.x, mean.y, delta.norm(), delta.y.atan2(delta.x))
}

/// The interaction matrix of a segment from its ends and their depths in m.
///
/// `None` when the ends coincide, where alpha is not defined, or a depth is not positive.
#[must_use]
pub fn segment_rows(s: &[Vector2<f64>; 2], z_m: [f64; 2]) -> Option<SMatrix<f64, 4, 6>> {
    let delta = s[1] - s[0];
    let L2 = delta.norm_squared();
    if !(L2 > 0.0 && z_m[0] > 0.0 && z_m[1] > 0.0) {
        return None;
    }
    let L = L2.sqrt();
    // ds/ds_2; that of s_1 has the same upper half and the opposite lower half.
    let (lx, ly, ax, ay) = (delta.x / L, delta.y / L, -delta.y / L2, delta.x / L2);
    let (rows1, rows2) = (point_rows(&s[0], z_m[0]), point_rows(&s[1], z_m[1]));
    let (sum, difference) = ((rows1 + rows2) * 0.5, rows2 - rows1);
    let (dX, dY) = (difference.row(0), difference.row(1));
    Some(SMatrix::from_rows(&[
        sum.row(0).into_owned(),
        sum.row(1).into_owned(),
        dX * lx + dY * ly,
        dX * ax + dY * ay,
    ]))
}

/// `angle` rad, wrapped to (-pi, pi].
#[must_use]
pub fn wrap_rad(angle: f64) -> f64 {
    let wrapped = angle.rem_euclid(TAU);
    if wrapped > PI { wrapped - TAU } else { wrapped }
}
