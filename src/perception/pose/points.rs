//! Correspondences of object point and image point, and the common interface of planar and spatial ones.

use super::PoseError;
use crate::geometry::Pose;
use nalgebra::{Point3, Vector2};

/// A point of a planar object and its image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correspondence {
    /// Position in the object's plane z = 0, m.
    pub r: Vector2<f64>,
    /// Normalized image coordinates (X, Y), undistorted.
    pub s: Vector2<f64>,
}

/// A point of a spatial object and its image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Correspondence3 {
    /// Position in the object frame, m.
    pub r: Point3<f64>,
    /// Normalized image coordinates (X, Y), undistorted.
    pub s: Vector2<f64>,
}

/// A pose with its reprojection error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseSolution {
    /// Pose of the object in the camera.
    pub X_CO: Pose,
    /// Root mean square over the points of the reprojection error, normalized units.
    pub rms: f64,
}

impl PoseSolution {
    /// Placeholder for unused entries.
    pub(super) fn none() -> Self {
        Self { X_CO: Pose::identity(), rms: f64::INFINITY }
    }
}

/// A correspondence, as the solvers read it.
pub trait PointSource: Copy {
    /// Position in the object frame, m.
    fn object(&self) -> [f64; 3];
    /// Normalized image coordinates.
    fn image(&self) -> [f64; 2];
}

impl PointSource for Correspondence {
    #[inline(always)]
    fn object(&self) -> [f64; 3] {
        [self.r.x, self.r.y, 0.0]
    }
    #[inline(always)]
    fn image(&self) -> [f64; 2] {
        [self.s.x, self.s.y]
    }
}

impl PointSource for Correspondence3 {
    #[inline(always)]
    fn object(&self) -> [f64; 3] {
        [self.r.x, self.r.y, self.r.z]
    }
    #[inline(always)]
    fn image(&self) -> [f64; 2] {
        [self.s.x, self.s.y]
    }
}

/// Errors for sets that are too small or contain NaN or infinity.
pub(super) fn check<P: PointSource>(points: &[P], needed: usize) -> Result<(), PoseError> {
    if points.len() < needed {
        return Err(PoseError::TooFewPoints { needed, given: points.len() });
    }
    // One sum instead of five tests per point: x * 0 is NaN exactly when x is NaN or infinite.
    let mut zero = 0.0;
    for point in points {
        let ([x, y, z], [X, Y]) = (point.object(), point.image());
        zero += (x * 0.0 + y * 0.0 + z * 0.0) + (X * 0.0 + Y * 0.0);
    }
    if zero == 0.0 {
        return Ok(());
    }
    let bad = |p: &P| !p.object().iter().chain(&p.image()).all(|x| x.is_finite());
    Err(PoseError::NotFinite { index: points.iter().position(bad).unwrap_or(0) })
}

/// Mean of the object points, m.
#[inline(always)]
pub(super) fn centroid<P: PointSource>(points: &[P]) -> [f64; 3] {
    let mut sum = [0.0; 3];
    for point in points {
        let r = point.object();
        sum = [sum[0] + r[0], sum[1] + r[1], sum[2] + r[2]];
    }
    let scale = 1.0 / points.len() as f64;
    sum.map(|x| x * scale)
}

/// Root mean square over the points of the distance between image and projection, normalized units.
///
/// Infinite when some point lies in or behind the plane of the camera's centre, zero for no points.
#[must_use]
pub fn reprojection_rms<P: PointSource>(X_CO: &Pose, points: &[P]) -> f64 {
    let R = X_CO.rotation.to_rotation_matrix();
    let mut sum = 0.0;
    for point in points {
        let r = R * Point3::from(point.object()) + X_CO.translation.vector;
        if r.z <= 0.0 {
            return f64::INFINITY;
        }
        let [X, Y] = point.image();
        sum += (X - r.x / r.z).powi(2) + (Y - r.y / r.z).powi(2);
    }
    (sum / points.len().max(1) as f64).sqrt()
}
