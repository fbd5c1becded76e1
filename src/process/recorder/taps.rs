//! A recorder's ends of the services: each takes what was sent, adds it to the recording, and counts what was lost on the way.

use crate::config::{Config, DriveKind};
use crate::ipc::{Channel, QuietFrameReceiver, Receiver, Services};
use crate::messages::{
    CameraHealth, CameraId, DriveCommandMsg, DriveStateMsg, DriveTextMsg, FrameHeader, JointState,
    Measurement, MessageRecord, RequestMsg, Status, TraceMsg, trace_flag,
};
use crate::process::vision::FrameCounter;
use crate::process::{ProcessError, second_vision, shape_of};
use crate::record::{ImageTopic, RecordTopic, RecordingWriter, SequenceCounter};
use crate::time::MonoNs;
use iceoryx2::prelude::ZeroCopySend;
use std::fmt::Debug;
use std::io::Write;

/// Records that are taken from one service before the next one has its turn, so that a fast one holds up nobody: what the largest buffer holds.
const MAX_IN_A_ROW: usize = 1024;

/// What came of a service.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ServiceCount {
    /// Its name.
    pub service: String,
    /// What was recorded of it, and what was lost.
    pub counter: SequenceCounter,
}

/// Where the run stands, as its last trace says.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct RunState {
    /// Number of that trace.
    pub(super) sequence: u64,
    /// Whether it is in a fault.
    pub(super) has_fault: bool,
    /// Whether that trace is the last one.
    pub(super) is_over: bool,
}

/// One service.
pub(super) trait ServiceTap<W: Write> {
    /// Adds its topics to a recording that begins, which it writes to from now on.
    fn begin(&mut self, writer: &mut RecordingWriter<W>) -> Result<(), ProcessError>;
    /// Takes what there is, after a recording has begun; whether there was anything.
    fn take_all(&mut self, writer: &mut RecordingWriter<W>) -> Result<bool, ProcessError>;
    /// What came of it so far.
    fn count(&self) -> ServiceCount;
    /// Ticks of control up to the last that was taken, where it tells them.
    fn ticks(&self) -> Option<u64> {
        None
    }
    /// Where the run stood at the last that was taken, where it tells that.
    fn run_state(&self) -> Option<RunState> {
        None
    }
    /// Whether it takes frames.
    fn takes_frames(&self) -> bool {
        false
    }
}

/// Name and place of a record that travels by itself: the number that its sender gave it, and its instant.
trait SequencedRecord {
    fn number(&self) -> (u64, MonoNs);
    /// Where the run stands by it.
    fn run_state(&self) -> Option<RunState> {
        None
    }
}

macro_rules! numbered {
    ($($Record:ty: $sequence:ident, $stamp:ident;)+) => {
        $(impl SequencedRecord for $Record {
            fn number(&self) -> (u64, MonoNs) {
                (self.$sequence, self.$stamp)
            }
        })+
    };
}

numbered! {
    CameraHealth: sequence, stamp;
    // one for each frame, or each frame of the left camera that has its pair
    Measurement: frames_received, exposure;
    JointState: sequence, stamp;
    Status: sequence, stamp;
    RequestMsg: sequence, stamp;
    DriveCommandMsg: sequence, stamp;
    DriveStateMsg: sequence, stamp;
    DriveTextMsg: sequence, stamp;
}

impl SequencedRecord for TraceMsg {
    fn number(&self) -> (u64, MonoNs) {
        (self.sequence, self.stamp)
    }

    fn run_state(&self) -> Option<RunState> {
        let is_over = self.flags & trace_flag::LAST != 0;
        Some(RunState { sequence: self.sequence, has_fault: self.fault != 0, is_over })
    }
}

struct RecordTap<T: MessageRecord + ZeroCopySend + Debug + 'static> {
    service: Channel,
    receiver: Receiver<T>,
    topic: Option<RecordTopic<T>>,
    counter: SequenceCounter,
    run_state: Option<RunState>,
}

impl<W: Write, T: MessageRecord + SequencedRecord + ZeroCopySend + Debug> ServiceTap<W> for RecordTap<T> {
    fn begin(&mut self, writer: &mut RecordingWriter<W>) -> Result<(), ProcessError> {
        self.topic = Some(writer.add_records(&topic(self.service))?);
        Ok(())
    }

    fn take_all(&mut self, writer: &mut RecordingWriter<W>) -> Result<bool, ProcessError> {
        let Some(topic) = self.topic else { return Ok(false) };
        for taken in 0..MAX_IN_A_ROW {
            let Some(record) = self.receiver.receive()? else { return Ok(taken > 0) };
            let (sequence, stamp) = record.number();
            self.counter.count(sequence);
            self.run_state = record.run_state().or(self.run_state);
            writer.write(topic, sequence, stamp, &record)?;
        }
        Ok(true)
    }

    fn count(&self) -> ServiceCount {
        ServiceCount { service: self.service.to_string(), counter: self.counter }
    }

    fn ticks(&self) -> Option<u64> {
        self.counter.next().filter(|_| self.service == Channel::Trace)
    }

    fn run_state(&self) -> Option<RunState> {
        self.run_state
    }
}

struct FrameTap {
    camera: CameraId,
    receiver: QuietFrameReceiver,
    topics: Option<(RecordTopic<FrameHeader>, ImageTopic)>,
    counter: FrameCounter,
}

impl<W: Write> ServiceTap<W> for FrameTap {
    fn begin(&mut self, writer: &mut RecordingWriter<W>) -> Result<(), ProcessError> {
        let id = self.camera;
        let images = writer.add_images(&topic(Channel::Frame(id)), &format!("camera_{id}"))?;
        self.topics = Some((writer.add_records(&format!("/camera/{id}/frame_header"))?, images));
        Ok(())
    }

    fn take_all(&mut self, writer: &mut RecordingWriter<W>) -> Result<bool, ProcessError> {
        let Some((headers, images)) = &self.topics else { return Ok(false) };
        for taken in 0..MAX_IN_A_ROW {
            let Some(frame) = self.receiver.receive()? else { return Ok(taken > 0) };
            let header = frame.header();
            self.counter.count(&header);
            writer.write(*headers, header.frame_id, header.exposure, &header)?;
            writer.write_image(images, &header, frame.pixels())?;
        }
        Ok(true)
    }

    fn count(&self) -> ServiceCount {
        let FrameCounter { received, dropped, .. } = self.counter;
        let counter = SequenceCounter::of(received, dropped);
        ServiceCount { service: Channel::Frame(self.camera).to_string(), counter }
    }

    fn takes_frames(&self) -> bool {
        true
    }
}

/// The topic of a service: its name, as ROS writes one.
fn topic(service: Channel) -> String {
    format!("/{service}")
}

fn records<W: Write, T: MessageRecord + SequencedRecord + ZeroCopySend + Debug + 'static>(
    service: Channel,
    receiver: Receiver<T>,
) -> Box<dyn ServiceTap<W>> {
    let counter = SequenceCounter::default();
    Box::new(RecordTap { service, receiver, topic: None, counter, run_state: None })
}

/// Ends of all services of a run, for which a recording is still to begin.
pub(super) fn open<W: Write>(
    config: &Config,
    services: &Services,
) -> Result<Vec<Box<dyn ServiceTap<W>>>, ProcessError> {
    // First, so that of every tick that it has taken everything else is taken too.
    let mut taps = vec![records(Channel::Trace, services.trace_receiver()?)];
    for camera in config.cameras() {
        let id = camera.id;
        taps.push(Box::new(FrameTap {
            camera: id,
            receiver: services.frame_recorder(id, shape_of(camera, config.clock))?,
            topics: None,
            counter: FrameCounter::default(),
        }));
        taps.push(records(Channel::Health(id), services.health_receiver(id)?));
    }
    for id in std::iter::once(config.camera.id).chain(second_vision(config)) {
        taps.push(records(Channel::Measurement(id), services.measurement_recorder(id)?));
    }
    taps.push(records(Channel::JointState, services.joint_state_recorder()?));
    taps.push(records(Channel::Status, services.status_recorder()?));
    taps.push(records(Channel::Request, services.request_recorder()?));
    if config.drive.kind == DriveKind::External {
        let (commands, states) = services.drive_recorders()?;
        taps.push(records(Channel::DriveCommand, commands));
        taps.push(records(Channel::DriveState, states));
        taps.push(records(Channel::DriveText, services.drive_text_receiver()?));
    }
    Ok(taps)
}
