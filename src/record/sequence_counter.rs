//! How many records of a service were lost on their way, by the numbers that their sender gave them.

/// Counts records and the gaps between their numbers.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct SequenceCounter {
    /// Records that arrived.
    pub recorded: u64,
    /// Records that did not, between the first and the last that did.
    pub lost: u64,
    /// How often the numbers began anew: another sender.
    pub restarts: u64,
    next: Option<u64>,
}

impl SequenceCounter {
    /// Of a service that is counted elsewhere.
    #[must_use]
    pub fn of(recorded: u64, lost: u64) -> Self {
        Self { recorded, lost, ..Self::default() }
    }

    /// The number that comes next.
    #[must_use]
    pub fn next(&self) -> Option<u64> {
        self.next
    }

    /// Notes the record with the number `sequence`. One that is lower than expected is the first of a new sender, which is no loss.
    pub fn count(&mut self, sequence: u64) {
        self.recorded += 1;
        match self.next {
            Some(next) if sequence >= next => self.lost += sequence - next,
            Some(_) => self.restarts += 1,
            None => {}
        }
        self.next = Some(sequence.saturating_add(1));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_are_lost_and_new_beginnings_are_not() {
        let mut counter = SequenceCounter::default();
        for sequence in [7, 8, 11, 12, 0, 1, 3] {
            counter.count(sequence);
        }
        assert_eq!((counter.recorded, counter.lost, counter.restarts), (7, 3, 1));
    }
}
