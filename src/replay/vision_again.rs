//! Recorded frames through vision.

use super::run_again::differs;
use super::{Difference, ReplayError};
use crate::config::{Clock, Config, assemble};
use crate::imaging::ImageView;
use crate::messages::{FrameHeader, JointState, Measurement, TraceMsg};
use crate::record::RecordingReader;
use crate::vision::{Carrier, Frame, Prior, TargetChoice, TargetSet};
use std::collections::VecDeque;
use std::io::Read;

/// Frames that are kept until their measurements have been read. Derived: a measurement is sent at most a few frames after its frame, and the file has
/// both within a second, which is a hundred frames of the fastest camera here.
const WAITING_FRAMES: usize = 128;

/// What came of it.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredAgain {
    /// Frames that were measured and compared.
    pub frames: u64,
    /// Measurements whose frame, or the joint states before it, are not in the recording.
    pub without_frame: u64,
    /// Where the measurement is not what was recorded.
    pub difference: Option<Difference>,
}

struct VisionAgain {
    vision: TargetSet,
    carrier: Box<dyn Carrier>,
    choice: TargetChoice,
    states: VecDeque<JointState>,
    frames: VecDeque<(FrameHeader, Vec<u8>)>,
    received: u64,
}

/// Measures the frames of a recording of a run of `config`, from whose messages nothing was taken yet, and compares up to the first difference.
///
/// # Errors
/// When the recording cannot be read, begins after its run, or the run has a pair of cameras.
pub fn measure_again<R: Read>(
    reader: &mut RecordingReader<R>,
    config: &Config,
) -> Result<MeasuredAgain, ReplayError> {
    if config.stereo.is_some() || config.second_view.is_some() {
        return Err(ReplayError::PairOfCameras);
    }
    let mut again = VisionAgain::new(config)?;
    let mut result = MeasuredAgain { frames: 0, without_frame: 0, difference: None };
    let id = config.camera.id;
    let (frame, frame_header, measurement) = (
        format!("/camera/{id}/frame"),
        format!("/camera/{id}/frame_header"),
        format!("/vision/{id}/measurement"),
    );
    // A measurement may stand before its frame or before the joint states that vision had.
    let mut waiting: VecDeque<Measurement> = VecDeque::new();
    let (mut header, mut has_begun) = (None, false);
    while let Some(message) = reader.next_message()? {
        match message.topic() {
            topic if topic == frame_header => header = Some(message.record::<FrameHeader>()?),
            topic if topic == frame => {
                if let Some(header) = header.take() {
                    again.frames.push_back((header, message.image()?.pixels.to_vec()));
                }
            }
            "/control/joint_state" => again.states.push_back(message.record()?),
            "/control/trace" if !std::mem::replace(&mut has_begun, true) => {
                let first: TraceMsg = message.record()?;
                if first.sequence > 0 {
                    return Err(ReplayError::NoBegin(first.sequence));
                }
            }
            topic if topic == measurement => waiting.push_back(message.record()?),
            _ => {}
        }
        while waiting.len() > 1 && again.knows_enough(&waiting) {
            let Some(then) = waiting.pop_front() else { break };
            if again.compare(&then, config, &mut result, &measurement) {
                return Ok(result);
            }
        }
    }
    for then in waiting {
        if again.compare(&then, config, &mut result, &measurement) {
            break;
        }
    }
    Ok(result)
}

impl VisionAgain {
    fn new(config: &Config) -> Result<Self, ReplayError> {
        Ok(Self {
            vision: assemble::target_set(config),
            carrier: assemble::carrier(config)?,
            choice: TargetChoice::default(),
            states: VecDeque::new(),
            frames: VecDeque::new(),
            received: 0,
        })
    }

    /// Whether the file has all that the oldest measurement was made of, or will not have it any more.
    fn knows_enough(&mut self, waiting: &VecDeque<Measurement>) -> bool {
        while self.frames.len() > WAITING_FRAMES {
            self.frames.pop_front();
        }
        let Some(oldest) = waiting.front() else { return false };
        let has_states = self.states.back().is_some_and(|state| state.stamp >= oldest.arm_stamp);
        (has_states && self.frames.iter().any(|(header, _)| is_of(oldest, header)))
            || waiting.len() > WAITING_FRAMES / 2
    }

    /// Measures the frame of `then` again; whether the result is another one.
    fn compare(
        &mut self,
        then: &Measurement,
        config: &Config,
        result: &mut MeasuredAgain,
        topic: &str,
    ) -> bool {
        let Some(at) = self.frames.iter().position(|(header, _)| is_of(then, header)) else {
            result.without_frame += 1;
            return false;
        };
        // Those before it were overwritten before vision took them.
        self.frames.drain(..at);
        let Some((header, pixels)) = self.frames.pop_front() else { return false };
        if then.frames_received <= self.received {
            // Another vision process.
            self.vision = assemble::target_set(config);
        }
        self.received = then.frames_received;
        let until = then.arm_stamp;
        while let Some(state) = self.states.pop_front_if(|state| state.stamp <= until) {
            self.carrier.note(&state);
            self.choice.note(&state);
        }
        let at = if config.clock == Clock::Lockstep { until.min(header.exposure) } else { header.exposure };
        let prior = Prior { X_WC: self.carrier.X_WC(at), ..Prior::default() };
        let view = ImageView::new(&pixels, header.width_px as usize, header.height_px as usize);
        let Ok(image) = view else {
            result.without_frame += 1;
            return false;
        };
        let Measurement { vision_start, vision_end, frames_received, frames_dropped, arm_stamp, .. } = *then;
        let now = Measurement {
            // What the process adds, of its clock and its counts.
            vision_start,
            vision_end,
            frames_received,
            frames_dropped,
            arm_stamp,
            ..self.vision.process(self.choice.at(until), &Frame { header, image }, &prior)
        };
        result.frames += 1;
        result.difference = differs(topic, then.frame_id, then.exposure, then, &now);
        result.difference.is_some()
    }
}

fn is_of(measurement: &Measurement, header: &FrameHeader) -> bool {
    (measurement.frame_id, measurement.exposure, measurement.frame_sent)
        == (header.frame_id, header.exposure, header.sent)
}
