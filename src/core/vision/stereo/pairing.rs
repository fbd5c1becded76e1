//! Pairing of the frames of a left and a right camera, by their exposure stamps alone.
//!
//! ```text
//! left   |--l0-----l1-----l2-----l3--►      l0 r0 and l3 r3 are pairs, |l - r| <= tolerance
//! right  |--r0----------r2'------r3--►      l1 has no pair: r2' is later than l1 + tolerance; nor has r2'
//! ```
//! With a tolerance of at most half a period no stamp can belong to two pairs. The number of waiting frames is bounded: a side that runs far ahead loses
//! its oldest ones. The module reads no clock: its caller says when frames are not to wait any longer ([`Pairing::give_up`]).

use crate::time::{MonoNs, SpanNs};
use std::collections::VecDeque;

/// Frames of one camera that may wait for those of the other: half a second at 30 Hz, as long as `camera.latency_ms` may be, so that more
/// of them would wait for a frame that was lost.
const MAX_WAITING: usize = 16;

/// Which of the two cameras.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Side {
    /// The first one, in whose frame positions are given.
    Left,
    /// The second one.
    Right,
}

impl Side {
    /// Its name for messages.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Left => "left",
            Self::Right => "right",
        }
    }

    /// The other camera.
    #[must_use]
    pub fn other(self) -> Self {
        match self {
            Self::Left => Self::Right,
            Self::Right => Self::Left,
        }
    }
}

/// Result of pairing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Match<T> {
    /// Frames of both cameras with the same stamp within the tolerance.
    Both {
        /// Data of the left frame.
        left: T,
        /// Data of the right frame.
        right: T,
    },
    /// A frame of this camera without one of the other.
    Alone(Side, T),
}

/// Numbers of pairs and of frames without a pair.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct PairingCounts {
    /// Pairs.
    pub pairs: u64,
    /// Frames of the left camera without one of the right.
    pub left_alone: u64,
    /// Frames of the right camera without one of the left.
    pub right_alone: u64,
    /// Right stamp less left stamp of the last two frames whose stamps differed by more than the tolerance; `None` while there were none.
    pub last_miss: Option<SpanNs>,
}

/// Pairs the frames of two cameras; `T` is the data stored for each frame.
#[derive(Debug, Clone)]
pub struct Pairing<T> {
    tolerance: SpanNs,
    left: VecDeque<(MonoNs, T)>,
    right: VecDeque<(MonoNs, T)>,
    /// Frames with exposures up to these do not wait for the other camera any longer.
    left_given_up: Option<MonoNs>,
    right_given_up: Option<MonoNs>,
    counts: PairingCounts,
}

impl<T> Pairing<T> {
    /// Pairing of frames whose stamps differ by `tolerance` or less.
    #[must_use]
    pub fn new(tolerance: SpanNs) -> Self {
        let queue = || VecDeque::with_capacity(MAX_WAITING + 1);
        Self {
            tolerance,
            left: queue(),
            right: queue(),
            left_given_up: None,
            right_given_up: None,
            counts: PairingCounts::default(),
        }
    }

    /// Stores the data `what` of a frame of `side` exposed at `stamp`. Call [`Self::next_match`] afterwards until it returns `None`.
    pub fn file(&mut self, side: Side, stamp: MonoNs, what: T) {
        self.queue(side).push_back((stamp, what));
    }

    /// Ends the waiting of frames of `side` with stamps up to `until`.
    pub fn give_up(&mut self, side: Side, until: MonoNs) {
        let place = match side {
            Side::Left => &mut self.left_given_up,
            Side::Right => &mut self.right_given_up,
        };
        *place = Some(until);
    }

    /// Stamp of the oldest frame of `side` that waits.
    #[must_use]
    pub fn waiting(&self, side: Side) -> Option<MonoNs> {
        match side {
            Side::Left => self.left.front(),
            Side::Right => self.right.front(),
        }
        .map(|(stamp, _)| *stamp)
    }

    /// Data of the oldest frame of `side` that waits.
    #[must_use]
    pub fn front(&self, side: Side) -> Option<&T> {
        let queue = match side {
            Side::Left => &self.left,
            Side::Right => &self.right,
        };
        queue.front().map(|(_, what)| what)
    }

    /// The next pair, or frame without one, oldest first; `None` when all stored frames have to wait.
    pub fn next_match(&mut self) -> Option<Match<T>> {
        let (left, right) = (self.waiting(Side::Left), self.waiting(Side::Right));
        if let (Some(left), Some(right)) = (left, right) {
            let apart = right - left;
            if apart.0.unsigned_abs() <= self.tolerance.0.unsigned_abs() {
                let (_, left) = self.left.pop_front()?;
                let (_, right) = self.right.pop_front()?;
                self.counts.pairs += 1;
                return Some(Match::Both { left, right });
            }
            // The earlier one cannot have a pair any more: the other camera's frames are later.
            self.counts.last_miss = Some(apart);
            return self.alone(if apart.0 > 0 { Side::Left } else { Side::Right });
        }
        for (side, first) in [(Side::Left, left), (Side::Right, right)] {
            let given_up = match side {
                Side::Left => self.left_given_up,
                Side::Right => self.right_given_up,
            };
            let overdue = first.zip(given_up).is_some_and(|(first, until)| first <= until);
            if overdue || self.queue(side).len() > MAX_WAITING {
                return self.alone(side);
            }
        }
        None
    }

    /// Numbers of pairs and of frames without a pair.
    #[must_use]
    pub fn counts(&self) -> PairingCounts {
        self.counts
    }

    fn alone(&mut self, side: Side) -> Option<Match<T>> {
        let (_, what) = self.queue(side).pop_front()?;
        match side {
            Side::Left => self.counts.left_alone += 1,
            Side::Right => self.counts.right_alone += 1,
        }
        Some(Match::Alone(side, what))
    }

    fn queue(&mut self, side: Side) -> &mut VecDeque<(MonoNs, T)> {
        match side {
            Side::Left => &mut self.left,
            Side::Right => &mut self.right,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    const MS: i64 = 1_000_000;
    const PERIOD: i64 = 40 * MS;

    fn pairing() -> Pairing<u64> {
        Pairing::new(SpanNs(5 * MS))
    }

    fn all(pairing: &mut Pairing<u64>) -> Vec<Match<u64>> {
        std::iter::from_fn(|| pairing.next_match()).collect()
    }

    proptest! {
        /// Whatever is lost and in whatever order the two streams come: the pairs are the instants that both cameras saw, and every
        /// frame comes out once.
        #[test]
        fn pairs_are_the_instants_that_both_saw(
            lost in prop::collection::vec((prop::bool::weighted(0.2), prop::bool::weighted(0.2)), 1..60),
            jitter in prop::collection::vec(-2 * MS..=2 * MS, 120),
            lead in prop::collection::vec(0..6_usize, 120),
        ) {
            let (mut pairing, lost) = (pairing(), &lost);
            let stamp = |k: usize, side: usize| MonoNs(k as i64 * PERIOD + jitter[2 * k + side]);
            let of = |side: usize| (0..lost.len()).filter(move |k| !if side == 0 { lost[*k].0 } else { lost[*k].1 });
            let mut streams = [of(0).collect::<VecDeque<_>>(), of(1).collect::<VecDeque<_>>()];
            let mut found = Vec::new();
            // now one of the cameras is ahead, now the other
            for turn in 0.. {
                let side = turn % 2;
                for _ in 0..lead[turn % lead.len()].max(1) {
                    let Some(k) = streams[side].pop_front() else { break };
                    let which = if side == 0 { Side::Left } else { Side::Right };
                    pairing.file(which, stamp(k, side), k as u64);
                    found.extend(all(&mut pairing));
                    if streams[side].front().is_some_and(|next| {
                        streams[1 - side].front().is_some_and(|other| *next > other + 10)
                    }) {
                        break; // no camera is ahead by more than what may wait
                    }
                }
                if streams.iter().all(VecDeque::is_empty) {
                    break;
                }
            }
            for side in [Side::Left, Side::Right] {
                pairing.give_up(side, MonoNs(i64::MAX));
            }
            found.extend(all(&mut pairing));
            let (mut pairs, mut left, mut right) = (BTreeSet::new(), BTreeSet::new(), BTreeSet::new());
            for one in &found {
                let fresh = match one {
                    Match::Both { left, right } => {
                        prop_assert_eq!(left, right);
                        pairs.insert(*left)
                    }
                    Match::Alone(Side::Left, k) => left.insert(*k),
                    Match::Alone(Side::Right, k) => right.insert(*k),
                };
                prop_assert!(fresh, "{:?} comes twice", one);
            }
            let seen = |a: bool, b: bool| {
                let like = move |(_, l): &(u64, &(bool, bool))| (!l.0, !l.1) == (a, b);
                (0..).zip(lost).filter(like).map(|(k, _)| k).collect::<BTreeSet<u64>>()
            };
            prop_assert_eq!(&pairs, &seen(true, true));
            prop_assert_eq!(&left, &seen(true, false));
            prop_assert_eq!(&right, &seen(false, true));
            let counts = pairing.counts();
            let told = [counts.pairs, counts.left_alone, counts.right_alone];
            prop_assert_eq!(told, [pairs.len(), left.len(), right.len()].map(|n| n as u64));
        }
    }

    #[test]
    fn stamps_that_are_always_apart_never_pair_and_say_by_how_much() {
        let mut pairing = pairing();
        let mut alone = 0;
        for k in 0..50 {
            pairing.file(Side::Left, MonoNs(k * PERIOD), k as u64);
            pairing.file(Side::Right, MonoNs(k * PERIOD + 15 * MS), k as u64);
            alone += all(&mut pairing).iter().filter(|m| matches!(m, Match::Alone(..))).count();
        }
        let counts = pairing.counts();
        assert_eq!((counts.pairs, counts.left_alone, alone), (0, 50, 99));
        let miss = counts.last_miss.unwrap().0;
        assert!(miss == 15 * MS || miss == 15 * MS - PERIOD, "{miss}");
    }

    #[test]
    fn with_one_camera_absent_no_frame_waits_for_ever() {
        let mut pairing = pairing();
        let mut out = 0;
        for k in 0..1000 {
            pairing.file(Side::Left, MonoNs(k * PERIOD), k as u64);
            out += all(&mut pairing).len();
        }
        assert_eq!(out, 1000 - MAX_WAITING);
        pairing.give_up(Side::Left, MonoNs(998 * PERIOD));
        let rest = all(&mut pairing);
        assert_eq!(rest.len(), MAX_WAITING - 1);
        assert_eq!(pairing.waiting(Side::Left), Some(MonoNs(999 * PERIOD)), "the newest still waits");
        assert_eq!(pairing.counts().last_miss, None, "there was nothing to miss");
    }

    #[test]
    fn a_limit_is_inside_and_stamps_of_any_bits_do_no_harm() {
        let mut pairing = pairing();
        pairing.file(Side::Left, MonoNs(0), 1);
        pairing.file(Side::Right, MonoNs(5 * MS), 2);
        assert_eq!(all(&mut pairing), [Match::Both { left: 1, right: 2 }]);
        pairing.file(Side::Left, MonoNs(0), 3);
        pairing.file(Side::Right, MonoNs(5 * MS + 1), 4);
        assert_eq!(all(&mut pairing), [Match::Alone(Side::Left, 3)]);
        for k in 0..100 {
            pairing.file(Side::Left, MonoNs(if k % 3 == 0 { i64::MIN / 2 } else { i64::MAX / 2 }), k);
            pairing.file(Side::Right, MonoNs(k as i64), k);
            all(&mut pairing);
        }
        assert!(pairing.left.len() <= MAX_WAITING && pairing.right.len() <= MAX_WAITING);
    }
}
