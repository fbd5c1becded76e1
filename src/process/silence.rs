//! How long nothing has come, in time that counts: only while this process itself came round to look. Whoever was stopped
//! together with the others (a suspended machine, a frozen container) owes them their time.

use crate::time::{MonoNs, SpanNs};

/// Two looks that lie farther apart than this count as so far apart.
const LONGEST_LOOK: SpanNs = SpanNs(200_000_000);

/// Time without a sign.
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

    /// Still nothing at `now`: how long it has lasted.
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
