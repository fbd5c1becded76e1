//! The real-time thread: everything that it does between its first tick and its last.
//!
//! ```text
//! wait ─► newest measurement from its ring ─► ControlLoop::tick ─► trace into its ring ─► wait
//! ```
//! It makes no system call but its sleep, and does not allocate. A late tick is counted; ticks that have passed are
//! skipped, never caught up.

use super::commands::{Answered, Numbered};
use super::deadlines::Deadlines;
use crate::control::control_loop::{ControlLoop, Finish};
use crate::control::safety::Fault;
use crate::control::trace::Trace;
use crate::messages::Measurement;
use crate::process::stop::{STOP_REASON, StopFlag};
use crate::rt::{self, DeadlineWait};
use crate::time::SpanNs;
use rtrb::{Consumer, Producer};

/// From the start of the thread to its first tick.
const LEAD: SpanNs = SpanNs(2_000_000);

/// What the thread works with.
pub(super) struct RealtimeThread<const N: usize> {
    pub(super) control: ControlLoop<N>,
    pub(super) measurements: Consumer<Measurement>,
    pub(super) records: Producer<Trace>,
    /// What somebody wants of the loop, and what it says to that.
    pub(super) requests: Consumer<Numbered>,
    pub(super) answers: Producer<Answered>,
    /// A request from outside, and the companion's own when it cannot go on.
    pub(super) stops: [StopFlag; 2],
    pub(super) max_missed_in_a_row: u64,
}

/// What it leaves at its end.
pub(super) struct AtEnd<const N: usize> {
    pub(super) control: ControlLoop<N>,
    pub(super) finish: Finish,
    pub(super) deadlines: Deadlines,
    /// Traces that found no room in the ring.
    pub(super) lost_traces: u64,
    pub(super) page_faults: u64,
    /// Share of the time that it spun.
    pub(super) spin_share: f64,
}

impl<const N: usize> RealtimeThread<N> {
    /// Ticks to the end of the run; spins for `spin` before each deadline.
    pub(super) fn run(mut self, spin: SpanNs) -> AtEnd<N> {
        rt::prefault();
        let faults_before = rt::page_faults();
        let start = rt::now();
        let mut deadlines = Deadlines::new(start + LEAD);
        let mut wait = DeadlineWait::new(spin);
        let mut lost_traces = 0;
        let finish: Finish = loop {
            let woken = wait.until(deadlines.next());
            let (tick, time) = deadlines.woken(woken);
            if deadlines.missed_in_a_row() > self.max_missed_in_a_row {
                self.control.fail(Fault::DeadlinesMissed);
            }
            if self.stops.iter().any(StopFlag::is_requested) {
                self.control.stop(STOP_REASON);
            }
            while let Ok(Numbered { number, request }) = self.requests.pop() {
                let refusal = self.control.request(request).err();
                let state = self.control.controller().state().told();
                // There is room for as many answers as for requests.
                let _ = self.answers.push(Answered { number, refusal, state });
            }
            let mut newest: Option<Measurement> = None;
            while let Ok(m) = self.measurements.pop() {
                if newest.is_none_or(|kept| m.exposure >= kept.exposure) {
                    newest = Some(m);
                }
            }
            let mut trace = self.control.tick(tick, time, newest.as_ref());
            let done = rt::now();
            self.control.commanded(done, &mut trace);
            deadlines.done(done);
            if let Some(status) = &mut trace.status {
                status.missed_deadlines = deadlines.missed();
            }
            trace.lost = lost_traces;
            // Full only when the companion hangs; control goes on.
            lost_traces += u64::from(self.records.push(trace).is_err());
            if let Some(finish) = trace.finish {
                break finish;
            }
        };
        AtEnd {
            control: self.control,
            finish,
            deadlines,
            lost_traces,
            page_faults: rt::page_faults() - faults_before,
            spin_share: wait.spun().as_s() / (rt::now() - start).as_s(),
        }
    }
}
