//! Whether the arm stands.

use super::{Controller, Rest, State};
use crate::control::safety::REST_SPEED;
use crate::drive::{CommandMode, DriveState};
use crate::robot::joint_in_words;
use crate::time::{MonoNs, SpanNs, TICK};
use nalgebra::SVector;

/// How long an arm may go on moving after its reference has come to rest. Chosen by hand: a run must end even if an arm never rests.
const PATIENCE: SpanNs = SpanNs(3_000_000_000);
/// The same of an arm whose state is not usable, or of which a joint's encoder says nothing: no torque can brake that one, and the sooner the run ends, the sooner the drive's brakes do.
/// Chosen by hand: a drive with a servo of its own, which goes on braking by the commands, has come to rest by then.
const PATIENCE_UNHEARD: SpanNs = SpanNs(200_000_000);

/// How much longer than within its limits an arm may take to brake before each joint is braked by itself. Chosen by hand: what is off its model by a tenth is at rest by then.
const OVERDUE: SpanNs = SpanNs(200_000_000);

/// Whether the arm stands, and since when what tells it.
#[derive(Debug, Clone)]
pub(super) struct Standstill<const N: usize> {
    pub(super) rest: Rest,
    /// When the reference came to rest while the arm is to stand, and when braking began.
    rests_since: Option<MonoNs>,
    brakes_since: Option<MonoNs>,
    /// Since when no state was usable.
    unseen_since: Option<MonoNs>,
    /// Whether the arm has come to rest since braking began.
    has_rested: bool,
    /// Longest time from any motion to rest.
    longest_braking: SpanNs,
    /// The velocities of the joints in the last usable state, rad/s or m/s.
    known_qd: SVector<f64, N>,
}

impl<const N: usize> Standstill<N> {
    /// An arm of which nothing is known yet, and that brakes within `longest_braking`.
    pub(super) fn new(longest_braking: SpanNs) -> Self {
        Self {
            rest: Rest::Moving,
            rests_since: None,
            brakes_since: None,
            unseen_since: None,
            has_rested: false,
            longest_braking,
            known_qd: SVector::zeros(),
        }
    }
}

/// A joint of which nobody can tell whether it stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UnknownJoint {
    /// Which, from 0.
    pub joint: usize,
    /// Its velocity in the last state that was usable, rad/s or m/s.
    pub known: f64,
    /// What the drive says of its velocity, rad/s or m/s; NaN where that is no number.
    pub reported: f64,
    /// Whether it moves along its axis, so that velocities are in m/s.
    pub slides: bool,
}

impl UnknownJoint {
    /// Whether it stood in its last usable state, and the drive does not say otherwise.
    pub(in crate::control) fn stood(&self) -> bool {
        let is_slow = |qd: f64| qd.abs() <= REST_SPEED;
        is_slow(self.known) && (self.reported.is_nan() || is_slow(self.reported))
    }

    /// What is told of it at the end of a run, with the `names` of all joints.
    #[must_use]
    pub fn in_words<S: AsRef<str>>(&self, names: &[S]) -> String {
        let unit = if self.slides { "m/s" } else { "rad/s" };
        let [known, reported] = [self.known, self.reported].map(|qd| format!("{qd:.2} {unit}"));
        let says = if self.reported.is_finite() && reported != known {
            format!(", and the drive says {reported}")
        } else {
            String::new()
        };
        let joint = joint_in_words(names, self.joint);
        format!(
            "the run ended while nobody could tell whether {joint} stood: its last known velocity was {known}{says}"
        )
    }
}

impl<const N: usize> Controller<N> {
    /// Whether an arm in a fault should have come to rest at `now`, and never has since braking began, or since what pushed it let go.
    pub(super) fn is_overdue(&self, now: MonoNs) -> bool {
        let stands = &self.standstill;
        let longest = SpanNs(stands.longest_braking.0.saturating_add(OVERDUE.0));
        let let_go = self.touched_at.filter(|_| self.is_let_go(now));
        !stands.has_rested && stands.brakes_since.max(let_go).is_some_and(|since| now - since > longest)
    }

    /// Notes whether the arm stands at `now`, in the state that is believed of it; `None` where none is usable.
    pub(super) fn note_rest(&mut self, now: MonoNs, believed: Option<&DriveState<N>>) {
        let brakes = matches!(self.state, State::Stopping | State::Failing | State::Fault | State::Clearing);
        // From `v <= J T^2` braking takes at most two ticks `T`, and in one tick it changes the acceleration by at most
        // `J T`: a standstill at the next one is within the limits.
        let reference_rests = self.reference.rests_within(SpanNs(2 * TICK.0));
        let distrusted = self.encoder_watch.distrusted();
        let heard = distrusted == [false; N];
        let stands = &mut self.standstill;
        if let Some(believed) = believed {
            stands.known_qd =
                SVector::from_fn(|i, _| if distrusted[i] { stands.known_qd[i] } else { believed.qd[i] });
        }
        let since = |holds: bool, before: Option<MonoNs>| holds.then(|| before.unwrap_or(now));
        stands.brakes_since = since(brakes, stands.brakes_since);
        stands.rests_since = since(reference_rests && !self.state.moves(), stands.rests_since);
        stands.unseen_since = since(believed.is_none(), stands.unseen_since);
        let is_over = |since: Option<MonoNs>, patience| since.is_some_and(|since| now - since > patience);
        let is_lost = is_over(stands.unseen_since, PATIENCE_UNHEARD);
        let patience = if heard && !is_lost { PATIENCE } else { PATIENCE_UNHEARD };
        let longest_braking = SpanNs(patience.0.saturating_add(stands.longest_braking.0));
        let is_settled = match believed {
            Some(_) => !heard || self.rest_watch.is_at_rest(),
            // Torques do not brake what is not seen, and a load that nobody told sags under them: the drive's brakes are to hold it.
            None => self.mode == CommandMode::Torque,
        };
        stands.rest = if stands.rests_since.is_some() && is_settled {
            if heard && believed.is_some() { Rest::AtRest } else { Rest::Unknown }
        } else if is_over(stands.rests_since, patience)
            || (brakes && is_over(stands.brakes_since, longest_braking))
        {
            if is_lost { Rest::Unknown } else { Rest::Restless }
        } else {
            Rest::Moving
        };
        stands.has_rested = brakes && (stands.has_rested || stands.rest == Rest::AtRest);
    }

    /// The joint that is most likely to move of those that `reported`, the drive's last state, tells nothing about; `None` while the state of all is known. Those that were fast against their limits are told first.
    #[must_use]
    pub fn unknown_joint(&self, reported: &DriveState<N>) -> Option<UnknownJoint> {
        let is_blind = self.standstill.unseen_since.is_some();
        let distrusted = self.encoder_watch.distrusted();
        let share = |i: usize| {
            let speed =
                self.standstill.known_qd[i].abs().max(if is_blind { reported.qd[i].abs() } else { 0.0 });
            speed / self.arm.limits.velocity[i]
        };
        let joint =
            (0..N).filter(|i| is_blind || distrusted[*i]).max_by(|a, b| share(*a).total_cmp(&share(*b)))?;
        Some(UnknownJoint {
            joint,
            known: self.standstill.known_qd[joint],
            reported: if is_blind { reported.qd[joint] } else { f64::NAN },
            slides: self.arm.robot.is_prismatic(joint),
        })
    }
}
