//! Direct linear transformation for points in space, (10.13).

mod camera;

pub use camera::{LinearCamera, dlt_camera};

use super::linear::{Whitening, direct_linear};
use super::points::check;
use super::{Correspondence3, PoseError};
use crate::geometry::{Pose, closest_rotation};
use nalgebra::{Matrix3, Translation3, UnitQuaternion, Vector3};

/// Pose from at least six points that are not all coplanar.
///
/// The linear solution followed by the closest rotation (10.12): exact without noise, a start value for
/// [`super::refine_3d`] with it.
///
/// # Errors
/// [`PoseError::TooFewPoints`], [`PoseError::NotFinite`], [`PoseError::Degenerate`] for coplanar points, and
/// [`PoseError::BehindCamera`] when the solution leaves a point behind the camera.
pub fn dlt_pose(points: &[Correspondence3]) -> Result<Pose, PoseError> {
    check(points, 6)?;
    let LinearProjection { M, p, mean } = linear_projection(points)?;
    // [R p] is known up to a factor, whose sign makes det R positive and whose size makes R's columns unit vectors.
    let sign = M.determinant().signum();
    let size = M.norm() / 3.0_f64.sqrt();
    if !(size > 0.0 && size < f64::INFINITY) {
        return Err(PoseError::Degenerate);
    }
    let R = closest_rotation(&(M * (sign / size))).ok_or(PoseError::Degenerate)?;
    let p = p * (sign / size) - R * mean;
    let X_CO = Pose::from_parts(Translation3::from(p), UnitQuaternion::from_rotation_matrix(&R));
    let in_front = points.iter().all(|point| (X_CO * point.r).z > 0.0);
    if in_front { Ok(X_CO) } else { Err(PoseError::BehindCamera) }
}

/// The matrix `[M p']` of (10.13) up to a factor of either sign: a point r is seen at `M (r - mean) + p`.
pub(super) struct LinearProjection {
    pub(super) M: Matrix3<f64>,
    /// Of the mean of the object points.
    pub(super) p: Vector3<f64>,
    pub(super) mean: Vector3<f64>,
}

/// Of six points or more, with images in any linear coordinates: normalized, or pixels.
pub(super) fn linear_projection(points: &[Correspondence3]) -> Result<LinearProjection, PoseError> {
    let at =
        |i: usize| points.get(i).map_or(([0.0; 3], [0.0; 2]), |p| ([p.r.x, p.r.y, p.r.z], [p.s.x, p.s.y]));
    let r = Whitening::new(points.len(), |i| at(i).0).ok_or(PoseError::Degenerate)?;
    let s = Whitening::new(points.len(), |i| at(i).1).ok_or(PoseError::Degenerate)?;
    let P = direct_linear::<4>(points.len(), |i| {
        let [x, y, z] = r.apply(at(i).0);
        ([x, y, z, 1.0], s.apply(at(i).1))
    })?;
    let column = |j: usize| {
        let (u, v, w) = (P[0][j] / s.scale, P[1][j] / s.scale, P[2][j]);
        Vector3::new(u + s.mean[0] * w, v + s.mean[1] * w, w)
    };
    let M = Matrix3::from_columns(&[column(0), column(1), column(2)]) * r.scale;
    Ok(LinearProjection { M, p: column(3), mean: Vector3::from(r.mean) })
}

#[cfg(test)]
mod tests;
