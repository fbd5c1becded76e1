//! A camera in another program: images come as messages, and whatever a program may do wrong has its reaction here.
//!
//! ```text
//! ImageLink::receive ─► size, format, length right? ─► numbered ─► dated ─► the newest, turned into grey where it lies
//!                            │ no                        │ gap       │ no time
//!                            ▼                           ▼           ▼
//!       before the first good one: an error; later: lost, counted, and told once
//! ```
//! The program is foreign. Vision sees nothing that it writes: pixels are copied, as grey levels, into frames that only the camera process can
//! change, and every number of a header is checked before it is used.

use super::count::{RateMeter, SequenceCount};
use super::stamp::{Dated, DriverStamp, StampClock, Stamps};
use super::v4l2::SensorArea;
use super::{Captured, Filled, FreeRunningSource, SourceError, SourceHealth};
use crate::config::{self, Shutter};
use crate::imaging::grey::{PixelFormat, ToGrey};
use crate::input::printable;
use crate::messages::{CameraState, ImageHeader};
use crate::time::{MonoNs, SpanNs};
use std::collections::BTreeSet;
use std::time::Duration;
use tracing::{info, warn};

/// Images that may wait at once: more are not looked at in one wait. Chosen by hand: twice what the service keeps.
const MOST_AT_ONCE: usize = 8;
/// Images without a possible stamp in a row before the arrival counts instead; as many as the service keeps may be old ones, so that only more of them speak against the clock.
const PATIENCE: u32 = 4;
/// Periods without an image, and shortest time, after which a program counts as silent; as a V4L2 camera has them.
const SILENT_PERIODS: f64 = 5.0;
const SILENT: SpanNs = SpanNs(500_000_000);
/// The same before the first image. Chosen by hand: a Python program takes seconds to load its libraries.
const SILENT_AT_START: SpanNs = SpanNs(3_000_000_000);
/// From one look for dead programs to the next. Chosen by hand: each reads a folder.
const LOOK_PERIOD: SpanNs = SpanNs(500_000_000);
/// Share by which a rate may be off before it is told. Chosen by hand: a program that sleeps between frames is off by a few per cent.
const RATE_OFF: f64 = 0.05;
/// Most different notes about a program, so that it cannot fill the log.
const MAX_NOTES: usize = 64;

/// An image of another program, where it lies.
pub trait ForeignImage {
    /// What its program says of it.
    fn header(&self) -> ImageHeader;
    /// Its bytes, which the program may still change.
    fn bytes(&self) -> &[u8];
}

/// Carries images from another program.
pub trait ImageLink {
    /// What it carries.
    type Image: ForeignImage;
    /// Waits until an image may be there, or for `longest`.
    ///
    /// # Errors
    /// When it does not work any more.
    fn wait(&mut self, longest: Duration) -> Result<(), SourceError>;
    /// The oldest waiting image.
    ///
    /// # Errors
    /// When it does not work any more.
    fn receive(&mut self) -> Result<Option<Self::Image>, SourceError>;
    /// Whether a program is there that may send; those that were killed are forgotten.
    fn has_sender(&mut self) -> bool;
    /// The machine's monotonic clock.
    fn now(&self) -> MonoNs;
}

/// How the bytes of an image lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct ImageLayout {
    format: PixelFormat,
    stride: usize,
}

/// The camera process's view of such a program.
#[derive(Debug)]
pub struct ExternalCamera<L: ImageLink> {
    link: L,
    whole: (u32, u32),
    /// The part of it that is used.
    area: SensorArea,
    asked_hz: f64,
    asked_exposure: SpanNs,
    grey: Option<(PixelFormat, ToGrey)>,
    taken: Option<(L::Image, ImageLayout)>,
    sequence: SequenceCount,
    stamps: Stamps,
    rate: RateMeter,
    rate_is_off: bool,
    has_begun: bool,
    last_image: MonoNs,
    next_look: MonoNs,
    health: SourceHealth,
    told: BTreeSet<String>,
}

impl<L: ImageLink> ExternalCamera<L> {
    /// Of `camera`, from the program behind `link`.
    #[must_use]
    pub fn new(link: L, camera: &config::Camera) -> Self {
        let (width, height) = camera.full_size_px();
        let all = SensorArea { left: 0, top: 0, width, height };
        let area = camera.roi().map_or(all, |r| SensorArea {
            left: r.x_px.cast_signed(),
            top: r.y_px.cast_signed(),
            width: r.width_px,
            height: r.height_px,
        });
        let now = link.now();
        Self {
            link,
            whole: (width, height),
            area,
            asked_hz: camera.rate_hz,
            asked_exposure: camera.exposure,
            grey: None,
            taken: None,
            sequence: SequenceCount::default(),
            stamps: Stamps::new(Shutter::Global, SpanNs::ZERO, PATIENCE),
            rate: RateMeter::default(),
            rate_is_off: false,
            has_begun: false,
            last_image: now,
            next_look: now,
            health: SourceHealth { state: CameraState::Starting, since: now, ..SourceHealth::default() },
            told: BTreeSet::new(),
        }
    }

    /// Tells something once.
    fn tell(&mut self, line: String) {
        if self.told.len() < MAX_NOTES && self.told.insert(line.clone()) {
            warn!("external camera: {line}");
        }
    }

    fn enter(&mut self, state: CameraState) {
        if self.health.state != state {
            (self.health.state, self.health.since) = (state, self.link.now());
        }
    }

    /// How the bytes of an image lie; in words what is wrong with it.
    fn layout(&self, image: &L::Image) -> Result<ImageLayout, String> {
        let h = image.header();
        let (width, height) = self.whole;
        let letters = h.format.to_le_bytes();
        let format = PixelFormat::from_fourcc(letters).ok_or_else(|| {
            let known: Vec<_> = PixelFormat::ALL
                .iter()
                .map(|f| String::from_utf8_lossy(&f.fourcc()).trim_end().to_owned())
                .collect();
            let given = printable(&String::from_utf8_lossy(&letters));
            format!(
                "its images have the pixel format `{given}` ({:#x}); send one of {}",
                h.format,
                known.join(", ")
            )
        })?;
        if (h.width_px, h.height_px) != (width, height) {
            return Err(format!(
                "its images have {}x{} px, the run file says {width}x{height}; set camera.width_px and camera.height_px, \
                 and calibrate for that size, or send the other one",
                h.width_px, h.height_px
            ));
        }
        if format == PixelFormat::Mjpg && (self.area.width, self.area.height) != self.whole {
            return Err("MJPG cannot be cut to camera.roi; send GREY or BGR3, or leave the region out".into());
        }
        let stride = match h.stride_bytes {
            0 => format.min_stride_bytes(width),
            stride => stride as usize,
        };
        if stride < format.min_stride_bytes(width) {
            let least = format.min_stride_bytes(width);
            return Err(format!("lines of its images are {stride} bytes apart, {width} px need {least}"));
        }
        let (len, least) = (image.bytes().len(), format.min_payload_bytes(width, height, stride));
        if len < least {
            return Err(format!("its images have {len} bytes, their format and size need {least}"));
        }
        Ok(ImageLayout { format, stride })
    }

    /// The newest image that is whole; older ones and others are counted.
    fn take_newest(&mut self) -> Result<Option<(L::Image, ImageLayout)>, SourceError> {
        let mut newest = None;
        for _ in 0..MOST_AT_ONCE {
            let Some(image) = self.link.receive()? else { break };
            match self.layout(&image) {
                Ok(layout) => {
                    self.has_begun = true;
                    self.health.superseded += u64::from(newest.replace((image, layout)).is_some());
                }
                Err(wrong) if !self.has_begun => return Err(SourceError::ExternalImage(wrong)),
                Err(wrong) => {
                    self.health.corrupt += 1;
                    self.tell(format!("{wrong}; such images are lost"));
                }
            }
        }
        Ok(newest)
    }

    /// When an image was exposed; `None` where that is unknown.
    fn date(&mut self, h: &ImageHeader, arrival: MonoNs) -> Option<MonoNs> {
        let clock = if h.stamp == MonoNs::ZERO { StampClock::Unknown } else { StampClock::Monotonic };
        let believed = self.stamps.doubt().is_none();
        // The stamp is of the middle: no exposure and no readout lie between.
        let dated =
            self.stamps.date(&DriverStamp { stamp: h.stamp, clock, at_start: true, arrival }, SpanNs::ZERO);
        if believed && let Some(doubt) = self.stamps.doubt() {
            self.tell(format!(
                "{}: images are dated by their arrival; `vservo calibrate latency` finds by how much that is late \
                 (camera.stamp_offset_ms)",
                doubt.of_program()
            ));
        }
        match dated {
            Dated::Mid(mid) => Some(mid),
            Dated::Undated => {
                self.health.undated += 1;
                None
            }
        }
    }

    /// What a header says against the contract, of an image that is used all the same.
    fn look_at_header(&mut self, h: &ImageHeader) {
        let longest_ns = (1.0 + RATE_OFF) * SpanNs::from_s(1.0 / self.asked_hz).0 as f64;
        // Another program begins a count of its own.
        let stands = self.sequence.stands() && !self.health.state.is_away();
        let odd = &mut self.health.odd_headers;
        for (count, is_odd, why) in [
            (&mut odd.sequence, stands, "numbers that stand still, go back or leap"),
            (
                &mut odd.exposure,
                h.exposure_span_ns as f64 > longest_ns,
                "exposures that are longer than a period",
            ),
            (
                &mut odd.reserved,
                h.flags != 0 || h.reserved != 0,
                "flags or reserved fields that are not zero",
            ),
        ] {
            *count += u64::from(is_odd);
            if is_odd && *count == 1 {
                warn!("external camera: its images have {why}");
            }
        }
    }

    fn note_rate(&mut self, mid: MonoNs, sequence: u64) {
        if !self.rate.note(mid, sequence) {
            return;
        }
        let hz = self.rate.measured_hz().unwrap_or(self.asked_hz);
        self.rate_is_off = (hz - self.asked_hz).abs() > RATE_OFF * self.asked_hz;
        if self.rate_is_off {
            self.tell(format!(
                "it gives {hz:.0} images a second, camera.rate_hz says {}: set the one or the other, because time-outs and \
                 update policies are checked with that rate",
                self.asked_hz
            ));
        }
    }

    fn captured(&mut self) -> Result<Option<Captured>, SourceError> {
        let Some((image, layout)) = self.take_newest()? else { return Ok(None) };
        let (h, arrival) = (image.header(), self.link.now());
        // The count wraps after four thousand million images, as those of drivers do.
        let sequence = self.sequence.number(h.sequence as u32);
        self.last_image = arrival;
        self.look_at_header(&h);
        let Some(mid) = self.date(&h, arrival) else { return Ok(None) };
        self.note_rate(mid, sequence);
        let span = match i64::try_from(h.exposure_span_ns) {
            Ok(span) if span > 0 => SpanNs(span).min(SpanNs::from_s(1.0 / self.asked_hz)),
            _ => self.asked_exposure,
        };
        self.taken = Some((image, layout));
        Ok(Some(Captured { mid, span, sequence, lost: 0 }))
    }

    /// No image came within a wait.
    fn look_at_silence(&mut self) {
        let now = self.link.now();
        let least = if self.has_begun { SILENT } else { SILENT_AT_START };
        if now - self.last_image < least.max(SpanNs::from_s(SILENT_PERIODS / self.asked_hz))
            || now < self.next_look
        {
            return;
        }
        self.next_look = now + LOOK_PERIOD;
        let state = if self.link.has_sender() { CameraState::Stalled } else { CameraState::Gone };
        if state != self.health.state {
            match state {
                CameraState::Gone if !self.has_begun => {
                    warn!("external camera: no program has come to give images; it is waited for");
                }
                CameraState::Gone => {
                    warn!("external camera: its program has left; another one is waited for")
                }
                _ => warn!("external camera: its program is there, and gives no images; they are waited for"),
            }
        }
        self.enter(state);
    }

    fn streams_again(&mut self) {
        if self.health.state.is_away() {
            info!(
                "external camera: images are back after {:.1} s",
                (self.link.now() - self.health.since).as_s()
            );
            self.health.restarted += 1;
            self.stamps.restart();
            self.rate.restart();
        }
        self.enter(CameraState::Streaming);
    }
}

impl<L: ImageLink> FreeRunningSource for ExternalCamera<L> {
    fn wait(&mut self, longest: Duration) -> Result<Option<Captured>, SourceError> {
        self.taken = None;
        let mut captured = self.captured()?;
        if captured.is_none() {
            self.link.wait(longest)?;
            captured = self.captured()?;
        }
        match captured {
            Some(_) => self.streams_again(),
            None => self.look_at_silence(),
        }
        Ok(captured)
    }

    fn fill(&mut self, out: &mut [u8]) -> Result<Filled, SourceError> {
        let Some((image, ImageLayout { format, stride })) = &self.taken else { return Ok(Filled::Damaged) };
        let (area, bytes) = (self.area, image.bytes());
        if self.grey.as_ref().is_none_or(|(of, _)| of != format) {
            self.grey = Some((*format, ToGrey::new(*format, area.width, area.height)));
        }
        let Some((_, grey)) = &mut self.grey else { return Ok(Filled::Damaged) };
        let before = area.left.unsigned_abs() as usize * format.min_stride_bytes(2) / 2;
        let from = (area.top.unsigned_abs() as usize).saturating_mul(*stride).saturating_add(before);
        match grey.convert(bytes.get(from..).unwrap_or_default(), *stride, out) {
            Ok(()) => Ok(Filled::Image),
            Err(cause) => {
                self.health.corrupt += 1;
                self.tell(format!("an image could not be turned into grey: {cause}"));
                Ok(Filled::Damaged)
            }
        }
    }

    fn health(&self) -> SourceHealth {
        SourceHealth {
            stamps_clamped: self.stamps.clamped(),
            rate_hz: self.rate.measured_hz(),
            stamps_are_doubted: self.stamps.doubt().is_some(),
            rate_is_missed: self.rate_is_off,
            ..self.health
        }
    }
}

#[cfg(test)]
mod tests;
