//! The desired features of (10.78): what the camera sees from the desired pose.

use super::View;
use crate::geometry::Pose;
use crate::messages::MAX_FEATURES;
use nalgebra::{Point3, Vector2};

/// Desired feature points `s_d` and their depths in the desired pose.
#[derive(Debug, Clone, PartialEq)]
pub struct SetPoint {
    X_DO: Pose,
    s_d: [Vector2<f64>; MAX_FEATURES],
    z_d_m: [f64; MAX_FEATURES],
    p_O: [Point3<f64>; MAX_FEATURES],
    count: usize,
}

impl SetPoint {
    /// The view of the points `p_O` (object frame, m) when the object lies at `X_DO` in the camera.
    ///
    /// `None` when a point would lie behind the camera, or there are none or more than [`MAX_FEATURES`].
    #[must_use]
    pub fn from_pose(X_DO: &Pose, points: &[Point3<f64>]) -> Option<Self> {
        if points.is_empty() || points.len() > MAX_FEATURES {
            return None;
        }
        let mut set_point = Self {
            X_DO: *X_DO,
            s_d: [Vector2::zeros(); MAX_FEATURES],
            z_d_m: [0.0; MAX_FEATURES],
            p_O: [Point3::origin(); MAX_FEATURES],
            count: points.len(),
        };
        let places = set_point.s_d.iter_mut().zip(&mut set_point.z_d_m).zip(&mut set_point.p_O);
        for ((s, z), (p_O, kept)) in places.zip(points).map(|((sz, kept), p)| (sz, (p, kept))) {
            let p_D = X_DO * p_O;
            if p_D.z <= 0.0 {
                return None;
            }
            *s = p_D.coords.xy() / p_D.z;
            *z = p_D.z;
            *kept = *p_O;
        }
        Some(set_point)
    }

    /// The pose of the object in the desired camera frame.
    #[must_use]
    pub fn X_DO(&self) -> &Pose {
        &self.X_DO
    }

    /// Desired features, normalized coordinates.
    #[must_use]
    pub fn features(&self) -> &[Vector2<f64>] {
        self.s_d.get(..self.count).unwrap_or(&self.s_d)
    }

    /// Depths in the desired pose, m.
    #[must_use]
    pub fn depths_m(&self) -> &[f64] {
        self.z_d_m.get(..self.count).unwrap_or(&self.z_d_m)
    }

    /// The points in the object frame, m.
    #[must_use]
    pub fn points(&self) -> &[Point3<f64>] {
        self.p_O.get(..self.count).unwrap_or(&self.p_O)
    }

    /// Root mean square distance between seen and desired features, in pixels of a camera with focal lengths
    /// `f_px`; NaN when the view does not have the set-point's features.
    #[must_use]
    pub fn error_rms_px(&self, seen: &View, f_px: &Vector2<f64>) -> f64 {
        self.rms_px(seen.features().iter().copied(), f_px)
    }

    /// The same for the view from a true pose `X_CO`; NaN when a point lies behind the camera.
    #[must_use]
    pub fn error_rms_px_at(&self, X_CO: &Pose, f_px: &Vector2<f64>) -> f64 {
        let view = self.points().iter().map(|p_O| {
            let p_C = X_CO * p_O;
            if p_C.z > 0.0 { p_C.coords.xy() / p_C.z } else { Vector2::repeat(f64::NAN) }
        });
        self.rms_px(view, f_px)
    }

    fn rms_px(&self, seen: impl ExactSizeIterator<Item = Vector2<f64>>, f_px: &Vector2<f64>) -> f64 {
        if seen.len() != self.count {
            return f64::NAN;
        }
        let sum: f64 =
            seen.zip(self.features()).map(|(s, s_d)| (s_d - s).component_mul(f_px).norm_squared()).sum();
        (sum / self.count as f64).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_3;

    fn textbook() -> (Pose, [Point3<f64>; 2]) {
        // Sect. 10.9: x_d,o = [-0.1 0.1 0.6 -pi/3].
        let X_DO = Pose::new([-0.1, 0.1, 0.6].into(), [0.0, 0.0, -FRAC_PI_3].into());
        (X_DO, [Point3::origin(), Point3::new(0.1, 0.0, 0.0)])
    }

    #[test]
    fn desired_features_of_the_comparison() {
        let (X_DO, points) = textbook();
        let s = SetPoint::from_pose(&X_DO, &points).unwrap();
        let flat: Vec<f64> = s.features().iter().flat_map(|s| [s.x, s.y]).collect();
        for (got, printed) in flat.iter().zip([-0.1667, 0.1667, -0.0833, 0.0223]) {
            assert!((got - printed).abs() < 5e-5, "{flat:?}");
        }
        assert_eq!(s.depths_m(), [0.6, 0.6]);
    }

    #[test]
    fn no_error_in_the_desired_pose_and_a_pixel_beside_it() {
        let (X_DO, points) = textbook();
        let s = SetPoint::from_pose(&X_DO, &points).unwrap();
        let f_px = Vector2::new(600.0, 600.0);
        assert!(s.error_rms_px_at(&X_DO, &f_px) < 1e-12);
        let beside = Pose::translation(0.001, 0.0, 0.0) * X_DO;
        assert!((s.error_rms_px_at(&beside, &f_px) - 1.0).abs() < 1e-9);
        let one = View::new([Vector2::zeros()].into_iter(), None).unwrap();
        assert!(s.error_rms_px(&one, &f_px).is_nan(), "other features, no error");
    }

    #[test]
    fn points_behind_the_camera_and_empty_sets_are_refused() {
        let (X_DO, points) = textbook();
        assert!(SetPoint::from_pose(&Pose::translation(0.0, 0.0, -0.6), &points).is_none());
        assert!(SetPoint::from_pose(&X_DO, &[]).is_none());
        assert!(SetPoint::from_pose(&X_DO, &[Point3::origin(); MAX_FEATURES + 1]).is_none());
    }
}
