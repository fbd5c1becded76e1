//! Duration of a silence, counting only the time in which this process itself was running. When all processes were stopped
//! together (a suspended machine, a frozen container), that time must not count against the others.

use crate::time::{MonoNs, SpanNs};

/// Longest time that counts between two calls. Chosen by hand: twice the period of 0.1 s at which the watches call, so that a
/// late call counts in full and a suspension hardly.
const LONGEST_LOOK: SpanNs = SpanNs(200_000_000);

/// Time without a sign of life.
#[derive(Debug, Clone, Copy)]
pub(super) struct Silence {
    looked: MonoNs,
    lasted: SpanNs,
}

impl Silence {
    /// Begins at `now`.
    pub(super) fn begin(now: MonoNs) -> Self {
        Self { looked: now, lasted: SpanNs(0) }
    }

    /// Notes that the silence still lasts at `now`; returns its duration.
    pub(super) fn look(&mut self, now: MonoNs) -> SpanNs {
        self.lasted.0 += (now - self.looked).min(LONGEST_LOOK).0.max(0);
        self.looked = now;
        self.lasted
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_time_that_was_looked_at_counts() {
        let ms = |n: i64| MonoNs(n * 1_000_000);
        let mut silence = Silence::begin(ms(1_000));
        for k in 1..=50 {
            assert_eq!(silence.look(ms(1_000 + 100 * k)), SpanNs(k * 100_000_000));
        }
        assert_eq!(silence.look(ms(3_600_000)), SpanNs(5_200_000_000), "an hour of sleep is one look");
        assert_eq!(silence.look(ms(3_600_000)), SpanNs(5_200_000_000));
    }
}
