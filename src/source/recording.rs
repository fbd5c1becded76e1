//! A recording as camera: the images of one of its topics, in the order in which they stand there.
//!
//! Those of `vservo record` and of `ros2 bag record --storage mcap`: `sensor_msgs/msg/Image` and `sensor_msgs/msg/CompressedImage`. The file is read as it is played, so that
//! it may be longer than memory. One that is cut off is played up to there.

use super::image_file::{self, Size};
use super::{Exposed, Exposure, ScheduledSource, SourceError};
use crate::imaging::grey::{PixelFormat, ToGrey};
use crate::messages::{CameraId, JointState};
use crate::record::{RecordedMessage, RecordingError, RecordingReader, RosImage, compressed_image};
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use tracing::warn;

const IMAGE: &str = "sensor_msgs/msg/Image";
const COMPRESSED_IMAGE: &str = "sensor_msgs/msg/CompressedImage";

/// Plays a recording. An image that cannot be used is reported, counted and left out, unless it is to end the replay.
pub struct RecordedCamera {
    path: PathBuf,
    topic: String,
    reader: RecordingReader<BufReader<File>>,
    decoder: GreyImages,
    repeat: bool,
    strict: bool,
    left_out: usize,
    /// Whether an image was good in this round.
    has_played: bool,
}

/// Which images are played, and how.
#[derive(Debug, Clone, Copy)]
pub struct RecordedTopic<'a> {
    /// The topic; where it is none, that of camera `camera`, or the only one with images.
    pub topic: Option<&'a str>,
    /// The number of the camera.
    pub camera: CameraId,
    /// Columns and rows of the camera, px.
    pub size_px: (u32, u32),
    /// Whether it begins anew at the end.
    pub repeat: bool,
    /// Whether the first image that cannot be used ends it.
    pub strict: bool,
}

impl RecordedCamera {
    /// Opens the recording `path` and looks at its first image.
    ///
    /// # Errors
    /// [`SourceError`] when it cannot be read, has no such topic or no image that can be used.
    pub fn open(path: &Path, wanted: &RecordedTopic<'_>) -> Result<Self, SourceError> {
        let (width, height) = wanted.size_px;
        let mut camera = Self {
            path: path.into(),
            topic: topic(path, wanted)?,
            reader: open(path)?,
            decoder: GreyImages::new(Size { width, height }),
            repeat: wanted.repeat,
            strict: wanted.strict,
            left_out: 0,
            has_played: false,
        };
        if camera.decode_next(&mut vec![0; width as usize * height as usize])?.is_none() {
            return Err(camera.failed(format!("holds no image on {}", camera.topic)));
        }
        camera.reader = open(path)?;
        Ok(camera)
    }

    /// Decodes the next good image into `out`; the stamp of its message, ns, or `None` at the end.
    pub(super) fn decode_next(&mut self, out: &mut [u8]) -> Result<Option<u64>, SourceError> {
        loop {
            let message = self.reader.next_message().map_err(|e| recording(&self.path, &e))?;
            let Some(message) = message else {
                if let Some(why) = self.reader.cut_off() {
                    warn!("{}: played up to where it is cut off: {why}", self.path.display());
                }
                if !self.repeat || !std::mem::take(&mut self.has_played) {
                    return Ok(None);
                }
                self.reader = open(&self.path)?;
                continue;
            };
            if message.topic() != self.topic {
                continue;
            }
            match self.decoder.decode_into(&self.path, &message, out) {
                Ok(()) => {
                    self.has_played = true;
                    return Ok(Some(message.stamp_ns));
                }
                // The first image tells whether the camera is that of the recording.
                Err(error) if self.strict || !self.has_played && self.left_out == 0 => return Err(error),
                Err(error) => {
                    self.left_out += 1;
                    warn!(left_out = self.left_out, "{error}; played without it (--strict stops)");
                }
            }
        }
    }

    pub(super) fn failed(&self, what: String) -> SourceError {
        SourceError::Recording { file: self.path.clone(), what }
    }
}

impl ScheduledSource for RecordedCamera {
    fn arm(&mut self, _state: &JointState) {}

    fn expose(&mut self, _exposure: &Exposure, out: &mut [u8]) -> Result<Exposed, SourceError> {
        Ok(if self.decode_next(out)?.is_some() { Exposed::Image } else { Exposed::End })
    }

    fn is_known_ahead(&self) -> bool {
        true
    }
}

pub(super) fn recording(path: &Path, error: &RecordingError) -> SourceError {
    SourceError::Recording { file: path.into(), what: error.to_string() }
}

pub(super) fn open(path: &Path) -> Result<RecordingReader<BufReader<File>>, SourceError> {
    let file = image_file::open_plain(path)?;
    RecordingReader::open(BufReader::new(file)).map_err(|e| recording(path, &e))
}

/// The topic that is `wanted` of a recording.
fn topic(path: &Path, wanted: &RecordedTopic<'_>) -> Result<String, SourceError> {
    if let Some(topic) = wanted.topic {
        return Ok(topic.into());
    }
    let mut reader = open(path)?;
    let mut own = format!("/camera/{}/frame", wanted.camera);
    // Topics are told before their first messages: those of all cameras stand there when the first image comes, or a few messages later.
    let mut found = Vec::new();
    while let Some(message) = reader.next_message().map_err(|e| recording(path, &e))? {
        if is_image(message.definition()) {
            break;
        }
    }
    found.extend(reader.topics().filter(|(_, kind)| is_image(Some(kind))).map(|(topic, _)| topic.to_owned()));
    let (what, list) = match found.as_slice() {
        [] => ("holds no images", String::new()),
        [only] => {
            own.clone_from(only);
            return Ok(own);
        }
        several if several.contains(&own) => return Ok(own),
        several => ("holds several cameras, name one with camera.replay.topic: ", several.join(", ")),
    };
    Err(SourceError::Recording { file: path.into(), what: format!("{what}{list}") })
}

fn is_image(definition: Option<&str>) -> bool {
    matches!(definition, Some(IMAGE | COMPRESSED_IMAGE))
}

/// Makes recorded images grey.
struct GreyImages {
    size: Size,
    decoder: Option<(PixelFormat, ToGrey)>,
}

impl GreyImages {
    fn new(size: Size) -> Self {
        Self { size, decoder: None }
    }

    /// Writes the grey levels of the image in `message` to `out`.
    fn decode_into(
        &mut self,
        path: &Path,
        message: &RecordedMessage<'_>,
        out: &mut [u8],
    ) -> Result<(), SourceError> {
        let failed = |what: String| SourceError::Recording { file: path.into(), what };
        match message.definition() {
            Some(IMAGE) => {
                let image = RosImage::take(message.data());
                let (_, image) = image.ok_or_else(|| failed("an image is damaged".into()))?;
                image_file::check_size(path, (image.width_px, image.height_px), self.size)?;
                let Some(format) = pixel_format(&image) else {
                    let known = "mono8, mono16, bgr8, rgb8, yuv422_yuy2 and uyvy";
                    return Err(failed(format!(
                        "images have the encoding {}; known are {known}",
                        image.encoding
                    )));
                };
                let Size { width, height } = self.size;
                let decoder = match &mut self.decoder {
                    Some((known, decoder)) if *known == format => decoder,
                    place => &mut place.insert((format, ToGrey::new(format, width, height))).1,
                };
                decoder
                    .convert(image.data, image.stride_bytes as usize, out)
                    .map_err(|error| failed(format!("an image is damaged: {error}")))
            }
            Some(COMPRESSED_IMAGE) => {
                let file = compressed_image(message.data());
                let file = file.ok_or_else(|| failed("an image is damaged".into()))?;
                image_file::decode_into(path, file, self.size, out)
            }
            _ => Err(failed(format!("{} carries no images", message.topic()))),
        }
    }
}

/// The format of a ROS encoding (sensor_msgs/image_encodings.hpp); `None` where it is not known here.
fn pixel_format(image: &RosImage<'_>) -> Option<PixelFormat> {
    Some(match image.encoding {
        "mono8" | "8UC1" => PixelFormat::Grey,
        "mono16" | "16UC1" if !image.is_bigendian => PixelFormat::Y16,
        "bgr8" | "8UC3" => PixelFormat::Bgr3,
        "rgb8" => PixelFormat::Rgb3,
        "yuv422_yuy2" | "yuyv" => PixelFormat::Yuyv,
        "yuv422" | "uyvy" => PixelFormat::Uyvy,
        _ => return None,
    })
}

impl std::fmt::Debug for RecordedCamera {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RecordedCamera")
            .field("path", &self.path)
            .field("topic", &self.topic)
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::FrameHeader;
    use crate::record::RecordingWriter;
    use crate::time::{MonoNs, SpanNs};
    use std::collections::BTreeMap;

    const EXPOSURE: Exposure = Exposure { frame_id: 0, mid: MonoNs(0), span: SpanNs(0) };

    /// `sensor_msgs/msg/Image` of 4 x 2 px with `data` in `encoding`, laid out by hand: XCDR1 from the OMG's tables, with lines `stride` bytes apart.
    fn ros_image(encoding: &str, stride: u32, data: &[u8]) -> Vec<u8> {
        let mut bytes = vec![0_u8, 1, 0, 0];
        let number = |bytes: &mut Vec<u8>, value: u32| {
            while !bytes.len().is_multiple_of(4) {
                bytes.push(0);
            }
            bytes.extend_from_slice(&value.to_le_bytes());
        };
        let text = |bytes: &mut Vec<u8>, text: &str| {
            number(bytes, text.len() as u32 + 1);
            bytes.extend_from_slice(text.as_bytes());
            bytes.push(0);
        };
        number(&mut bytes, 12);
        number(&mut bytes, 500);
        text(&mut bytes, "optical_frame");
        number(&mut bytes, 2);
        number(&mut bytes, 4);
        text(&mut bytes, encoding);
        bytes.push(0);
        number(&mut bytes, stride);
        number(&mut bytes, data.len() as u32);
        bytes.extend_from_slice(data);
        bytes
    }

    fn compressed(file: &[u8]) -> Vec<u8> {
        let mut bytes = vec![0_u8, 1, 0, 0];
        for number in [12_u32, 500, 2] {
            bytes.extend_from_slice(&number.to_le_bytes());
        }
        bytes.extend_from_slice(b"c\0\0\0"); // the frame's name, filled up to the next number
        bytes.extend_from_slice(&4_u32.to_le_bytes());
        bytes.extend_from_slice(b"png\0");
        bytes.extend_from_slice(&(file.len() as u32).to_le_bytes());
        bytes.extend_from_slice(file);
        bytes
    }

    /// A recording with these messages of ROS: topic, type, bytes.
    fn recorded(messages: &[(&str, &str, Vec<u8>)]) -> tempfile::NamedTempFile {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        let mut writer = RecordingWriter::new(file.as_file_mut(), &BTreeMap::new()).unwrap();
        let mut topics = BTreeMap::new();
        for (topic, kind, _) in messages {
            topics.entry(*topic).or_insert_with(|| writer.add_cdr(topic, kind, "uint8[] data").unwrap());
        }
        for (k, (topic, _, bytes)) in (0..).zip(messages) {
            writer.write_copied(topics[topic], k, k, bytes).unwrap();
        }
        writer.finish(&BTreeMap::new()).unwrap();
        file
    }

    fn wanted(topic: Option<&str>) -> RecordedTopic<'_> {
        RecordedTopic { topic, camera: CameraId::FIRST, size_px: (4, 2), repeat: false, strict: false }
    }

    fn played(camera: &mut RecordedCamera, count: usize) -> Vec<Option<Vec<u8>>> {
        let mut out = vec![0; 8];
        (0..count)
            .map(|_| (camera.expose(&EXPOSURE, &mut out).unwrap() == Exposed::Image).then(|| out.clone()))
            .collect()
    }

    #[test]
    fn frames_of_vservo_are_played_as_they_were() {
        let mut file = tempfile::NamedTempFile::new().unwrap();
        let mut writer = RecordingWriter::new(file.as_file_mut(), &BTreeMap::new()).unwrap();
        let topics = [0, 1].map(|n| writer.add_images(&format!("/camera/{n}/frame"), "camera").unwrap());
        for k in 0..3_u8 {
            for (n, topic) in (0..).zip(&topics) {
                let header = FrameHeader {
                    frame_id: u64::from(k),
                    width_px: 4,
                    height_px: 2,
                    ..FrameHeader::default()
                };
                writer.write_image(topic, &header, &[10 * k + n; 8]).unwrap();
            }
        }
        writer.finish(&BTreeMap::new()).unwrap();
        for n in [0_u8, 1] {
            let mut camera =
                RecordedCamera::open(file.path(), &RecordedTopic { camera: CameraId(n), ..wanted(None) })
                    .unwrap();
            let seen = played(&mut camera, 4);
            let levels: Vec<_> = seen.iter().map(|pixels| pixels.as_ref().map(|pixels| pixels[7])).collect();
            assert_eq!(levels, [Some(n), Some(10 + n), Some(20 + n), None]);
        }
        let again = RecordedTopic { repeat: true, ..wanted(None) };
        let mut camera = RecordedCamera::open(file.path(), &again).unwrap();
        let levels: Vec<_> = played(&mut camera, 7).iter().flatten().map(|pixels| pixels[0]).collect();
        assert_eq!(levels, [0, 10, 20, 0, 10, 20, 0]);
    }

    #[test]
    fn images_of_other_programs_become_grey() {
        let grey = [3_u8, 50, 90, 130, 170, 210, 250, 7];
        let padded: Vec<u8> = grey.chunks(4).flat_map(|row| [row, &[99, 99]].concat()).collect();
        let colours: Vec<u8> = grey.iter().flat_map(|level| [*level; 3]).collect();
        let wide: Vec<u8> = grey.iter().flat_map(|level| [0x5A, *level]).collect();
        let png = crate::source::encode_png(&grey, 4, 2, image::ExtendedColorType::L8).unwrap();
        for (kind, bytes) in [
            (IMAGE, ros_image("mono8", 4, &grey)),
            (IMAGE, ros_image("mono8", 6, &padded)),
            (IMAGE, ros_image("bgr8", 12, &colours)),
            (IMAGE, ros_image("rgb8", 12, &colours)),
            (IMAGE, ros_image("mono16", 8, &wide)),
            (COMPRESSED_IMAGE, compressed(&png)),
        ] {
            let file = recorded(&[("/image_raw", kind, bytes)]);
            let mut camera = RecordedCamera::open(file.path(), &wanted(None)).unwrap();
            assert_eq!(camera.topic, "/image_raw");
            assert_eq!(played(&mut camera, 2), [Some(grey.to_vec()), None]);
        }
    }

    #[test]
    fn what_cannot_be_played_is_told() {
        let message = |result: Result<RecordedCamera, SourceError>| result.unwrap_err().to_string();
        let good = ros_image("mono8", 4, &[1; 8]);
        let two = recorded(&[("/left", IMAGE, good.clone()), ("/right", IMAGE, good.clone())]);
        let told = message(RecordedCamera::open(two.path(), &wanted(None)));
        assert!(told.contains("/left, /right") && told.contains("camera.replay.topic"), "{told}");
        assert!(RecordedCamera::open(two.path(), &wanted(Some("/right"))).is_ok());
        assert!(message(RecordedCamera::open(two.path(), &wanted(Some("/up")))).contains("no image on /up"));
        let none = recorded(&[("/chatter", "std_msgs/msg/String", vec![0, 1, 0, 0])]);
        assert!(message(RecordedCamera::open(none.path(), &wanted(None))).contains("holds no images"));
        let depth = recorded(&[("/depth", IMAGE, ros_image("32FC1", 16, &[0; 32]))]);
        assert!(message(RecordedCamera::open(depth.path(), &wanted(None))).contains("encoding 32FC1"));
        let wide = RecordedTopic { size_px: (5, 2), ..wanted(Some("/left")) };
        assert!(message(RecordedCamera::open(two.path(), &wide)).contains("is 4x2 px, the camera is 5x2 px"));
        let text = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(text.path(), "no recording").unwrap();
        assert!(message(RecordedCamera::open(text.path(), &wanted(None))).contains("is no recording"));
        assert!(message(RecordedCamera::open(std::path::Path::new("/"), &wanted(None))).contains("a folder"));
    }

    #[test]
    fn a_damaged_image_is_left_out_unless_that_is_strict() {
        let good = |level| ros_image("mono8", 4, &[level; 8]);
        let mut short = good(2);
        short.truncate(40);
        let file = recorded(&[
            ("/a", IMAGE, good(1)),
            ("/a", IMAGE, short),
            ("/a", IMAGE, ros_image("mono8", 4, &[2; 7])),
            ("/a", IMAGE, good(3)),
        ]);
        let mut camera = RecordedCamera::open(file.path(), &wanted(None)).unwrap();
        let levels: Vec<_> = played(&mut camera, 3).iter().flatten().map(|pixels| pixels[0]).collect();
        assert_eq!((levels, camera.left_out), (vec![1, 3], 2));
        let strict = RecordedTopic { strict: true, ..wanted(None) };
        let mut camera = RecordedCamera::open(file.path(), &strict).unwrap();
        assert_eq!(played(&mut camera, 1), [Some(vec![1; 8])]);
        assert!(camera.expose(&EXPOSURE, &mut [0; 8]).is_err());
    }
}
