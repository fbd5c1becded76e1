//! A histogram of durations with fixed buckets: recording neither allocates nor searches, so the real-time
//! thread may do it. Values keep about 3 % of resolution from 1 ns to half a minute.

use crate::time::SpanNs;
use serde::{Deserialize, Serialize};

/// Sub-buckets in each octave, as power of two.
const SUB_BITS: u32 = 5;
const SUB: usize = 1 << SUB_BITS;
/// Octaves above the linear range: up to 2^35 ns = 34 s.
const OCTAVES: usize = 31;
const BUCKETS: usize = SUB * (OCTAVES + 1);

/// Counts durations in log-linear buckets. Negative durations count as zero.
#[derive(Debug, Clone)]
pub struct Histogram {
    counts: [u32; BUCKETS],
    total: u64,
    max_ns: u64,
}

/// Quantiles in microseconds, as in the summary.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Quantiles {
    /// Median.
    pub p50: f64,
    /// 99 of 100 are at most this.
    pub p99: f64,
    /// 999 of 1000 are at most this.
    pub p999: f64,
    /// Largest.
    pub max: f64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self { counts: [0; BUCKETS], total: 0, max_ns: 0 }
    }
}

impl Histogram {
    /// Counts one duration.
    pub fn record(&mut self, span: SpanNs) {
        let ns = span.0.max(0).unsigned_abs();
        if let Some(count) = self.counts.get_mut(bucket(ns)) {
            *count = count.saturating_add(1);
        }
        self.total += 1;
        self.max_ns = self.max_ns.max(ns);
    }

    /// How many durations were counted.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.total
    }

    /// The duration in ns that a share `quantile` (0 to 1) of all does not exceed; 0 when nothing was counted.
    #[must_use]
    pub fn quantile_ns(&self, quantile: f64) -> u64 {
        let wanted = (quantile * self.total as f64).ceil().max(1.0) as u64;
        let mut seen = 0;
        for (i, count) in self.counts.iter().enumerate() {
            seen += u64::from(*count);
            if seen >= wanted {
                // The last bucket also holds all that is longer than the range.
                return if i == BUCKETS - 1 { self.max_ns } else { upper_edge(i).min(self.max_ns) };
            }
        }
        self.max_ns
    }

    /// Median, p99, p99.9 and maximum in us.
    #[must_use]
    pub fn quantiles_us(&self) -> Quantiles {
        let us = |ns: u64| ns as f64 * 1e-3;
        Quantiles {
            p50: us(self.quantile_ns(0.5)),
            p99: us(self.quantile_ns(0.99)),
            p999: us(self.quantile_ns(0.999)),
            max: us(self.max_ns),
        }
    }
}

fn bucket(ns: u64) -> usize {
    if ns < SUB as u64 {
        return ns as usize;
    }
    let octave = ns.ilog2() - SUB_BITS; // 0 for [32, 64)
    let sub = (ns >> octave) as usize - SUB;
    (SUB * (octave as usize + 1) + sub).min(BUCKETS - 1)
}

fn upper_edge(bucket: usize) -> u64 {
    if bucket < SUB {
        return bucket as u64;
    }
    let octave = bucket / SUB - 1;
    ((SUB + bucket % SUB + 1) as u64) << octave
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn quantiles_are_within_a_bucket_of_the_truth(mut spans in prop::collection::vec(0i64..40_000_000_000, 1..300)) {
            let mut h = Histogram::default();
            for s in &spans {
                h.record(SpanNs(*s));
            }
            spans.sort_unstable();
            for q in [0.5, 0.9, 0.99, 1.0] {
                let exact = spans[((q * spans.len() as f64).ceil() as usize).max(1) - 1] as f64;
                let got = h.quantile_ns(q) as f64;
                prop_assert!(exact > 34e9 || (got >= exact && got <= exact * 1.04 + 1.0), "{q}: {got} for {exact}");
            }
        }
    }

    #[test]
    fn empty_and_negative() {
        let mut h = Histogram::default();
        assert_eq!(h.quantiles_us(), Quantiles::default());
        h.record(SpanNs(-5));
        assert_eq!((h.count(), h.quantile_ns(1.0)), (1, 0));
    }

    #[test]
    fn longer_than_the_range_is_kept_as_maximum() {
        let mut h = Histogram::default();
        h.record(SpanNs(100_000_000_000));
        assert_eq!(h.quantile_ns(0.5), 100_000_000_000);
    }
}
