//! The vision process of two cameras: takes the frames of both, and sends one measurement for each frame of the left one.
//!
//! ```text
//! camera/0/frame ─► look ─┐
//!                         ├─► pairing ─► measurement, or why there is none ─► vision/0/measurement
//! camera/1/frame ─► look ─┘
//! ```
//! In real time a left frame waits for its mate half a period beyond the time at which that should be here; in lockstep it is known which
//! frames come, and they are waited for by their numbers. Either way the stamps alone say what is a pair.

use super::priority::{self, Rank};
use super::report_images::ReportImages;
use super::vision::FrameCounter;
use super::{LONGEST_WAIT, Membership, ProcessError, ReportFolder, StopFlag, process_faults, shape_of};
use crate::config::Clock;
use crate::config::{Camera, Config, assemble};
use crate::faults::{FaultyProcess, ProcessFaults};
use crate::imaging::ImageView;
use crate::ipc::{FrameReceiver, Instance, ReceivedFrame, Role, Sender, Services};
use crate::messages::{FrameHeader, Measurement, TargetStatus};
use crate::rt::now;
use crate::time::{MonoNs, SpanNs};
use crate::vision::{Frame, PairingCounts, Side, StereoMeasurement, StereoVision};
use std::time::Duration;
use tracing::{debug_span, info, warn};

/// Number of single frames, without any pair, that is reported. Chosen by hand: 0.8 s at 25 Hz.
const ALONE: u64 = 20;

/// Runs vision for the pair of cameras of `config` until a stop is requested, and leaves images of the left one in the folder
/// `report`, where there is one.
///
/// # Errors
/// When shared memory or the instance fails, or a simulated pair cannot be taught.
pub fn run(
    config: &Config,
    instance: &Instance,
    stop: &StopFlag,
    report: Option<&ReportFolder>,
) -> Result<(), ProcessError> {
    let Some(right) = config.further_cameras.first() else {
        return Err(assemble::AssembleError::NoStereo.into());
    };
    // Before joining: control waits for a vision that is ready.
    let vision = assemble::stereo_vision(config)?;
    let membership = Membership::join(instance, Role::Vision(config.camera.id), config)?;
    let services = membership.services();
    let mut worker = StereoVisionWorker {
        clock: config.clock,
        left: CameraInput::open(&config.camera, config.clock, services)?,
        right: CameraInput::open(right, config.clock, services)?,
        measurements: services.measurement_sender(config.camera.id)?,
        membership: &membership,
        faults: process_faults::of(config, FaultyProcess::Vision),
        vision,
        looked: MonoNs::ZERO,
        status_logger: StatusLogger::default(),
        images: ReportImages::new(report, &config.camera),
    };
    services.require_room_for_peers()?;
    priority::take(config, Rank::Vision)?;
    info!(taught_points = worker.vision.taught().count(), "vision runs by two cameras");
    let ended = match config.clock {
        Clock::Realtime => worker.run_by_the_clock(stop),
        Clock::Lockstep => worker.run_by_the_ticks(stop),
    };
    worker.images.write();
    let PairingCounts { pairs, left_alone, right_alone, .. } = worker.vision.counts();
    info!(pairs, left_alone, right_alone, "frames of the two cameras");
    ended
}

/// One camera's frames.
struct CameraInput<'a> {
    camera: &'a Camera,
    frames: FrameReceiver,
    counter: FrameCounter,
    /// The newest frame, and when it came.
    newest: Option<(u64, MonoNs)>,
}

impl<'a> CameraInput<'a> {
    fn open(camera: &'a Camera, clock: Clock, services: &Services) -> Result<Self, ProcessError> {
        let frames = services.frame_receiver(camera.id, shape_of(camera, clock))?;
        Ok(Self { camera, frames, counter: FrameCounter::default(), newest: None })
    }

    fn receive(&mut self) -> Result<Option<ReceivedFrame>, ProcessError> {
        let frame = self.frames.receive()?;
        if let Some(header) = frame.as_ref().map(ReceivedFrame::header) {
            self.counter.count(&header);
            self.newest = Some((header.frame_id, now()));
        }
        Ok(frame)
    }
}

struct StereoVisionWorker<'a> {
    clock: Clock,
    left: CameraInput<'a>,
    right: CameraInput<'a>,
    measurements: Sender<Measurement>,
    faults: ProcessFaults,
    membership: &'a Membership,
    vision: StereoVision,
    /// When the newest frame began to be looked at.
    looked: MonoNs,
    status_logger: StatusLogger,
    images: ReportImages,
}

impl StereoVisionWorker<'_> {
    /// Takes frames as they come.
    fn run_by_the_clock(&mut self, stop: &StopFlag) -> Result<(), ProcessError> {
        let (left, right) = (self.left.camera, self.right.camera);
        let period = SpanNs::from_s(1.0 / left.rate_hz);
        let later = right.latency.0 + right.schedule.jitter().0 - left.latency.0;
        let patience = SpanNs(period.0 / 2 + later.max(0));
        while !stop.is_requested() {
            self.membership.beat();
            let mut came = false;
            for side in [Side::Left, Side::Right] {
                let input = if side == Side::Left { &mut self.left } else { &mut self.right };
                if let Some(frame) = input.receive()? {
                    self.look(side, &frame);
                    came = true;
                }
            }
            for side in [Side::Left, Side::Right] {
                let waits = self.vision.waiting(side).copied();
                if let Some(header) = waits.filter(|header| header.sent + patience <= now()) {
                    self.vision.give_up(side, header.exposure);
                }
            }
            self.send_all(period)?;
            if came {
                continue;
            }
            match self.vision.waiting(Side::Left).map(|header| header.sent + patience - now()) {
                Some(left) => {
                    let longest = Duration::from_nanos(left.0.max(0).unsigned_abs()).min(LONGEST_WAIT);
                    self.right.frames.wait(longest)?;
                }
                None => self.left.frames.wait(LONGEST_WAIT)?,
            }
        }
        Ok(())
    }

    /// Takes each left frame with the right one of the same number, unless that camera loses it.
    fn run_by_the_ticks(&mut self, stop: &StopFlag) -> Result<(), ProcessError> {
        while !stop.is_requested() {
            self.membership.beat();
            let Some(frame) = self.left.receive()? else {
                self.left.frames.wait(LONGEST_WAIT)?;
                continue;
            };
            let FrameHeader { frame_id, exposure, .. } = frame.header();
            self.look(Side::Left, &frame);
            drop(frame);
            let is_lost = self.right.camera.schedule.is_lost(frame_id);
            while !is_lost && self.right.newest.is_none_or(|(newest, _)| newest < frame_id) {
                self.membership.beat();
                match self.right.receive()? {
                    Some(frame) if frame.header().frame_id == frame_id => self.look(Side::Right, &frame),
                    // its mate was lost
                    Some(_) => {}
                    None if stop.is_requested() => return Ok(()),
                    None => self.right.frames.wait(LONGEST_WAIT)?,
                }
            }
            self.vision.give_up(Side::Left, exposure);
            self.send_all(SpanNs::ZERO)?;
        }
        Ok(())
    }

    fn look(&mut self, side: Side, frame: &ReceivedFrame) {
        let header = frame.header();
        if side == Side::Left {
            process_faults::suffer(&self.faults, header.frame_id);
        }
        self.looked = now();
        let _span = debug_span!("frame", frame = header.frame_id, camera = header.camera).entered();
        match ImageView::new(frame.pixels(), header.width_px as usize, header.height_px as usize) {
            Ok(image) => self.vision.look(side, &Frame { header, image }),
            Err(_) => self.vision.look_past(side, header),
        }
        if side == Side::Left {
            self.images.note_frame(frame);
        }
    }

    /// Sends what is settled. A right frame without a left one is a measurement only where the left camera is silent altogether: its
    /// frames are what control counts.
    fn send_all(&mut self, period: SpanNs) -> Result<(), ProcessError> {
        while let Some(StereoMeasurement { mut measurement, blind }) = self.vision.next_measurement() {
            let _span = debug_span!("measurement", frame = measurement.frame_id).entered();
            let is_right = measurement.camera != u32::from(self.left.camera.id);
            let is_silent = self.clock == Clock::Realtime
                && self.left.newest.is_none_or(|(_, came)| now() - came > SpanNs(2 * period.0));
            self.status_logger.tell(&measurement, blind, &self.vision);
            if is_right && !is_silent {
                continue;
            }
            measurement.vision_start = self.looked;
            measurement.vision_end = now();
            measurement.frames_received = self.left.counter.received;
            measurement.frames_dropped = self.left.counter.dropped;
            self.measurements.send(&measurement)?;
            if !is_right {
                self.images.note_measurement(&measurement);
            }
        }
        Ok(())
    }
}

/// One line whenever the target is found or lost, or the reason changes, and one where frames never pair.
#[derive(Debug, Default)]
struct StatusLogger {
    said: Option<(TargetStatus, Option<Side>)>,
    never_pair: bool,
}

impl StatusLogger {
    fn tell(&mut self, m: &Measurement, blind: Option<Side>, vision: &StereoVision) {
        let counts = vision.counts();
        if !self.never_pair
            && let Some(why) = why_no_pairs(&counts)
        {
            warn!("{why}");
            self.never_pair = true;
        }
        let status = m.target_status();
        if self.said.replace((status, blind)) == Some((status, blind)) {
            return;
        }
        let frame = m.frame_id;
        match (status, blind) {
            (TargetStatus::Found, _) => info!(frame, "target found by both cameras"),
            (TargetStatus::Inconsistent, _) => {
                warn!(
                    frame,
                    "measurement refused: the points are not as they were taught, or the cameras not as described"
                );
            }
            (TargetStatus::NoPair, Some(side)) => {
                warn!(frame, "no measurement: no frame of the {} camera at this instant", side.as_str());
            }
            (_, Some(side)) => warn!(frame, "no target in the {} camera: {}", side.as_str(), status.as_str()),
            (_, None) => warn!(frame, "no target: {}", status.as_str()),
        }
    }
}

/// Why no frame ever found its mate, after a while.
fn why_no_pairs(counts: &PairingCounts) -> Option<String> {
    let alone = counts.left_alone + counts.right_alone;
    if counts.pairs > 0 || alone < ALONE {
        return None;
    }
    Some(match counts.last_miss {
        Some(apart) => format!(
            "no frames of the two cameras pair: their exposures are {:.2} ms apart (right less left), more than \
             stereo.pair_tolerance_ms; trigger both together, or set cameras[1].stamp_offset_ms",
            apart.as_s() * 1e3
        ),
        None => {
            let silent = if counts.left_alone > 0 { Side::Right } else { Side::Left };
            format!("no frames of the two cameras pair: the {} camera gives none", silent.as_str())
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_that_never_pair_are_told_with_their_distance() {
        let counts = PairingCounts { left_alone: 12, right_alone: 12, ..PairingCounts::default() };
        let apart = Some(SpanNs(15_000_000));
        let why = why_no_pairs(&PairingCounts { last_miss: apart, ..counts }).unwrap();
        assert!(why.contains("15.00 ms apart") && why.contains("stamp_offset_ms"), "{why}");
        let away = PairingCounts { right_alone: 0, left_alone: 20, ..counts };
        assert!(why_no_pairs(&away).unwrap().contains("the right camera gives none"));
        assert_eq!(why_no_pairs(&PairingCounts { pairs: 1, ..counts }), None);
        assert_eq!(why_no_pairs(&PairingCounts { left_alone: 2, ..counts }), None, "it is early");
    }
}
