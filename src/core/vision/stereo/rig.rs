//! Triangulation with two cameras that are fixed to each other: points that both detect, associated by id, become points in space, (10.49)-(10.53).
//!
//! Positions are in the frame L of the left camera, m. Nothing is known of the object but the ids of its points.

use crate::camera_model::CameraModel;
use crate::detect::Detection;
use crate::geometry::Pose;
use crate::stereo::{Conjugates, StereoError, Triangulator};
use nalgebra::{Matrix3, Point3, Vector2};

/// A triangulated point, in the frame L of the left camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpacePoint {
    /// Which point.
    pub id: u32,
    /// Its position in L, m.
    pub p_L: Point3<f64>,
    /// Covariance of `p_L`, m^2.
    pub covariance: Matrix3<f64>,
    /// Squared distance of the two rays over its variance: chi-square with one degree of freedom.
    pub misfit: f64,
    /// Standard deviation of an image coordinate, normalized, root mean square over both images.
    pub sd: f64,
    /// The same, px of the left image.
    pub sd_px: f64,
    /// Image in the left camera, px.
    pub left_px: Vector2<f64>,
    /// Image in the right camera, px.
    pub right_px: Vector2<f64>,
    /// Image in the left camera, normalized coordinates.
    pub left_s: Vector2<f64>,
}

/// Two cameras with their lenses and the pose `X_LR` of the right camera in the left one.
#[derive(Debug, Clone)]
pub struct StereoRig {
    left: CameraModel,
    right: CameraModel,
    X_LR: Pose,
    triangulator: Triangulator,
    model_sd_px: f64,
    /// Variance of each coordinate, px^2, beyond what the finders state ([`super::super::noise_level`]).
    pub(super) noise_px2: f64,
}

impl StereoRig {
    /// Cameras with their lenses, the right one at `X_LR` in the left one.
    ///
    /// # Errors
    /// [`StereoError::Degenerate`] for cameras in one place, [`StereoError::BadGuess`] for a pose that is not finite.
    pub fn new(left: CameraModel, right: CameraModel, X_LR: Pose) -> Result<Self, StereoError> {
        Ok(Self {
            left,
            right,
            X_LR,
            triangulator: Triangulator::new(&X_LR)?,
            model_sd_px: 0.0,
            noise_px2: 0.0,
        })
    }

    /// The same rig with a model error: standard deviation of each coordinate, px, by which lenses and marks differ from their description. It is
    /// part of all stated covariances, because nothing is known of the object by which offsets could be corrected.
    #[must_use]
    pub fn with_model_sd_px(self, model_sd_px: f64) -> Self {
        Self { model_sd_px, ..self }
    }

    /// The left camera.
    #[must_use]
    pub fn left(&self) -> &CameraModel {
        &self.left
    }

    /// The right camera.
    #[must_use]
    pub fn right(&self) -> &CameraModel {
        &self.right
    }

    /// Pose of the right camera in the left one.
    #[must_use]
    pub fn X_LR(&self) -> &Pose {
        &self.X_LR
    }

    /// Images of a point of the left frame in both images, px; `None` where one of the cameras cannot see it.
    #[must_use]
    pub fn project(&self, p_L: &Point3<f64>) -> Option<[Vector2<f64>; 2]> {
        Some([self.left.project(p_L)?, self.right.project(&self.X_LR.inverse_transform_point(p_L))?])
    }

    /// Triangulates the points that are in both lists (ids rising) into `points`. One that does not lie in front of both cameras is left out.
    pub fn triangulate(&self, left: &[Detection], right: &[Detection], points: &mut Vec<SpacePoint>) {
        points.clear();
        let mut others = right.iter().peekable();
        for l in left {
            while others.peek().is_some_and(|r| r.id < l.id) {
                others.next();
            }
            if let Some(r) = others.peek().filter(|r| r.id == l.id) {
                points.extend(self.point(l, r));
            }
        }
    }

    fn point(&self, left: &Detection, right: &Detection) -> Option<SpacePoint> {
        let pair =
            Conjugates { s_1: self.left.normalized_of(&left.px), s_2: self.right.normalized_of(&right.px) };
        let found = self.triangulator.point(&pair).ok()?;
        // Pixels as a share of normalized coordinates, where the lens has them.
        let scale = |camera: &CameraModel, s: &Vector2<f64>| camera.pixel_jacobian(s).determinant().abs();
        let (at_left, at_right) = (scale(&self.left, &pair.s_1), scale(&self.right, &pair.s_2));
        let model = self.model_sd_px * self.model_sd_px + self.noise_px2;
        let square = |found: &Detection, scale: f64| (found.sd_px * found.sd_px + model) / scale;
        // The optimal triangulation assumes equal variances in both images.
        let variance = 0.5 * (square(left, at_left) + square(right, at_right));
        let point = SpacePoint {
            id: left.id,
            p_L: found.p_1,
            covariance: found.covariance * variance,
            misfit: found.error2 / variance,
            sd: variance.sqrt(),
            sd_px: (variance * at_left).sqrt(),
            left_px: left.px,
            right_px: right.px,
            left_s: pair.s_1,
        };
        let is_usable = point.misfit.is_finite() && point.covariance.iter().all(|c| c.is_finite());
        (is_usable && variance > 0.0).then_some(point)
    }
}
