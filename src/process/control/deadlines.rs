//! The deadlines of the real-time thread: which tick is served, which were missed, and how late it all was.
//!
//! A tick is missed when its command is not written before the next tick begins: because the thread woke up too late
//! to serve it at all, or because it was still at work. Missed ticks are skipped, never caught up.
//!
//! Every tick of the run has its place in the histograms, so that a long stall does not hide behind one entry: a tick that
//! was skipped woke up when the thread did, and its command is the next one that was written.
//!
//! ```text
//! deadline ──── wake ────► woken ──── step ────► command written
//!    └──────────────────── total ───────────────────┘      missed: total >= 1 tick
//! ```

use crate::report::histogram::SpanHistogram;
use crate::report::summary::TickTimes;
use crate::time::TICK;
use crate::time::{MonoNs, SpanNs};

/// Deadlines at whole ticks after a start.
#[derive(Debug, Clone)]
pub(super) struct Deadlines {
    tick: u64,
    deadline: MonoNs,
    woken: MonoNs,
    missed: u64,
    in_a_row: u64,
    skipped: u64,
    /// Ticks that were skipped since the last command.
    just_skipped: u64,
    wake: SpanHistogram,
    step: SpanHistogram,
    total: SpanHistogram,
}

impl Deadlines {
    /// Tick 0 is due at `start`.
    pub(super) fn new(start: MonoNs) -> Self {
        Self {
            tick: 0,
            deadline: start,
            woken: start,
            missed: 0,
            in_a_row: 0,
            skipped: 0,
            just_skipped: 0,
            wake: SpanHistogram::default(),
            step: SpanHistogram::default(),
            total: SpanHistogram::default(),
        }
    }

    /// When the next tick is due.
    pub(super) fn next(&self) -> MonoNs {
        self.deadline
    }

    /// The thread woke up: the newest tick that is due, and its time.
    pub(super) fn woken(&mut self, at: MonoNs) -> (u64, MonoNs) {
        let passed = ((at - self.deadline).0 / TICK.0).max(0);
        let skipped = passed.unsigned_abs();
        self.tick += skipped;
        self.deadline = self.deadline + SpanNs(passed * TICK.0);
        self.woken = at;
        self.wake.record_series(at - self.deadline, TICK, skipped + 1);
        self.just_skipped = skipped;
        self.skipped += skipped;
        self.miss(skipped);
        (self.tick, self.deadline)
    }

    /// The tick's command was written.
    pub(super) fn done(&mut self, at: MonoNs) {
        let total = at - self.deadline;
        self.step.record(at - self.woken);
        self.total.record_series(total, TICK, std::mem::take(&mut self.just_skipped) + 1);
        if total >= TICK {
            self.miss(1);
        } else {
            self.in_a_row = 0;
        }
        self.tick += 1;
        self.deadline = self.deadline + TICK;
    }

    /// Ticks missed.
    pub(super) fn missed(&self) -> u64 {
        self.missed
    }

    /// Ticks missed since the last one that was served in time.
    pub(super) fn missed_in_a_row(&self) -> u64 {
        self.in_a_row
    }

    /// Ticks that were not served at all.
    pub(super) fn skipped(&self) -> u64 {
        self.skipped
    }

    /// Wake-up, step and total times.
    pub(super) fn times(&self) -> TickTimes {
        TickTimes {
            wake: self.wake.quantiles_us(),
            step: self.step.quantiles_us(),
            total: self.total.quantiles_us(),
            total_histogram: self.total.buckets_us(),
        }
    }

    fn miss(&mut self, ticks: u64) {
        self.missed += ticks;
        self.in_a_row += ticks;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const US: i64 = 1_000;

    /// Serves one tick: wakes `late_us` after it was due and works for `work_us`; the tick that was served.
    fn serve(d: &mut Deadlines, late_us: i64, work_us: i64) -> u64 {
        let woken = d.next() + SpanNs(late_us * US);
        let (tick, _) = d.woken(woken);
        d.done(woken + SpanNs(work_us * US));
        tick
    }

    #[test]
    fn punctual_ticks_follow_one_another() {
        let mut d = Deadlines::new(MonoNs(5_000));
        assert_eq!((0..4).map(|_| serve(&mut d, 30, 5)).collect::<Vec<_>>(), [0, 1, 2, 3]);
        assert_eq!((d.missed(), d.next()), (0, MonoNs(5_000 + 4_000 * US)));
    }

    #[test]
    fn ticks_that_passed_are_skipped_and_counted() {
        let mut d = Deadlines::new(MonoNs(0));
        serve(&mut d, 0, 5);
        assert_eq!(serve(&mut d, 3_400, 5), 4, "ticks 1, 2 and 3 passed");
        assert_eq!((d.missed(), d.missed_in_a_row()), (3, 0), "tick 4 was in time");
        assert_eq!(serve(&mut d, 0, 5), 5);
    }

    #[test]
    fn a_command_that_comes_too_late_is_missed_too() {
        let mut d = Deadlines::new(MonoNs(0));
        assert_eq!(serve(&mut d, 0, 1_500), 0);
        assert_eq!((d.missed(), d.missed_in_a_row()), (1, 1));
        assert_eq!(serve(&mut d, 500, 5), 1, "served late, but before tick 2");
        assert_eq!((d.missed(), d.missed_in_a_row()), (1, 0));
    }

    /// Entries of the histogram of totals, and those at a tick or above.
    fn entries(d: &Deadlines) -> (u64, u64) {
        let times = d.times();
        assert_eq!(times.late_ticks(), d.missed());
        (times.total_histogram.iter().map(|(_, count)| count).sum(), times.late_ticks())
    }

    #[test]
    fn exactly_a_tick_late_is_missed_in_both_counts() {
        let mut d = Deadlines::new(MonoNs(0));
        serve(&mut d, 0, 1_000);
        assert_eq!((d.missed(), entries(&d)), (1, (1, 1)), "the command came when tick 1 was due");
        let woken = d.next() + TICK;
        d.woken(woken);
        d.done(woken); // no time at all: the tick that was skipped is late by one tick to the nanosecond
        assert_eq!((d.missed(), d.skipped(), entries(&d)), (2, 1, (3, 2)));
        d.done(d.next() + SpanNs(TICK.0 - 1));
        assert_eq!((d.missed(), entries(&d)), (2, (4, 2)), "a nanosecond less is in time");
    }

    #[test]
    fn a_stall_has_an_entry_for_each_of_its_ticks() {
        let mut d = Deadlines::new(MonoNs(0));
        for _ in 0..900 {
            serve(&mut d, 10, 5);
        }
        serve(&mut d, 100_300, 5);
        let times = d.times();
        assert_eq!(entries(&d), (1001, 100));
        assert!(times.total.p50 < 16.0 && times.total.p99 > 80_000.0, "{times:?}");
        assert!(times.wake.p99 > 80_000.0 && times.step.max < 6.0, "{times:?}");
    }

    proptest! {
        #[test]
        fn every_tick_has_an_entry_and_late_ones_count_as_missed(
            ticks in prop::collection::vec((-50i64..5_000_000, 0i64..2_500_000), 1..300),
            stalls in prop::collection::vec((0usize..300, 0i64..80_000_000_000), 0..4),
        ) {
            let mut d = Deadlines::new(MonoNs(7));
            let (mut served, mut punctual) = (0, 0);
            for (k, (late_ns, work_ns)) in ticks.iter().enumerate() {
                let stall: i64 = stalls.iter().filter(|(at, _)| *at == k).map(|(_, ns)| ns).sum();
                let woken = d.next() + SpanNs(late_ns + stall);
                d.woken(woken);
                d.done(woken + SpanNs(*work_ns));
                served += 1;
                punctual += u64::from(d.missed_in_a_row() == 0);
            }
            prop_assert_eq!(entries(&d), (served + d.skipped(), d.missed()));
            prop_assert_eq!(punctual + d.missed(), served + d.skipped());
            prop_assert_eq!(d.next(), MonoNs(7 + (served + d.skipped()) as i64 * TICK.0));
            prop_assert_eq!(d.wake.count(), d.total.count());
        }
    }
}
