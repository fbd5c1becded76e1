//! What is known of a stream's frames: their numbers, when and for how long they were exposed, how often they really come.

use super::node::{CameraHost, FilledBuffer, is_rate};
use super::session::Session;
use super::{CaptureFacts, CaptureRequest};
use crate::source::count::{RateMeter, ReadingPlan, SequenceCount};
use crate::source::stamp::{Dated, DriverStamp, Stamps};
use crate::source::{Captured, SourceHealth};
use crate::time::{MonoNs, SpanNs};

/// Share of the requested rate below which the rate counts as missed. Chosen by hand: dropped frames of a few per cent are counted elsewhere.
const RATE_MISSED: f64 = 0.95;

/// The frames of a camera, over all its streams.
#[derive(Debug)]
pub(super) struct Track {
    sequence: SequenceCount,
    stamps: Stamps,
    rate: RateMeter,
    reading: ReadingPlan,
    requested_hz: f64,
    requested_exposure: SpanNs,
    /// From frame to frame, as the device says, or as it was asked for.
    period: SpanNs,
    /// Of the device, where it says; else as configured.
    exposure: SpanNs,
    exposure_is_read: bool,
    exposure_is_automatic: bool,
    undated: u64,
    newest: Option<FilledBuffer>,
}

impl Track {
    pub(super) fn new(request: &CaptureRequest, buffers: u32) -> Self {
        Self {
            sequence: SequenceCount::default(),
            stamps: Stamps::new(request.settings.shutter, request.settings.readout, buffers),
            rate: RateMeter::default(),
            reading: ReadingPlan::new(),
            requested_hz: request.rate_hz,
            requested_exposure: request.exposure,
            period: SpanNs::from_s(1.0 / request.rate_hz),
            exposure: request.exposure,
            exposure_is_read: false,
            exposure_is_automatic: false,
            undated: 0,
            newest: None,
        }
    }

    /// Goes on with a newly opened device. Gives how it exposes, for people.
    pub(super) fn adopt(&mut self, session: &Session) -> String {
        let (read, automatic) = session.exposure();
        let said_hz = session.agreed().interval.map(|i| i.rate_hz()).filter(|hz| *hz > 0.0);
        self.period = SpanNs::from_s(1.0 / said_hz.unwrap_or(self.requested_hz));
        (self.exposure_is_automatic, self.exposure_is_read) = (automatic, read.is_some());
        self.set_exposure(read);
        self.begin();
        let ms = |span: SpanNs| span.as_s() * 1e3;
        match (read, automatic) {
            (Some(span), true) => format!("automatic, now {:.1} ms", ms(span)),
            (Some(span), false) => format!("{:.1} ms", ms(span)),
            (None, _) => {
                format!("taken as camera.exposure_ms, {:.1} ms: the device does not say", ms(self.exposure))
            }
        }
    }

    /// A stream begins: its numbers and stamps have nothing to do with those before.
    pub(super) fn begin(&mut self) {
        self.sequence.restart();
        self.stamps.restart();
        self.rate.restart();
    }

    fn set_exposure(&mut self, read: Option<SpanNs>) {
        let Some(read) = read else { return self.exposure = self.requested_exposure };
        // Some devices say what they would like: no exposure is longer than the time between frames.
        let longest = match self.rate.measured_hz() {
            Some(hz) => self.period.max(SpanNs::from_s(1.0 / hz)),
            None => self.period,
        };
        self.exposure = read.min(longest);
    }

    /// Reads the exposure anew, where the device changes it by itself and it is time to. To be called while no frame waits for it.
    pub(super) fn follow_exposure(&mut self, session: &Session, host: &dyn CameraHost) {
        if !(self.exposure_is_automatic && self.exposure_is_read && self.reading.is_due()) {
            return;
        }
        let begin = host.now();
        let (read, automatic) = session.exposure();
        self.exposure_is_automatic = automatic;
        self.set_exposure(read.or(Some(self.exposure)));
        self.reading.took(host.now() - begin, self.period);
    }

    /// Takes a frame in that came at `arrival`; `None` where its time is unknown. Tells what is new.
    pub(super) fn frame(
        &mut self,
        buffer: &FilledBuffer,
        arrival: MonoNs,
        tell: &mut dyn FnMut(String),
    ) -> Option<Captured> {
        let sequence = self.sequence.number(buffer.sequence);
        let FilledBuffer { stamp, clock, at_start, .. } = *buffer;
        let believed = self.stamps.doubt().is_none();
        let dated = self.stamps.date(&DriverStamp { stamp, clock, at_start, arrival }, self.exposure);
        if believed && let Some(doubt) = self.stamps.doubt() {
            tell(format!(
                "{}: frames are dated by their arrival; `vservo calibrate latency` finds by how much that is late \
                 (camera.stamp_offset_ms)",
                doubt.describe()
            ));
        }
        self.newest = Some(*buffer);
        let Dated::Mid(mid) = dated else {
            self.undated += 1;
            return None;
        };
        if self.rate.note(mid, sequence)
            && let Some(hz) = self.missed_rate_hz()
        {
            tell(format!(
                "it exposes at {hz:.0} Hz, {} Hz were asked for: in the dark an automatic exposure takes longer than a frame; \
                 set the exposure, or controls exposure_dynamic_framerate = 0",
                self.requested_hz
            ));
        }
        Some(Captured { mid, span: self.exposure, sequence, lost: 0 })
    }

    /// The rate that is really obtained, where it is less than was asked for.
    fn missed_rate_hz(&self) -> Option<f64> {
        self.rate
            .measured_hz()
            .filter(|hz| !is_rate(*hz, self.requested_hz) && *hz < RATE_MISSED * self.requested_hz)
    }

    /// From frame to frame.
    pub(super) fn period(&self) -> SpanNs {
        self.period
    }

    /// What it knows, beside what the camera knows.
    pub(super) fn health(&self, health: SourceHealth) -> SourceHealth {
        SourceHealth {
            undated: self.undated,
            stamps_clamped: self.stamps.clamped(),
            rate_hz: self.rate.measured_hz(),
            stamps_are_doubted: self.stamps.doubt().is_some(),
            rate_is_missed: self.missed_rate_hz().is_some(),
            ..health
        }
    }

    /// How `session` is used.
    pub(super) fn facts(&self, session: &Session, conversions: u64) -> CaptureFacts {
        let agreed = session.agreed();
        CaptureFacts {
            path: session.path().into(),
            info: session.node().info().clone(),
            format: agreed.layout.fourcc,
            width: agreed.layout.width,
            height: agreed.layout.height,
            rate_hz: agreed.interval.map(|i| i.rate_hz()),
            buffers: session.buffers(),
            exposure: self.exposure,
            exposure_is_read: self.exposure_is_read,
            exposure_is_automatic: self.exposure_is_automatic,
            stamp_clock: self.newest.map(|buffer| buffer.clock),
            stamp_at_start: self.newest.is_some_and(|buffer| buffer.at_start),
            stamp_doubt: self.stamps.doubt(),
            conversions,
        }
    }
}
