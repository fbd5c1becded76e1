//! A frame as `sensor_msgs/msg/Image`, of 8-bit grey, in XCDR1.

use super::CDR_LITTLE_ENDIAN;
use crate::messages::{FieldValue, FrameHeader};
use crate::time::MonoNs;

/// Name of the definition.
pub(crate) const NAME: &str = "sensor_msgs/msg/Image";
/// The definition (sensor_msgs of ROS 2 Humble, without its comments).
pub(crate) const SCHEMA: &str = "std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
";
/// 8-bit grey, as ROS calls it.
const ENCODING: &str = "mono8";
/// Nanoseconds in a second, which follows from the unit.
const NS_PER_S: i64 = 1_000_000_000;

/// A frame, as a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ImageMessage<'a> {
    /// Middle of its exposure, to be shown as a stamp of ROS.
    pub stamp: MonoNs,
    /// Columns, px.
    pub width_px: u32,
    /// Rows, px.
    pub height_px: u32,
    /// Grey levels, row by row.
    pub pixels: &'a [u8],
}

impl<'a> ImageMessage<'a> {
    /// Of a frame as it was sent.
    #[must_use]
    pub fn new(header: &FrameHeader, pixels: &'a [u8]) -> Self {
        let FrameHeader { exposure, width_px, height_px, .. } = *header;
        Self { stamp: exposure, width_px, height_px, pixels }
    }

    /// Appends the message; `camera` is the name of its coordinate frame.
    pub(crate) fn put(&self, camera: &str, bytes: &mut Vec<u8>) {
        bytes.extend_from_slice(&CDR_LITTLE_ENDIAN);
        let begin = bytes.len();
        let seconds = i32::try_from(self.stamp.0.div_euclid(NS_PER_S)).unwrap_or_default();
        bytes.extend_from_slice(&seconds.to_le_bytes());
        (self.stamp.0.rem_euclid(NS_PER_S) as u32).put(bytes);
        put_text(camera, begin, bytes);
        put_u32(self.height_px, begin, bytes);
        put_u32(self.width_px, begin, bytes);
        put_text(ENCODING, begin, bytes);
        bytes.push(0); // little-endian, as far as bytes can be
        put_u32(self.width_px, begin, bytes);
        put_u32(u32::try_from(self.pixels.len()).unwrap_or_default(), begin, bytes);
        bytes.extend_from_slice(self.pixels);
    }

    /// The frame in a message; `None` where it is none of 8-bit grey.
    #[must_use]
    pub fn take(message: &'a [u8]) -> Option<Self> {
        let (stamp, image) = RosImage::take(message)?;
        let RosImage { width_px, height_px, encoding, is_bigendian: _, stride_bytes, data } = image;
        let size = u64::from(width_px) * u64::from(height_px);
        let fits = stride_bytes == width_px && data.len() as u64 == size;
        (encoding == ENCODING && fits).then_some(Self { stamp, width_px, height_px, pixels: data })
    }
}

/// An image as any ROS program records it, `sensor_msgs/msg/Image`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RosImage<'a> {
    /// Columns, px.
    pub width_px: u32,
    /// Rows, px.
    pub height_px: u32,
    /// How pixels are laid out (`mono8`, `bgr8`, ...).
    pub encoding: &'a str,
    /// Whether numbers of more than a byte begin with their highest.
    pub is_bigendian: bool,
    /// From one row to the next, bytes.
    pub stride_bytes: u32,
    /// The rows.
    pub data: &'a [u8],
}

impl<'a> RosImage<'a> {
    /// The image in a message with its stamp; `None` where it is none.
    #[must_use]
    pub fn take(message: &'a [u8]) -> Option<(MonoNs, Self)> {
        let mut input = CdrInput { rest: message.strip_prefix(&CDR_LITTLE_ENDIAN)?, at: 0 };
        let stamp = input.header()?;
        let (height_px, width_px) = (input.u32()?, input.u32()?);
        let encoding = input.text()?;
        let is_bigendian = input.bytes(1)? != [0];
        let (stride_bytes, data) = (input.u32()?, input.sequence()?);
        Some((stamp, Self { width_px, height_px, encoding, is_bigendian, stride_bytes, data }))
    }
}

/// The file of an image in a message of `sensor_msgs/msg/CompressedImage`; `None` where it is none.
#[must_use]
pub fn compressed_image(message: &[u8]) -> Option<&[u8]> {
    let mut input = CdrInput { rest: message.strip_prefix(&CDR_LITTLE_ENDIAN)?, at: 0 };
    input.header()?;
    input.text()?; // the format, which the file tells itself
    input.sequence()
}

/// Fills up to a multiple of four bytes from `begin`, then the number.
fn put_u32(value: u32, begin: usize, bytes: &mut Vec<u8>) {
    while !(bytes.len() - begin).is_multiple_of(4) {
        bytes.push(0);
    }
    value.put(bytes);
}

fn put_text(text: &str, begin: usize, bytes: &mut Vec<u8>) {
    put_u32(u32::try_from(text.len() + 1).unwrap_or_default(), begin, bytes);
    bytes.extend_from_slice(text.as_bytes());
    bytes.push(0);
}

/// Reads values where their alignment puts them.
struct CdrInput<'a> {
    rest: &'a [u8],
    at: usize,
}

impl<'a> CdrInput<'a> {
    fn bytes(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.rest.split_at_checked(count)?;
        self.rest = rest;
        self.at += count;
        Some(taken)
    }

    fn u32(&mut self) -> Option<u32> {
        self.bytes(self.at.next_multiple_of(4) - self.at)?;
        u32::take(&mut self.bytes(4)?)
    }

    /// A stamp and the name of a coordinate frame; the stamp.
    fn header(&mut self) -> Option<MonoNs> {
        let seconds = i64::from(self.u32()?.cast_signed());
        let stamp = MonoNs(seconds * NS_PER_S + i64::from(self.u32()?));
        self.sequence()?;
        Some(stamp)
    }

    fn text(&mut self) -> Option<&'a str> {
        std::str::from_utf8(self.sequence()?.strip_suffix(&[0])?).ok()
    }

    fn sequence(&mut self) -> Option<&'a [u8]> {
        let count = self.u32()?;
        self.bytes(count as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_frame_comes_back_as_it_was(
            stamp in -1_000_000_000_000_i64..i64::from(i32::MAX) * NS_PER_S,
            width_px in 0_u32..20, height_px in 0_u32..20, camera in "[a-z0-9/_]{0,12}", seed: u8,
        ) {
            let pixels: Vec<u8> = (0..width_px * height_px).map(|i| (i as u8).wrapping_mul(seed)).collect();
            let image = ImageMessage { stamp: MonoNs(stamp), width_px, height_px, pixels: &pixels };
            let mut bytes = Vec::new();
            image.put(&camera, &mut bytes);
            prop_assert_eq!(ImageMessage::take(&bytes), Some(image));
            for cut in 0..bytes.len() {
                prop_assert_eq!(ImageMessage::take(&bytes[..cut]), None);
            }
        }

        #[test]
        fn other_bytes_are_no_frame(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
            prop_assert_eq!(ImageMessage::take(&bytes), None);
        }
    }
}
