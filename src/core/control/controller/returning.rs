//! The way back to where the target was last seen whole, and the search from there: once after each loss of the view, and for a target that is looked for again.
//!
//! ```text
//! Holding ─ a way back ─► Returning ─ near its end, not seen for some time ─► Returning: search ─► Returning: back ─► Holding
//! ```
//! A law that has lost its target twice in a row, or that comes no nearer to a goal that is far before an end of the arm, tries another way ([`Controller::try_another_way`]): scheme D by the mean interaction matrix goes by the current
//! one, and by any other one by the mean, until another goal is set. Where the description is right the mean loses fewer targets; what it has lost with a mount or a lens that is not as told, it loses again.
//! By the current one the camera goes straight in the image, which takes it away from a target that is turned far about the optical axis, up to the ends of the arm (Chaumette).

use super::Controller;
use super::searching::{SearchMotion, is_elsewhere, within_share};
use crate::control::lifecycle::{Cue, State};
use crate::control::trace::Event;
use crate::messages::Measurement;
use crate::servo::{InteractionAt, MeasurementVerdict, NoTask};
use crate::time::{MonoNs, SpanNs};
use nalgebra::SVector;

/// Longest way back: an arm that a limit in space holds off its end gives up then. Derived: a turn of a joint at a quarter of 2 rad/s, which slow arms reach,
/// takes 12.6 s, and the exponential end from 1 rad to a milliradian at 2 1/s takes 3.5 s.
const LONGEST: SpanNs = SpanNs(20_000_000_000);
/// For how long the target must not be seen from where it was seen before the arm looks around. Chosen by hand: a hand that passes takes as long, and frames at 5 Hz show it twice.
const LOOKED_FOR: SpanNs = SpanNs(500_000_000);

/// Distance from the end of the way back, rad or m, from which on the arm may look around as well. Chosen by hand: half a metre before the target it is 25 mm.
const NEAR: f64 = 0.05;

/// How near to each other, rad or m, two postures at which the target was lost count as the same. Chosen by hand: a plane of [workspace] stops an arm at the same place to a millirad, and a hand
/// that passes takes the view wherever the arm is on its way.
const SAME_PLACE: f64 = 0.1;
/// Losses of the view at one place, each soon after the one before, after which the arm holds. Chosen by hand: chance takes the view at one place twice.
const MOST_LOSSES: u8 = 3;
/// Losses of the view in a row, wherever, each soon after the one before, after which scheme D tries another way. Chosen by hand: the first may be a hand that passed. Measured: of 11 starts before a camera that is
/// 5 to 20 degrees askew, which the mean interaction matrix loses for ever, the current one brings 6 to the goal.
const OTHER_WAY_AFTER: u8 = 2;

/// Losses of the view in a row at one place: what stands in the way there is no chance, and going back brings the arm there again.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct LossCount<const N: usize> {
    /// Where and when the last one was.
    last: Option<(SVector<f64, N>, MonoNs)>,
    count: u8,
    /// Those at any places.
    in_a_row: u8,
}

impl<const N: usize> LossCount<N> {
    /// The same count after a loss at `q`, rad or m.
    fn after(self, q: SVector<f64, N>, now: MonoNs) -> Self {
        let last = self.last.filter(|(_, when)| now - *when < LONGEST);
        let more = |is_again: bool, count: u8| if is_again { count.saturating_add(1) } else { 1 };
        let is_there = last.is_some_and(|(at, _)| (q - at).amax() < SAME_PLACE);
        Self {
            last: Some((q, now)),
            count: more(is_there, self.count),
            in_a_row: more(last.is_some(), self.in_a_row),
        }
    }

    fn is_for_ever(&self) -> bool {
        self.count >= MOST_LOSSES
    }
}

/// What is known of the way back.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct ReturnWatch<const N: usize> {
    /// The losses of the view before this one, and this one.
    losses: LossCount<N>,
    /// Whether the arm has already returned after this loss of the view.
    has_returned: bool,
    /// Since when it is on its way back.
    since: Option<MonoNs>,
    /// Since when the target is lost.
    lost_since: Option<MonoNs>,
    /// The search, while it goes on.
    search: Option<SearchMotion>,
    /// Whether the arm has already searched after this loss of the view.
    has_searched: bool,
    /// Whether the last measurement says that the target is elsewhere.
    elsewhere: bool,
    /// Whether it says where the target is, so that the view is lost because that is refused: no other way helps against it.
    is_found: bool,
    /// Whether it was told that nobody knows where the target is.
    told: bool,
    /// Whether the goal's target is another one than the arm servoed on last, and so may be far from where the arm is.
    is_other: bool,
    /// Whether the arm waited for its target already.
    waited: bool,
    /// The interaction matrix by which the law was to go, where it goes another way.
    asked_way: Option<InteractionAt>,
    /// Whether the arm is to go back to where the law began, whatever it sees on its way.
    to_begin: bool,
}

impl<const N: usize> ReturnWatch<N> {
    pub(super) fn note(&mut self, m: &Measurement, verdict: MeasurementVerdict) {
        // What is left of a target at the border of the view says as well that it is elsewhere.
        let is_cut_off = matches!(
            verdict,
            MeasurementVerdict::TooFewFeatures | MeasurementVerdict::NoTask(NoTask::TooFew)
        );
        self.is_found = m.found();
        self.elsewhere = is_cut_off || is_elsewhere(m.target_status());
    }

    /// A new goal has other losses.
    pub(super) fn forget_losses(&mut self) {
        (self.losses, self.asked_way) = (LossCount::default(), None);
    }

    /// What was lost and looked for so far was another target.
    pub(super) fn forget_target(&mut self) {
        *self = Self { told: self.told, is_other: true, asked_way: self.asked_way, ..Self::default() };
    }

    pub(super) fn is_to_begin(&self) -> bool {
        self.to_begin
    }

    /// Whether an arm that is to go to the begin, with a way `left`, rad or m, is on its way: about its end it goes on as soon as it sees its target.
    pub(super) fn goes_to_begin(&self, left: Option<f64>) -> bool {
        self.to_begin && left.is_some_and(|left| left > NEAR)
    }

    pub(super) fn is_searching(&self) -> bool {
        self.search.is_some()
    }

    pub(super) fn search_mut(&mut self) -> Option<&mut SearchMotion> {
        self.search.as_mut()
    }
}

impl<const N: usize> Controller<N> {
    /// Updates the lifecycle by whether the camera `sees` anything, and how far a way back has still to go, rad or m; it was `before` this tick.
    pub(super) fn note_way_back(&mut self, now: MonoNs, before: State, (sees, left): (bool, Option<f64>)) {
        let r = self.returning;
        // That it was seen on the way of some motion does not say that it is in view where the arm starts.
        let begins = r.is_other && self.state == State::Waiting && !r.waited;
        if begins {
            self.servo.look_for_it_again();
        }
        let left = left.filter(|_| !begins);
        let is_late = r.since.is_some_and(|since| now - since > LONGEST);
        // An arm that was just started goes nowhere but to its goal, unless that is of another target than what it saw last.
        let may_leave = self.state != State::Waiting || self.servo.looks_for_another();
        let is_away = |state| matches!(state, State::Holding | State::Returning);
        let ongoing = r.search.filter(|search| sees && is_away(self.state) && search.goes_on(now));
        let ends = r.search.is_some() && ongoing.is_none();
        // Only one return for each loss of the view: noise about the end of the way back must not start another one. After a search the arm goes back once more.
        let is_new = self.state == State::Holding && before == State::Servoing && !r.to_begin;
        let losses = if is_new { r.losses.after(self.reference.state().q, now) } else { r.losses };
        if is_new && (r.elsewhere || !r.is_found) && losses.in_a_row >= OTHER_WAY_AFTER {
            self.try_another_way();
        }
        let is_for_ever = losses.is_for_ever() && is_away(self.state);
        if is_new && is_for_ever && left.is_some() {
            self.events.push(Event::LostAgain);
        }
        let has_way = left.is_some() || self.returning.to_begin && !r.to_begin;
        let goes = has_way && (ends || !r.has_returned) && !is_late && may_leave && !is_for_ever;
        // Not from where a way back was given up.
        let is_near = left.is_none_or(|left| left < NEAR);
        let search = ongoing.or_else(|| self.search_begins(now, sees && is_near));
        self.returning.search = search;
        self.cue(if goes || search.is_some() { Cue::WayBack } else { Cue::Returned });
        let lost = self.servo.knows_no_place() && matches!(self.state, State::Holding | State::Waiting);
        if lost && !r.told {
            self.events.push(Event::NeverSeen);
        }
        let (holds, returns) = (self.state == State::Holding, self.state == State::Returning);
        let searches = search.is_some() && returns;
        match (r.search.is_some(), searches) {
            // From a state that held this was told by the change of state.
            (false, true) if before == State::Returning => self.events.push(Event::Searching),
            (true, false) if returns => self.events.push(Event::Returning),
            _ => {}
        }
        self.returning = ReturnWatch {
            losses,
            has_returned: holds && (r.has_returned || before == State::Returning),
            since: returns.then(|| r.since.filter(|_| !ends).unwrap_or(now)),
            lost_since: is_away(self.state).then(|| r.lost_since.unwrap_or(now)),
            search: search.filter(|_| searches),
            has_searched: is_away(self.state) && (r.has_searched || searches),
            elsewhere: r.elsewhere,
            is_found: r.is_found,
            told: lost || (r.told && self.servo.looks_for_another()),
            is_other: r.is_other && self.state != State::Servoing,
            waited: self.state == State::Waiting,
            asked_way: self.returning.asked_way,
            to_begin: self.returning.to_begin && returns && (r.goes_to_begin(left) || !r.to_begin),
        };
    }

    /// Has the law go another way to this goal, once, from where it began, which is reported as an event. Not where somebody else commands the arm in its place.
    pub(in crate::control) fn try_another_way(&mut self) {
        let goes_by_law = matches!(self.state, State::Holding | State::Returning | State::Servoing)
            && self.behaviour.goes_by_law();
        if self.returning.asked_way.is_some() || !goes_by_law {
            return;
        }
        self.returning.asked_way = self.servo.take_other_interaction();
        if self.returning.asked_way.is_some() {
            self.returning.to_begin = true;
            self.events.push(Event::AnotherWay);
        }
    }

    /// Another goal may be reached by the law as it was asked for.
    pub(super) fn forget_losses(&mut self) {
        if let Some(asked) = self.returning.asked_way {
            self.servo.set_interaction(asked);
        }
        self.returning.forget_losses();
        self.servo.begin_here();
    }

    /// A search that begins now, of an arm that `may` look around.
    fn search_begins(&self, now: MonoNs, may: bool) -> Option<SearchMotion> {
        let settings = self.servo.settings();
        let longest = settings.search.filter(|_| settings.returns && may)?;
        let ReturnWatch { lost_since, has_searched, elsewhere, .. } = self.returning;
        let waited = lost_since.is_some_and(|since| now - since > LOOKED_FOR);
        let begins = waited && elsewhere && !has_searched;
        (begins && self.servo.seen_place().is_some()).then(|| SearchMotion::new(now, longest))
    }

    /// The velocity `qd`, rad/s or m/s, of a way back. The way to where the law began, to a target that was seen some time ago, or from the end of a search, may be long and passes where the arm has not
    /// just been: it is as slow as any motion to a posture.
    pub(super) fn pace_of_return(&self, qd: SVector<f64, N>) -> SVector<f64, N> {
        if !self.servo.looks_for_another() && !self.returning.has_searched && !self.returning.to_begin {
            return qd;
        }
        qd * within_share(&qd, &self.arm.limits.velocity)
    }
}
