//! What the camera sees at one instant: measured, or carried from its exposure to another time by the camera's known
//! motion.

use super::SetPoint;
use crate::geometry::Pose;
use crate::messages::{MAX_FEATURES, Measurement};
use nalgebra::{Point3, Vector2};

/// Feature points, in normalized coordinates, and where known the object's pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    s: [Vector2<f64>; MAX_FEATURES],
    count: usize,
    X_CO: Option<Pose>,
    X_CO_known: Option<Pose>,
}

impl View {
    /// The view of a measurement; `None` when the target was not found or a feature is not finite.
    #[must_use]
    pub fn of(measurement: &Measurement) -> Option<Self> {
        if !measurement.found() {
            return None;
        }
        Self::new(measurement.features().iter().map(|f| Vector2::new(f.x, f.y)), measurement.pose())
    }

    /// A view of feature points `s`; `None` when there are none, too many, or one is not finite.
    #[must_use]
    pub fn new(s: impl ExactSizeIterator<Item = Vector2<f64>>, X_CO: Option<Pose>) -> Option<Self> {
        let count = s.len();
        if count == 0 || count > MAX_FEATURES {
            return None;
        }
        let mut view = Self { s: [Vector2::zeros(); MAX_FEATURES], count, X_CO, X_CO_known: None };
        for (place, s) in view.s.iter_mut().zip(s) {
            if !(s.x.is_finite() && s.y.is_finite()) {
                return None;
            }
            *place = s;
        }
        Some(view)
    }

    /// The feature points.
    #[must_use]
    pub fn features(&self) -> &[Vector2<f64>] {
        self.s.get(..self.count).unwrap_or(&self.s)
    }

    /// The object's pose in the camera, where vision found it.
    #[must_use]
    pub fn X_CO(&self) -> Option<&Pose> {
        self.X_CO.as_ref()
    }

    /// The object's pose as a simulation knows it, without vision.
    #[must_use]
    pub fn X_CO_known(&self) -> Option<&Pose> {
        self.X_CO_known.as_ref()
    }

    /// The same view with the object's pose that a simulation knows.
    #[must_use]
    pub fn with_known(self, X_CO_known: Option<Pose>) -> Self {
        Self { X_CO_known, ..self }
    }

    /// Depth of point `p_O` of the object, m; `fallback_m` where the pose is unknown or puts the point behind the camera.
    #[must_use]
    pub fn depth_m(&self, p_O: &Point3<f64>, fallback_m: f64) -> f64 {
        self.X_CO.map(|X| (X * p_O).z).filter(|z| *z > 0.0).unwrap_or(fallback_m)
    }

    /// The view from another place: the camera frame C' lies such that `X_DC` brings coordinates from C to C' (D for
    /// "destination"). The object does not move. `None` when a point would come to lie behind the camera.
    #[must_use]
    pub fn carried(&self, X_DC: &Pose, set_point: &SetPoint) -> Option<Self> {
        let mut there = *self;
        let known = set_point.points().iter().zip(set_point.depths_m());
        for (s, (p_O, z_d)) in there.s.iter_mut().take(self.count).zip(known) {
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
    use super::*;
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
            let carried = seen_from(&X_CO).carried(&X_DC, &set_point).unwrap();
            let there = seen_from(&(X_DC * X_CO));
            for (s, t) in carried.features().iter().zip(there.features()) {
                prop_assert!((s - t).norm() < 1e-12);
            }
        }
    }

    #[test]
    fn without_a_pose_the_desired_depth_serves() {
        let goal = Pose::translation(0.0, 0.0, 0.5);
        let set_point = SetPoint::from_pose(&goal, &square()).unwrap();
        let view = View::new(set_point.features().to_vec().into_iter(), None).unwrap();
        let carried = view.carried(&Pose::translation(0.01, 0.0, 0.0), &set_point).unwrap();
        assert!((carried.features()[0].x - 0.02).abs() < 1e-12);
        assert!(view.carried(&Pose::translation(0.0, 0.0, -0.6), &set_point).is_none());
    }

    #[test]
    fn unusable_points_are_refused() {
        assert!(View::new([].into_iter(), None).is_none());
        assert!(View::new([Vector2::new(f64::NAN, 0.0)].into_iter(), None).is_none());
        assert!(View::new([Vector2::zeros(); MAX_FEATURES + 1].into_iter(), None).is_none());
        assert!(View::of(&Measurement::default()).is_none());
    }
}
