//! A camera that streams, and comes back when it was away.
//!
//! ```text
//!             first frame          no frame for a while
//!  Starting ─────────────► Streaming ◄──────────────► Stalled ── still none: begun anew, ever more rarely
//!                              │   ▲
//!             stream error, EIO│   │ frames                       3 attempts without a frame: opened anew
//!                              ▼   │                              ▲
//!                          Recovering: stop, pause, start ────────┤
//!                              │                                  ▼
//!                    ENODEV    └───────────────────────► Gone: closed; looked for with growing pauses,
//!                                                              by what it is, not by its node's number
//! ```
//! A frame's way: taken from the driver, dated, converted once into shared memory, given back. Nothing here waits longer than its caller allows,
//! but for the driver's own opening and starting.

use super::fault::is_gone;
use super::name::{self, Identity, OpenedNode};
use super::node::{CameraHost, Waited};
use super::session::{Losses, Session};
use super::track::Track;
use super::{CaptureFacts, CaptureRequest, V4l2Error};
use crate::messages::CameraState;
use crate::source::count::Backoff;
use crate::source::{Captured, Filled, FreeRunningSource, SourceError, SourceHealth};
use crate::time::{MonoNs, SpanNs};
use rustix::io::Errno;
use std::collections::BTreeSet;
use std::time::Duration;
use tracing::{info, warn};

/// Attempts to start a stream before the process gives up. Chosen by hand: with the pauses of [`Backoff`] they take two seconds.
const ATTEMPTS: u32 = 5;
/// Wake-ups without a frame in a row after which the stream counts as broken. Chosen by hand: single ones are normal.
const IDLE_WAKES: u32 = 10;
/// Attempts to restart a stream before the device is reopened. Chosen by hand: a restart is quicker than opening, but does not mend a device that was
/// reset or unplugged; each one in vain takes a pause.
const RESTARTS: u32 = 3;
/// Periods without a frame, and shortest time, after which a camera counts as stalled. Chosen by hand: automatic exposure may halve a rate, and
/// USB may lose a few frames.
const STALLED_PERIODS: f64 = 5.0;
const STALLED: SpanNs = SpanNs(500_000_000);
/// Shortest such time after the start of a stream. Chosen by hand: a sensor may have to wake up.
const STALLED_AT_START: SpanNs = SpanNs(3_000_000_000);
/// Duration of a stall after which the stream is restarted; the pauses between such attempts grow. Chosen by hand, longer than the start.
const RESTART_STALLED: SpanNs = SpanNs(5_000_000_000);
/// Most different notes about a device. Chosen by hand: a broken driver must not fill the log.
const MAX_NOTES: usize = 64;

/// What there is of the device.
#[derive(Debug)]
enum DeviceState {
    /// It streams.
    Streams(Session),
    /// Its stream is to be begun anew at this time.
    Pauses(Session, MonoNs),
    /// It is closed, and looked for at this time.
    Closed(MonoNs),
}

/// A camera of the kernel's video interface.
#[derive(Debug)]
pub struct V4l2Camera {
    host: Box<dyn CameraHost>,
    request: CaptureRequest,
    identity: Identity,
    link: DeviceState,
    track: Track,
    backoff: Backoff,
    /// Restarts since the last frame.
    restarts: u32,
    last_frame: MonoNs,
    next_restart: SpanNs,
    losses: Losses,
    idle_wakes: u32,
    damaged_in_conversion: u64,
    conversions: u64,
    state: CameraState,
    since: MonoNs,
    reopened: u64,
    restarted: u64,
    told: BTreeSet<String>,
}

impl V4l2Camera {
    /// Opens the camera and begins to stream.
    pub(super) fn open(host: Box<dyn CameraHost>, request: CaptureRequest) -> Result<Self, V4l2Error> {
        let mut backoff = Backoff::new();
        let mut attempt = 1;
        let (identity, session, news) = loop {
            match Self::open_once(host.as_ref(), &request) {
                Ok(opened) => break opened,
                Err(e) if e.may_pass() && attempt < ATTEMPTS => {
                    warn!("{e}; trying again ({attempt} of {ATTEMPTS})");
                    attempt += 1;
                    host.pause(backoff.pause());
                }
                Err(e) => return Err(e),
            }
        };
        let now = host.now();
        let mut camera = Self {
            track: Track::new(&request, session.buffers()),
            host,
            request,
            identity,
            link: DeviceState::Closed(now),
            backoff: Backoff::new(),
            restarts: 0,
            last_frame: now,
            next_restart: RESTART_STALLED,
            losses: Losses::default(),
            idle_wakes: 0,
            damaged_in_conversion: 0,
            conversions: 0,
            state: CameraState::Starting,
            since: now,
            reopened: 0,
            restarted: 0,
            told: BTreeSet::new(),
        };
        camera.adopt(session, news);
        Ok(camera)
    }

    fn open_once(
        host: &dyn CameraHost,
        request: &CaptureRequest,
    ) -> Result<(Identity, Session, Vec<String>), V4l2Error> {
        let OpenedNode { file, node } = name::resolve(host, &request.settings.device)?;
        let identity = Identity::of(&file, node.info());
        let (mut session, news) = Session::prepare(&file.path, node, request)?;
        session.begin()?;
        Ok((identity, session, news))
    }

    /// Goes on with a session that streams.
    fn adopt(&mut self, session: Session, news: Vec<String>) {
        let exposure = self.track.adopt(&session);
        let agreed = session.agreed();
        info!(
            "{}: {} {}x{}{}, exposure {exposure}",
            session.path().display(),
            agreed.layout.fourcc,
            agreed.layout.width,
            agreed.layout.height,
            agreed.interval.map_or(String::new(), |i| format!(" at {:.3} Hz", i.rate_hz())),
        );
        self.link = DeviceState::Streams(session);
        self.begin_count();
        news.into_iter().for_each(|line| self.tell(line));
    }

    /// A stream begins: its numbers and stamps have nothing to do with those before.
    fn begin_count(&mut self) {
        self.track.begin();
        self.idle_wakes = 0;
        self.last_frame = self.host.now();
        self.next_restart = RESTART_STALLED;
    }

    /// Tells something once.
    fn tell(&mut self, line: String) {
        if self.told.len() < MAX_NOTES && !self.told.contains(&line) {
            warn!("camera {}: {line}", self.request.settings.device);
            self.told.insert(line);
        }
    }

    fn enter(&mut self, state: CameraState) {
        if self.state != state {
            (self.state, self.since) = (state, self.host.now());
        }
    }

    /// Waits for a frame of a device that streams.
    fn wait_for_frame(
        &mut self,
        session: &mut Session,
        longest: Duration,
    ) -> Result<Option<Captured>, Errno> {
        session.give_back()?;
        self.track.follow_exposure(session, self.host.as_ref());
        let waited = session.node().wait(longest)?;
        if waited == Waited::TimeIsUp {
            return Ok(None);
        }
        let losses = self.losses;
        let Some(buffer) = session.take_newest(&mut self.losses)? else {
            // Trouble that nobody gives a reason for, or wake-ups for nothing: no time passes with either.
            self.idle_wakes = if self.losses == losses { self.idle_wakes + 1 } else { 0 };
            let is_futile = waited == Waited::Troubled || self.idle_wakes > IDLE_WAKES;
            return if is_futile { Err(Errno::IO) } else { Ok(None) };
        };
        self.idle_wakes = 0;
        let arrival = self.host.now();
        let mut news = Vec::new();
        let captured = self.track.frame(&buffer, arrival, &mut |line| news.push(line));
        news.into_iter().for_each(|line| self.tell(line));
        match captured {
            Some(_) => self.last_frame = arrival,
            None => session.give_back()?,
        }
        Ok(captured)
    }

    /// The device failed.
    fn failed(&mut self, session: Session, cause: Errno) {
        let now = self.host.now();
        if is_gone(cause) {
            if self.state != CameraState::Gone {
                warn!("camera {}: unplugged; it is looked for", self.request.settings.device);
            }
            drop(session);
            self.enter(CameraState::Gone);
            self.backoff = Backoff::new();
            self.link = DeviceState::Closed(now + self.backoff.pause());
            return;
        }
        if self.state != CameraState::Recovering {
            warn!(
                "camera {}: its stream failed: {}; it is begun anew",
                self.request.settings.device,
                std::io::Error::from(cause)
            );
            self.backoff = Backoff::new();
        }
        self.enter(CameraState::Recovering);
        self.restarts += 1;
        let next = now + self.backoff.pause();
        self.link = if self.restarts > RESTARTS {
            drop(session);
            DeviceState::Closed(next)
        } else {
            DeviceState::Pauses(session, next)
        };
    }

    /// Begins a stream anew.
    fn restart(&mut self, mut session: Session) {
        match session.restart() {
            Ok(()) => {
                self.restarted += 1;
                self.link = DeviceState::Streams(session);
                self.begin_count();
            }
            Err(e) => self.failed(session, e),
        }
    }

    /// Looks for the device, and opens it with all its settings.
    fn reopen(&mut self) {
        let opened = name::find_again(self.host.as_ref(), &self.identity).map(|OpenedNode { file, node }| {
            let (mut session, news) = Session::prepare(&file.path, node, &self.request)?;
            session.begin()?;
            Ok((session, news))
        });
        match opened {
            Some(Ok((session, news))) => {
                self.reopened += 1;
                self.restarts = 0;
                info!("camera {}: it is back", self.request.settings.device);
                self.adopt(session, news);
                self.enter(CameraState::Recovering); // until a frame has come
            }
            other => {
                if let Some(Err::<_, V4l2Error>(error)) = other {
                    self.tell(format!("it is back, but cannot be used yet: {error}"));
                }
                self.link = DeviceState::Closed(self.host.now() + self.backoff.pause());
            }
        }
    }

    /// No frame came within a wait.
    fn look_at_silence(&mut self) {
        let silent = self.host.now() - self.last_frame;
        let least = if self.state == CameraState::Starting { STALLED_AT_START } else { STALLED };
        let limit = least.max(SpanNs::from_s(STALLED_PERIODS * self.track.period().as_s()));
        if silent < limit {
            return;
        }
        if matches!(self.state, CameraState::Starting | CameraState::Streaming) {
            warn!(
                "camera {}: no frame for {:.1} s; it is waited for",
                self.request.settings.device,
                silent.as_s()
            );
            self.enter(CameraState::Stalled);
        }
        if silent > self.next_restart && matches!(self.link, DeviceState::Streams(_)) {
            let next = SpanNs(self.next_restart.0.saturating_mul(2));
            if let DeviceState::Streams(session) =
                std::mem::replace(&mut self.link, DeviceState::Closed(MonoNs::ZERO))
            {
                let last_frame = self.last_frame;
                self.restart(session);
                (self.last_frame, self.next_restart) = (last_frame, next); // the silence goes on
            }
        }
    }

    /// Waits until `time` or for `longest`, whichever is sooner; true when `time` has come.
    fn pause_until(&self, time: MonoNs, longest: Duration) -> bool {
        let left = (time - self.host.now()).min(SpanNs::from_s(longest.as_secs_f64()));
        if left > SpanNs::ZERO {
            self.host.pause(left);
        }
        self.host.now() >= time
    }

    /// How the device is used, for people; `None` while it is away.
    #[must_use]
    pub fn facts(&self) -> Option<CaptureFacts> {
        let DeviceState::Streams(session) = &self.link else { return None };
        Some(self.track.facts(session, self.conversions))
    }
}

impl FreeRunningSource for V4l2Camera {
    fn wait(&mut self, longest: Duration) -> Result<Option<Captured>, SourceError> {
        let captured = match std::mem::replace(&mut self.link, DeviceState::Closed(MonoNs::ZERO)) {
            DeviceState::Streams(mut session) => match self.wait_for_frame(&mut session, longest) {
                Ok(captured) => {
                    self.link = DeviceState::Streams(session);
                    captured
                }
                Err(cause) => {
                    self.failed(session, cause);
                    None
                }
            },
            DeviceState::Pauses(session, time) => {
                if self.pause_until(time, longest) {
                    self.restart(session);
                } else {
                    self.link = DeviceState::Pauses(session, time);
                }
                None
            }
            DeviceState::Closed(time) => {
                self.link = DeviceState::Closed(time);
                if self.pause_until(time, longest) {
                    self.reopen();
                }
                None
            }
        };
        match captured {
            None => self.look_at_silence(),
            Some(_) => {
                if self.state.is_away() {
                    info!(
                        "camera {}: frames are back after {:.1} s",
                        self.request.settings.device,
                        (self.host.now() - self.since).as_s()
                    );
                }
                self.restarts = 0;
                self.backoff = Backoff::new();
                self.enter(CameraState::Streaming);
            }
        }
        Ok(captured)
    }

    fn fill(&mut self, out: &mut [u8]) -> Result<Filled, SourceError> {
        let DeviceState::Streams(session) = &mut self.link else { return Ok(Filled::Damaged) };
        let converted = session.convert(out);
        self.conversions += 1;
        // An error here shows again at the next wait, which sees to it.
        let returned = session.give_back();
        if let Err(cause) = returned
            && let DeviceState::Streams(session) =
                std::mem::replace(&mut self.link, DeviceState::Closed(MonoNs::ZERO))
        {
            self.failed(session, cause);
        }
        match converted {
            Ok(()) => Ok(Filled::Image),
            Err(cause) => {
                self.damaged_in_conversion += 1;
                self.tell(format!("a frame could not be turned into grey: {cause}"));
                Ok(Filled::Damaged)
            }
        }
    }

    fn health(&self) -> SourceHealth {
        self.track.health(SourceHealth {
            state: self.state,
            since: self.since,
            corrupt: self.losses.damaged + self.damaged_in_conversion,
            superseded: self.losses.superseded,
            reopened: self.reopened,
            restarted: self.restarted,
            ..SourceHealth::default()
        })
    }
}
