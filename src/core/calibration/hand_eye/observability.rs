//! Whether the arm has turned enough, and about which axes, for the camera's pose to show.
//!
//! Position enters `A X = X B` only by `(R_A - I) p_X`. The mean of `(R_A - I)^T (R_A - I)` over all motions, which is
//! `4 sin^2(angle / 2) (I - n n^T)` of each, has its least eigenvalue along the axis about which all turns were: that direction of p_X
//! is not determined where it vanishes.

use super::{CameraMount, HandEyeError, LoopSample, motions};
use crate::geometry::rotation_angle;
use crate::linalg::symmetric_eigen;
use nalgebra::{Matrix3, Vector3};

/// Turns below this show nothing, rad.
const MIN_RAD: f64 = 0.02;
/// Difference between the rotation angles of arm and camera that noise does not explain, rad, and as a share of the arm's angle. Chosen by hand: poses of boards
/// are wrong by some mrad, and wrong units or frames by far more than a tenth.
const CONTRADICTION_RAD: f64 = 0.1;
const CONTRADICTION_SHARE: f64 = 0.2;

/// How far the arm turned, and about what.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RotationSpread {
    /// Largest angle between two views, rad.
    pub largest_rad: f64,
    /// The direction in M across which the views turn least: along it the camera's position is the least sure.
    pub axis: Vector3<f64>,
    /// How far they turn across it, root mean square over all pairs, rad: no more than this determines the position along it.
    pub across_rad: f64,
    /// The angle of the arm's turn less that of the camera's, root mean square over all pairs, rad: no camera pose changes it.
    pub mismatch_rad: f64,
}

impl RotationSpread {
    /// Refuses views that do not determine the camera's pose.
    pub(super) fn check(&self, place: CameraMount) -> Result<(), HandEyeError> {
        if !(self.largest_rad > MIN_RAD) {
            return Err(HandEyeError::NoRotation { largest_deg: self.largest_rad.to_degrees() });
        }
        if !(self.across_rad > MIN_RAD) {
            return Err(HandEyeError::OneAxis {
                axis: self.axis.into(),
                bearer: place.bearer(),
                across_deg: self.across_rad.to_degrees(),
            });
        }
        if !(self.mismatch_rad < CONTRADICTION_RAD.max(CONTRADICTION_SHARE * self.across_rad)) {
            return Err(HandEyeError::Contradiction { difference_deg: self.mismatch_rad.to_degrees() });
        }
        Ok(())
    }
}

/// The rotations of all pairs of views; `None` for fewer than two, or numbers that are none.
#[must_use]
pub fn rotation_spread(samples: &[LoopSample]) -> Option<RotationSpread> {
    let (mut sum, mut count, mut largest_rad, mut mismatch) = (Matrix3::zeros(), 0.0, 0.0f64, 0.0);
    for (A, B) in motions(samples) {
        let R = A.rotation.to_rotation_matrix();
        let angle = rotation_angle(&R);
        let C = R.matrix() - Matrix3::identity();
        sum += C.transpose() * C;
        count += 1.0;
        largest_rad = largest_rad.max(angle);
        mismatch += (angle - rotation_angle(&B.rotation.to_rotation_matrix())).powi(2);
    }
    if !(count > 0.0) {
        return None;
    }
    let (values, vectors) = symmetric_eigen(&(sum / count))?;
    // the sign by which most of the axis is positive
    let axis: Vector3<f64> = vectors.column(2).into_owned();
    let axis = if axis.sum() < 0.0 { -axis } else { axis };
    Some(RotationSpread {
        largest_rad,
        axis,
        // of the least eigenvalue; 4 sin^2(a / 2) is a^2 for small angles
        across_rad: 2.0 * (0.5 * values.z.max(0.0).sqrt()).min(1.0).asin(),
        mismatch_rad: (mismatch / count).sqrt(),
    })
}
