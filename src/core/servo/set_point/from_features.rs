//! A set-point from desired features alone, given as numbers or taught. The desired pose is found by a search, which is not done in a tick.

use super::SetPoint;
use crate::camera_model::CameraModel;
use crate::geometry::Pose;
use crate::messages::MAX_FEATURES;
use crate::pose::{Correspondence, Correspondence3, planar_pose, refine_3d};
use nalgebra::{Point3, Vector2};

impl SetPoint {
    /// Given features `s_d` (normalized) of the points `p_O` (m), for example measured in the desired pose.
    ///
    /// Four or more coplanar points with z = 0 also give the desired pose and the depths; otherwise there is no
    /// desired pose and `z_d_m` is used as the depth of all points. `None` when the lists do not fit each other, a number is not
    /// finite, or the depth is not positive.
    #[must_use]
    pub fn from_features(s_d: &[Vector2<f64>], points: &[Point3<f64>], z_d_m: f64) -> Option<Self> {
        let finite = s_d.iter().all(|s| s.x.is_finite() && s.y.is_finite());
        if s_d.len() != points.len() || !finite || !(z_d_m > 0.0) {
            return None;
        }
        let mut seen = [Correspondence { r: Vector2::zeros(), s: Vector2::zeros() }; MAX_FEATURES];
        for ((place, s), p) in seen.iter_mut().zip(s_d).zip(points) {
            *place = Correspondence { r: p.coords.xy(), s: *s };
        }
        let planar = points.iter().all(|p| p.z == 0.0);
        let X_DO = seen.get(..points.len()).filter(|_| planar).and_then(|p| planar_pose(p).ok());
        let mut set_point = match X_DO.and_then(|found| Self::from_pose(&found.best.X_CO, points)) {
            Some(set_point) => set_point,
            None => Self { z_d_m: [z_d_m; MAX_FEATURES], ..Self::empty(points)? },
        };
        for (place, s) in set_point.s_d.iter_mut().zip(s_d) {
            *place = *s;
        }
        set_point.is_seen = true;
        Some(set_point)
    }

    /// The goal of an image as it truly is, where `self` has it by the lens `believed`: the same pixels by the lens `truth`, of the points where they truly are, `p_O`,
    /// m, with the pose from which that lens sees them so. `None` of a goal that is a pose, and where the points are others.
    #[must_use]
    pub fn in_truth(&self, believed: &CameraModel, truth: &CameraModel, p_O: &[Point3<f64>]) -> Option<Self> {
        if !self.is_seen {
            return None;
        }
        let mut s_d = [Vector2::zeros(); MAX_FEATURES];
        for (place, s) in s_d.iter_mut().zip(self.features()) {
            *place = truth.normalized_of(&believed.pixel_of(s));
        }
        let z_d_m = self.depths_m().iter().sum::<f64>() / self.count as f64;
        let found = Self::from_features(s_d.get(..self.count)?, p_O, z_d_m)?;
        let near = self.X_DO().filter(|_| found.X_DO().is_none());
        near.and_then(|X_DO| found.posed_near(X_DO)).unwrap_or(found).of_target_of(self)
    }

    /// Another goal of the same target: its points with other features, from about as far away. Where these fix no pose it is that one of two near the present one.
    #[must_use]
    pub fn at_features(&self, s_d: &[Vector2<f64>]) -> Option<Self> {
        let depths_m = self.depths_m();
        let z_d_m = depths_m.iter().sum::<f64>() / depths_m.len() as f64;
        let found = Self::from_features(s_d, self.points(), z_d_m)?;
        let near = self.X_DO().filter(|_| found.X_DO().is_none());
        near.and_then(|X_DO| found.posed_near(X_DO)).unwrap_or(found).of_target_of(self)
    }

    /// Another goal of the same target, at the pose `X_DO` in the camera.
    #[must_use]
    pub fn at_pose(&self, X_DO: &Pose) -> Option<Self> {
        Self::from_pose(X_DO, self.points())?.of_target_of(self)
    }

    fn of_target_of(self, other: &Self) -> Option<Self> {
        self.with_target(other.target()).with_ids(other.ids())?.with_selection(*other.selection())
    }

    /// The same features with the desired pose of least reprojection error and its depths, refined from a pose near it: for points that are not
    /// coplanar. `None` where they do not determine a pose.
    #[must_use]
    pub(crate) fn posed_near(&self, guess: &Pose) -> Option<Self> {
        let mut seen = [Correspondence3 { r: Point3::origin(), s: Vector2::zeros() }; MAX_FEATURES];
        for ((place, s), p) in seen.iter_mut().zip(self.features()).zip(self.points()) {
            *place = Correspondence3 { r: *p, s: *s };
        }
        let found = refine_3d(guess, seen.get(..self.count)?, 1.0).ok()?;
        let posed = Self::from_pose(&found.X_CO, self.points())?;
        Some(Self {
            s_d: self.s_d,
            ids: self.ids,
            selection: self.selection,
            target: self.target,
            is_seen: self.is_seen,
            ..posed
        })
    }
}
