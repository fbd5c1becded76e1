//! The deadlines of the real-time thread: which tick is served, which were missed, and how late it all was.
//!
//! A tick is missed when its command is not written before the next tick begins: because the thread woke up too late
//! to serve it at all, or because it was still at work. Missed ticks are skipped, never caught up.

use crate::histogram::Histogram;
use crate::schedule::TICK;
use crate::summary::TickTimes;
use crate::time::{MonoNs, SpanNs};

/// Deadlines at whole ticks after a start.
#[derive(Debug, Clone)]
pub(super) struct Deadlines {
    tick: u64,
    deadline: MonoNs,
    woken: MonoNs,
    missed: u64,
    in_a_row: u64,
    wake: Histogram,
    step: Histogram,
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
            wake: Histogram::default(),
            step: Histogram::default(),
        }
    }

    /// When the next tick is due.
    pub(super) fn next(&self) -> MonoNs {
        self.deadline
    }

    /// The thread woke up: the newest tick that is due, and its time.
    pub(super) fn woken(&mut self, at: MonoNs) -> (u64, MonoNs) {
        let passed = ((at - self.deadline).0 / TICK.0).max(0);
        self.wake.record(at - self.deadline);
        self.miss(passed.unsigned_abs());
        self.tick += passed.unsigned_abs();
        self.deadline = self.deadline + SpanNs(passed * TICK.0);
        self.woken = at;
        (self.tick, self.deadline)
    }

    /// The tick's command was written.
    pub(super) fn done(&mut self, at: MonoNs) {
        self.step.record(at - self.woken);
        if at - self.deadline > TICK {
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

    /// Wake-up and step times.
    pub(super) fn times(&self) -> TickTimes {
        TickTimes { wake: self.wake.quantiles_us(), step: self.step.quantiles_us() }
    }

    fn miss(&mut self, ticks: u64) {
        self.missed += ticks;
        self.in_a_row += ticks;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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

    #[test]
    fn every_tick_is_served_or_missed() {
        let mut d = Deadlines::new(MonoNs(0));
        let mut served_in_time = 0;
        for k in 0..1_000i64 {
            let before = d.missed();
            serve(&mut d, (k * 7919) % 4_000, (k * 104_729) % 1_900);
            served_in_time += u64::from(d.missed_in_a_row() == 0 && d.missed() >= before);
        }
        assert_eq!(d.next(), MonoNs((served_in_time + d.missed()) as i64 * TICK.0));
    }
}
