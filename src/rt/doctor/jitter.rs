//! How late a 1 kHz thread wakes up on this machine, with the scheduling that a run would get.

use crate::config::RealtimeRequest;
use crate::histogram::{Histogram, Quantiles};
use crate::rt::{Awake, now, prepare_thread, sleep_until};
use crate::time::SpanNs;
use serde::Serialize;
use std::fmt::Write as _;

const PERIOD: SpanNs = SpanNs::MILLISECOND;
/// Upper edges of the bars that are printed, us.
const EDGES_US: [u64; 10] = [5, 10, 20, 50, 100, 200, 500, 1_000, 2_000, 5_000];
const BAR: usize = 40;

/// Lateness of a 1 kHz thread.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Jitter {
    /// Wake-ups.
    pub wakes: u64,
    /// What scheduling the thread had.
    pub scheduling: String,
    /// Deadline to wake-up, us.
    pub wake_us: Quantiles,
    /// Wake-ups up to each edge, us, and the number of those above the last edge but one.
    pub histogram: Vec<Bar>,
}

/// One bar of the histogram.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Bar {
    /// Lateness at most this, us; `null` for all that is later.
    pub up_to_us: Option<u64>,
    /// Wake-ups.
    pub count: u64,
}

/// Wakes up every millisecond for `seconds`, on the calling thread's own copy.
#[must_use]
pub fn measure(seconds: f64, request: RealtimeRequest) -> Option<Jitter> {
    let wakes = (seconds * 1e3).round().max(1.0) as u64;
    std::thread::Builder::new().name("jitter".into()).spawn(move || run(wakes, request)).ok()?.join().ok()
}

/// The lateness of every single wake-up during `seconds`, us; for comparisons with other programs.
#[must_use]
pub fn measure_each(seconds: f64, request: RealtimeRequest) -> Option<Vec<f64>> {
    let wakes = (seconds * 1e3).round().max(1.0) as usize;
    let work = move || {
        let _ = prepare_thread(&request);
        let _awake = Awake::keep();
        let mut late_us = Vec::with_capacity(wakes);
        wake_up(wakes, |late| late_us.push(late.as_us()));
        late_us
    };
    std::thread::Builder::new().name("jitter".into()).spawn(work).ok()?.join().ok()
}

/// Wakes up `wakes` times at absolute deadlines and tells how late; deadlines that passed are skipped.
fn wake_up(wakes: usize, mut tell: impl FnMut(SpanNs)) {
    let mut deadline = now() + PERIOD;
    for _ in 0..wakes {
        sleep_until(deadline);
        let late = now() - deadline;
        tell(late);
        deadline = deadline + SpanNs(PERIOD.0 * (1 + (late.0 / PERIOD.0).max(0)));
    }
}

fn run(wakes: u64, request: RealtimeRequest) -> Jitter {
    let obtained = prepare_thread(&request);
    let _awake = Awake::keep();
    let mut histogram = Histogram::default();
    let mut bars = EDGES_US.map(|edge| Bar { up_to_us: Some(edge), count: 0 }).to_vec();
    bars.push(Bar { up_to_us: None, count: 0 });
    wake_up(wakes as usize, |late| {
        histogram.record(late);
        let late_us = late.0.max(0).unsigned_abs().div_ceil(1_000);
        if let Some(bar) = bars.iter_mut().find(|b| b.up_to_us.is_none_or(|edge| late_us <= edge)) {
            bar.count += 1;
        }
    });
    Jitter { wakes, scheduling: obtained.to_string(), wake_us: histogram.quantiles_us(), histogram: bars }
}

impl Jitter {
    /// Lines for people.
    #[must_use]
    pub fn to_text(&self) -> String {
        let q = &self.wake_us;
        let mut t = String::new();
        let _ = writeln!(
            t,
            "wake-up latency over {} ms with {}: p50 {:.1}  p99 {:.1}  p99.9 {:.1}  max {:.1} us",
            self.wakes, self.scheduling, q.p50, q.p99, q.p999, q.max
        );
        let most = self.histogram.iter().map(|b| b.count).max().unwrap_or(1).max(1);
        for b in self.histogram.iter().filter(|b| b.count > 0) {
            // A logarithm: the few late ones are what matters.
            let length = (b.count as f64).ln_1p() / (most as f64).ln_1p() * BAR as f64;
            let label = b.up_to_us.map_or("later".to_string(), |edge| format!("<= {edge} us"));
            let _ = writeln!(t, "{label:>12} {:>8} {}", b.count, "#".repeat(length.ceil() as usize));
        }
        t
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_wake_up_is_counted_once() {
        let request = RealtimeRequest { priority: 10, cpu: None, lock_memory: false };
        let j = measure(0.05, request).unwrap();
        assert_eq!(j.wakes, 50);
        assert_eq!(j.histogram.iter().map(|b| b.count).sum::<u64>(), 50);
        assert!(j.wake_us.max > 0.0);
        assert!(j.to_text().contains("p99.9"));
    }
}
