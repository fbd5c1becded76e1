//! Whether the goal is met: since when, and whether it was reported as reached or left.

use crate::control::trace::Event;
use crate::time::{MonoNs, SpanNs};

/// A goal that was reached counts as left when the error exceeds its tolerance so many times. Chosen by hand: with 1, an error that noise keeps about
/// the tolerance would be reported at every measurement; with more, an arm that was pushed away would be reported late.
const LEFT_AT: f64 = 2.0;

/// Watches the feature error against the goal.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct GoalWatch {
    /// Since when every measurement has met the goal.
    met_since: Option<MonoNs>,
    /// Of a goal that was reported as reached and is not left: since when it was met.
    reached_since: Option<MonoNs>,
    /// Whether the last error was beyond what a goal that was reached allows.
    is_away: bool,
}

impl GoalWatch {
    /// Takes in the feature error of a measurement at `now`, px, NaN where it has none; `arrived` says whether the goal is at rest.
    pub(super) fn note_error(&mut self, now: MonoNs, error_px: f64, tolerance_px: f64, arrived: bool) {
        self.is_away = !arrived || error_px > LEFT_AT * tolerance_px;
        if error_px.is_nan() || error_px > tolerance_px || !arrived {
            self.met_since = None;
        } else {
            self.met_since.get_or_insert(now);
        }
    }

    /// Whether the goal has been met for the time `hold`.
    pub(super) fn is_held(&self, now: MonoNs, hold: SpanNs) -> bool {
        self.met_since.is_some_and(|since| now - since >= hold)
    }

    /// The event of this tick, of a run that goes on at its goal: that it was reached, where it is `held`, or left. An arm that does not servo
    /// any more has left it.
    pub(super) fn change(&mut self, servoing: bool, held: bool) -> Option<Event> {
        match self.reached_since {
            None if servoing && held => {
                self.reached_since = self.met_since;
                Some(Event::GoalReached)
            }
            Some(_) if self.is_away || !servoing => {
                (self.reached_since, self.met_since) = (None, None);
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
            let held = watch.is_held(at(ms), hold);
            told.extend(watch.change(true, held).map(|event| (ms, event)));
        }
        assert_eq!(told, [(240, Event::GoalReached), (320, Event::GoalLeft), (480, Event::GoalReached)]);
        assert!((watch.at_goal_s(at(500)) - 0.14).abs() < 1e-9);
        assert_eq!(watch.change(false, true), Some(Event::GoalLeft), "an arm that was stopped");
        assert!(watch.at_goal_s(at(500)).is_nan());
    }
}
