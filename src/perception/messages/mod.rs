//! The plain records that flow between the cores, and between the processes over shared memory.
//!
//! Each is `repr(C)` without pointers and carries a versioned type name: a peer in another language binds by
//! that name, and reads the bytes of shared memory directly. A change of a field requires a new version in the name and
//! in the layout tests. Enumerations are sent as integer codes, because shared memory may hold a value that no variant has.
//!
//! ```text
//! camera --FrameHeader + [u8]--> vision --Measurement--> control --JointState--> camera
//! external camera --ImageHeader + [u8]--> camera
//! camera --CameraHealth--> control                       │  ├------Status--> supervisor, views
//!                                                        │  └----TraceMsg, RequestMsg--> recorder
//!                                                        └-DriveCommandMsg--> external drive --DriveStateMsg, DriveTextMsg--> control
//! ```

mod camera_health;
mod camera_id;
mod command;
mod drive;
mod drive_text;
mod frame;
mod joint_state;
mod layout;
mod measurement;
mod record_layouts;
mod request;
mod status;
#[cfg(test)]
mod tests;
mod trace;

pub use camera_health::{CameraHealth, CameraState, health_flag};
pub use camera_id::CameraId;
pub use command::{COMMAND_VALUES, CommandForm, ControlAnswer, ControlCommand, answer_flag};
pub use drive::{DriveCommandMsg, DriveStateMsg, RobotState, drive_flag};
pub use drive_text::{DRIVE_TEXT_BYTES, DriveTextMsg, text_kind};
pub use frame::{FrameHeader, ImageHeader, frame_flag};
pub use joint_state::{JointState, joint_flag};
pub use layout::{FieldType, FieldValue, MessageRecord, NamedCode, RecordField, RecordLayout};
pub use measurement::{FeaturePoint, Measurement, TargetStatus, measurement_flag};
pub use record_layouts::RECORD_LAYOUTS;
pub use request::RequestMsg;
pub use status::{ControlState, Status, status_flag};
pub use trace::{TRACE_LIMITS, TraceMsg, trace_flag};

/// Most joints that an arm may have, so that records have a fixed layout: seven are what a redundant arm of today has.
pub const MAX_JOINTS: usize = 7;

/// Most cameras that a cell may have, so that each has its services and locks. Chosen by hand: a pair, and two that only observe;
/// each further one needs names and locks alone.
pub const MAX_CAMERAS: usize = 4;

/// Most features that one measurement carries, so that records have a fixed layout. Chosen: a grid of 8 by 8; of more, one point lowers the
/// standard deviation of a pose by less than a hundredth.
pub const MAX_FEATURES: usize = 64;
