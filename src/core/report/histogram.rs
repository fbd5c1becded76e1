//! A histogram of durations with fixed buckets: recording neither allocates nor searches, so the real-time
//! thread may do it. Values keep about 3 % of resolution from 1 ns to half a minute.
//!
//! Durations are counted in units of 1 ms / 2^20 (0.95 ns). Edges of buckets lie at powers of two, so that the control
//! tick of 1 ms is one of them: what is late by a tick or more can be read off exactly.

use crate::time::SpanNs;
use serde::{Deserialize, Serialize};

/// Sub-buckets in each octave, as power of two: 32, so that a bucket is 3 % of its value wide at most.
const SUB_BITS: u32 = 5;
const SUB: usize = 1 << SUB_BITS;
/// Octaves above the linear range, so that it ends at 2^36 units = 65 s, longer than any wait of a run.
const OCTAVES: usize = 31;
const BUCKETS: usize = SUB * (OCTAVES + 1);
/// A nanosecond is `UNITS / PER_NS` units: 2^20 / 10^6, reduced, so that a millisecond, at which a tick is missed, is an edge of buckets.
const UNITS: u64 = 16_384;
const PER_NS: u64 = 15_625;
/// Longest duration that is converted to units, ns: 18 minutes, above the range, and so short that the product with `UNITS` must not overflow.
const LONGEST_NS: u64 = 1 << 40;

/// Counts durations in log-linear buckets. Negative durations count as zero.
#[derive(Debug, Clone)]
pub struct SpanHistogram {
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

impl Default for SpanHistogram {
    fn default() -> Self {
        Self { counts: [0; BUCKETS], total: 0, max_ns: 0 }
    }
}

impl SpanHistogram {
    /// Counts one duration.
    pub fn record(&mut self, span: SpanNs) {
        self.record_series(span, SpanNs(0), 1);
    }

    /// Counts the durations `first`, `first + step`, ..., `count` of them, with no more work than there are buckets.
    /// A step that is not positive is none: then all are like the first.
    pub fn record_series(&mut self, first: SpanNs, step: SpanNs, count: u64) {
        let step = step.0.max(0).unsigned_abs();
        let (mut ns, mut left) = (first.0.max(0).unsigned_abs(), count);
        while left > 0 {
            let i = bucket(ns);
            let here = match step {
                _ if i == BUCKETS - 1 => left,
                0 => left,
                _ => (upper_edge(i) - ns).div_ceil(step).min(left),
            };
            if let Some(count) = self.counts.get_mut(i) {
                *count = count.saturating_add(u32::try_from(here).unwrap_or(u32::MAX));
            }
            self.max_ns = self.max_ns.max(ns.saturating_add(step.saturating_mul(here - 1)));
            ns = ns.saturating_add(step.saturating_mul(here));
            left -= here;
        }
        self.total += count;
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
                return if i == BUCKETS - 1 { self.max_ns } else { (upper_edge(i) - 1).min(self.max_ns) };
            }
        }
        self.max_ns
    }

    /// The buckets that are not empty, shortest durations first: upper edge in us, which itself belongs to the next
    /// bucket, and count. 1000 us is the edge of a bucket.
    #[must_use]
    pub fn buckets_us(&self) -> Vec<(f64, u64)> {
        let edge = |i| if i == BUCKETS - 1 { self.max_ns.saturating_add(1) } else { upper_edge(i) };
        let filled = self.counts.iter().enumerate().filter(|(_, count)| **count > 0);
        filled.map(|(i, count)| (edge(i) as f64 * 1e-3, u64::from(*count))).collect()
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
    let units = ns.min(LONGEST_NS) * UNITS / PER_NS;
    if units < SUB as u64 {
        return units as usize;
    }
    let octave = units.ilog2() - SUB_BITS; // 0 for [32, 64)
    let sub = (units >> octave) as usize - SUB;
    (SUB * (octave as usize + 1) + sub).min(BUCKETS - 1)
}

/// The shortest duration that is too long for the bucket, ns.
fn upper_edge(bucket: usize) -> u64 {
    let units = if bucket < SUB {
        bucket as u64 + 1
    } else {
        let octave = bucket / SUB - 1;
        ((SUB + bucket % SUB + 1) as u64) << octave
    };
    (units * PER_NS).div_ceil(UNITS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn quantiles_are_within_a_bucket_of_the_truth(mut spans in prop::collection::vec(0i64..40_000_000_000, 1..300)) {
            let mut h = SpanHistogram::default();
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

    proptest! {
        #[test]
        fn a_series_counts_like_its_members(first in -5_000i64..3_000_000_000, step in 0i64..2_000_000_000, count in 0u64..200) {
            let (mut series, mut members) = (SpanHistogram::default(), SpanHistogram::default());
            series.record_series(SpanNs(first), SpanNs(step), count);
            (0..count as i64).for_each(|k| members.record(SpanNs(first.max(0) + k * step)));
            prop_assert_eq!(series.counts, members.counts);
            prop_assert_eq!((series.total, series.max_ns), (members.total, members.max_ns));
        }

        #[test]
        fn every_duration_lies_in_exactly_its_bucket(ns in 0u64..60_000_000_000) {
            let i = bucket(ns);
            prop_assert!(ns < upper_edge(i));
            prop_assert!(i == 0 || ns >= upper_edge(i - 1));
        }
    }

    #[test]
    fn a_millisecond_is_an_edge() {
        let mut h = SpanHistogram::default();
        for ns in [999_999, 1_000_000, 1_000_001] {
            h.record(SpanNs(ns));
        }
        let buckets = h.buckets_us();
        assert_eq!((buckets.len(), buckets[0], buckets[1].1), (2, (1000.0, 1), 2));
    }

    #[test]
    fn a_series_as_long_as_a_day_takes_no_time() {
        let mut h = SpanHistogram::default();
        h.record_series(SpanNs(500), SpanNs::MILLISECOND, 86_400_000);
        assert_eq!(h.count(), 86_400_000);
        assert_eq!(h.quantile_ns(1.0), 500 + 86_399_999 * 1_000_000);
        assert_eq!(h.buckets_us().iter().map(|b| b.1).sum::<u64>(), 86_400_000);
    }

    #[test]
    fn empty_and_negative() {
        let mut h = SpanHistogram::default();
        assert_eq!(h.quantiles_us(), Quantiles::default());
        h.record(SpanNs(-5));
        assert_eq!((h.count(), h.quantile_ns(1.0)), (1, 0));
    }

    #[test]
    fn longer_than_the_range_is_kept_as_maximum() {
        let mut h = SpanHistogram::default();
        h.record(SpanNs(100_000_000_000));
        assert_eq!(h.quantile_ns(0.5), 100_000_000_000);
    }
}
