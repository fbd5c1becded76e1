//! The view: features of the target at one instant, measured at an exposure, or predicted at another time by the known motion of the camera.
//!
//! Data flow: a measurement becomes a view of the set-point's features, associated by id ([`View::of`]); it is checked ([`View::is_possible`]), its hidden
//! features are completed where the law needs them ([`View::sufficient`]), it is transformed to the pose of the camera now ([`View::predicted_at`]), and
//! the law reads it. Hidden features are NaN, so that a law which overlooks them has no finite output.

use super::{DepthRow, SetPoint};
use crate::geometry::Pose;
use crate::messages::{MAX_FEATURES, Measurement};
use crate::pose::{Correspondence3, refine_3d};
use nalgebra::{Matrix6, Point3, Vector2};

/// So many points determine the camera's pose uniquely, because three leave up to four poses ([`crate::pose::p3p`]): where fewer are visible, the
/// hidden ones are placed by the pose. With half of it a test of hidden features fails, with twice of it none.
const ENOUGH: usize = 4;
/// Largest distance, m, and largest normalized coordinate of a measurement, so that corrupted bits are not taken for a view: no arm's object is a
/// kilometre away, and no lens of the crate images more than tan(89.9 degrees).
const FARTHEST_M: f64 = 1e3;
const FARTHEST_ASIDE: f64 = 573.0;
/// Largest variance of a pose, m^2 and rad^2: the square of the farthest distance. A larger one would contain no information.
const MAX_VARIANCE: f64 = 1e6;
/// How far the norm of a rotation's quaternion may be from 1: a program that computes in single precision is right to 1e-7.
const ROTATION_SLACK: f64 = 1e-6;
const HIDDEN: Vector2<f64> = Vector2::new(f64::NAN, f64::NAN);

/// Feature points in normalized coordinates, in the order of the set-point's points, and the object's pose `X_CO` where it is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    s: [Vector2<f64>; MAX_FEATURES],
    count: usize,
    X_CO: Option<Pose>,
    X_CO_known: Option<Pose>,
    initial: Option<DepthRow>,
}

/// Whether a feature is in the view.
#[inline(always)]
pub(super) fn is_there(s: &Vector2<f64>) -> bool {
    !s.x.is_nan()
}

impl View {
    /// The view of the set-point's features in a measurement. `None` when it is of another target, when the target was not found, when none of its points is one of the
    /// set-point's, when a coordinate is outside of what a lens can image, or when the list is invalid: too long, or without rising ids.
    #[must_use]
    pub fn of(measurement: &Measurement, set_point: &SetPoint) -> Option<Self> {
        let list = measurement.features();
        if measurement.target_number != set_point.target()
            || !measurement.found()
            || measurement.feature_count as usize > MAX_FEATURES
            || !list.is_sorted_by(|a, b| a.id < b.id)
        {
            return None;
        }
        let ids = set_point.ids();
        let (X_CO, count) = (measurement.pose(), ids.len());
        let mut view = Self { s: [HIDDEN; MAX_FEATURES], count, X_CO, X_CO_known: None, initial: None };
        let mut seen = 0;
        // ids rise on both sides, and mostly none is missing
        let mut next = 0;
        for f in list {
            if ids.get(next).is_none_or(|id| u64::from(*id) != f.id) {
                match ids.binary_search_by_key(&f.id, |id| u64::from(*id)) {
                    Ok(found) => next = found,
                    Err(_) => continue,
                }
            }
            if !(f.x.abs() <= FARTHEST_ASIDE && f.y.abs() <= FARTHEST_ASIDE) {
                return None;
            }
            if let Some(place) = view.s.get_mut(next) {
                *place = Vector2::new(f.x, f.y);
                (seen, next) = (seen + 1, next + 1);
            }
        }
        (seen > 0).then_some(view)
    }

    /// The same view without a pose, which a description that is not trusted gives.
    #[must_use]
    pub fn without_pose(self) -> Self {
        Self { X_CO: None, ..self }
    }

    /// Whether the pose, where there is one, and its `covariance` are possible for the visible features: a valid rotation, finite variances, and no
    /// visible point behind the camera or more than a kilometre away.
    #[must_use]
    pub fn is_possible(&self, set_point: &SetPoint, covariance: &Matrix6<f64>) -> bool {
        let Some(X_CO) = &self.X_CO else { return true };
        let is_rotation = (X_CO.rotation.as_ref().norm() - 1.0).abs() <= ROTATION_SLACK;
        let is_near = X_CO.translation.vector.iter().all(|x| x.abs() <= FARTHEST_M);
        is_rotation
            && is_near
            && covariance.iter().all(|x| x.abs() <= MAX_VARIANCE)
            && covariance.diagonal().iter().all(|x| *x >= 0.0)
            && self.features().iter().zip(set_point.points()).all(|(s, p_O)| {
                let z_m = (X_CO * p_O).z;
                !is_there(s) || (z_m > 0.0 && z_m <= FARTHEST_M)
            })
    }

    /// A view of feature points `s`; `None` when there are none, too many, or one is not finite.
    #[must_use]
    pub fn new(s: impl ExactSizeIterator<Item = Vector2<f64>>, X_CO: Option<Pose>) -> Option<Self> {
        let count = s.len();
        if count == 0 || count > MAX_FEATURES {
            return None;
        }
        let mut view = Self { s: [HIDDEN; MAX_FEATURES], count, X_CO, X_CO_known: None, initial: None };
        for (place, s) in view.s.iter_mut().zip(s) {
            if !(s.x.is_finite() && s.y.is_finite()) {
                return None;
            }
            *place = s;
        }
        Some(view)
    }

    /// The feature points in the order of the set-point's; those that are hidden are NaN.
    #[must_use]
    pub fn features(&self) -> &[Vector2<f64>] {
        self.s.get(..self.count).unwrap_or(&self.s)
    }

    /// Feature `i`, unless it is hidden.
    #[must_use]
    #[inline(always)]
    pub fn feature(&self, i: usize) -> Option<&Vector2<f64>> {
        self.s.get(i).filter(|s| is_there(s))
    }

    /// The features that are not hidden, with their index.
    pub fn seen(&self) -> impl Iterator<Item = (usize, Vector2<f64>)> + '_ {
        (0..self.count).filter_map(|i| self.feature(i).map(|s| (i, *s)))
    }

    /// The same view with its features where `place` has them, by index; `None` where it has none for one that is not hidden.
    #[must_use]
    pub(super) fn moved(mut self, place: impl Fn(usize) -> Option<Vector2<f64>>) -> Option<Self> {
        for (i, s) in self.s.iter_mut().take(self.count).enumerate().filter(|(_, s)| is_there(s)) {
            *s = place(i).filter(|s| s.x.is_finite() && s.y.is_finite())?;
        }
        Some(self)
    }

    /// Whether some features are hidden.
    #[must_use]
    pub fn is_partial(&self) -> bool {
        !self.features().iter().all(is_there)
    }

    /// A view that is sufficient for the laws where features are hidden: unchanged if enough of those that the set-point selects are visible;
    /// otherwise with the hidden ones projected from the pose. `None` where there is no pose.
    #[must_use]
    pub fn sufficient(self, set_point: &SetPoint) -> Option<Self> {
        let selected = set_point.selection().points();
        let seen = selected.clone().filter(|i| self.feature(*i).is_some()).count();
        let all = selected.count();
        let needed = if set_point.selection().needs_outline() { all } else { ENOUGH.min(all) };
        if seen >= needed { Some(self) } else { self.completed(set_point) }
    }

    /// The view with its hidden features projected from the pose. `None` where there is no pose.
    #[must_use]
    pub fn completed(mut self, set_point: &SetPoint) -> Option<Self> {
        for (s, p_O) in self.s.iter_mut().zip(set_point.points()).filter(|(s, _)| !is_there(s)) {
            let p_C = self.X_CO? * p_O;
            if !(p_C.z > 0.0) {
                return None;
            }
            *s = p_C.coords.xy() / p_C.z;
        }
        Some(self)
    }

    /// The object's pose in the camera, where vision found it.
    #[must_use]
    pub fn X_CO(&self) -> Option<&Pose> {
        self.X_CO.as_ref()
    }

    /// The object's true pose, where a simulation has it.
    #[must_use]
    pub fn X_CO_known(&self) -> Option<&Pose> {
        self.X_CO_known.as_ref()
    }

    /// This view with its hidden features and its pose from a predicted view `guess` of the same instant, the pose refined by the visible features;
    /// and the covariance of that pose, as twist `[v; w]` in C, for features with the standard deviation `sd`. `None` when the visible features
    /// lie farther than `largest` from the prediction, root mean square. Normalized units.
    pub(super) fn with_hidden_of(
        mut self,
        guess: &Self,
        set_point: &SetPoint,
        (largest, sd): (f64, f64),
    ) -> Option<(Self, Matrix6<f64>)> {
        let (mut sum, mut count) = (0.0, 0.0);
        for (s, g) in self.s.iter_mut().take(guess.count).zip(&guess.s) {
            if is_there(s) {
                sum += (*s - g).norm_squared();
                count += 1.0;
            } else {
                *s = *g;
            }
        }
        if !(sum <= count * largest * largest) {
            return None;
        }
        let mut pairs = [Correspondence3 { r: Point3::origin(), s: Vector2::zeros() }; MAX_FEATURES];
        for (pair, (r, s)) in pairs.iter_mut().zip(set_point.points().iter().zip(self.features())) {
            *pair = Correspondence3 { r: *r, s: *s };
        }
        let refined = refine_3d(guess.X_CO()?, pairs.get(..self.count)?, sd).ok()?;
        self.X_CO = Some(refined.X_CO);
        Some((self, refined.covariance))
    }

    /// The same view with the object's true pose of a simulation.
    #[must_use]
    pub fn with_known(self, X_CO_known: Option<Pose>) -> Self {
        Self { X_CO_known, ..self }
    }

    /// The same view with the depths that the first measurement of the run gave ([`DepthSource::Initial`](super::DepthSource::Initial)).
    #[must_use]
    pub fn with_initial(self, initial: Option<DepthRow>) -> Self {
        Self { initial, ..self }
    }

    /// The depths that the first measurement of the run gave.
    #[must_use]
    pub fn initial_depths(&self) -> Option<&DepthRow> {
        self.initial.as_ref()
    }

    /// Depth of point `p_O` of the object, m; `fallback_m` where the pose is unknown or puts the point behind the camera.
    #[must_use]
    pub fn depth_m(&self, p_O: &Point3<f64>, fallback_m: f64) -> f64 {
        self.X_CO.map(|X| (X * p_O).z).filter(|z| *z > 0.0).unwrap_or(fallback_m)
    }

    /// The view from another camera frame C', where `X_DC` transforms coordinates from C to C' (D for
    /// "destination"). The object does not move. `None` when a point would lie behind the camera.
    #[must_use]
    pub fn predicted_at(&self, X_DC: &Pose, set_point: &SetPoint) -> Option<Self> {
        let mut there = *self;
        let known = set_point.points().iter().zip(set_point.depths_m());
        for (s, (p_O, z_d)) in there.s.iter_mut().take(self.count).zip(known).filter(|(s, _)| is_there(s)) {
            let z = self.depth_m(p_O, *z_d);
            let p_D = X_DC * Point3::new(s.x * z, s.y * z, z);
            if p_D.z <= 0.0 || !p_D.coords.iter().all(|c| c.is_finite()) {
                return None;
            }
            *s = p_D.coords.xy() / p_D.z;
        }
        there.X_CO = self.X_CO.map(|X_CO| X_DC * X_CO);
        there.X_CO_known = self.X_CO_known.map(|X_CO| X_DC * X_CO);
        Some(there)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{FeatureKind, OutlineFeature, Selection};
    use super::*;
    use crate::messages::TargetStatus;
    use proptest::prelude::*;

    fn square() -> [Point3<f64>; 4] {
        [(0.0, 0.0), (0.1, 0.0), (0.1, 0.1), (0.0, 0.1)].map(|(x, y)| Point3::new(x, y, 0.0))
    }

    fn seen_from(X_CO: &Pose) -> View {
        View::new(square().iter().map(|p| (X_CO * p).coords).map(|p| p.xy() / p.z), Some(*X_CO)).unwrap()
    }

    proptest! {
        #[test]
        fn carrying_is_seeing_from_there(
            a in prop::array::uniform6(-0.2..0.2f64), b in prop::array::uniform6(-0.2..0.2f64)
        ) {
            let goal = Pose::translation(0.0, 0.0, 0.6);
            let set_point = SetPoint::from_pose(&goal, &square()).unwrap();
            let pose = |v: [f64; 6]| Pose::new([v[0], v[1], v[2]].into(), [v[3], v[4], v[5]].into());
            let X_CO = pose(a) * Pose::translation(0.0, 0.0, 0.8);
            let X_DC = pose(b);
            let predicted = seen_from(&X_CO).predicted_at(&X_DC, &set_point).unwrap();
            let there = seen_from(&(X_DC * X_CO));
            for (s, t) in predicted.features().iter().zip(there.features()) {
                prop_assert!((s - t).norm() < 1e-12);
            }
        }
    }

    #[test]
    fn without_a_pose_the_desired_depth_serves() {
        let goal = Pose::translation(0.0, 0.0, 0.5);
        let set_point = SetPoint::from_pose(&goal, &square()).unwrap();
        let view = View::new(set_point.features().to_vec().into_iter(), None).unwrap();
        let predicted = view.predicted_at(&Pose::translation(0.01, 0.0, 0.0), &set_point).unwrap();
        assert!((predicted.features()[0].x - 0.02).abs() < 1e-12);
        assert!(view.predicted_at(&Pose::translation(0.0, 0.0, -0.6), &set_point).is_none());
    }

    #[test]
    fn hidden_features_stay_hidden_or_follow_from_the_pose() {
        let X_CO = Pose::new([-0.04, -0.05, 0.5].into(), [0.2, -0.1, 0.4].into());
        let set_point = SetPoint::from_pose(&Pose::translation(-0.05, -0.05, 0.6), &square())
            .unwrap()
            .with_ids(&[2, 5, 9, 70])
            .unwrap();
        let whole = seen_from(&X_CO);
        let mut m =
            Measurement { status: TargetStatus::Found as u32, feature_count: 4, ..Measurement::default() };
        // 4 and 71 are no points of the set-point, 5 is hidden
        for (f, (id, i)) in m.features.iter_mut().zip([(2, 0), (4, 0), (9, 2), (70, 3)]) {
            let s = whole.features()[i];
            (f.id, f.x, f.y) = (id, s.x, s.y);
        }
        let view = View::of(&m, &set_point).unwrap();
        assert!(view.is_partial() && view.feature(1).is_none() && view.feature(4).is_none());
        assert_eq!([0, 2, 3].map(|i| view.feature(i)), [0, 2, 3].map(|i| Some(&whole.features()[i])));
        assert!(view.sufficient(&set_point).is_none(), "three points and no pose");
        m.set_pose(&X_CO);
        let view = View::of(&m, &set_point).unwrap().sufficient(&set_point).unwrap();
        assert!(!view.is_partial());
        assert!(view.features().iter().zip(whole.features()).all(|(a, b)| (a - b).norm() < 1e-12));
        // where the law needs none of what is hidden, nothing is made up
        let two = Selection::new([(FeatureKind::Point(0), 1.0), (FeatureKind::Point(2), 1.0)]).unwrap();
        let set_point = set_point.with_selection(two).unwrap();
        assert!(View::of(&m, &set_point).unwrap().sufficient(&set_point).unwrap().is_partial());
        // an area needs all of its outline
        let area = Selection::new([(FeatureKind::Outline(OutlineFeature::Area), 1.0)]).unwrap();
        let set_point = set_point.with_selection(area.with_outline([0, 2, 3]).unwrap()).unwrap();
        assert!(View::of(&m, &set_point).unwrap().sufficient(&set_point).unwrap().is_partial());
        let set_point = set_point.with_selection(area.with_outline([0, 1, 3]).unwrap()).unwrap();
        assert!(!View::of(&m, &set_point).unwrap().sufficient(&set_point).unwrap().is_partial());
        for wrong_count in [0, MAX_FEATURES as u32 + 1, u32::MAX] {
            assert!(View::of(&Measurement { feature_count: wrong_count, ..m }, &set_point).is_none());
        }
        m.features[1].id = 9; // twice
        assert!(View::of(&m, &set_point).is_none());
    }

    #[test]
    fn unusable_points_are_refused() {
        assert!(View::new([].into_iter(), None).is_none());
        assert!(View::new([Vector2::new(f64::NAN, 0.0)].into_iter(), None).is_none());
        assert!(View::new([Vector2::zeros(); MAX_FEATURES + 1].into_iter(), None).is_none());
        let set_point = SetPoint::from_pose(&Pose::translation(0.0, 0.0, 0.5), &square()).unwrap();
        assert!(View::of(&Measurement::default(), &set_point).is_none());
    }
}
