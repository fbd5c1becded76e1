//! How well a camera does: rate, jitter of stamps, gaps, latency and cost, from what its source gives; and the table for a run file.

use super::node::NodeInfo;
use super::{CaptureFacts, FourCc, V4l2Camera};
use crate::source::stamp::StampClock;
use crate::source::{Captured, Filled, FreeRunningSource, OddHeaders, SourceError, SourceHealth};
use crate::time::{MonoNs, SpanNs};
use serde::Serialize;
use std::path::PathBuf;
use std::time::Duration;

/// Longest single wait, and so the delay with which an interruption is noticed. Chosen by hand: it is not felt, and 20 wake-ups a second cost nothing.
const SLICE: Duration = Duration::from_millis(50);

/// Quantiles of some times, ms.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Spread {
    /// Half of them are shorter.
    pub p50_ms: f64,
    /// 99 of a hundred are shorter.
    pub p99_ms: f64,
    /// The longest.
    pub max_ms: f64,
}

impl Spread {
    /// Of any spans; zeroes where there are none.
    fn of(mut spans: Vec<SpanNs>) -> Self {
        spans.sort();
        let at = |share: f64| {
            let place = (share * spans.len().saturating_sub(1) as f64).round() as usize;
            spans.get(place).map_or(0.0, |span| span.as_s() * 1e3)
        };
        Self { p50_ms: at(0.5), p99_ms: at(0.99), max_ms: at(1.0) }
    }
}

/// What a probe found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ProbeReport {
    /// The node.
    pub path: PathBuf,
    /// What it says of itself.
    #[serde(flatten)]
    pub info: NodeInfo,
    /// Pixel format.
    pub format: FourCc,
    /// Columns, px.
    pub width: u32,
    /// Rows, px.
    pub height: u32,
    /// Frames per second that were asked for.
    pub asked_hz: f64,
    /// That the device says to keep.
    pub said_hz: Option<f64>,
    /// That it really exposed, by its stamps and its count.
    pub obtained_hz: f64,
    /// Frames that came.
    pub frames: u64,
    /// Frames that did not, by the device's count.
    pub lost: u64,
    /// Among these: damaged ones.
    pub corrupt: u64,
    /// Among these: such as came together with a newer one.
    pub superseded: u64,
    /// How long the measurement took, s.
    pub duration_s: f64,
    /// Distance of neighbouring frames less the mean distance, its size.
    pub jitter: Spread,
    /// From the middle of the exposure to where the frame can be read.
    pub latency: Spread,
    /// Conversion into grey of a frame.
    pub conversion: Spread,
    /// Length of the exposure, ms.
    pub exposure_ms: f64,
    /// Whether that is the device's word; else it was assumed.
    pub exposure_is_read: bool,
    /// Whether the device changes it by itself.
    pub exposure_is_automatic: bool,
    /// By what clock the device stamps.
    pub stamp_clock: Option<StampClock>,
    /// Whether stamps are of the start of the exposure; else of the frame's end.
    pub stamp_at_start: bool,
    /// Frames whose stamps lay in the future.
    pub stamps_clamped: u64,
    /// Why the stamps are not believed.
    pub stamps_doubted: Option<&'static str>,
}

/// What a source of any kind did while it was measured.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SourceCheck {
    /// Rate of the run file.
    pub asked_hz: f64,
    /// Rate by the stamps.
    pub obtained_hz: f64,
    /// Frames that were usable.
    pub frames: u64,
    /// Frames that were not, by the source's own count and by the silence at the end.
    pub lost: u64,
    /// Damaged ones: of another size or format, or too short.
    pub corrupt: u64,
    /// Such as came together with a newer one.
    pub superseded: u64,
    /// Such as had no possible stamp.
    pub undated: u64,
    /// Such as should have come after the last one, where the source is silent at the end; by the rate of the run file.
    pub silent: u64,
    /// What the source is at the end, where it gives no frames any more.
    pub away: Option<&'static str>,
    /// Frames whose headers say what no camera can mean.
    pub odd_headers: OddHeaders,
    /// How often it was silent and came back.
    pub interrupted: u64,
    /// Frames whose stamps lay in the future.
    pub stamps_clamped: u64,
    /// Whether its stamps are not believed.
    pub stamps_doubted: bool,
    /// How long the measurement took from the first frame on, s.
    pub duration_s: f64,
    /// Distance of neighbouring frames less the mean distance, its size.
    pub jitter: Spread,
    /// From the middle of the exposure to where the frame can be read.
    pub latency: Spread,
}

/// A measurement that goes on.
#[derive(Debug)]
pub struct Probe {
    asked_hz: f64,
    begin: MonoNs,
    /// When the first and the last frame came.
    came: Option<(MonoNs, MonoNs)>,
    mids: Vec<(MonoNs, u64)>,
    latencies: Vec<SpanNs>,
    conversions: Vec<SpanNs>,
    out: Vec<u8>,
}

impl Probe {
    /// Frames that are measured at most.
    const MOST: usize = 1_000_000;

    /// Of a camera whose images have so many pixels.
    #[must_use]
    pub fn new(asked_hz: f64, pixels: usize, now: MonoNs) -> Self {
        let (mids, latencies, conversions) = (Vec::new(), Vec::new(), Vec::new());
        Self { asked_hz, begin: now, came: None, mids, latencies, conversions, out: vec![0; pixels] }
    }

    /// Takes one frame, if one comes soon; its grey levels.
    ///
    /// # Errors
    /// [`SourceError`].
    pub fn take(
        &mut self,
        camera: &mut dyn FreeRunningSource,
        now: &mut dyn FnMut() -> MonoNs,
    ) -> Result<Option<&[u8]>, SourceError> {
        let Some(Captured { mid, sequence, .. }) = camera.wait(SLICE)? else { return Ok(None) };
        let begin = now();
        if camera.fill(&mut self.out)? == Filled::Damaged {
            return Ok(None);
        }
        let end = now();
        self.came = Some((self.came.map_or(begin, |(first, _)| first), begin));
        if self.mids.len() < Self::MOST {
            self.mids.push((mid, sequence));
            self.latencies.push(end - mid);
            self.conversions.push(end - begin);
        }
        Ok(Some(&self.out))
    }

    /// Frames so far.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.mids.len()
    }

    /// What a source of any kind did; `None` where no frame came.
    #[must_use]
    pub fn check(self, health: &SourceHealth, now: MonoNs) -> Option<SourceCheck> {
        let (exposures, mean_s) = self.steps()?;
        let frames = self.mids.len() as u64;
        let ((first, last), is_away) = (self.came?, health.state.is_away());
        let silent = if is_away { ((now - last).as_s() * self.asked_hz).round() as u64 } else { 0 };
        // What came damaged in the silence is in both.
        let lost = (exposures + 1).saturating_sub(frames) + silent;
        Some(SourceCheck {
            asked_hz: self.asked_hz,
            obtained_hz: if mean_s > 0.0 { 1.0 / mean_s } else { 0.0 },
            frames,
            lost: lost.max(health.corrupt + health.superseded + health.undated),
            corrupt: health.corrupt,
            superseded: health.superseded,
            undated: health.undated,
            silent,
            away: is_away.then(|| health.state.as_str()),
            odd_headers: health.odd_headers,
            interrupted: health.restarted + health.reopened,
            stamps_clamped: health.stamps_clamped,
            stamps_doubted: health.stamps_are_doubted,
            duration_s: (now - first).as_s(),
            jitter: self.jitter(mean_s),
            latency: Spread::of(self.latencies),
        })
    }

    /// Exposures between the first and the last frame, and the mean distance of two, s.
    fn steps(&self) -> Option<(u64, f64)> {
        let ((first, from), (last, to)) = (*self.mids.first()?, *self.mids.last()?);
        let exposures = to - from;
        Some((exposures, (last - first).as_s() / exposures.max(1) as f64))
    }

    fn jitter(&self, mean_s: f64) -> Spread {
        let steps = self.mids.iter().zip(self.mids.iter().skip(1));
        let jitter = steps.map(|((a, m), (b, n))| {
            let off_s = (*b - *a).as_s() - mean_s * (n - m) as f64;
            SpanNs::from_s(off_s.abs())
        });
        Spread::of(jitter.collect())
    }

    /// What was found; `None` where no frame came, or the camera is away.
    #[must_use]
    pub fn report(self, camera: &V4l2Camera, now: MonoNs) -> Option<ProbeReport> {
        let facts = camera.facts()?;
        let health = camera.health();
        let (exposures, mean) = self.steps()?;
        let frames = self.mids.len() as u64;
        let CaptureFacts { path, info, format, width, height, rate_hz, exposure, .. } = facts;
        Some(ProbeReport {
            path,
            info,
            format,
            width,
            height,
            asked_hz: self.asked_hz,
            said_hz: rate_hz,
            obtained_hz: if mean > 0.0 { 1.0 / mean } else { 0.0 },
            frames,
            lost: (exposures + 1).saturating_sub(frames),
            corrupt: health.corrupt,
            superseded: health.superseded,
            duration_s: (now - self.begin).as_s(),
            jitter: self.jitter(mean),
            latency: Spread::of(self.latencies),
            conversion: Spread::of(self.conversions),
            exposure_ms: exposure.as_s() * 1e3,
            exposure_is_read: facts.exposure_is_read,
            exposure_is_automatic: facts.exposure_is_automatic,
            stamp_clock: facts.stamp_clock,
            stamp_at_start: facts.stamp_at_start,
            stamps_clamped: health.stamps_clamped,
            stamps_doubted: facts.stamp_doubt.map(super::StampDoubt::describe),
        })
    }
}
