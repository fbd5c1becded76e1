//! A recorder's ends of the services: each takes what was sent, adds it to the recording, and counts what was lost on the way.

use crate::config::{Config, DriveKind};
use crate::ipc::{Channel, QuietFrameReceiver, Receiver, Services};
use crate::messages::{
    CameraHealth, DriveCommandMsg, DriveStateMsg, DriveTextMsg, FrameHeader, JointState, Measurement,
    MessageRecord, RequestMsg, Status, TraceMsg,
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

/// One service.
pub(super) trait ServiceTap<W: Write> {
    /// Takes what there is; whether there was anything.
    fn take_all(&mut self, writer: &mut RecordingWriter<W>) -> Result<bool, ProcessError>;
    /// What came of it so far.
    fn count(&self) -> ServiceCount;
    /// Ticks of control up to the last that was taken, where it tells them.
    fn ticks(&self) -> Option<u64> {
        None
    }
}

/// Name and place of a record that travels by itself: the number that its sender gave it, and its instant.
trait SequencedRecord {
    fn number(&self) -> (u64, MonoNs);
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
    TraceMsg: sequence, stamp;
    Status: sequence, stamp;
    RequestMsg: sequence, stamp;
    DriveCommandMsg: sequence, stamp;
    DriveStateMsg: sequence, stamp;
    DriveTextMsg: sequence, stamp;
}

struct RecordTap<T: MessageRecord + ZeroCopySend + Debug + 'static> {
    service: Channel,
    receiver: Receiver<T>,
    topic: RecordTopic<T>,
    counter: SequenceCounter,
}

impl<W: Write, T: MessageRecord + SequencedRecord + ZeroCopySend + Debug> ServiceTap<W> for RecordTap<T> {
    fn take_all(&mut self, writer: &mut RecordingWriter<W>) -> Result<bool, ProcessError> {
        for taken in 0..MAX_IN_A_ROW {
            let Some(record) = self.receiver.receive()? else { return Ok(taken > 0) };
            let (sequence, stamp) = record.number();
            self.counter.count(sequence);
            writer.write(self.topic, sequence, stamp, &record)?;
        }
        Ok(true)
    }

    fn count(&self) -> ServiceCount {
        ServiceCount { service: self.service.to_string(), counter: self.counter }
    }

    fn ticks(&self) -> Option<u64> {
        self.counter.next().filter(|_| self.service == Channel::Trace)
    }
}

struct FrameTap {
    service: Channel,
    receiver: QuietFrameReceiver,
    images: ImageTopic,
    headers: RecordTopic<FrameHeader>,
    counter: FrameCounter,
}

impl<W: Write> ServiceTap<W> for FrameTap {
    fn take_all(&mut self, writer: &mut RecordingWriter<W>) -> Result<bool, ProcessError> {
        for taken in 0..MAX_IN_A_ROW {
            let Some(frame) = self.receiver.receive()? else { return Ok(taken > 0) };
            let header = frame.header();
            self.counter.count(&header);
            writer.write(self.headers, header.frame_id, header.exposure, &header)?;
            writer.write_image(&self.images, &header, frame.pixels())?;
        }
        Ok(true)
    }

    fn count(&self) -> ServiceCount {
        let FrameCounter { received, dropped, .. } = self.counter;
        let counter = SequenceCounter::of(received, dropped);
        ServiceCount { service: self.service.to_string(), counter }
    }
}

/// The topic of a service: its name, as ROS writes one.
fn topic(service: Channel) -> String {
    format!("/{service}")
}

fn records<W: Write, T: MessageRecord + SequencedRecord + ZeroCopySend + Debug + 'static>(
    service: Channel,
    receiver: Receiver<T>,
    writer: &mut RecordingWriter<W>,
) -> Result<Box<dyn ServiceTap<W>>, ProcessError> {
    let topic = writer.add_records(&topic(service))?;
    Ok(Box::new(RecordTap { service, receiver, topic, counter: SequenceCounter::default() }))
}

/// Ends of all services of a run.
pub(super) fn open<W: Write>(
    config: &Config,
    services: &Services,
    writer: &mut RecordingWriter<W>,
) -> Result<Vec<Box<dyn ServiceTap<W>>>, ProcessError> {
    // First, so that of every tick that it has taken everything else is taken too.
    let mut taps = vec![records(Channel::Trace, services.trace_receiver()?, writer)?];
    for camera in config.cameras() {
        let (id, service) = (camera.id, Channel::Frame(camera.id));
        taps.push(Box::new(FrameTap {
            service,
            receiver: services.frame_recorder(id, shape_of(camera, config.clock))?,
            images: writer.add_images(&topic(service), &format!("camera_{id}"))?,
            headers: writer.add_records(&format!("/camera/{id}/frame_header"))?,
            counter: FrameCounter::default(),
        }));
        taps.push(records(Channel::Health(id), services.health_receiver(id)?, writer)?);
    }
    for id in std::iter::once(config.camera.id).chain(second_vision(config)) {
        taps.push(records(Channel::Measurement(id), services.measurement_recorder(id)?, writer)?);
    }
    taps.push(records(Channel::JointState, services.joint_state_recorder()?, writer)?);
    taps.push(records(Channel::Status, services.status_recorder()?, writer)?);
    taps.push(records(Channel::Request, services.request_recorder()?, writer)?);
    if config.drive.kind == DriveKind::External {
        let (commands, states) = services.drive_recorders()?;
        taps.push(records(Channel::DriveCommand, commands, writer)?);
        taps.push(records(Channel::DriveState, states, writer)?);
        taps.push(records(Channel::DriveText, services.drive_text_receiver()?, writer)?);
    }
    Ok(taps)
}
