//! Whether the arm stands.

use super::{Controller, Rest, State};
use crate::time::{MonoNs, SpanNs, TICK};

/// How long an arm may go on moving after its reference has come to rest. Chosen by hand: a run must end even if an arm never rests.
const PATIENCE: SpanNs = SpanNs(3_000_000_000);
/// The same of an arm with a joint whose encoder says nothing: no motor can brake that one, and the sooner the run ends, the sooner the drive's brakes do. Chosen by hand.
const PATIENCE_UNHEARD: SpanNs = SpanNs(200_000_000);

/// How much longer than within its limits an arm may take to brake before each joint is braked by itself. Chosen by hand: what is off its model by a tenth is at rest by then.
const OVERDUE: SpanNs = SpanNs(200_000_000);

impl<const N: usize> Controller<N> {
    /// Whether an arm in a fault should have come to rest at `now`, and never has since braking began, or since what pushed it let go.
    pub(super) fn is_overdue(&self, now: MonoNs) -> bool {
        let longest = SpanNs(self.longest_braking.0.saturating_add(OVERDUE.0));
        let let_go = self.touched_at.filter(|_| self.is_let_go(now));
        !self.has_rested && self.brakes_since.max(let_go).is_some_and(|since| now - since > longest)
    }

    /// Notes whether the arm stands at `now`; `seen`: its state is known.
    pub(super) fn note_rest(&mut self, now: MonoNs, seen: bool) {
        let brakes = matches!(self.state, State::Stopping | State::Failing | State::Fault | State::Clearing);
        let since = *self.brakes_since.get_or_insert(now);
        self.brakes_since = brakes.then_some(since);
        // From `v <= J T^2` braking takes at most two ticks `T`, and in one tick it changes the acceleration by at most
        // `J T`: a standstill at the next one is within the limits.
        let reference_rests = self.reference.rests_within(SpanNs(2 * TICK.0));
        let since = *self.rests_since.get_or_insert(now);
        self.rests_since = (reference_rests && !self.state.moves()).then_some(since);
        let heard = self.encoder_watch.distrusted() == [false; N];
        let patience = if heard { PATIENCE } else { PATIENCE_UNHEARD };
        let longest_braking = SpanNs(patience.0.saturating_add(self.longest_braking.0));
        let is_over = |since: Option<MonoNs>, patience| since.is_some_and(|since| now - since > patience);
        self.rest = if self.rests_since.is_some() && (!seen || self.rest_watch.is_at_rest()) {
            if seen { Rest::AtRest } else { Rest::Unknown }
        } else if is_over(self.rests_since, patience)
            || (brakes && is_over(self.brakes_since, longest_braking))
        {
            Rest::Restless
        } else {
            Rest::Moving
        };
        self.has_rested = brakes && (self.has_rested || self.rest == Rest::AtRest);
    }
}
