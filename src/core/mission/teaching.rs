//! Teaching a set-point: the mean of what the camera sees in a few measurements.

use super::{Mission, Service};
use crate::control::lifecycle::Request;
use crate::control::order::ControlOrder;
use crate::messages::{ControlState, MAX_FEATURES, Measurement};
use crate::servo::{MeasurementVerdict, SetPoint, View};
use nalgebra::Vector2;

/// A set-point in the making.
#[derive(Debug, Clone)]
pub(super) struct GoalTeacher {
    wanted: u32,
    /// Measurements still to come.
    left: u32,
    sum: [Vector2<f64>; MAX_FEATURES],
}

impl GoalTeacher {
    pub(super) fn new(measurements: u32) -> Self {
        Self { wanted: measurements, left: measurements, sum: [Vector2::zeros(); MAX_FEATURES] }
    }

    /// Takes in a view, unless a feature is hidden and cannot be computed from the pose. The last view completes the set-point. It keeps the
    /// selection of `before` and, where the new features give no pose even when started from that of the view, its mean depth.
    pub(super) fn add(&mut self, view: &View, before: &SetPoint) -> Option<SetPoint> {
        if self.left == 0 {
            return None;
        }
        let view = view.completed(before)?;
        for (sum, s) in self.sum.iter_mut().zip(view.features()) {
            *sum += s;
        }
        self.left -= 1;
        if self.left > 0 {
            return None;
        }
        let mut s_d = self.sum;
        for s in &mut s_d {
            *s /= f64::from(self.wanted);
        }
        let depths_m = before.depths_m();
        let z_d_m = depths_m.iter().sum::<f64>() / depths_m.len() as f64;
        let taught = SetPoint::from_features(s_d.get(..view.features().len())?, before.points(), z_d_m)?;
        // The pose of points that are not coplanar is found by iteration from a near one.
        let posed = view.X_CO().filter(|_| taught.X_DO().is_none()).and_then(|X_CO| taught.posed_near(X_CO));
        let taught = posed.unwrap_or(taught).with_target(before.target());
        taught.with_ids(before.ids())?.with_selection(*before.selection())
    }
}

impl<const N: usize> Mission<N> {
    /// Teaching takes the views that the law could use, and is given up where control leaves the state `Teaching`.
    pub(super) fn learn(&mut self, m: &Measurement, verdict: Option<MeasurementVerdict>) {
        if self.state != ControlState::Teaching {
            self.teacher = None;
        }
        let stands = self.teaches_from.is_some_and(|from| m.exposure >= from);
        let Some(teacher) = self.teacher.as_mut().filter(|_| stands) else { return };
        let view = View::of(m, &self.goal.set_point);
        let view = view.filter(|_| verdict.is_some_and(MeasurementVerdict::is_used));
        let Some(taught) = view.and_then(|view| teacher.add(&view, &self.goal.set_point)) else { return };
        self.teacher = None;
        self.set_goal(taught.clone());
        self.orders.push_back(ControlOrder::Goal(taught));
        if self.plan.service == (Service::OneShot { teaches: true }) {
            self.orders.push_back(ControlOrder::Request(Request::Start));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use nalgebra::Point3;

    /// The goal is the mean of what was seen, with its pose.
    #[test]
    fn what_is_seen_becomes_the_goal() {
        let points: Vec<_> =
            [(0.0, 0.0), (0.1, 0.0), (0.1, 0.1), (0.0, 0.1)].map(|(x, y)| Point3::new(x, y, 0.0)).into();
        let before = SetPoint::from_pose(&Pose::translation(0.0, 0.0, 0.6), &points).unwrap();
        let before = before.with_ids(&[2, 3, 5, 7]).unwrap();
        let X_CO = Pose::new([-0.06, -0.04, 0.5].into(), [0.1, -0.2, 0.3].into());
        let exact = SetPoint::from_pose(&X_CO, &points).unwrap();
        let seen = |error: f64| {
            let features: Vec<_> = exact.features().iter().map(|s| s + Vector2::new(error, -error)).collect();
            View::new(features.into_iter(), Some(X_CO)).unwrap()
        };
        let mut teacher = GoalTeacher::new(4);
        for error in [1e-3, -1e-3, 2e-3] {
            assert_eq!(teacher.add(&seen(error), &before), None);
        }
        let taught = teacher.add(&seen(-2e-3), &before).unwrap();
        for (s, s_d) in taught.features().iter().zip(exact.features()) {
            assert!((s - s_d).norm() < 1e-12);
        }
        let off = taught.X_DO().unwrap().inv_mul(&X_CO);
        assert!(off.translation.vector.norm() < 1e-6 && off.rotation.angle() < 1e-6, "{off}");
        assert_eq!(taught.ids(), before.ids());
        assert_eq!(teacher.add(&seen(0.0), &before), None, "it is over");
    }
}
