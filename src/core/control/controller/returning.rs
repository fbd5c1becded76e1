//! The way back to where the target was last seen whole: once after each loss of the view, and for a target that is looked for again.

use super::Controller;
use crate::control::behaviour::LIMIT_SHARE;
use crate::control::lifecycle::{Cue, State};
use crate::control::trace::Event;
use crate::time::{MonoNs, SpanNs};
use nalgebra::SVector;

/// Longest way back: an arm that a limit in space holds off its end gives up then. Derived: a turn of a joint at a quarter of 2 rad/s, which slow arms reach,
/// takes 12.6 s, and the exponential end from 1 rad to a milliradian at 2 1/s takes 3.5 s.
const LONGEST: SpanNs = SpanNs(20_000_000_000);

/// What is known of the way back.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct ReturnWatch {
    /// Whether the arm has already returned after this loss of the view.
    has_returned: bool,
    /// Since when it is on its way back.
    since: Option<MonoNs>,
    /// Whether it was told that nobody knows where the target is.
    told: bool,
}

impl<const N: usize> Controller<N> {
    /// Updates the lifecycle by whether there is a `way_back`; it was `before` this tick.
    pub(super) fn note_way_back(&mut self, now: MonoNs, before: State, way_back: bool) {
        let ReturnWatch { has_returned, since, told } = self.returning;
        let is_late = since.is_some_and(|since| now - since > LONGEST);
        // An arm that was just started goes nowhere but to its goal, unless that is of another target than what it saw last.
        let may_leave = self.state != State::Waiting || self.servo.looks_for_another();
        // Only one return for each loss of the view: noise about the end of the way back must not start another one.
        let goes = way_back && !has_returned && !is_late && may_leave;
        self.cue(if goes { Cue::WayBack } else { Cue::Returned });
        let lost = self.servo.knows_no_place() && matches!(self.state, State::Holding | State::Waiting);
        if lost && !told {
            self.events.push(Event::NeverSeen);
        }
        self.returning = ReturnWatch {
            has_returned: self.state == State::Holding && (has_returned || before == State::Returning),
            since: (self.state == State::Returning).then(|| since.unwrap_or(now)),
            told: lost || (told && self.servo.looks_for_another()),
        };
    }

    /// The velocity `qd`, rad/s or m/s, of a way back. The way to a target that was seen some time ago may be long and passes where the arm has not just been: it
    /// is as slow as any motion to a posture.
    pub(super) fn pace_of_return(&self, qd: SVector<f64, N>) -> SVector<f64, N> {
        if !self.servo.looks_for_another() {
            return qd;
        }
        let shares =
            qd.iter().zip(&self.arm.limits.velocity).map(|(qd, limit)| qd.abs() / (LIMIT_SHARE * limit));
        let share = shares.fold(0.0, f64::max);
        if share > 1.0 { qd / share } else { qd }
    }
}
