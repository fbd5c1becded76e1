//! Which target control wants measured, by its joint states: each of them says it, so that a vision that was started anew, or has missed some, knows it with the next.

use crate::messages::JointState;
use crate::time::MonoNs;
use std::collections::VecDeque;

/// Changes that are remembered. Derived: the frames that are on their way at once span at most a few seconds, and a client that asks as fast as it is
/// answered changes the target some hundred times in that time; a change that is forgotten too early costs one measurement, which control refuses.
const REMEMBERED: usize = 256;

/// The target that control wanted at each time.
#[derive(Debug, Clone)]
pub struct TargetChoice {
    /// From when on which one was wanted; the times rise.
    changes: VecDeque<(MonoNs, u32)>,
}

impl Default for TargetChoice {
    fn default() -> Self {
        Self { changes: VecDeque::with_capacity(REMEMBERED) }
    }
}

impl TargetChoice {
    /// Takes in a joint state; it allocates nothing.
    pub fn note(&mut self, state: &JointState) {
        if self.changes.back().is_some_and(|(_, wanted)| *wanted == state.target_number) {
            return;
        }
        if self.changes.len() == REMEMBERED {
            self.changes.pop_front();
        }
        self.changes.push_back((state.stamp, state.target_number));
    }

    /// The number of the target that was wanted at `time`; the first one where nothing is known.
    #[must_use]
    pub fn at(&self, time: MonoNs) -> u32 {
        let until = self.changes.iter().rev().find(|(from, _)| *from <= time);
        until.map_or(0, |(_, wanted)| *wanted)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_choice_of_each_time_is_kept() {
        let mut choice = TargetChoice::default();
        assert_eq!(choice.at(MonoNs(5)), 0);
        for (stamp, target_number) in [(10, 0), (20, 2), (30, 2), (40, 1)] {
            choice.note(&JointState { stamp: MonoNs(stamp), target_number, ..JointState::default() });
        }
        let wanted = [9, 10, 19, 20, 39, 40, 1000].map(|t| choice.at(MonoNs(t)));
        assert_eq!(wanted, [0, 0, 0, 2, 2, 1, 1]);
        let room = choice.changes.capacity();
        for k in 0..10 * REMEMBERED {
            let (stamp, target_number) = (MonoNs(100 + k as i64), (k % 3) as u32);
            choice.note(&JointState { stamp, target_number, ..JointState::default() });
        }
        assert_eq!(choice.changes.capacity(), room);
    }
}
