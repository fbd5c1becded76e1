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
//! A frame's way: taken from the driver, dated, converted once into shared memory, given back. Nothing here waits longer than it was told,
//! but for the driver's own opening and starting.

use super::count::{Backoff, RateMeter, ReadingPlan, SequenceCount};
use super::fault::is_gone;
use super::name::{self, Found, Identity};
use super::node::{CameraHost, FilledBuffer, Waited, is_rate};
use super::session::{Losses, Session};
use super::stamp::{Dated, DriverStamp, Stamps};
use super::{CaptureFacts, CaptureWish, V4l2Error};
use crate::messages::CameraState;
use crate::source::{Captured, Filled, FreeRunningSource, SourceError, SourceHealth};
use crate::time::{MonoNs, SpanNs};
use rustix::io::Errno;
use std::collections::BTreeSet;
use std::time::Duration;
use tracing::{info, warn};

/// Attempts at the start of a stream, before the process gives it up.
const ATTEMPTS: u32 = 5;
/// Attempts at beginning a stream anew, before the device is opened anew.
const RESTARTS: u32 = 3;
/// Periods without a frame after which a camera counts as stalled, and the least time.
const STALLED_PERIODS: f64 = 5.0;
const STALLED: SpanNs = SpanNs(500_000_000);
/// A stall after which the stream is begun anew; the pauses between such attempts grow.
const RESTART_STALLED: SpanNs = SpanNs(5_000_000_000);
/// Different notes that are told of a device.
const MOST_NOTES: usize = 64;

/// What there is of the device.
#[derive(Debug)]
enum Link {
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
    wish: CaptureWish,
    identity: Identity,
    link: Link,
    sequence: SequenceCount,
    stamps: Stamps,
    rate: RateMeter,
    reading: ReadingPlan,
    /// From frame to frame, as the device says, or as it was asked for.
    period: SpanNs,
    /// Of the device, where it says; else as configured.
    exposure: SpanNs,
    exposure_is_read: bool,
    automatic: bool,
    backoff: Backoff,
    /// Restarts since the last frame.
    restarts: u32,
    last_frame: MonoNs,
    next_restart: SpanNs,
    losses: Losses,
    damaged_in_conversion: u64,
    undated: u64,
    conversions: u64,
    state: CameraState,
    since: MonoNs,
    reopened: u64,
    restarted: u64,
    told: BTreeSet<String>,
    last_buffer: Option<FilledBuffer>,
}

impl V4l2Camera {
    /// Opens the camera and begins to stream.
    pub(super) fn open(host: Box<dyn CameraHost>, wish: CaptureWish) -> Result<Self, V4l2Error> {
        let mut backoff = Backoff::new();
        let mut attempt = 1;
        let (identity, session, news) = loop {
            match Self::open_once(host.as_ref(), &wish) {
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
            stamps: Stamps::new(wish.settings.shutter, wish.settings.readout, session.buffers()),
            period: SpanNs::from_s(1.0 / wish.rate_hz),
            exposure: wish.exposure,
            exposure_is_read: false,
            automatic: false,
            host,
            wish,
            identity,
            link: Link::Closed(now),
            sequence: SequenceCount::default(),
            rate: RateMeter::default(),
            reading: ReadingPlan::new(),
            backoff: Backoff::new(),
            restarts: 0,
            last_frame: now,
            next_restart: RESTART_STALLED,
            losses: Losses::default(),
            damaged_in_conversion: 0,
            undated: 0,
            conversions: 0,
            state: CameraState::Starting,
            since: now,
            reopened: 0,
            restarted: 0,
            told: BTreeSet::new(),
            last_buffer: None,
        };
        camera.adopt(session, news);
        Ok(camera)
    }

    fn open_once(
        host: &dyn CameraHost,
        wish: &CaptureWish,
    ) -> Result<(Identity, Session, Vec<String>), V4l2Error> {
        let Found { file, node } = name::resolve(host, &wish.settings.device)?;
        let identity = Identity::of(&file, node.info());
        let (mut session, news) = Session::prepare(&file.path, node, wish)?;
        session.begin()?;
        Ok((identity, session, news))
    }

    /// Goes on with a session that streams.
    fn adopt(&mut self, session: Session, news: Vec<String>) {
        let (read, automatic) = session.exposure();
        let agreed = session.agreed();
        info!(
            "{}: {} {}x{}{}, exposure {}",
            session.path().display(),
            agreed.layout.fourcc,
            agreed.layout.width,
            agreed.layout.height,
            agreed.interval.map_or(String::new(), |i| format!(" at {:.3} Hz", i.rate_hz())),
            match (read, automatic) {
                (Some(span), true) => format!("automatic, now {:.1} ms", span.as_s() * 1e3),
                (Some(span), false) => format!("{:.1} ms", span.as_s() * 1e3),
                (None, _) => format!(
                    "taken as camera.exposure_ms, {:.1} ms: the device does not say",
                    self.wish.exposure.as_s() * 1e3
                ),
            }
        );
        let said_hz = agreed.interval.map(|i| i.rate_hz()).filter(|hz| *hz > 0.0);
        self.period = SpanNs::from_s(1.0 / said_hz.unwrap_or(self.wish.rate_hz));
        self.link = Link::Streams(session);
        (self.automatic, self.exposure_is_read) = (automatic, read.is_some());
        self.set_exposure(read);
        self.begin_count();
        news.into_iter().for_each(|line| self.tell(line));
    }

    /// A stream begins: its numbers and stamps have nothing to do with those before.
    fn begin_count(&mut self) {
        self.sequence.restart();
        self.stamps.restart();
        self.rate.restart();
        self.last_frame = self.host.now();
        self.next_restart = RESTART_STALLED;
    }

    /// Tells something once.
    fn tell(&mut self, line: String) {
        if self.told.len() < MOST_NOTES && !self.told.contains(&line) {
            warn!("camera {}: {line}", self.wish.settings.device);
            self.told.insert(line);
        }
    }

    fn enter(&mut self, state: CameraState) {
        if self.state != state {
            (self.state, self.since) = (state, self.host.now());
        }
    }

    fn set_exposure(&mut self, read: Option<SpanNs>) {
        let Some(read) = read else { return self.exposure = self.wish.exposure };
        // Some devices say what they would like: no exposure is longer than the time between frames.
        let longest = match self.rate.measured_hz() {
            Some(hz) => self.period.max(SpanNs::from_s(1.0 / hz)),
            None => self.period,
        };
        self.exposure = read.min(longest);
    }

    /// Waits for a frame of a device that streams.
    fn wait_for_frame(
        &mut self,
        session: &mut Session,
        longest: Duration,
    ) -> Result<Option<Captured>, Errno> {
        session.give_back()?;
        if self.automatic && self.exposure_is_read && self.reading.is_due() {
            let begin = self.host.now();
            let (read, automatic) = session.exposure();
            self.automatic = automatic;
            self.set_exposure(read.or(Some(self.exposure)));
            self.reading.took(self.host.now() - begin, self.period);
        }
        let waited = session.node().wait(longest)?;
        if waited == Waited::TimeIsUp {
            return Ok(None);
        }
        let taken = session.take_newest(&mut self.losses)?;
        let Some(buffer) = taken else {
            // Trouble that nobody gives a reason for, and that no time passes with.
            return if waited == Waited::Troubled { Err(Errno::IO) } else { Ok(None) };
        };
        let arrival = self.host.now();
        let number = self.sequence.number(buffer.sequence);
        let driver =
            DriverStamp { stamp: buffer.stamp, clock: buffer.clock, at_start: buffer.at_start, arrival };
        let believed = self.stamps.doubt().is_none();
        let dated = self.stamps.date(&driver, self.exposure);
        if believed && let Some(doubt) = self.stamps.doubt() {
            self.tell(format!(
                "{}: frames are dated by their arrival; `vservo calibrate latency` finds by how much that is late \
                 (camera.stamp_offset_ms)",
                doubt.describe()
            ));
        }
        self.last_buffer = Some(buffer);
        let Dated::Mid(mid) = dated else {
            self.undated += 1;
            session.give_back()?;
            return Ok(None);
        };
        self.last_frame = arrival;
        if self.rate.note(mid, number) {
            self.judge_rate();
        }
        Ok(Some(Captured { mid, span: self.exposure, sequence: number, lost: 0 }))
    }

    fn judge_rate(&mut self) {
        let wished = self.wish.rate_hz;
        if let Some(hz) = self.rate.measured_hz()
            && hz < 0.9 * wished
        {
            self.tell(format!(
                "it exposes at {hz:.0} Hz, {wished} Hz were asked for: in the dark an automatic exposure takes longer than a frame; \
                 set the exposure, or controls exposure_dynamic_framerate = 0"
            ));
        }
    }

    /// The device failed.
    fn failed(&mut self, session: Session, cause: Errno) {
        let now = self.host.now();
        if is_gone(cause) {
            if self.state != CameraState::Gone {
                warn!("camera {}: unplugged; it is looked for", self.wish.settings.device);
            }
            drop(session);
            self.enter(CameraState::Gone);
            self.backoff = Backoff::new();
            self.link = Link::Closed(now + self.backoff.pause());
            return;
        }
        if self.state != CameraState::Recovering {
            warn!(
                "camera {}: its stream failed: {}; it is begun anew",
                self.wish.settings.device,
                std::io::Error::from(cause)
            );
            self.backoff = Backoff::new();
        }
        self.enter(CameraState::Recovering);
        self.restarts += 1;
        let next = now + self.backoff.pause();
        self.link = if self.restarts > RESTARTS {
            drop(session);
            Link::Closed(next)
        } else {
            Link::Pauses(session, next)
        };
    }

    /// Begins a stream anew.
    fn restart(&mut self, mut session: Session) {
        match session.restart() {
            Ok(()) => {
                self.restarted += 1;
                self.link = Link::Streams(session);
                self.begin_count();
            }
            Err(e) => self.failed(session, e),
        }
    }

    /// Looks for the device, and opens it with all its settings.
    fn reopen(&mut self) {
        let opened = name::find_again(self.host.as_ref(), &self.identity).map(|Found { file, node }| {
            let (mut session, news) = Session::prepare(&file.path, node, &self.wish)?;
            session.begin()?;
            Ok((session, news))
        });
        match opened {
            Some(Ok((session, news))) => {
                self.reopened += 1;
                self.restarts = 0;
                info!("camera {}: it is back", self.wish.settings.device);
                self.adopt(session, news);
                self.enter(CameraState::Recovering); // until a frame has come
            }
            other => {
                if let Some(Err::<_, V4l2Error>(error)) = other {
                    self.tell(format!("it is back, but cannot be used yet: {error}"));
                }
                self.link = Link::Closed(self.host.now() + self.backoff.pause());
            }
        }
    }

    /// No frame came within a wait.
    fn look_at_silence(&mut self) {
        let silent = self.host.now() - self.last_frame;
        let limit = STALLED.max(SpanNs::from_s(STALLED_PERIODS * self.period.as_s()));
        if silent < limit {
            return;
        }
        if matches!(self.state, CameraState::Starting | CameraState::Streaming) {
            warn!(
                "camera {}: no frame for {:.1} s; it is waited for",
                self.wish.settings.device,
                silent.as_s()
            );
            self.enter(CameraState::Stalled);
        }
        if silent > self.next_restart && matches!(self.link, Link::Streams(_)) {
            let next = SpanNs(self.next_restart.0.saturating_mul(2));
            if let Link::Streams(session) = std::mem::replace(&mut self.link, Link::Closed(MonoNs::ZERO)) {
                let (last_frame, sequence) = (self.last_frame, self.sequence);
                self.restart(session);
                // The silence goes on, and so does the count: nothing is known to be lost.
                (self.last_frame, self.sequence, self.next_restart) = (last_frame, sequence, next);
                self.sequence.restart();
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
        let Link::Streams(session) = &self.link else { return None };
        let agreed = session.agreed();
        Some(CaptureFacts {
            path: session.path().into(),
            info: session.node().info().clone(),
            format: agreed.layout.fourcc,
            width: agreed.layout.width,
            height: agreed.layout.height,
            rate_hz: agreed.interval.map(|i| i.rate_hz()),
            buffers: session.buffers(),
            exposure: self.exposure,
            exposure_is_read: self.exposure_is_read,
            exposure_is_automatic: self.automatic,
            stamp_clock: self.last_buffer.map(|b| b.clock),
            stamp_at_start: self.last_buffer.is_some_and(|b| b.at_start),
            stamp_doubt: self.stamps.doubt(),
            conversions: self.conversions,
        })
    }
}

impl FreeRunningSource for V4l2Camera {
    fn wait(&mut self, longest: Duration) -> Result<Option<Captured>, SourceError> {
        let captured = match std::mem::replace(&mut self.link, Link::Closed(MonoNs::ZERO)) {
            Link::Streams(mut session) => match self.wait_for_frame(&mut session, longest) {
                Ok(captured) => {
                    self.link = Link::Streams(session);
                    captured
                }
                Err(cause) => {
                    self.failed(session, cause);
                    None
                }
            },
            Link::Pauses(session, time) => {
                if self.pause_until(time, longest) {
                    self.restart(session);
                } else {
                    self.link = Link::Pauses(session, time);
                }
                None
            }
            Link::Closed(time) => {
                self.link = Link::Closed(time);
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
                        self.wish.settings.device,
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
        let Link::Streams(session) = &mut self.link else { return Ok(Filled::Damaged) };
        let converted = session.convert(out);
        self.conversions += 1;
        // An error here shows again at the next wait, which sees to it.
        let returned = session.give_back();
        if let Err(cause) = returned
            && let Link::Streams(session) = std::mem::replace(&mut self.link, Link::Closed(MonoNs::ZERO))
        {
            self.failed(session, cause);
        }
        match converted {
            Ok(()) => Ok(Filled::Picture),
            Err(cause) => {
                self.damaged_in_conversion += 1;
                self.tell(format!("a frame could not be turned into grey: {cause}"));
                Ok(Filled::Damaged)
            }
        }
    }

    fn health(&self) -> SourceHealth {
        let rate_hz = self.rate.measured_hz();
        SourceHealth {
            state: self.state,
            since: self.since,
            corrupt: self.losses.damaged + self.damaged_in_conversion,
            superseded: self.losses.superseded,
            undated: self.undated,
            reopened: self.reopened,
            restarted: self.restarted,
            stamps_clamped: self.stamps.clamped(),
            rate_hz,
            stamps_are_doubted: self.stamps.doubt().is_some(),
            rate_is_missed: rate_hz
                .is_some_and(|hz| !is_rate(hz, self.wish.rate_hz) && hz < 0.95 * self.wish.rate_hz),
        }
    }
}
