//! Teaching a set-point: the mean of what the camera sees in a few measurements.

use super::{SetPoint, View};
use crate::messages::MAX_FEATURES;
use nalgebra::Vector2;

/// A set-point in the making.
#[derive(Debug, Clone, Copy)]
pub(super) struct GoalTeacher {
    wanted: u32,
    /// Measurements still to come.
    pub(super) left: u32,
    sum: [Vector2<f64>; MAX_FEATURES],
}

impl GoalTeacher {
    pub(super) fn new(measurements: u32) -> Self {
        Self { wanted: measurements, left: measurements, sum: [Vector2::zeros(); MAX_FEATURES] }
    }

    /// Takes a view in, unless a feature is hidden and cannot be told from the pose; the last one completes the set-point, which keeps the selection and, where the new features
    /// give no pose even with that of the view to start from, the mean depth of `before`.
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
        // Points that are no plane tell their pose from near it.
        let posed = view.X_CO().filter(|_| taught.X_DO().is_none()).and_then(|X_CO| taught.posed_near(X_CO));
        posed.unwrap_or(taught).with_ids(before.ids())?.with_selection(*before.selection())
    }
}
