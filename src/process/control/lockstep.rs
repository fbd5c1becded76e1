//! Lockstep: a simulated clock that waits for nothing but its own measurements.
//!
//! At each tick the arm's state goes out; a camera whose frame is due renders it. The measurement of a frame is used
//! exactly `latency` later, and the loop waits there until it has come. Nothing else decides: not the machine's load, not
//! the order in which processes run.

use super::commands::Commands;
use super::event_log;
use super::external_drive::{self, DriveEnd, DrivePorts, HURRY, LOOK_FIRST, LOOK_LATER, TELL, WaitOutcome};
use super::recorder_pace::RecorderPace;
use super::requests::{Answered, ClientRequest};
use super::stops::Stops;
use super::{Listeners, Pace, Ports};
use crate::config::{Camera, Config};
use crate::control::safety::Fault;
use crate::drive::DriveFault;
use crate::ipc::{Receiver, Role, Spin, WakeListener};
use crate::messages::{Measurement, frame_flag};
use crate::mission::LockstepRun;
use crate::process::STOP_REASON;
use crate::process::silence::Silence;
use crate::process::{LONGEST_SPIN, LONGEST_WAIT, Membership, ProcessError, WAKE_AHEAD};
use crate::process::{frame_shape, second_vision, seeing_cameras, seeing_roles, shape_of};
use crate::report::statistics::RunStatistics;
use crate::rt::now;
use crate::scene::FrameSchedule;
use crate::time::TICK;
use crate::time::{MonoNs, SpanNs};
use std::collections::VecDeque;
use tracing::{debug_span, error, info, warn};

/// Time after which a wait for a measurement is reported. Chosen by hand: a frame takes some milliseconds, even on a loaded machine.
const REPORT_AFTER: SpanNs = SpanNs(2_000_000_000);
/// Time after which a measurement is given up, because camera or vision must hang. Chosen by hand: a suspended process has that time to resume.
const PEERS_PATIENCE: SpanNs = SpanNs(10_000_000_000);

/// Waits until camera and vision have joined, because they would miss what is sent before. They join within a moment, so that
/// requests wait for the first tick; a stop does not.
pub(super) fn wait_for_peers(
    membership: &Membership,
    config: &Config,
    stops: &Stops,
) -> Result<(), ProcessError> {
    let further: Vec<_> =
        seeing_cameras(config).skip(1).map(|camera| (camera.id, shape_of(camera, config.clock))).collect();
    let first = (config.camera.id, frame_shape(config));
    let presence = membership.services().peer_presence(first, &further, second_vision(config))?;
    let began = now();
    let mut told = None;
    while !stops.end_the_start() {
        membership.beat();
        let peers = presence.look();
        if peers.camera && peers.vision {
            return Ok(());
        }
        let time = now();
        if told.is_none() {
            info!("waiting for the camera and vision processes of this instance");
            told = Some(time);
        } else if told.is_some_and(|told| time - told > TELL) {
            let missing = match (peers.camera, peers.vision) {
                (false, false) => "camera and vision have",
                (false, true) => "the camera has",
                _ => "vision has",
            };
            warn!("{missing} not joined for {:.0} s", (time - began).as_s());
            told = Some(time);
        }
        // To look costs a part of a millisecond.
        std::thread::sleep(if time - began < HURRY { LOOK_FIRST } else { LOOK_LATER });
    }
    Ok(())
}

/// Ticks to the end of the run.
pub(super) fn run<const N: usize>(
    config: &Config,
    mut control: LockstepRun<N>,
    ports: &Ports<'_>,
    (mut drive, mut commands): (Option<DrivePorts<'_>>, Commands),
    listeners: &mut Listeners<N>,
    stops: &Stops,
) -> Result<(LockstepRun<N>, RunStatistics, Pace), ProcessError> {
    let seen = seeing_cameras(config);
    let mut inbox = Inbox::new(config, &config.camera, (&ports.measurements, &ports.wake_listener));
    let second = config.second_view.as_ref().zip(ports.second.as_ref());
    let mut second = second
        .map(|(view, (measurements, wake))| Inbox::new(config, &view.cell.camera, (measurements, wake)));
    // A measurement of the second camera that waits for a tick without one of the first.
    let mut delayed = None;
    let mut pace = RecorderPace::new(config);
    let next_after = |tick| seen.clone().map(|camera| camera.schedule.next_exposure_tick(tick)).min();
    let mut next_exposure = next_after(0).unwrap_or(u64::MAX);
    let mut statistics = RunStatistics::new(config.robot.joint_names());
    let mut tick = 0;
    // The first failure of the transport: from then on nothing is waited for but the drive, and the arm comes to rest.
    let mut broken = None;
    loop {
        let now = MonoNs(TICK.0 * tick as i64);
        // The first state came when the drive was connected.
        if let Some(drive) = &mut drive
            && tick > 0
        {
            match drive.wait_for_state(tick, stops) {
                Ok(WaitOutcome::Here) => note(&mut broken, drive.take_words()),
                Ok(WaitOutcome::Failed(fault)) => control.fail(Fault::Drive(fault)),
                Err(error) => {
                    control.fail(Fault::Drive(DriveFault::Silent));
                    note(&mut broken, Err(error));
                }
            }
        }
        ports.membership.beat();
        let state = control.sense(tick, now);
        if seen.clone().any(|camera| camera.schedule.frame_at(tick).is_some()) {
            next_exposure = next_after(tick).unwrap_or(u64::MAX);
            note(&mut broken, ports.joint_state.send(&state));
        } else {
            note(&mut broken, ports.joint_state.send_quietly(&state));
        }
        stops.obey(&mut control.control);
        if broken.is_some() {
            control.stop(STOP_REASON);
        }
        commands.begin_pass();
        while let Some(ClientRequest { number, request, command }) =
            commands.next(|command| control.mission.examine(command))
        {
            let refusal = control.ask(number, request, &command).err();
            commands.note_goal(&control.mission);
            let state = control.controller().state().told();
            if let Some(record) = commands.answer(&Answered { number, refusal, state, tick, stamp: now }) {
                note(&mut broken, ports.requests.send(|| record));
            }
        }
        let before = inbox.next_frame;
        let mut measurement = inbox.due_at(tick, (ports.membership, stops), &mut broken);
        if let Some(second) = &mut second {
            delayed = second.due_at(tick, (ports.membership, stops), &mut broken).or(delayed);
            measurement = measurement.or_else(|| delayed.take());
        }
        if inbox.peers_hang || second.as_ref().is_some_and(|second| second.peers_hang) {
            control.fail(Fault::PeersSilent);
        }
        // From here to the next frame nothing is waited for: the camera may wake up meanwhile.
        let ahead = next_exposure - tick;
        if ahead == WAKE_AHEAD || (ahead < WAKE_AHEAD && inbox.next_frame > before) {
            note(&mut broken, ports.joint_state.notify());
        }
        if let Some(m) = &measurement {
            listeners.note_measurement(m);
        }
        let trace = control.act(now, measurement.as_ref());
        let is_recorded = ports.trace.is_heard();
        note(&mut broken, ports.trace.send(|| trace.record()));
        if is_recorded {
            pace.keep(tick, ports.membership);
        }
        statistics.note(&trace);
        listeners.note(&trace);
        commands.note(&trace, &control.mission);
        event_log::log(&trace, &control.mission);
        if let Some(drive) = &mut drive {
            drive.hand_words_to(&mut commands);
            note(&mut broken, drive.send());
        }
        if let Some(status) = &trace.status {
            note(&mut broken, ports.status.send_quietly(status));
        }
        if trace.finish.is_some() {
            let said = external_drive::farewell(drive);
            return match broken {
                Some(error) => Err(error),
                None => said.map(|DriveEnd { robot_words, .. }| {
                    (control, statistics, Pace { robot_words, ..Pace::without_deadlines() })
                }),
            };
        }
        tick += 1;
    }
}

/// Keeps the first failure, and reports it.
fn note<E: Into<ProcessError>>(broken: &mut Option<ProcessError>, result: Result<(), E>) {
    if let (Err(error), None) = (result.map_err(Into::into), &broken) {
        error!("{error}: the arm is brought to rest, then the run ends");
        *broken = Some(error);
    }
}

/// Measurements of one camera that have arrived, in the order of their frames.
struct Inbox<'a> {
    schedule: &'a FrameSchedule,
    measurements: &'a Receiver<Measurement>,
    wake_listener: &'a WakeListener,
    /// The frame whose measurement is due next.
    next_frame: u64,
    waiting: VecDeque<Measurement>,
    last_frame: Option<u64>,
    /// All of shared memory was, when the first measurement came: nothing moves before.
    is_reserved: bool,
    /// Camera and vision did not answer in time, and are not waited for any more.
    peers_hang: bool,
    /// Who is waited for.
    seeing: Vec<Role>,
    spin: Spin,
}

impl<'a> Inbox<'a> {
    /// Of `camera`, whose measurements come by these ends.
    fn new(
        config: &Config,
        camera: &'a Camera,
        (measurements, wake_listener): (&'a Receiver<Measurement>, &'a WakeListener),
    ) -> Self {
        Self {
            schedule: &camera.schedule,
            measurements,
            wake_listener,
            next_frame: 0,
            waiting: VecDeque::new(),
            last_frame: None,
            is_reserved: false,
            peers_hang: false,
            seeing: seeing_roles(config),
            spin: Spin::new(LONGEST_SPIN),
        }
    }

    /// The newest measurement that may be used from `tick` on, and not before.
    fn due_at(
        &mut self,
        tick: u64,
        (membership, stops): (&Membership, &Stops),
        broken: &mut Option<ProcessError>,
    ) -> Option<Measurement> {
        let mut newest = None;
        while self.schedule.usable_tick(self.next_frame) == tick {
            let id = self.next_frame;
            if !self.schedule.is_lost(id) && broken.is_none() {
                let _span = debug_span!("measurement", frame = id).entered();
                match self.measurement_of(id, membership, stops) {
                    Ok(here) => newest = here.or(newest),
                    Err(error) => note(broken, Err(error)),
                }
            }
            self.next_frame += 1;
        }
        newest
    }

    /// The measurement of frame `id`, as soon as it is there; `None` when a stop is requested meanwhile, no such frame
    /// will ever come, or camera and vision hang.
    fn measurement_of(
        &mut self,
        id: u64,
        membership: &Membership,
        stops: &Stops,
    ) -> Result<Option<Measurement>, ProcessError> {
        let mut wait = None;
        loop {
            while let Some(m) = self.measurements.receive()? {
                if !std::mem::replace(&mut self.is_reserved, true) {
                    membership.services().instance().reserve()?;
                }
                if m.flags & frame_flag::LAST != 0 {
                    self.last_frame = Some(m.frame_id);
                }
                self.waiting.push_back(*m);
            }
            while self.waiting.front().is_some_and(|m| m.frame_id < id) {
                self.waiting.pop_front();
            }
            match self.waiting.front() {
                Some(m) if m.frame_id == id => return Ok(self.waiting.pop_front()),
                Some(_) => return Ok(None),
                None if stops.are_asked() || self.last_frame.is_some_and(|last| id > last) => {
                    return Ok(None);
                }
                None => {}
            }
            self.peers_hang |=
                wait.get_or_insert_with(MeasurementWait::begin).is_over(id, &self.seeing, membership);
            if self.peers_hang {
                return Ok(None);
            }
            membership.beat();
            let here = || self.measurements.is_waiting();
            self.wake_listener.wait_spinning(LONGEST_WAIT, &mut self.spin, here)?;
        }
    }
}

/// A wait for a measurement: it is reported after a while, and bounded.
struct MeasurementWait {
    silence: Silence,
    told: bool,
}

impl MeasurementWait {
    fn begin() -> Self {
        Self { silence: Silence::begin(now()), told: false }
    }

    fn is_over(&mut self, frame_id: u64, seeing: &[Role], membership: &Membership) -> bool {
        let time = now();
        let waited = self.silence.look(time);
        if waited > REPORT_AFTER && !std::mem::replace(&mut self.told, true) {
            let instance = membership.services().instance();
            let hangs = |role| instance.last_heartbeat(role).is_none_or(|last| time - last > REPORT_AFTER);
            let hanging: Vec<_> = seeing.iter().filter(|r| hangs(**r)).map(ToString::to_string).collect();
            let who = if hanging.is_empty() { "none".into() } else { hanging.join(", ") };
            warn!(
                "waiting for camera and vision: the measurement of frame {frame_id} does not come (without a sign of life: \
                 {who})"
            );
        }
        waited > PEERS_PATIENCE
    }
}
