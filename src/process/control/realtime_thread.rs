//! The real-time thread: everything that it does between its first tick and its last.
//!
//! ```text
//! wait ─► orders and requests, newest measurement from their rings ─► ControlLoop ─► trace into its ring ─► wait
//! ```
//! It makes no system call but its sleep, and does not allocate. A late tick is counted; ticks that have passed are
//! skipped, never caught up.

use super::deadlines::Deadlines;
use super::requests::{Answered, Asking, Numbered};
use super::stops::Stops;
use crate::control::control_loop::ControlLoop;
use crate::control::safety::Fault;
use crate::control::trace::Trace;
use crate::messages::Measurement;
use crate::process::stop::{STOP_REASON, StopFlag};
use crate::rt::{self, DeadlineWait};
use crate::time::SpanNs;
use rtrb::{Consumer, Producer};
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// From the start of the thread to its first tick.
const LEAD: SpanNs = SpanNs(2_000_000);

/// What the thread works with.
pub(super) struct RealtimeThread<const N: usize> {
    pub(super) control: ControlLoop<N>,
    pub(super) measurements: Consumer<Measurement>,
    pub(super) records: Producer<Trace>,
    /// What mission and clients want of the loop, and what it says to the latter.
    pub(super) requests: Consumer<Asking<N>>,
    pub(super) answers: Producer<Answered>,
    /// What is asked for from outside.
    pub(super) stops: Stops,
    /// The companion's own request, when it cannot go on.
    pub(super) halt: StopFlag,
    pub(super) max_missed_in_a_row: u64,
}

/// How its ticks went.
struct Ticked {
    deadlines: Deadlines,
    lost_traces: u64,
    last: Option<Trace>,
    page_faults: u64,
    spin_share: f64,
}

impl Ticked {
    fn with<const N: usize>(self, control: ControlLoop<N>) -> AtEnd<N> {
        let Self { deadlines, lost_traces, last, page_faults, spin_share } = self;
        AtEnd { control, deadlines, lost_traces, last, page_faults, spin_share }
    }
}

/// What it leaves at its end.
pub(super) struct AtEnd<const N: usize> {
    pub(super) control: ControlLoop<N>,
    pub(super) deadlines: Deadlines,
    /// Traces that found no room in the ring.
    pub(super) lost_traces: u64,
    /// The last trace, where that found none: how the run ended must not be lost.
    pub(super) last: Option<Trace>,
    pub(super) page_faults: u64,
    /// Share of the time that it spun.
    pub(super) spin_share: f64,
}

/// The thread panicked, with these words.
#[derive(Debug)]
pub(super) struct Panic(pub(super) String);

impl<const N: usize> RealtimeThread<N> {
    /// Ticks to the end of the run; spins for `spin` before each deadline. After a panic nothing of the control loop can be
    /// trusted but its drive: that is told that no command follows, and stops by its own means.
    pub(super) fn run(mut self, spin: SpanNs) -> Result<AtEnd<N>, Panic> {
        let ticked = catch_unwind(AssertUnwindSafe(|| self.tick_to_the_end(spin)));
        match ticked {
            Ok(end) => Ok(end.with(self.control)),
            Err(cause) => {
                self.control.abandon();
                Err(Panic(words_of(cause.as_ref())))
            }
        }
    }

    fn tick_to_the_end(&mut self, spin: SpanNs) -> Ticked {
        rt::prefault();
        let faults_before = rt::page_faults();
        let start = rt::now();
        let mut deadlines = Deadlines::new(start + LEAD);
        let mut wait = DeadlineWait::new(spin);
        let mut lost_traces = 0;
        let last = loop {
            let woken = wait.until(deadlines.next());
            let (tick, time) = deadlines.woken(woken);
            if deadlines.missed_in_a_row() > self.max_missed_in_a_row {
                self.control.fail(Fault::DeadlinesMissed);
            }
            if self.halt.is_requested() {
                self.control.stop(STOP_REASON);
            }
            self.stops.obey(&mut self.control);
            while let Ok(asking) = self.requests.pop() {
                self.obey(&asking);
            }
            let mut newest: Option<Measurement> = None;
            while let Ok(m) = self.measurements.pop() {
                if newest.is_none_or(|kept| m.exposure >= kept.exposure) {
                    newest = Some(m);
                }
            }
            self.control.sense(tick, time);
            let mut trace = self.control.act(time, newest.as_ref());
            let done = rt::now();
            self.control.commanded(done, &mut trace);
            deadlines.done(done);
            trace.missed_deadlines = deadlines.missed();
            trace.lost = lost_traces;
            // Full only when the companion hangs; control goes on.
            let unsent = self.records.push(trace).is_err();
            if trace.over {
                break unsent.then_some(trace);
            }
            lost_traces += u64::from(unsent);
        };
        Ticked {
            deadlines,
            lost_traces,
            last,
            page_faults: rt::page_faults() - faults_before,
            spin_share: wait.spun().as_s() / (rt::now() - start).as_s(),
        }
    }
}

impl<const N: usize> RealtimeThread<N> {
    fn obey(&mut self, asking: &Asking<N>) {
        match asking {
            Asking::Order(order) => self.control.obey(order),
            Asking::Request(Numbered { number, request }) => {
                let refusal = self.control.request(*request).err();
                let state = self.control.controller().state().told();
                // There is room for as many answers as for requests.
                let _ = self.answers.push(Answered { number: *number, refusal, state });
            }
        }
    }
}

/// What a panic says.
fn words_of(cause: &(dyn Any + Send)) -> String {
    let text = cause.downcast_ref::<&str>().copied();
    text.or_else(|| cause.downcast_ref::<String>().map(String::as_str))
        .unwrap_or("no reason given")
        .to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Config, assemble};
    use crate::drive::{CommandMode, Drive, DriveCommand, DriveState};
    use crate::time::MonoNs;
    use nalgebra::SVector;
    use rtrb::RingBuffer;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};

    /// An arm whose code has a defect.
    struct Defective<const N: usize> {
        q: SVector<f64, N>,
        reads: u32,
        was_ended: Arc<AtomicBool>,
    }

    impl<const N: usize> Drive<N> for Defective<N> {
        fn read(&mut self, _now: MonoNs) -> DriveState<N> {
            self.reads += 1;
            assert!(self.reads < 5, "index {} out of range", self.reads);
            DriveState { q: self.q, qd: SVector::zeros(), truth: None }
        }

        fn write(&mut self, _command: &DriveCommand<N>) {}

        fn modes(&self) -> &'static [CommandMode] {
            &CommandMode::ALL
        }

        fn end(&mut self, _last: &DriveCommand<N>) {
            self.was_ended.store(true, Ordering::Relaxed);
        }
    }

    #[test]
    fn a_panic_ends_the_drive_and_is_told() {
        let config = Config::load(None, &[]).unwrap();
        let was_ended = Arc::new(AtomicBool::new(false));
        let q = assemble::q_start::<4>(&config).unwrap();
        let drive = Box::new(Defective { q, reads: 0, was_ended: was_ended.clone() });
        let robot = config.robot.build().unwrap();
        let control = assemble::control_loop_with::<4>(&config, robot, drive).unwrap().control;
        let (records, _kept) = RingBuffer::new(16);
        let (_kept, measurements) = RingBuffer::new(1);
        let place: crate::ipc::Instance = format!("u-panic-{}", std::process::id()).parse().unwrap();
        let stops = Stops::new(StopFlag::default(), place.make_stop_word().unwrap(), false);
        let (_kept, requests) = RingBuffer::new(1);
        let (answers, _kept) = RingBuffer::new(1);
        let worker = RealtimeThread {
            control,
            measurements,
            records,
            requests,
            answers,
            stops,
            halt: StopFlag::default(),
            max_missed_in_a_row: 1_000_000,
        };
        let Err(Panic(reason)) = worker.run(SpanNs::ZERO) else { panic!("it ran to its end") };
        assert_eq!(reason, "index 5 out of range");
        assert!(was_ended.load(Ordering::Relaxed), "the drive knows that no command follows");
        place.remove_leftovers(None);
    }
}
