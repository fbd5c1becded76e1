//! Whether the goal is met: since when, and whether it was reported as reached or left.
//!
//! It is met by every measurement for a time, or, where measurements scatter beyond it, in the [mean](super::goal_mean).

use super::goal_mean::{GoalMean, LEFT_AT, MetInMean};
use super::{Goal, Mission};
use crate::control::outcome::{Finish, Outcome};
use crate::control::trace::Event;
use crate::messages::Measurement;
use crate::servo::{SetPoint, View, stated_px2};
use crate::time::{MonoNs, SpanNs};
use nalgebra::Vector2;

/// The end of a run that has met its goal.
pub(super) const CONVERGED: Finish =
    Finish { outcome: Outcome::Converged, reason: "the goal was reached and held" };
/// The same in the mean; the confidence follows from the quantile in [`super::goal_mean`].
const CONVERGED_IN_MEAN: Finish = Finish {
    outcome: Outcome::Converged,
    reason: "the goal was reached and held in the mean: single measurements scatter beyond goal.feature_error_px, their mean is within it with 99 % \
             confidence",
};

/// A goal counts as left by [`LEFT_AT`], and where errors scatter by so many standard deviations of the scatter beside it. Derived: of a single point, whose squared error over its scatter is chi-square of two degrees of freedom over
/// two, one in 8000 exceeds it, and of more points fewer.
const SCATTERS: f64 = 3.0;

/// Watches the feature error against the goal.
#[derive(Debug, Clone, Default)]
pub(super) struct GoalWatch {
    /// Since when every measurement has met the goal.
    met_since: Option<MonoNs>,
    /// Errors of the measurements in a row, and since when they meet the goal in the mean.
    mean: Box<GoalMean>,
    met_in_mean: Option<MetInMean>,
    /// Mean square by which single errors scatter at a goal that was reached in the mean, px^2.
    scatter_px2: f64,
    /// Of a goal that was reported as reached and is not left: since when it was met.
    reached_since: Option<MonoNs>,
    /// Whether the last error was beyond what a goal that was reached allows.
    is_away: bool,
}

impl<const N: usize> Mission<N> {
    /// Takes in the measurement `m` at `now`, whose feature error is `error_px`, NaN where it has none, and whether the goal is at rest.
    pub(super) fn watch_goal(&mut self, now: MonoNs, m: &Measurement, error_px: f64, arrived: bool) {
        let Self { goal, goal_watch, plan, .. } = self;
        goal_watch.watch((now, m), (error_px, arrived), (&goal.set_point, goal), &plan.f_px);
    }
}

impl GoalWatch {
    /// The goal is another one, or the arm starts anew.
    pub(super) fn begin_anew(&mut self) {
        self.mean.begin_anew();
        (self.met_since, self.met_in_mean, self.reached_since) = (None, None, None);
        (self.scatter_px2, self.is_away) = (0.0, false);
    }

    /// It is to be met for another time: since when it is met stays.
    pub(super) fn hold_anew(&mut self) {
        (self.met_in_mean, self.reached_since) = (None, None);
    }

    /// Takes in a measurement that came at a time, with its feature error, px, NaN where it has none, and whether the goal is at rest: of `set_point`, within the tolerance
    /// and for the time of `goal`, by a lens with the focal lengths `f_px`.
    pub(super) fn watch(
        &mut self,
        (now, m): (MonoNs, &Measurement),
        (error_px, arrived): (f64, bool),
        (set_point, goal): (&SetPoint, &Goal),
        f_px: &Vector2<f64>,
    ) {
        self.note_error(now, error_px, goal.tolerance_px, arrived);
        match View::of(m, set_point).filter(|_| arrived && error_px.is_finite()) {
            Some(view) => self.mean.note(now, &view, (set_point, f_px), stated_px2(m)),
            None => self.mean.begin_anew(),
        }
        self.met_in_mean = self.mean.met(now, goal.tolerance_px, goal.hold);
    }

    /// Whether the last error was beyond what a goal that was reached allows.
    pub(super) fn is_away(&self) -> bool {
        self.is_away
    }

    /// Takes in the feature error of a measurement at `now`, px, NaN where it has none; `arrived` says whether the goal is at rest.
    pub(super) fn note_error(&mut self, now: MonoNs, error_px: f64, tolerance_px: f64, arrived: bool) {
        let largest_px2 = (LEFT_AT * tolerance_px).powi(2) + SCATTERS * SCATTERS * self.scatter_px2;
        self.is_away = !arrived || error_px > largest_px2.sqrt();
        if error_px.is_nan() || error_px > tolerance_px || !arrived {
            self.met_since = None;
        } else {
            self.met_since.get_or_insert(now);
        }
    }

    /// The end of a run whose goal has been met by every measurement for the time `hold`, or in the mean.
    pub(super) fn held(&self, now: MonoNs, hold: SpanNs) -> Option<Finish> {
        let by_each = self.met_since.is_some_and(|since| now - since >= hold).then_some(CONVERGED);
        by_each.or(self.met_in_mean.map(|_| CONVERGED_IN_MEAN))
    }

    /// The event of this tick, of a run that goes on at its goal: that it was reached, where it is `held`, or left. An arm that does not servo
    /// any more has left it.
    pub(super) fn change(&mut self, servoing: bool, held: bool) -> Option<Event> {
        match self.reached_since {
            None if servoing && held => {
                let in_mean =
                    self.met_in_mean.filter(|mean| self.met_since.is_none_or(|each| mean.since < each));
                self.reached_since = in_mean.map(|mean| mean.since).or(self.met_since);
                self.scatter_px2 = in_mean.map_or(0.0, |mean| mean.scatter_px2);
                Some(Event::GoalReached)
            }
            Some(_) if self.is_away || !servoing => {
                self.begin_anew();
                Some(Event::GoalLeft)
            }
            _ => None,
        }
    }

    /// For how long the goal has been reached and held at `now`, s; NaN where it is not.
    pub(super) fn at_goal_s(&self, now: MonoNs) -> f64 {
        self.reached_since.map_or(f64::NAN, |since| (now - since).as_s())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_goal_is_reached_when_held_and_left_beyond_its_tolerance() {
        let at = |ms: i64| MonoNs(ms * 1_000_000);
        let hold = SpanNs(100_000_000);
        let mut watch = GoalWatch::default();
        let mut told = Vec::new();
        for (ms, error_px) in [
            (0, 9.0),
            (40, 0.9),
            (80, 1.1),
            (120, 0.8),
            (240, 0.9),
            (280, 1.9),
            (320, 2.1),
            (360, 0.1),
            (480, 0.1),
        ] {
            watch.note_error(at(ms), error_px, 1.0, true);
            let held = watch.held(at(ms), hold).is_some();
            told.extend(watch.change(true, held).map(|event| (ms, event)));
        }
        assert_eq!(told, [(240, Event::GoalReached), (320, Event::GoalLeft), (480, Event::GoalReached)]);
        assert!((watch.at_goal_s(at(500)) - 0.14).abs() < 1e-9);
        assert_eq!(watch.change(false, true), Some(Event::GoalLeft), "an arm that was stopped");
        assert!(watch.at_goal_s(at(500)).is_nan());
    }
}
