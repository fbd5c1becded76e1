//! The set-point of visual servoing: the desired features `s_d` of (10.78), from a desired pose, given as numbers, or taught from measurements.
//!
//! Points are given in the object frame O (m), features are normalized image coordinates, and `X_DO` is the pose of O in the frame D of the camera at
//! the goal.

mod from_features;

use super::view::is_there;
use super::{Selection, View};
use crate::geometry::Pose;
use crate::messages::MAX_FEATURES;
use nalgebra::{Point3, Vector2, Vector3};

/// Desired feature points `s_d`, their depths in the desired pose, and which of them the law compares.
#[derive(Debug, Clone, PartialEq)]
pub struct SetPoint {
    X_DO: Option<Pose>,
    s_d: [Vector2<f64>; MAX_FEATURES],
    z_d_m: [f64; MAX_FEATURES],
    p_O: [Point3<f64>; MAX_FEATURES],
    ids: [u32; MAX_FEATURES],
    count: usize,
    selection: Selection,
    n_D: Vector3<f64>,
    target: u32,
    is_seen: bool,
}

impl SetPoint {
    /// The features of the points `p_O` (object frame, m) for an object at `X_DO` in the camera. All points are
    /// selected.
    ///
    /// `None` when a point would lie behind the camera, or there are none or more than [`MAX_FEATURES`].
    #[must_use]
    pub fn from_pose(X_DO: &Pose, points: &[Point3<f64>]) -> Option<Self> {
        let mut set_point = Self::empty(points)?;
        set_point.move_to(X_DO).then_some(set_point)
    }

    /// Moves the desired pose to `X_DO`, and with it features, depths and normal. Returns false, and changes nothing, where a point would lie
    /// behind the camera.
    pub fn move_to(&mut self, X_DO: &Pose) -> bool {
        if !self.points().iter().all(|p_O| (X_DO * p_O).z > 0.0) {
            return false;
        }
        let places = self.s_d.iter_mut().zip(&mut self.z_d_m).zip(&self.p_O);
        for ((s, z), p_O) in places.take(self.count) {
            let p_D = X_DO * p_O;
            *s = p_D.coords.xy() / p_D.z;
            *z = p_D.z;
        }
        self.X_DO = Some(*X_DO);
        self.is_seen = false;
        let n_D = X_DO.rotation * Vector3::z();
        self.n_D = if n_D.z < 0.0 { -n_D } else { n_D };
        true
    }

    fn empty(points: &[Point3<f64>]) -> Option<Self> {
        if points.is_empty() || points.len() > MAX_FEATURES {
            return None;
        }
        let mut p_O = [Point3::origin(); MAX_FEATURES];
        for (place, p) in p_O.iter_mut().zip(points) {
            *place = *p;
        }
        Some(Self {
            X_DO: None,
            s_d: [Vector2::zeros(); MAX_FEATURES],
            z_d_m: [0.0; MAX_FEATURES],
            p_O,
            ids: std::array::from_fn(|i| i as u32),
            count: points.len(),
            selection: Selection::all_points(points.len()),
            n_D: Vector3::z(),
            target: 0,
            is_seen: false,
        })
    }

    /// The same set-point, of which the law compares `selection` only. `None` when it names a point that does not exist.
    #[must_use]
    pub fn with_selection(self, selection: Selection) -> Option<Self> {
        selection.fits(self.count).then_some(Self { selection, ..self })
    }

    /// The same set-point for points with these rising ids. `None` when they are not as many as the points.
    #[must_use]
    pub fn with_ids(mut self, ids: &[u32]) -> Option<Self> {
        let good = ids.len() == self.count && ids.is_sorted_by(|a, b| a < b);
        self.ids.get_mut(..self.count).filter(|_| good)?.copy_from_slice(ids);
        Some(self)
    }

    /// The same set-point of the target with this number, whose measurements alone are compared with it.
    #[must_use]
    pub fn with_target(self, target: u32) -> Self {
        Self { target, ..self }
    }

    /// Number of the target that it is of: 0 is the first one of a run.
    #[must_use]
    pub fn target(&self) -> u32 {
        self.target
    }

    /// Ids of the points, by which measurements are associated with them.
    #[must_use]
    pub fn ids(&self) -> &[u32] {
        self.ids.get(..self.count).unwrap_or(&self.ids)
    }

    /// The pose of the object in the desired camera frame, where it is known.
    #[must_use]
    pub fn X_DO(&self) -> Option<&Pose> {
        self.X_DO.as_ref()
    }

    /// Whether the desired features are those of the desired pose: of a goal that is a pose. Features that were measured fit none so well.
    #[must_use]
    pub fn is_of_pose(&self) -> bool {
        // A billionth of the focal length: rounding leaves less, and the finest measurement more.
        self.X_DO.is_some_and(|X_DO| self.error_rms_px_at(&X_DO, &Vector2::repeat(1.0)) < 1e-9)
    }

    /// Whether the goal is an image: features that were taught or given, to which the pose is only what is believed of them.
    #[must_use]
    pub fn is_seen(&self) -> bool {
        self.is_seen
    }

    /// What the law compares.
    #[must_use]
    pub fn selection(&self) -> &Selection {
        &self.selection
    }

    /// Expected normal of the object's plane in the desired frame, away from the camera.
    #[must_use]
    pub fn n_D(&self) -> Vector3<f64> {
        self.n_D
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

    /// Root mean square distance between the current features of the view `seen` and the desired ones, in pixels of a camera with focal lengths
    /// `f_px`, over the features that are not hidden; NaN when the view belongs to other features, or has none.
    #[must_use]
    pub fn error_rms_px(&self, seen: &View, f_px: &Vector2<f64>) -> f64 {
        if seen.features().len() != self.count {
            return f64::NAN;
        }
        let pairs = seen.features().iter().copied().zip(self.features());
        Self::rms_px(pairs.filter(|(s, _)| is_there(s)), f_px)
    }

    /// The same over the points that the law compares.
    #[must_use]
    pub fn compared_error_rms_px(&self, seen: &View, f_px: &Vector2<f64>) -> f64 {
        if seen.features().len() != self.count {
            return f64::NAN;
        }
        let pairs = self.selection.points().filter_map(|i| Some((*seen.feature(i)?, self.s_d.get(i)?)));
        Self::rms_px(pairs, f_px)
    }

    /// The same for the view from a true pose `X_CO`, NaN when a point lies behind the camera.
    #[must_use]
    pub fn error_rms_px_at(&self, X_CO: &Pose, f_px: &Vector2<f64>) -> f64 {
        let view = self.points().iter().map(|p_O| {
            let p_C = X_CO * p_O;
            if p_C.z > 0.0 { p_C.coords.xy() / p_C.z } else { Vector2::repeat(f64::NAN) }
        });
        Self::rms_px(view.zip(self.features()), f_px)
    }

    fn rms_px<'a>(pairs: impl Iterator<Item = (Vector2<f64>, &'a Vector2<f64>)>, f_px: &Vector2<f64>) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for (s, s_d) in pairs {
            sum += (s_d - s).component_mul(f_px).norm_squared();
            count += 1.0;
        }
        f64::sqrt(sum / count)
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
        assert!(s.error_rms_px_at(&X_DO, &f_px) < 1e-12 && s.is_of_pose());
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
        let other = Selection::new([(crate::servo::FeatureKind::Point(2), 1.0)]).unwrap();
        assert!(SetPoint::from_pose(&X_DO, &points).unwrap().with_selection(other).is_none());
    }

    #[test]
    fn points_in_space_tell_their_pose_from_near_it() {
        let X_DO = Pose::new([-0.05, 0.03, 0.6].into(), [0.3, -0.4, -1.0].into());
        let points =
            [[0.0, 0.0, 0.01], [0.1, 0.0, -0.02], [0.1, 0.1, 0.03], [0.0, 0.1, 0.0], [0.04, 0.07, -0.04]];
        let points = points.map(Point3::from);
        let posed = SetPoint::from_pose(&X_DO, &points).unwrap().with_ids(&[1, 2, 5, 8, 9]).unwrap();
        let given = SetPoint::from_features(posed.features(), &points, 0.5).unwrap();
        let given = given.with_ids(&[1, 2, 5, 8, 9]).unwrap();
        assert!(given.X_DO().is_none());
        let near = Pose::new([0.004, -0.003, 0.02].into(), [0.02, 0.01, -0.03].into()) * X_DO;
        let found = given.posed_near(&near).unwrap();
        assert!((found.X_DO().unwrap().to_homogeneous() - X_DO.to_homogeneous()).norm() < 1e-7);
        assert!(found.depths_m().iter().zip(posed.depths_m()).all(|(a, b)| (a - b).abs() < 1e-7));
        assert_eq!((found.features(), found.ids()), (posed.features(), posed.ids()));
        let two = SetPoint::from_features(&posed.features()[..2], &points[..2], 0.7).unwrap();
        assert!(two.posed_near(&near).is_none());
    }

    #[test]
    fn given_features_yield_the_pose_they_were_seen_from() {
        let X_DO = Pose::new([-0.05, 0.03, 0.6].into(), [0.3, -0.4, -1.0].into());
        let square = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]].map(|[x, y]| Point3::new(x, y, 0.0));
        let posed = SetPoint::from_pose(&X_DO, &square).unwrap();
        let given = SetPoint::from_features(posed.features(), &square, 1.0).unwrap();
        assert!((given.X_DO().unwrap().to_homogeneous() - X_DO.to_homogeneous()).norm() < 1e-7);
        assert!(given.depths_m().iter().zip(posed.depths_m()).all(|(a, b)| (a - b).abs() < 1e-7));
        assert!((given.n_D() - posed.n_D()).norm() < 1e-7);
        let two = SetPoint::from_features(&posed.features()[..2], &square[..2], 0.7).unwrap();
        assert_eq!((two.X_DO(), two.depths_m()), (None, [0.7, 0.7].as_slice()));
        assert!(SetPoint::from_features(&posed.features()[..2], &square, 0.7).is_none());
        assert!(SetPoint::from_features(posed.features(), &square, 0.0).is_none());
    }
}
