//! Everything of a recording, to the bit, with what viewers know by themselves beside it.

use super::cdr::CdrOutput;
use super::derived::DerivedMessages;
use super::derived_message::{DerivedMessage, camera_frame};
use crate::config::Config;
use crate::messages::CameraId;
use crate::record::{
    CopiedTopic, IMAGE_NAME, RecordedMessage, RecordingError, RecordingReader, RecordingWriter,
};
use crate::time::MonoNs;
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use std::collections::BTreeMap;
use std::io::{Read, Write};

/// Whose programs are to open it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ViewerKind {
    /// Foxglove: with annotations of the images.
    Foxglove,
    /// ROS 2: packages that it has not are left out.
    Ros2,
    /// Rerun, whose program converts it (`rerun mcap convert`): as for ROS 2, with the images as PNG, because it draws 8-bit grey as a depth.
    Rerun,
}

/// Bytes after which a chunk ends. Chosen by hand: what a recorder gathers at most.
const CHUNK_BYTES: usize = 4 << 20;

/// Writes what `reader` has, and what is derived of it, into `sink`; how many messages each topic has.
///
/// # Errors
/// When the recording cannot be read, has records of another version, or the sink fails.
pub fn write_for_viewers<R: Read, W: Write>(
    mut reader: RecordingReader<R>,
    config: &Config,
    kind: ViewerKind,
    sink: W,
) -> Result<BTreeMap<String, u64>, RecordingError> {
    let about = reader.metadata().get(crate::record::ABOUT).cloned().unwrap_or_default();
    let mut writer = RecordingWriter::new(sink, &about)?;
    for (name, data) in reader.attachments() {
        writer.attach(name, "application/octet-stream", data)?;
    }
    let mut output = ViewerOutput { writer, kind, topics: BTreeMap::new(), counts: BTreeMap::new() };
    let mut derived = DerivedMessages::new(config.clone());
    let mut is_first = true;
    while let Some(message) = reader.next_message()? {
        if std::mem::take(&mut is_first) {
            let stamp = MonoNs(i64::try_from(message.stamp_ns).unwrap_or_default());
            derived.fixed(stamp).into_iter().try_for_each(|made| output.derived(made))?;
        }
        let image = if kind == ViewerKind::Rerun { compressed(&message)? } else { None };
        match image {
            Some(image) => output.derived(image)?,
            None => output.copy(&message)?,
        }
        for made in derive(&mut derived, &message)? {
            output.derived(made)?;
        }
        if output.writer.waiting_bytes() > CHUNK_BYTES {
            output.writer.end_chunk()?;
        }
    }
    output.writer.finish(&BTreeMap::new())?;
    Ok(output.counts)
}

fn derive(
    derived: &mut DerivedMessages,
    message: &RecordedMessage<'_>,
) -> Result<Vec<DerivedMessage>, RecordingError> {
    Ok(match message.topic() {
        "/control/joint_state" => derived.joint_state(&message.record()?),
        "/control/trace" => derived.tick(&message.record()?),
        "/control/request" => derived.request(&message.record()?),
        topic if topic.ends_with("/frame_header") => derived.frame(&message.record()?).into_iter().collect(),
        topic if topic.ends_with("/measurement") => derived.measurement(&message.record()?),
        _ => Vec::new(),
    })
}

/// The image in `message` as a `sensor_msgs/CompressedImage` of its topic; `None` where there is none in it.
fn compressed(message: &RecordedMessage<'_>) -> Result<Option<DerivedMessage>, RecordingError> {
    if message.definition() != Some(IMAGE_NAME) {
        return Ok(None);
    }
    let image = message.image()?;
    let topic = message.topic();
    let mut png = Vec::new();
    PngEncoder::new(&mut png)
        .write_image(image.pixels, image.width_px, image.height_px, ExtendedColorType::L8)
        .map_err(|_| RecordingError::Message { topic: topic.into(), expected: "image of 8-bit grey" })?;
    let camera = topic.split('/').nth(2).and_then(|number| number.parse().ok()).unwrap_or_default();
    let mut out = CdrOutput::new();
    out.header(image.stamp, &camera_frame(CameraId(camera)));
    out.text("png");
    out.octets(&png);
    Ok(Some(DerivedMessage {
        topic: topic.into(),
        definition: "sensor_msgs/CompressedImage",
        stamp: image.stamp,
        data: out.bytes(),
    }))
}

struct ViewerOutput<W: Write> {
    writer: RecordingWriter<W>,
    kind: ViewerKind,
    topics: BTreeMap<String, CopiedTopic>,
    counts: BTreeMap<String, u64>,
}

impl<W: Write> ViewerOutput<W> {
    fn copy(&mut self, message: &RecordedMessage<'_>) -> Result<(), RecordingError> {
        let topic = message.topic();
        let id = match self.topics.get(topic) {
            Some(id) => *id,
            None => {
                let id = self.writer.add_copied(message)?;
                self.topics.insert(topic.to_owned(), id);
                id
            }
        };
        self.put(topic, id, message.stamp_ns, message.data())
    }

    fn derived(&mut self, message: DerivedMessage) -> Result<(), RecordingError> {
        if self.kind != ViewerKind::Foxglove && message.definition.starts_with("foxglove_msgs") {
            return Ok(());
        }
        let id = match self.topics.get(&message.topic) {
            Some(id) => *id,
            None => {
                let (name, text) = message.schema();
                let id = self.writer.add_cdr(&message.topic, &name, &text)?;
                self.topics.insert(message.topic.clone(), id);
                id
            }
        };
        let stamp_ns = u64::try_from(message.stamp.0).unwrap_or_default();
        self.put(&message.topic, id, stamp_ns, &message.data)
    }

    fn put(
        &mut self,
        topic: &str,
        id: CopiedTopic,
        stamp_ns: u64,
        data: &[u8],
    ) -> Result<(), RecordingError> {
        let count = self.counts.entry(topic.to_owned()).or_default();
        *count += 1;
        self.writer.write_copied(id, *count - 1, stamp_ns, data)
    }
}

/// The layout of the records of this version whose versioned name is `type_name`.
pub(super) fn layout_of(type_name: &str) -> Option<&'static crate::messages::RecordLayout> {
    crate::messages::RECORD_LAYOUTS.into_iter().find(|layout| layout.type_name == type_name)
}
