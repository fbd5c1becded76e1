//! The vision process: from frames, where they lie in shared memory, to measurements.

use super::priority::{self, Rank};
use super::report_images::ReportImages;
use super::{LONGEST_WAIT, Membership, ProcessError, ReportFolder, StopFlag, frame_shape, process_faults};
use crate::config::Clock;
use crate::config::{Config, assemble};
use crate::faults::FaultyProcess;
use crate::geometry::Pose;
use crate::imaging::ImageView;
use crate::ipc::{Instance, ReceivedFrame, Receiver, Role};
use crate::messages::{FrameHeader, JointState, Measurement, TargetStatus, measurement_flag};
use crate::rt::now;
use crate::scene::FrameSchedule;
use crate::time::{MonoNs, SpanNs, TICK};
use crate::vision::{Carrier, Frame, Prior, TargetChoice, TargetSet};
use tracing::{debug_span, info, warn};

/// Longest wait in lockstep for the joint state that the camera already has. Chosen by hand: it was sent to both within microseconds, so that
/// only load can delay it.
const LONGEST_FOR_STATE: SpanNs = SpanNs(50_000_000);

/// Runs vision for the camera of `config` until a stop is requested, and leaves images in the folder `report`, where there is one.
///
/// # Errors
/// When shared memory or the instance fails.
pub fn run(
    config: &Config,
    instance: &Instance,
    stop: &StopFlag,
    report: Option<&ReportFolder>,
) -> Result<(), ProcessError> {
    let id = config.camera.id;
    let membership = Membership::join(instance, Role::Vision(id), config)?;
    let services = membership.services();
    let frames = services.frame_receiver(id, frame_shape(config))?;
    let (states, _) = services.joint_state_receiver()?;
    let measurements = services.measurement_sender(id)?;
    services.require_room_for_peers()?;
    let mut worker = VisionWorker {
        arm: JointStateInput {
            carrier: assemble::carrier(config)?,
            choice: TargetChoice::default(),
            states,
            schedule: lockstep_schedule(config),
        },
        vision: assemble::target_set(config),
        names: config.targets().map(|(name, _)| name.to_owned()).collect(),
        counter: FrameCounter::default(),
        status: None,
        model_error: false,
        noise: false,
    };
    let faults = process_faults::of(config, FaultyProcess::Vision);
    let mut images = ReportImages::new(report, &config.camera);
    priority::take(config, Rank::Vision)?;
    info!("vision runs");
    while !stop.is_requested() {
        membership.beat();
        while let Some(frame) = frames.receive()? {
            membership.beat();
            let _span = debug_span!("frame", frame = frame.header().frame_id).entered();
            process_faults::suffer(&faults, frame.header().frame_id);
            let measurement = worker.measure(&frame)?;
            measurements.send(&measurement)?;
            // What nobody waits for comes after what control waits for.
            images.note_frame(&frame);
            images.note_measurement(&measurement);
        }
        frames.wait(LONGEST_WAIT)?;
    }
    images.write();
    Ok(())
}

/// The schedule of a simulated clock's camera: there it is known which joint state belongs to a frame.
fn lockstep_schedule(config: &Config) -> Option<FrameSchedule> {
    (config.clock == Clock::Lockstep).then_some(config.camera.schedule)
}

/// The arm, by its joint states.
struct JointStateInput {
    carrier: Box<dyn Carrier>,
    choice: TargetChoice,
    states: Receiver<JointState>,
    schedule: Option<FrameSchedule>,
}

impl JointStateInput {
    /// Where the camera is at the exposure of a frame, and until when that is known. In lockstep the state of the frame's tick is under way at least, as the camera
    /// had it, and none after it counts: the answer is the same on any load.
    fn X_WC(&mut self, header: &FrameHeader) -> Result<(Option<Pose>, MonoNs), ProcessError> {
        let tick = self.schedule.map(|schedule| schedule.exposure_tick(header.frame_id));
        let exposed = tick.map(|tick| MonoNs(TICK.0.saturating_mul(tick as i64)));
        let give_up = now() + LONGEST_FOR_STATE;
        loop {
            while let Some(state) = self.states.receive()? {
                self.carrier.note(&state);
                self.choice.note(&state);
            }
            let missing =
                exposed.is_some_and(|exposed| self.carrier.newest().is_none_or(|newest| newest < exposed));
            if !missing || now() > give_up {
                break;
            }
            std::thread::yield_now();
        }
        let known = exposed.or(self.carrier.newest()).unwrap_or(MonoNs::ZERO);
        let at = exposed.map_or(header.exposure, |exposed| exposed.min(header.exposure));
        Ok((self.carrier.X_WC(at), known))
    }
}

struct VisionWorker {
    arm: JointStateInput,
    vision: TargetSet,
    /// Names of the targets, by their numbers.
    names: Vec<String>,
    counter: FrameCounter,
    status: Option<TargetStatus>,
    /// Whether a model error, and noise that no finder states, was told.
    model_error: bool,
    noise: bool,
}

impl VisionWorker {
    fn measure(&mut self, frame: &ReceivedFrame) -> Result<Measurement, ProcessError> {
        let _span = debug_span!("measurement").entered();
        let vision_start = now();
        let header = frame.header();
        self.counter.count(&header);
        let (X_WC, arm_stamp) = self.arm.X_WC(&header)?;
        let prior = Prior { X_WC, ..Prior::default() };
        let view = ImageView::new(frame.pixels(), header.width_px as usize, header.height_px as usize);
        let mut measurement = match view {
            Ok(image) => self.process(self.arm.choice.at(arm_stamp), &Frame { header, image }, &prior),
            Err(_) => Measurement { target_number: self.vision.wanted(), ..unusable(&header) },
        };
        measurement.arm_stamp = arm_stamp;
        measurement.vision_start = vision_start;
        measurement.vision_end = now();
        measurement.frames_received = self.counter.received;
        measurement.frames_dropped = self.counter.dropped;
        self.report(&measurement);
        Ok(measurement)
    }

    /// Measures the target `wanted`, and tells when it is another one than before.
    fn process(&mut self, wanted: u32, frame: &Frame<'_>, prior: &Prior) -> Measurement {
        let before = self.vision.wanted();
        let measurement = self.vision.process(wanted, frame, prior);
        let number = measurement.target_number;
        if number != before {
            let name = self.names.get(number as usize).map_or("?", String::as_str);
            info!(frame = frame.header.frame_id, target = name, "looks for the target `{name}`");
            // What was told of the other one is no news of this one.
            self.status = None;
        }
        measurement
    }

    /// One line whenever the target is found or lost, or the reason changes.
    fn report(&mut self, measurement: &Measurement) {
        if measurement.flags & measurement_flag::MODEL_ERROR != 0
            && !std::mem::replace(&mut self.model_error, true)
        {
            warn!(
                frame = measurement.frame_id,
                rms_px = measurement.reprojection_rms_px,
                "the target's points do not fit its description, but steadily so: lens, target or shutter is not as the run file says"
            );
        }
        let noise_px = self.vision.unstated_noise_px();
        if noise_px > 0.0 && !std::mem::replace(&mut self.noise, true) {
            warn!(
                frame = measurement.frame_id,
                noise_px,
                "the target's points scatter from frame to frame by more than the finder's noise: does the camera shake, the air shimmer, the light flicker, or is the stream compressed? What is measured says so from now on"
            );
        }
        let status = measurement.target_status();
        if self.status == Some(status) {
            return;
        }
        if status == TargetStatus::Found {
            info!(frame = measurement.frame_id, "target found");
        } else if status == TargetStatus::Inconsistent {
            let rms_px = measurement.reprojection_rms_px;
            warn!(frame = measurement.frame_id, rms_px, "measurement refused: {}", status.as_str());
        } else {
            let why = self.vision.missed_in_words(status);
            warn!(frame = measurement.frame_id, "no target: {why}");
        }
        self.status = Some(status);
    }
}

/// A header that does not fit its pixels.
fn unusable(header: &FrameHeader) -> Measurement {
    Measurement {
        frame_id: header.frame_id,
        exposure: header.exposure,
        frame_sent: header.sent,
        camera: header.camera,
        flags: header.flags,
        status: TargetStatus::WrongSize as u32,
        ..Measurement::default()
    }
}

/// Tells the frames that vision skipped from those that the camera lost.
#[derive(Debug, Default, Clone, Copy)]
pub(super) struct FrameCounter {
    pub(super) received: u64,
    pub(super) dropped: u64,
    last: Option<(u64, u64)>,
}

impl FrameCounter {
    pub(super) fn count(&mut self, header: &FrameHeader) {
        self.received += 1;
        if let Some((last_id, last_lost)) = self.last {
            let gap = header.frame_id.saturating_sub(last_id + 1);
            self.dropped += gap.saturating_sub(header.lost.saturating_sub(last_lost));
        }
        self.last = Some((header.frame_id, header.lost));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn skipped_and_lost_frames_are_told_apart() {
        let mut c = FrameCounter::default();
        for (frame_id, lost) in [(5, 0), (6, 0), (9, 1), (10, 1), (2, 0), (3, 0)] {
            c.count(&FrameHeader { frame_id, lost, ..FrameHeader::default() });
        }
        // 7 and 8 are missing, one of them lost by the camera; a restarted camera (2) is no gap.
        assert_eq!((c.received, c.dropped), (6, 1));
    }
}
