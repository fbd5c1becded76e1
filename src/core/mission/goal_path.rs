//! A goal that moves on its path: errors are those from where it was at each exposure, and the goal is reached after the end of the path.

use super::Mission;
use crate::control::trace::Trace;
use crate::servo::SetPoint;
use crate::time::MonoNs;
use serde::{Deserialize, Serialize};

/// How near the features of a run stayed to a moving goal.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct PathTracking {
    /// Length of the path, s.
    pub end_s: f64,
    /// Whether the arm was moved along with the goal.
    pub feed_forward: bool,
    /// Measurements while the goal moved.
    pub measurements: u64,
    /// Root mean square of their feature errors, each against the goal at its exposure, px; `null` without a measurement.
    pub rms_px: Option<f64>,
    /// The largest of them, px.
    pub max_px: Option<f64>,
}

impl PathTracking {
    /// The same in words.
    #[must_use]
    pub fn describe(&self) -> String {
        let with = if self.feed_forward { "with" } else { "without" };
        let errors = self.rms_px.zip(self.max_px).map_or_else(
            || "nothing was measured on it".to_string(),
            |(rms, max)| format!("feature error {rms:.3} px rms, {max:.3} px at most"),
        );
        format!("{:.3} s, {with} feed-forward: {errors}", self.end_s)
    }
}

/// Sums of the feature errors while the goal moved.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct TrackingSums {
    measurements: u64,
    squares: f64,
    max_px: f64,
}

impl<const N: usize> Mission<N> {
    /// The time on the path at `then`, s; `None` before its begin, and without one.
    fn path_s(&self, then: MonoNs) -> Option<f64> {
        self.plan.path.as_ref()?;
        Some((then - self.path_began?).as_s())
    }

    /// Moves the goal to where it is at this tick.
    pub(super) fn move_goal(&mut self, trace: &Trace) {
        self.path_began = trace.path_began;
        if let Some((path, t_s)) = self.plan.path.as_ref().zip(self.path_s(trace.time)) {
            self.goal.set_point.move_to(&path.at(t_s).X_DO);
        }
        if !self.has_arrived(trace.time) {
            // What is behind a goal that moves does not stay, and is no oscillation.
            self.residual.begin_anew();
        }
    }

    /// Whether the goal rests at the end of its path at `then`; true without one.
    pub(super) fn has_arrived(&self, then: MonoNs) -> bool {
        self.plan.path.as_ref().is_none_or(|path| self.path_s(then).is_some_and(|t_s| t_s >= path.end_s()))
    }

    /// The set-point at the exposure `then`, where it was another one than now.
    pub(super) fn set_point_at(&self, then: MonoNs) -> Option<SetPoint> {
        let (path, t_s) = self.plan.path.as_ref().zip(self.path_s(then))?;
        let mut set_point = self.goal.set_point.clone();
        set_point.move_to(&path.at(t_s).X_DO).then_some(set_point)
    }

    /// Takes in the feature error of a measurement that was exposed at `then`, px, NaN where it has none.
    pub(super) fn note_tracking(&mut self, then: MonoNs, error_px: f64) {
        let moving = self.plan.path.as_ref().zip(self.path_s(then)).map(|(path, t_s)| path.at(t_s));
        if moving.is_some_and(|goal| goal.V_OD_D.norm() > 0.0) && error_px.is_finite() {
            let sums = &mut self.tracking;
            sums.measurements += 1;
            sums.squares += error_px * error_px;
            sums.max_px = sums.max_px.max(error_px);
        }
    }

    /// How near the run stayed to its goal on the path; `None` for a goal at rest.
    #[must_use]
    pub fn path_tracking(&self) -> Option<PathTracking> {
        let path = self.plan.path.as_ref()?;
        let TrackingSums { measurements, squares, max_px } = self.tracking;
        let some = measurements > 0;
        Some(PathTracking {
            end_s: path.end_s(),
            feed_forward: path.feed_forward,
            measurements,
            rms_px: some.then(|| (squares / measurements as f64).sqrt()),
            max_px: some.then_some(max_px),
        })
    }
}
