//! The real-time thread: everything that it does between its first tick and its last.
//!
//! ```text
//! wait ─► orders and requests, newest measurement from their rings ─► ControlLoop ─► trace into its ring ─► wait
//! ```
//! It makes no system call but its sleep, and does not allocate. A late tick is counted; ticks that have passed are
//! skipped, never caught up.

use super::deadlines::Deadlines;
use super::requests::{Answered, Asking};
use super::stops::Stops;
use crate::control::control_loop::ControlLoop;
use crate::control::safety::Fault;
use crate::control::trace::Trace;
use crate::messages::{CameraId, Measurement};
use crate::process::stop::{STOP_REASON, StopFlag};
use crate::rt::{self, DeadlineWait};
use crate::time::{MonoNs, SpanNs};
use rtrb::{Consumer, Producer};
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// Time from the start of the thread to its first tick. Chosen by hand: two ticks, so that the first deadline lies ahead.
const LEAD: SpanNs = SpanNs(2_000_000);
/// Ticks in a row whose traces may find no room in their ring, which holds a second of them: after 3 s the companion is taken to hang. The
/// arm is safe that long, as it holds `safety.measurement_timeout_ms` after the last measurement that was carried. Chosen by hand between that
/// and the 6 s after which the supervisor ends a run whose control process hangs.
const MAX_UNSENT_IN_A_ROW: u32 = 2000;
/// Why a run ends that nobody else could end.
const COMPANION_SILENT: &str = "the thread that carries the messages of control hangs";

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
        let mut newest = NewestMeasurements::default();
        let (mut lost_traces, mut unsent_in_a_row) = (0, 0u32);
        let last = loop {
            let woken = wait.until(deadlines.next());
            let (tick, time) = deadlines.woken(woken);
            if deadlines.missed_in_a_row() > self.max_missed_in_a_row {
                self.control.fail(Fault::DeadlinesMissed);
            }
            if self.halt.is_requested() {
                self.control.stop(STOP_REASON);
            }
            if unsent_in_a_row > MAX_UNSENT_IN_A_ROW {
                self.control.fail(Fault::CompanionSilent);
                self.control.stop(COMPANION_SILENT);
            }
            self.stops.obey(&mut self.control);
            while let Ok(asking) = self.requests.pop() {
                self.obey(&asking, (tick, time));
            }
            while let Ok(m) = self.measurements.pop() {
                newest.take(m);
            }
            let measurement = newest.next();
            self.control.sense(tick, time);
            let mut trace = self.control.act(time, measurement.as_ref());
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
            unsent_in_a_row = if unsent { unsent_in_a_row.saturating_add(1) } else { 0 };
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
    fn obey(&mut self, asking: &Asking<N>, (tick, stamp): (u64, MonoNs)) {
        match asking {
            Asking::Order(order) => self.control.obey(order),
            Asking::Request { number, request, order } => {
                let refusal = self.control.request_with(*request, order.as_ref()).err();
                let state = self.control.controller().state().told();
                // There is room for as many answers as for requests.
                let _ = self.answers.push(Answered { number: *number, refusal, state, tick, stamp });
            }
        }
    }
}

/// The newest measurement of each camera that control has not taken in yet: a tick takes one.
#[derive(Default)]
struct NewestMeasurements {
    /// That of the first camera, and of another one.
    of: [Option<Measurement>; 2],
}

impl NewestMeasurements {
    fn take(&mut self, m: Measurement) {
        let [first, other] = &mut self.of;
        let place = if m.camera == u32::from(CameraId::FIRST) { first } else { other };
        if place.is_none_or(|kept| m.exposure >= kept.exposure) {
            *place = Some(m);
        }
    }

    /// What this tick takes in; that of the other camera waits for the next one.
    fn next(&mut self) -> Option<Measurement> {
        let [first, other] = &mut self.of;
        first.take().or_else(|| other.take())
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
    use crate::drive::{
        CommandMode, Drive, DriveCommand, DriveState, SimulatedDrive, SimulatedDriveSettings,
    };
    use crate::ipc::Instance;
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

    /// A thread for the default run with this drive; rings that nobody empties, of 16 traces.
    fn worker(
        drive: impl FnOnce(SVector<f64, 4>) -> Box<dyn Drive<4> + Send>,
        place: &Instance,
    ) -> RealtimeThread<4> {
        let config = Config::load(None, &[]).unwrap();
        let robot = config.robot.build().unwrap();
        let drive = drive(assemble::q_start::<4>(&config).unwrap());
        RealtimeThread {
            control: assemble::control_loop_with::<4>(&config, robot, drive).unwrap().control,
            measurements: RingBuffer::new(1).1,
            records: RingBuffer::new(16).0,
            requests: RingBuffer::new(1).1,
            answers: RingBuffer::new(1).0,
            stops: Stops::new(StopFlag::default(), place.make_stop_word().unwrap(), false),
            halt: StopFlag::default(),
            max_missed_in_a_row: 1_000_000,
        }
    }

    fn place(name: &str) -> Instance {
        format!("u-{name}-{}", std::process::id()).parse().unwrap()
    }

    #[test]
    fn a_panic_ends_the_drive_and_is_told() {
        let place = place("panic");
        let was_ended = Arc::new(AtomicBool::new(false));
        let worker = worker(|q| Box::new(Defective { q, reads: 0, was_ended: was_ended.clone() }), &place);
        let Err(Panic(reason)) = worker.run(SpanNs::ZERO) else { panic!("it ran to its end") };
        assert_eq!(reason, "index 5 out of range");
        assert!(was_ended.load(Ordering::Relaxed), "the drive knows that no command follows");
        place.remove_leftovers(None);
    }

    #[test]
    fn a_companion_that_hangs_ends_the_run() {
        let place = place("hang");
        let robot = Config::load(None, &[]).unwrap().robot.build::<4>().unwrap();
        let arm =
            |q| Box::new(SimulatedDrive::new(robot, q, SimulatedDriveSettings::default()).unwrap()) as _;
        let Ok(end) = worker(arm, &place).run(SpanNs::ZERO) else { panic!("it panicked") };
        let last = end.last.unwrap();
        assert_eq!((last.fault, last.stopped), (Some(Fault::CompanionSilent), Some(COMPANION_SILENT)));
        assert!(last.over && end.lost_traces >= u64::from(MAX_UNSENT_IN_A_ROW));
        place.remove_leftovers(None);
    }
}
