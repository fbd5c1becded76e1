//! The vision process: from frames, where they lie in shared memory, to measurements.

use super::priority::{self, Rank};
use super::{LONGEST_WAIT, Membership, ProcessError, StopFlag, frame_shape};
use crate::config::Config;
use crate::imaging::ImageView;
use crate::ipc::{Instance, ReceivedFrame, Role};
use crate::messages::{FrameHeader, Measurement, TargetStatus};
use crate::rt::now;
use crate::vision::{Frame, Prior, Vision};
use tracing::{info, warn};

/// Runs vision for the camera of `config` until a stop is requested.
///
/// # Errors
/// When shared memory or the instance fails.
pub fn run(config: &Config, instance: &Instance, stop: &StopFlag) -> Result<(), ProcessError> {
    let id = config.camera.id;
    let membership = Membership::join(instance, Role::Vision(id))?;
    let services = membership.services();
    let frames = services.frame_receiver(id, frame_shape(config))?;
    let measurements = services.measurement_sender(id)?;
    services.require_room_for_peers()?;
    let mut worker = Worker {
        vision: crate::config::assemble::vision(config),
        counter: FrameCounter::default(),
        status: None,
    };
    priority::take(config, Rank::Vision)?;
    info!("vision runs");
    while !stop.is_requested() {
        membership.beat();
        while let Some(frame) = frames.receive()? {
            membership.beat();
            measurements.send(&worker.measure(&frame))?;
        }
        frames.wait(LONGEST_WAIT)?;
    }
    Ok(())
}

struct Worker {
    vision: Vision,
    counter: FrameCounter,
    status: Option<TargetStatus>,
}

impl Worker {
    fn measure(&mut self, frame: &ReceivedFrame) -> Measurement {
        let vision_start = now();
        let header = frame.header();
        self.counter.count(&header);
        let view = ImageView::new(frame.pixels(), header.width_px as usize, header.height_px as usize);
        let mut measurement = match view {
            Ok(image) => self.vision.process(&Frame { header, image }, &Prior::default()),
            Err(_) => unusable(&header),
        };
        measurement.vision_start = vision_start;
        measurement.vision_end = now();
        measurement.frames_received = self.counter.received;
        measurement.frames_dropped = self.counter.dropped;
        self.report(&measurement);
        measurement
    }

    /// One line whenever the target is found or lost, or the reason changes.
    fn report(&mut self, measurement: &Measurement) {
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
            warn!(frame = measurement.frame_id, "no target: {}", status.as_str());
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
struct FrameCounter {
    received: u64,
    dropped: u64,
    last: Option<(u64, u64)>,
}

impl FrameCounter {
    fn count(&mut self, header: &FrameHeader) {
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
