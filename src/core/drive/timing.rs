//! How the states of a drive come to the ticks of control: one in each of them, in every second or eighth, late, or no more.
//!
//! ```text
//! state of 2 ms    new old new old new old old old old old new
//!                      └ usual ┘       └ is_gap from the fifth on
//! ```
//! It is fed once a tick, and read by everything that supervises the arm: how many ticks a state is old, and from when on that is more than a slower drive's own period.

use super::DriveState;
use crate::time::{SpanNs, TICK};
use nalgebra::SVector;

/// Old states in a row that the slowest drive has, of 125 Hz: derived, a state in 8 ms.
const SLOWEST: u32 = 7;
/// Ticks in a row with an old state over which joints are still supervised: those between two states of the slowest drive, and one that is late. Positions that are so old are off by 25 mrad at
/// 3 rad/s, a share of what any of the supervision allows in its time; chosen by hand.
const LONGEST_HELD: u32 = SLOWEST + 1;
/// So many old states in a row beyond those that a slower drive always has between two new ones are a gap, in which a drive that hangs may not have obeyed. Chosen by hand: networks are late by one or two.
const LATE_IN_ROW: u32 = 4;

/// The ticks of a drive's states.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DriveTiming {
    /// Old states in a row, that of this tick included, and before its state.
    old_in_row: u32,
    before: u32,
    /// The fewest between two new ones, and no fewer than `least`; none before the second.
    usual: Option<u32>,
    /// Those that the drive has between two new ones as it tells, 0 where it tells nothing.
    least: u32,
    has_state: bool,
}

impl DriveTiming {
    /// Longest time without a tick after which control begins with a state as old as behind a gap, and with an arm that did not obey meanwhile. Derived: as many ticks.
    pub const HELD_UP: SpanNs = SpanNs(TICK.0 * LATE_IN_ROW as i64);

    /// Of a drive that tells the time from one of its states to the next, or does not. What a network holds up and then brings at once makes such a drive no quicker.
    #[must_use]
    pub fn of_period(told: Option<SpanNs>) -> Self {
        // To the nearest tick: a drive tells a rounded number.
        let ticks = told.map_or(1, |period| (period.0.max(0) + TICK.0 / 2) / TICK.0);
        let least = u32::try_from(ticks).unwrap_or(u32::MAX).saturating_sub(1).min(SLOWEST);
        Self { least, ..Self::default() }
    }

    /// A tick, with a state that came before or a new one.
    pub fn note(&mut self, is_old: bool) {
        self.before = self.old_in_row;
        if is_old {
            self.old_in_row = self.old_in_row.saturating_add(1);
            return;
        }
        if self.has_state {
            let fewest = self.usual.map_or(self.before, |usual| usual.min(self.before));
            self.usual = Some(fewest.max(self.least));
        }
        (self.old_in_row, self.has_state) = (0, true);
    }

    /// Whether the state of this tick is one that came before, which tells nothing of how joints moved since.
    #[must_use]
    pub fn is_old(&self) -> bool {
        self.old_in_row > 0
    }

    /// Whether no new state came for so long that the one that there is tells nothing of how joints follow.
    #[must_use]
    pub fn tells_nothing(&self) -> bool {
        self.old_in_row > LONGEST_HELD
    }

    /// Whether it came for longer than the drive's own period explains.
    #[must_use]
    pub fn is_gap(&self) -> bool {
        self.old_in_row >= self.usual.unwrap_or(SLOWEST) + LATE_IN_ROW
    }

    /// Ticks from the state before to the new one of this tick.
    #[must_use]
    pub fn ticks(&self) -> u32 {
        1 + self.before
    }

    /// Ticks from one state to the next as this drive has them; before its second, those of the slowest.
    #[must_use]
    pub fn usual_ticks(&self) -> u32 {
        1 + self.usual.unwrap_or(SLOWEST)
    }
}

/// Tells a state that a drive sends once more as if it were new: of an arm that moves by more than its encoders resolve it is the one before to the bit.
#[derive(Debug, Clone, Copy)]
pub struct RepeatedStates<const N: usize> {
    last: DriveState<N>,
    in_row: u32,
}

impl<const N: usize> Default for RepeatedStates<N> {
    fn default() -> Self {
        let nothing = SVector::zeros();
        Self { last: DriveState { q: nothing, qd: nothing, truth: None }, in_row: 0 }
    }
}

impl<const N: usize> RepeatedStates<N> {
    /// Displacement within a tick below which a state may come again, rad or m. Chosen by hand: a five-hundredth of what a joint goes in a tick of the slowest swing that is told (`control/safety/swing.rs`), so that what a repeated state is off by below it tells nothing.
    const LEAST_WAY: f64 = 1e-6;

    /// A tick, with the state of the drive, whose encoders have steps up to `step`, rad or m; whether it came before. A drive that goes on with it is not: its state is what is
    /// believed, and judged, from the slowest drive's period on.
    pub fn note(&mut self, state: &DriveState<N>, step: f64) -> bool {
        let way = state.qd.amax() * TICK.as_s();
        let is_same = state.q == self.last.q && state.qd == self.last.qd;
        if is_same && way > Self::LEAST_WAY.max(2.0 * step) {
            self.in_row = self.in_row.saturating_add(1);
            return self.in_row <= SLOWEST;
        }
        *self = Self { last: *state, in_row: 0 };
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;

    #[test]
    fn a_state_that_comes_again_while_the_arm_moves_is_old() {
        let state =
            |q: f64, qd: f64| DriveState { q: Vector2::new(q, 1.0), qd: Vector2::new(qd, 0.0), truth: None };
        let told = |states: &[(f64, f64)], step: f64| {
            let mut repeats = RepeatedStates::<2>::default();
            states.iter().map(|(q, qd)| repeats.note(&state(*q, *qd), step)).collect::<Vec<_>>()
        };
        let moves = [(0.1, 1.0), (0.1, 1.0), (0.101, 1.0), (0.101, 1.1), (0.101, 1.1)];
        assert_eq!(told(&moves, 0.0), [false, true, false, false, true]);
        assert_eq!(told(&moves, 6e-4), [false; 5], "the encoder has the same value while the arm moves");
        assert_eq!(told(&[(0.1, 0.0); 9], 0.0), [false; 9], "it stands");
        let hangs = told(&[(0.1, 1.0); 20], 0.0);
        assert_eq!(hangs.iter().filter(|old| **old).count(), 7);
        assert!(!hangs[0] && hangs[7] && !hangs[8], "what goes on with one state is judged by it");
    }

    /// After the ticks of `states`: `n` a new state, `o` an old one.
    fn after(states: &str) -> DriveTiming {
        let mut timing = DriveTiming::default();
        states.chars().for_each(|state| timing.note(state == 'o'));
        timing
    }

    #[test]
    fn a_slower_drive_has_its_own_gap() {
        for period in [1, 2, 4, 8_usize] {
            let regular = format!("n{}", "o".repeat(period - 1)).repeat(3);
            let timing = after(&format!("{regular}n"));
            assert_eq!((timing.ticks(), timing.usual_ticks()), (period as u32, period as u32));
            assert!(!timing.is_old() && !timing.is_gap());
            let late = |ticks| after(&format!("{regular}n{}", "o".repeat(ticks)));
            assert!(late(1).is_old());
            assert!(!late(period + 2).is_gap() && late(period + 3).is_gap(), "{period}");
            assert!(!late(8).tells_nothing() && late(9).tells_nothing(), "{period}");
        }
    }

    #[test]
    fn a_told_period_stays_whatever_a_network_does() {
        let ms = |ms: f64| Some(SpanNs::from_s(1e-3 * ms));
        // Of 125 Hz: one state is late, the next one comes right behind it.
        let late = "nooooooonooooooooooooonn";
        let after_told = |period| {
            let mut timing = DriveTiming::of_period(period);
            late.chars().chain("ooooooo".chars()).for_each(|state| timing.note(state == 'o'));
            (timing.usual_ticks(), timing.is_gap())
        };
        assert_eq!(after_told(ms(8.0)), (8, false));
        assert_eq!(after_told(None), (1, true), "who tells nothing is taken for as quick as it seemed once");
        let usual = |period, states: &str| {
            let mut timing = DriveTiming::of_period(period);
            states.chars().for_each(|state| timing.note(state == 'o'));
            timing.usual_ticks()
        };
        let at_once = |period| usual(ms(period), "nn");
        assert_eq!((at_once(1.0), at_once(0.9), at_once(2.04), at_once(0.2)), (1, 1, 2, 1));
        assert_eq!(at_once(50.0), 8, "control works with none that is slower");
        assert_eq!(usual(ms(1.0), "nooooooonooooooon"), 8, "who is slower than it tells is as slow as it is");
    }

    #[test]
    fn before_two_states_a_drive_may_be_the_slowest() {
        assert_eq!(
            (after("").usual_ticks(), after("ooon").usual_ticks(), after("nn").usual_ticks()),
            (8, 8, 1)
        );
        assert!(!after("noooooooooo").is_gap() && after("nooooooooooo").is_gap());
        assert_eq!(after("nooonon").usual_ticks(), 2, "the fewest");
    }
}
