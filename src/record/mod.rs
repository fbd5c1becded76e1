//! Recordings: files in the format MCAP (mcap.dev, version 0) that hold every record and frame of a run as it was sent.
//!
//! ```text
//! header, profile "ros2"
//! attachments   run file as resolved, robot files, machine        metadata `vservo`: version, clock, instance
//! chunk         schemas and topics                                so that every later chunk can be read
//! chunk, ...    messages of at most a second, compressed by lz4   whole on the disk before the next one is begun
//! metadata      `vservo.end`: recorded, lost                      only in a file whose recorder came to its end
//! summary       index of the chunks                               likewise
//! ```
//! A message is the record itself behind the four bytes that name its encoding: on a little-endian machine a `repr(C)` record without
//! gaps is what XCDR1 makes of it ([`crate::messages::RecordLayout`]), so that a recording is exact to the bit and can be read by every
//! program that knows ROS 2. Frames are `sensor_msgs/msg/Image`, with the header of each on a topic of its own.

mod image_message;
mod reader;
mod ros2_schema;
mod sequence_counter;
#[cfg(test)]
mod tests;
mod writer;

pub use image_message::{ImageMessage, RosImage, compressed_image};
pub(crate) use image_message::{NAME as IMAGE_NAME, SCHEMA as IMAGE_SCHEMA};
pub use reader::{RecordedMessage, RecordingReader};
pub use ros2_schema::{ros2_name, ros2_schema};
pub use sequence_counter::SequenceCounter;
pub use writer::{CopiedTopic, ImageTopic, RecordTopic, RecordingWriter};

use mcap::McapError;
use thiserror::Error;

/// What names the encoding of a message: XCDR1, little-endian, no options (OMG DDSI-RTPS 2.5, 10.2).
pub(crate) const CDR_LITTLE_ENDIAN: [u8; 4] = [0, 1, 0, 0];

/// Name of the metadata that tells what was recorded.
pub const ABOUT: &str = "vservo";
/// Name of the metadata that tells how the recording ended.
pub const END: &str = "vservo.end";
/// Name of the attachment with the run file as resolved.
pub const RUN_FILE: &str = "run.toml";
/// The key of [`END`] with the reason for which the supervisor ended the run before its time, which control does not know.
pub const FAILURE: &str = "failure";
/// The key of [`END`] with what a black box was written for.
pub const KEPT_BECAUSE: &str = "kept because";

impl From<McapError> for RecordingError {
    /// What the system says is of the disk; what a decompressor says is of the file.
    fn from(error: McapError) -> Self {
        match error {
            McapError::Io(cause) if cause.raw_os_error().is_some() => Self::Io(cause),
            error => Self::Format(error),
        }
    }
}

/// A recording cannot be written or read.
#[derive(Debug, Error)]
pub enum RecordingError {
    /// The file cannot be read.
    #[error("cannot be read: {0}")]
    Io(#[from] std::io::Error),
    /// What is in it is no recording, or a damaged one.
    #[error("is no recording, or damaged: {0}")]
    Format(McapError),
    /// A message does not have the form that its topic says.
    #[error("a message on {topic} is no {expected}")]
    Message {
        /// Where.
        topic: String,
        /// What was expected.
        expected: &'static str,
    },
    /// A topic has records of another version of this program.
    #[error("{topic} carries {found}, this program knows {expected}")]
    Version {
        /// Where.
        topic: String,
        /// What the file says.
        found: String,
        /// What this program has.
        expected: &'static str,
    },
}
