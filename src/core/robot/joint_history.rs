//! The history of the joints: their last states, and their positions at any time between these.

use crate::time::{MonoNs, SpanNs};
use nalgebra::SVector;

/// States kept: a second at 1 kHz, twice what the longest latency needs, since `camera.latency_ms` is at most 500.
const CAPACITY: usize = 1024;
/// Longest extrapolation of a motion beyond its last state; after that the arm counts as standing. Chosen by hand: 20 ticks.
const LONGEST_EXTRAPOLATION: SpanNs = SpanNs(20_000_000);

/// The last states of `N` joints. Memory is taken once, at the start.
#[derive(Debug)]
pub struct JointHistory<const N: usize> {
    /// Ring: the oldest state stands at `next` once the ring is full.
    states: Vec<JointSample<N>>,
    next: usize,
}

#[derive(Debug, Clone, Copy)]
struct JointSample<const N: usize> {
    stamp: MonoNs,
    q: SVector<f64, N>,
    qd: SVector<f64, N>,
}

impl<const N: usize> Default for JointHistory<N> {
    fn default() -> Self {
        Self::new()
    }
}

/// With room for all states: a copy may be used in a tick, too.
impl<const N: usize> Clone for JointHistory<N> {
    fn clone(&self) -> Self {
        let mut states = Vec::with_capacity(CAPACITY);
        states.extend_from_slice(&self.states);
        Self { states, next: self.next }
    }
}

impl<const N: usize> JointHistory<N> {
    /// A history without a state.
    #[must_use]
    pub fn new() -> Self {
        Self { states: Vec::with_capacity(CAPACITY), next: 0 }
    }

    /// Appends a state, rad or m. One that is not newer than the last starts the history anew: its clock was
    /// restarted.
    pub fn push(&mut self, stamp: MonoNs, q: &SVector<f64, N>, qd: &SVector<f64, N>) {
        if self.newest().is_some_and(|last| stamp <= last) {
            self.states.clear();
            self.next = 0;
        }
        let state = JointSample { stamp, q: *q, qd: *qd };
        match self.states.get_mut(self.next) {
            Some(oldest) => *oldest = state,
            None => self.states.push(state),
        }
        self.next = (self.next + 1) % CAPACITY;
    }

    /// Stamp of the newest state.
    #[must_use]
    pub fn newest(&self) -> Option<MonoNs> {
        let last = self.states.len().checked_sub(1)?;
        self.get(last).map(|s| s.stamp)
    }

    /// Stamp of the oldest state.
    #[must_use]
    pub fn oldest(&self) -> Option<MonoNs> {
        self.get(0).map(|s| s.stamp)
    }

    /// Joint positions at `time`, rad or m; `None` without any state.
    ///
    /// Linear between neighbouring states, which at 1 kHz is true to 2 um at 10 m/s^2; carried on with the nearest
    /// velocity, for at most 20 ms, before the oldest and after the newest.
    #[must_use]
    pub fn joints(&self, time: MonoNs) -> Option<SVector<f64, N>> {
        let after = self.first_not_before(time);
        match (after.checked_sub(1).and_then(|i| self.get(i)), self.get(after)) {
            (Some(a), Some(b)) => {
                let share = (time - a.stamp).as_s() / (b.stamp - a.stamp).as_s();
                Some(a.q + (b.q - a.q) * share)
            }
            (Some(last), None) => {
                Some(last.q + last.qd * (time - last.stamp).min(LONGEST_EXTRAPOLATION).as_s())
            }
            (None, Some(first)) => {
                Some(first.q - first.qd * (first.stamp - time).min(LONGEST_EXTRAPOLATION).as_s())
            }
            (None, None) => None,
        }
    }

    /// The state at `index`, counted from the oldest.
    fn get(&self, index: usize) -> Option<&JointSample<N>> {
        if index >= self.states.len() {
            return None;
        }
        let start = if self.states.len() < CAPACITY { 0 } else { self.next };
        self.states.get((start + index) % CAPACITY)
    }

    /// Index of the first state at or after `time`; one past the newest when there is none.
    fn first_not_before(&self, time: MonoNs) -> usize {
        let (mut low, mut high) = (0, self.states.len());
        while low < high {
            let middle = low + (high - low) / 2;
            if self.get(middle).is_some_and(|s| s.stamp < time) { low = middle + 1 } else { high = middle }
        }
        low
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;
    use proptest::prelude::*;

    fn history(ticks: std::ops::Range<i64>) -> JointHistory<2> {
        let mut h = JointHistory::new();
        for k in ticks {
            h.push(MonoNs(k * 1_000_000), &Vector2::new(k as f64, 1.0), &Vector2::new(1000.0, 0.0));
        }
        h
    }

    proptest! {
        #[test]
        fn a_steady_motion_is_found_anywhere_in_a_ring_of_any_fill(count in 1i64..3000, share in 0.0..1.0f64) {
            let h = history(0..count);
            let oldest = h.oldest().unwrap().0;
            let newest = h.newest().unwrap().0;
            prop_assert_eq!(newest, (count - 1) * 1_000_000);
            prop_assert_eq!((newest - oldest) / 1_000_000 + 1, count.min(CAPACITY as i64));
            let time = oldest + ((newest - oldest) as f64 * share) as i64;
            let q = h.joints(MonoNs(time)).unwrap();
            prop_assert!((q[0] - time as f64 * 1e-6).abs() < 1e-9);
        }
    }

    #[test]
    fn motion_is_carried_on_but_not_for_ever() {
        let h = history(10..20);
        let at = |ms: f64| h.joints(MonoNs((ms * 1e6) as i64)).unwrap()[0];
        assert!((at(20.5) - 20.5).abs() < 1e-9);
        assert!((at(9.0) - 9.0).abs() < 1e-9);
        assert!((at(900.0) - 39.0).abs() < 1e-9);
        assert!(JointHistory::<2>::new().joints(MonoNs(0)).is_none());
    }

    #[test]
    fn a_restarted_clock_starts_the_history_anew() {
        let mut h = history(100..2000);
        h.push(MonoNs(5), &Vector2::new(7.0, 0.0), &Vector2::zeros());
        assert_eq!((h.oldest(), h.newest()), (Some(MonoNs(5)), Some(MonoNs(5))));
        assert_eq!(h.joints(MonoNs(5)).unwrap()[0], 7.0);
    }

    #[test]
    fn a_copy_has_room_for_all_states_too() {
        let mut h = JointHistory::<2>::new();
        h.push(MonoNs(5), &Vector2::new(7.0, 0.0), &Vector2::zeros());
        let copy = h.clone();
        assert_eq!(copy.joints(MonoNs(5)), h.joints(MonoNs(5)));
        assert!(copy.states.capacity() >= CAPACITY);
    }
}
