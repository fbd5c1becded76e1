//! What is published of a run: its own records, and what viewers know by themselves, as `vservo export` derives it.

use super::hub::ChannelHub;
use crate::config::{Config, DriveKind};
use crate::export::{DerivedMessage, DerivedMessages};
use crate::messages::{
    CameraHealth, DriveCommandMsg, DriveStateMsg, DriveTextMsg, FrameHeader, JointState, Measurement,
    MessageRecord, RequestMsg, Status, TraceMsg,
};
use crate::monitor::WatchedRecord;
use crate::record::{CDR_LITTLE_ENDIAN, IMAGE_NAME, IMAGE_SCHEMA, ImageMessage, ros2_name, ros2_schema};
use crate::time::MonoNs;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Topics whose last message is told to who comes later, as ROS 2 has it.
const LATCHED: [&str; 2] = ["/tf_static", "/scene"];

/// Publishes one run.
#[derive(Debug)]
pub(crate) struct LivePublisher {
    hub: Arc<ChannelHub>,
    derived: DerivedMessages,
    /// The channel of each topic.
    channels: BTreeMap<String, u32>,
    camera: String,
    image: u32,
    has_fixed: bool,
}

impl LivePublisher {
    /// Of the `run`-th run of this watcher, with this run file.
    pub(crate) fn new(hub: Arc<ChannelHub>, run: u64, instance: &str, config: &Config) -> Self {
        hub.begin(run, &format!("vservo {instance}"));
        let camera = config.camera.id;
        // Offered before anybody wants it, since images are fetched only then.
        let schema = (IMAGE_NAME.to_owned(), IMAGE_SCHEMA.to_owned());
        let image = hub.offer(&format!("/camera/{camera}/frame"), schema);
        let mut publisher = Self {
            hub,
            derived: DerivedMessages::new(config.clone()),
            channels: BTreeMap::new(),
            camera: format!("camera_{camera}"),
            image,
            has_fixed: false,
        };
        publisher.offer::<Status>("/control/status");
        publisher.offer::<TraceMsg>("/control/trace");
        publisher.offer::<Measurement>(&format!("/vision/{camera}/measurement"));
        publisher.offer::<RequestMsg>("/control/request");
        if config.drive.kind == DriveKind::External {
            publisher.offer::<DriveCommandMsg>("/drive/command");
            publisher.offer::<DriveStateMsg>("/drive/state");
            publisher.offer::<DriveTextMsg>("/drive/text");
        }
        for camera in config.cameras() {
            publisher.offer::<CameraHealth>(&format!("/camera/{}/health", camera.id));
        }
        publisher
    }

    fn offer<T: MessageRecord>(&mut self, topic: &str) {
        let id = self.hub.offer(topic, (ros2_name(T::LAYOUT), ros2_schema(T::LAYOUT)));
        self.channels.insert(topic.to_owned(), id);
    }

    /// Whether images are to be fetched.
    pub(crate) fn wants_images(&self) -> bool {
        self.hub.is_wanted(self.image)
    }

    /// Publishes a record, and what is derived of it; `goal_px` is where the points of the goal are to be, px.
    pub(crate) fn publish(&mut self, record: &WatchedRecord<'_>, goal_px: &BTreeMap<u32, [f64; 2]>) {
        if !self.hub.has_viewers() {
            return;
        }
        match record {
            WatchedRecord::Status(status) => self.record("/control/status", status.stamp, *status),
            WatchedRecord::Tick(tick) => {
                if !std::mem::replace(&mut self.has_fixed, true) {
                    let fixed = self.derived.fixed(tick.stamp);
                    fixed.into_iter().for_each(|message| self.derived_message(message));
                }
                self.record("/control/trace", tick.stamp, *tick);
                let TraceMsg { stamp, q, qd, tau, .. } = **tick;
                let state = JointState { stamp, q, qd, tau, ..JointState::default() };
                let made = self.derived.joint_state(&state).into_iter().chain(self.derived.tick(tick));
                made.collect::<Vec<_>>().into_iter().for_each(|message| self.derived_message(message));
            }
            WatchedRecord::Measurement(m) => {
                self.record(&format!("/vision/{}/measurement", m.camera), m.exposure, *m);
                if !goal_px.is_empty() {
                    self.derived.set_goal_px(goal_px.iter().map(|(id, px)| (*id, *px)));
                }
                self.derived.measurement(m).into_iter().for_each(|message| self.derived_message(message));
            }
            WatchedRecord::Request(request) => {
                self.record("/control/request", request.stamp, *request);
                let made = self.derived.request(request);
                made.into_iter().for_each(|message| self.derived_message(message));
            }
            WatchedRecord::DriveCommand(command) => self.record("/drive/command", command.stamp, *command),
            WatchedRecord::DriveState(state) => self.record("/drive/state", state.stamp, *state),
            WatchedRecord::DriveText(text) => self.record("/drive/text", text.stamp, *text),
            WatchedRecord::Health(camera, health) => {
                self.record(&format!("/camera/{camera}/health"), health.stamp, *health);
            }
        }
    }

    /// Publishes a frame of the first camera, with its calibration.
    pub(crate) fn image(&mut self, header: &FrameHeader, pixels: &[u8]) {
        if !self.wants_images() {
            return;
        }
        let mut data = Vec::with_capacity(pixels.len() + 64); // the head of the message has about 50 bytes
        ImageMessage::new(header, pixels).put(&self.camera, &mut data);
        self.hub.publish(self.image, header.exposure, data, false);
        if let Some(calibration) = self.derived.frame(header) {
            self.derived_message(calibration);
        }
    }

    fn record<T: MessageRecord>(&self, topic: &str, stamp: MonoNs, record: &T) {
        let Some(id) = self.channels.get(topic).filter(|id| self.hub.is_wanted(**id)) else { return };
        let mut data = CDR_LITTLE_ENDIAN.to_vec();
        record.put(&mut data);
        self.hub.publish(*id, stamp, data, false);
    }

    fn derived_message(&mut self, message: DerivedMessage) {
        let id = match self.channels.get(&message.topic) {
            Some(id) => *id,
            None => {
                let id = self.hub.offer(&message.topic, message.schema());
                self.channels.insert(message.topic.clone(), id);
                id
            }
        };
        let is_latched = LATCHED.contains(&message.topic.as_str());
        self.hub.publish(id, message.stamp, message.data, is_latched);
    }
}
