//! How late a 1 kHz thread wakes up on this machine, with the scheduling that a run would get: sleeping all the way to its
//! deadlines, and spinning the last part of it.

use crate::config::RealtimeRequest;
use crate::report::histogram::{Quantiles, SpanHistogram};
use crate::report::summary::spin_text;
use crate::rt::{Awake, DeadlineWait, USUAL_SPIN, now, prepare_thread};
use crate::time::SpanNs;
use serde::Serialize;
use std::fmt::Write as _;

const PERIOD: SpanNs = SpanNs::MILLISECOND;
/// Upper edges of the bars that are printed, us, and the length of the longest bar, columns. Chosen by hand: usual steps of a
/// logarithmic scale over what kernels do, in a terminal of 80 columns.
const EDGES_US: [u64; 11] = [1, 5, 10, 20, 50, 100, 200, 500, 1_000, 2_000, 5_000];
const BAR: usize = 40;
/// Both ways of waiting take turns of so many wake-ups, A B B A, so that they see the same machine.
const TURN: u64 = 250;

/// Lateness of a 1 kHz thread.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Jitter {
    /// Wake-ups.
    pub wakes: u64,
    /// What scheduling the thread had.
    pub scheduling: String,
    /// How long it was to spin before each deadline, us; 0 where it only slept.
    pub spin_us: f64,
    /// What that cost: the time that it spun, as a share of a core.
    pub spin_share: f64,
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

/// Both ways of waiting.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// Sleeping all the way.
    pub sleeping: Jitter,
    /// Spinning before the deadline as a run does by itself.
    pub spinning: Jitter,
}

/// Wakes up every millisecond for `seconds`, half of them each way, on a thread of its own.
#[must_use]
pub fn measure(seconds: f64, request: RealtimeRequest) -> Option<Measured> {
    let wakes_each = (seconds * 0.5e3).round().max(1.0) as u64;
    std::thread::Builder::new()
        .name("jitter".into())
        .spawn(move || run(wakes_each, request))
        .ok()?
        .join()
        .ok()
}

/// The lateness of every single wake-up during `seconds`, us; for comparisons with other programs.
#[must_use]
pub fn measure_each(seconds: f64, request: RealtimeRequest, spin: SpanNs) -> Option<Vec<f64>> {
    let wakes = (seconds * 1e3).round().max(1.0) as u64;
    let work = move || {
        let _ = prepare_thread(&request);
        let _awake = Awake::keep();
        let mut late_us = Vec::with_capacity(wakes as usize);
        wake_up(wakes, &mut DeadlineWait::new(spin), |late| late_us.push(late.as_us()));
        late_us
    };
    std::thread::Builder::new().name("jitter".into()).spawn(work).ok()?.join().ok()
}

/// Wakes up `wakes` times at absolute deadlines and tells how late; deadlines that passed are skipped.
fn wake_up(wakes: u64, wait: &mut DeadlineWait, mut tell: impl FnMut(SpanNs)) {
    let mut deadline = now() + PERIOD;
    for _ in 0..wakes {
        let late = wait.until(deadline) - deadline;
        tell(late);
        deadline = deadline + SpanNs(PERIOD.0 * (1 + (late.0 / PERIOD.0).max(0)));
    }
}

fn run(wakes_each: u64, request: RealtimeRequest) -> Measured {
    let scheduling = prepare_thread(&request).to_string();
    let _awake = Awake::keep();
    let (mut sleeping, mut spinning) = (WaitTrial::new(SpanNs::ZERO), WaitTrial::new(USUAL_SPIN));
    while sleeping.wakes < wakes_each {
        let turn = TURN.min(wakes_each - sleeping.wakes);
        sleeping.take_turn(turn);
        spinning.take_turn(turn);
        let turn = TURN.min(wakes_each - sleeping.wakes);
        spinning.take_turn(turn);
        sleeping.take_turn(turn);
    }
    Measured { sleeping: sleeping.jitter(&scheduling), spinning: spinning.jitter(&scheduling) }
}

/// One way of waiting, and what it came to.
struct WaitTrial {
    spin: SpanNs,
    wait: DeadlineWait,
    wakes: u64,
    took: SpanNs,
    histogram: SpanHistogram,
    bars: Vec<Bar>,
}

impl WaitTrial {
    fn new(spin: SpanNs) -> Self {
        let mut bars = EDGES_US.map(|edge| Bar { up_to_us: Some(edge), count: 0 }).to_vec();
        bars.push(Bar { up_to_us: None, count: 0 });
        let (wait, histogram) = (DeadlineWait::new(spin), SpanHistogram::default());
        Self { spin, wait, wakes: 0, took: SpanNs::ZERO, histogram, bars }
    }

    fn take_turn(&mut self, wakes: u64) {
        let Self { wait, histogram, bars, .. } = self;
        let start = now();
        wake_up(wakes, wait, |late| {
            histogram.record(late);
            let late_us = late.0.max(0).unsigned_abs().div_ceil(1_000);
            if let Some(bar) = bars.iter_mut().find(|b| b.up_to_us.is_none_or(|edge| late_us <= edge)) {
                bar.count += 1;
            }
        });
        self.wakes += wakes;
        self.took = SpanNs(self.took.0 + (now() - start).0);
    }

    fn jitter(self, scheduling: &str) -> Jitter {
        Jitter {
            wakes: self.wakes,
            scheduling: scheduling.into(),
            spin_us: self.spin.as_us(),
            // Otherwise a run without a wake-up would divide by zero.
            spin_share: self.wait.spun().as_s() / self.took.as_s().max(1e-9),
            wake_us: self.histogram.quantiles_us(),
            histogram: self.bars,
        }
    }
}

impl Jitter {
    /// Lines for people.
    #[must_use]
    pub fn to_text(&self) -> String {
        let q = &self.wake_us;
        let mut t = String::new();
        let _ = writeln!(
            t,
            "wake-up latency over {} ms with {}{}: p50 {:.2}  p99 {:.1}  p99.9 {:.1}  max {:.1} us",
            self.wakes,
            self.scheduling,
            if self.spin_us > 0.0 {
                spin_text(self.spin_us, self.spin_share)
            } else {
                ", only sleeps".into()
            },
            q.p50,
            q.p99,
            q.p999,
            q.max
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
        let measured = measure(1.3, request).unwrap();
        for j in [&measured.sleeping, &measured.spinning] {
            assert_eq!(j.wakes, 650);
            assert_eq!(j.histogram.iter().map(|b| b.count).sum::<u64>(), 650);
            assert!(j.wake_us.max > 0.0);
            assert!(j.to_text().contains("p99.9"));
        }
        assert_eq!((measured.sleeping.spin_us, measured.sleeping.spin_share), (0.0, 0.0));
        assert!(measured.sleeping.to_text().contains("only sleeps"));
        assert_eq!(measured.spinning.spin_us, USUAL_SPIN.as_us());
        assert!(measured.spinning.spin_share > 0.0, "it waited before some deadline");
        assert!(measured.spinning.to_text().contains("spins the last 50 us ("));
    }
}
