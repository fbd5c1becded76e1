//! Real time: absolute deadlines every millisecond on a FIFO thread.
//!
//! ```text
//! companion thread                              real-time thread
//! measurement port ──ring──────────────────────► newest ─► ControlLoop
//! Mission, clients ──ring──────────────────────► orders, requests
//! joint_state, status ports ◄─ Mission ◄──ring── records
//! drive/state, drive/command ◄─rings─────────────► ExternalDrive, where there is one
//! ```
//! With an external drive the companion runs at the priority below.

use super::camera_watch::CameraWatch;
use super::commands::Commands;
use super::event_log;
use super::external_drive::{self, DriveEnd, DrivePorts};
use super::realtime_thread::{AtEnd, Panic, RealtimeThread};
use super::requests::{Answered, Asking, ClientRequest};
use super::restart_watch::RestartWatch;
use super::stops::Stops;
use super::{Listeners, Pace, Ports};
use crate::config::RealtimePolicy;
use crate::config::{Config, RealtimeRequest};
use crate::control::control_loop::ControlLoop;
use crate::control::trace::{FrameStamps, Trace};
use crate::ipc::IpcError;
use crate::messages::Measurement;
use crate::mission::{LockstepRun, Mission};
use crate::process::priority::Rank;
use crate::process::silence::Silence;
use crate::process::{ProcessError, StopFlag};
use crate::report::statistics::RunStatistics;
use crate::report::summary::{RealtimeReport, spin_text};
use crate::rt::{self, Awake, Obtained};
use crate::time::SpanNs;
use crate::time::TICK;
use rtrb::{Consumer, Producer, RingBuffer};
use std::collections::VecDeque;
use std::sync::mpsc;
use std::time::Duration;
use tracing::{debug, debug_span, error, info, warn};

/// Records that wait for the companion: a second of them, so that a companion that is kept from its core loses none. Chosen by hand:
/// half loses traces where a loaded machine withholds the core for longer, twice only takes memory.
const RECORDS: usize = 1024;
/// Measurements that wait for a tick. Chosen by hand: the newest one is used; a camera at 1 kHz fills it in 64 ms.
const MEASUREMENTS: usize = 64;
/// Requests and orders that wait for a tick: it must hold a tour of 14 postures and the requests of 8 clients.
const REQUESTS: usize = 32;
/// The companion looks after the rings at least so often.
const COMPANION_PERIOD: Duration = Duration::from_millis(1);
/// Between two tries of what has failed: a fifth of a tick. Chosen by hand: an external drive that must brake hears of it as soon as it can.
const PAUSE_WHEN_BROKEN: Duration = Duration::from_micros(200);
/// Time without measurements after which that is reported. Chosen by hand, for people.
const REPORT_AFTER: SpanNs = SpanNs(3_000_000_000);

/// Ticks to the end of the run.
pub(super) fn run<const N: usize>(
    config: &Config,
    LockstepRun { control, mission }: LockstepRun<N>,
    ports: &Ports<'_>,
    (mut drive, commands, camera): (Option<DrivePorts<'_>>, Commands, CameraWatch),
    listeners: &mut Listeners<N>,
    stops: Stops,
) -> Result<(LockstepRun<N>, RunStatistics, Pace), ProcessError> {
    let (records, to_send) = RingBuffer::new(RECORDS);
    let (received, measurements) = RingBuffer::new(MEASUREMENTS);
    let (asked, requests) = RingBuffer::new(REQUESTS);
    let (answers, answered) = RingBuffer::new(REQUESTS);
    let (tell, obtained) = mpsc::channel();
    let Config { realtime, .. } = config;
    let request = (realtime.policy != RealtimePolicy::Off).then_some(realtime.request);
    let asked_spin = realtime.spin;
    let enforce = realtime.policy == RealtimePolicy::Enforce;
    let memory = request.as_ref().and_then(rt::prepare_process);
    let max_missed_in_a_row = config.safety.max_missed_in_a_row;
    let halt = StopFlag::default();
    let restarts = RestartWatch::new(stops.clone(), config);
    let worker = RealtimeThread {
        control,
        measurements,
        records,
        requests,
        answers,
        stops,
        halt: halt.clone(),
        max_missed_in_a_row,
    };
    let thread = std::thread::Builder::new()
        .name("control-rt".into())
        .spawn(move || {
            let obtained = Obtained { memory, ..request.map(|r| rt::prepare_thread(&r)).unwrap_or_default() };
            let refused = enforce && obtained.require_all().is_err();
            let scheduling = obtained.to_string();
            let spin = rt::spin_before_deadlines(asked_spin, &obtained);
            let _ = tell.send((obtained, spin));
            (!refused).then(|| (worker.run(spin), scheduling, spin))
        })
        .map_err(|cause| ProcessError::Start { what: "the real-time thread", cause })?;
    if let Ok((obtained, spin)) = obtained.recv() {
        report(request.as_ref(), &obtained, spin);
        if enforce {
            obtained.require_all()?;
        }
    }
    if drive.is_some()
        && let Some(request) = request
    {
        // Joint states pass through this thread: whatever else the machine does, they come before it.
        let obtained = rt::prepare_thread(&Rank::Companion.request(&request));
        match obtained.fifo {
            Some(Ok(priority)) => info!("companion of the external drive: SCHED_FIFO {priority}"),
            _ => info!("companion of the external drive: normal priority"),
        }
    }
    // Held to the end of the run; where the kernel refuses it, an idle machine wakes up later.
    let _awake = request.map(|_| Awake::keep().inspect_err(|e| debug!("deep idle states stay allowed: {e}")));
    let statistics = RunStatistics::new(config.robot.joint_names());
    let mut companion = Companion {
        ports,
        mission,
        taken: VecDeque::with_capacity(MEASUREMENTS),
        received,
        to_send,
        commands,
        camera,
        restarts,
        asked,
        answered,
        listeners,
        statistics,
        unsent: 0,
        is_reserved: false,
        silence: None,
    };
    let mut broken = None;
    while !thread.is_finished() {
        ports.membership.beat();
        let carried = companion.carry();
        let waited = match &mut drive {
            Some(drive) => {
                let carried = drive.carry();
                drive.hand_words_to(&mut companion.commands);
                carried
            }
            None => ports.wake_listener.wait(COMPANION_PERIOD).map_err(ProcessError::from),
        };
        let Err(error) = carried.and(waited) else { continue };
        // Without messages the run cannot go on. The arm comes to rest first, for which all that still gets through is carried
        // on: an external drive hears the braking to its end.
        if broken.is_none() {
            error!("{error}: the arm is brought to rest, then the run ends");
            halt.request();
            broken = Some(error);
        }
        std::thread::sleep(PAUSE_WHEN_BROKEN); // what fails may not have waited
    }
    let carried = companion.carry();
    let drive_end = external_drive::farewell(drive);
    if let Some(error) = broken {
        return Err(error);
    }
    carried?;
    let DriveEnd { lost_commands, robot_words } = drive_end?;
    if companion.unsent > 0 {
        warn!(count = companion.unsent, "measurements came faster than control took them");
    }
    match thread.join() {
        Ok(Some((Ok(at_end), scheduling, spin))) => {
            if let Some(last) = at_end.last {
                companion.note(last);
            }
            let (control, pace) = pace(at_end, scheduling, spin);
            let camera_is_away = companion.camera.why_away(rt::now());
            let run = LockstepRun { control, mission: companion.mission };
            Ok((run, companion.statistics, Pace { lost_commands, camera_is_away, robot_words, ..pace }))
        }
        Ok(Some((Err(Panic(reason)), ..))) => {
            error!("the real-time thread panicked, the drive was told that no command follows: {reason}");
            Err(ProcessError::Panicked("real-time"))
        }
        Ok(None) | Err(_) => Err(ProcessError::Panicked("real-time")),
    }
}

fn report(request: Option<&RealtimeRequest>, obtained: &Obtained, spin: SpanNs) {
    let spin = spin_text(spin.as_us(), spin.as_us() / TICK.as_us());
    match request {
        Some(_) => info!("real-time scheduling: {obtained}{spin}"),
        None => info!("real-time scheduling: off{spin}"),
    }
}

fn pace<const N: usize>(at_end: AtEnd<N>, scheduling: String, spin: SpanNs) -> (ControlLoop<N>, Pace) {
    let AtEnd { control, deadlines, lost_traces, page_faults, spin_share, last: _ } = at_end;
    let pace = Pace {
        realtime: Some(RealtimeReport { scheduling, page_faults, spin_us: spin.as_us(), spin_share }),
        missed_deadlines: deadlines.missed(),
        skipped_ticks: deadlines.skipped(),
        tick_us: deadlines.times(),
        lost_traces,
        lost_commands: 0,
        camera_is_away: None,
        robot_words: None,
    };
    (control, pace)
}

/// Carries messages between the ports and the rings, and has the mission.
struct Companion<'a, const N: usize> {
    ports: &'a Ports<'a>,
    mission: Mission<N>,
    /// Measurements that went to the real-time thread: a trace names the one that it took.
    taken: VecDeque<Measurement>,
    received: Producer<Measurement>,
    to_send: Consumer<Trace>,
    commands: Commands,
    camera: CameraWatch,
    restarts: RestartWatch,
    asked: Producer<Asking<N>>,
    answered: Consumer<Answered>,
    listeners: &'a mut Listeners<N>,
    statistics: RunStatistics,
    unsent: u64,
    /// All of shared memory was, when the first measurement came.
    is_reserved: bool,
    /// The silence since the last measurement; `None` once it was reported.
    silence: Option<Silence>,
}

impl<const N: usize> Companion<'_, N> {
    /// Carries everything there is, also where one service fails; gives the first failure.
    fn carry(&mut self) -> Result<(), ProcessError> {
        let measured = self.take_measurements();
        let looked = self.look_at_cameras();
        self.look_at_restarts();
        let mut told = self.send_records();
        while let Ok(answered) = self.answered.pop() {
            told = told.and(self.answer(&answered));
        }
        self.commands.begin_pass();
        while self.asked.slots() > 0 {
            // The mission's orders first: what they are about is older.
            let asking = match self.mission.next_order() {
                Some(order) => Asking::Order(order),
                None => match self.commands.next(|command| self.mission.examine(command)) {
                    Some(ClientRequest { number, request, command }) => {
                        match self.mission.plan(number, request, &command) {
                            Ok(order) => Asking::Request { number, request, order },
                            Err(refusal) => {
                                let (state, (tick, stamp)) =
                                    (self.mission.state(), self.commands.last_tick());
                                let refusal = Some(refusal);
                                told =
                                    told.and(self.answer(&Answered { number, refusal, state, tick, stamp }));
                                continue;
                            }
                        }
                    }
                    None => break,
                },
            };
            let _ = self.asked.push(asking); // there is room
        }
        Ok(measured.and(looked).and(told)?)
    }

    fn answer(&mut self, answered: &Answered) -> Result<(), IpcError> {
        self.mission.decided(answered.number, answered.refusal.is_none());
        self.commands.note_goal(&self.mission);
        self.commands.answer(answered).map_or(Ok(()), |record| self.ports.requests.send(|| record))
    }

    fn take_measurements(&mut self) -> Result<(), IpcError> {
        while let Some(measurement) = self.next_measurement()? {
            let _span = debug_span!("measurement", frame = measurement.frame_id).entered();
            self.silence = Some(Silence::begin(rt::now()));
            self.reserve()?;
            self.listeners.note_measurement(&measurement);
            if self.received.push(measurement).is_err() {
                self.unsent += 1;
                continue;
            }
            if self.taken.len() == MEASUREMENTS {
                self.taken.pop_front();
            }
            self.taken.push_back(measurement);
        }
        Ok(())
    }

    /// The next measurement of a camera that has one.
    fn next_measurement(&self) -> Result<Option<Measurement>, IpcError> {
        let second = || self.ports.second.as_ref().map_or(Ok(None), |(second, _)| second.receive());
        let next = match self.ports.measurements.receive()? {
            None => second()?,
            first => first,
        };
        Ok(next.map(|measurement| *measurement))
    }

    /// Before the first measurement moves the arm: camera and vision have joined by then, with segments of their own.
    fn reserve(&mut self) -> Result<(), IpcError> {
        if !std::mem::replace(&mut self.is_reserved, true) {
            self.ports.membership.services().instance().reserve()?;
        }
        Ok(())
    }

    fn look_at_cameras(&mut self) -> Result<(), IpcError> {
        if let Some(event) = self.camera.look()? {
            self.statistics.note_event(rt::now(), event);
        }
        Ok(())
    }

    /// Of the processes that see for this one.
    fn look_at_restarts(&mut self) {
        let news = self.restarts.look();
        if let Some(event) = news.event {
            self.statistics.note_event(rt::now(), event);
        }
        if news.holds {
            self.commands.hold();
        }
    }

    /// The trace of a tick, completed by the mission.
    fn note(&mut self, mut trace: Trace) -> Trace {
        let frame = trace.measurement_record.map(|record| record.frame);
        let measurement =
            frame.and_then(|frame| self.taken.iter().rev().find(|m| FrameStamps::of(m) == frame));
        self.mission.note(&mut trace, measurement);
        self.statistics.note(&trace);
        self.commands.note(&trace, &self.mission);
        self.listeners.note(&trace);
        event_log::log(&trace, &self.mission);
        trace
    }

    fn send_records(&mut self) -> Result<(), IpcError> {
        let mut sent = Ok(());
        // The mission sees all that has come before it gives out orders; of that the last trace tells.
        for after in (0..self.to_send.slots()).rev() {
            let Ok(mut record) = self.to_send.pop() else { break };
            record.gives_orders = after == 0;
            let record = self.note(record);
            sent = sent
                .and(self.ports.joint_state.send_quietly(&record.joint_state))
                .and(self.ports.trace.send(|| record.record()));
            if self.silence.as_mut().is_some_and(|silence| silence.look(rt::now()) > REPORT_AFTER) {
                warn!(
                    "no measurement for {:.0} s: the arm holds; do camera and vision run?",
                    REPORT_AFTER.as_s()
                );
                self.silence = None;
            }
            if let Some(status) = &record.status {
                let status = self.restarts.added_to(&self.camera.added_to(status));
                self.commands.note_camera(&status);
                sent = sent.and(self.ports.status.send_quietly(&status));
            }
        }
        sent
    }
}
