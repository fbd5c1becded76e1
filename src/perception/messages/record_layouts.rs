//! The layouts of all records, for what is made from them: recordings, and texts for other languages.

use super::{
    CameraHealth, ControlAnswer, ControlCommand, DriveCommandMsg, DriveStateMsg, DriveTextMsg, FrameHeader,
    ImageHeader, JointState, Measurement, MessageRecord, RecordLayout, RequestMsg, Status, TraceMsg,
};

/// The layouts of all records.
pub const RECORD_LAYOUTS: [&RecordLayout; 13] = [
    CameraHealth::LAYOUT,
    ControlAnswer::LAYOUT,
    ControlCommand::LAYOUT,
    DriveCommandMsg::LAYOUT,
    DriveStateMsg::LAYOUT,
    DriveTextMsg::LAYOUT,
    FrameHeader::LAYOUT,
    ImageHeader::LAYOUT,
    JointState::LAYOUT,
    Measurement::LAYOUT,
    RequestMsg::LAYOUT,
    Status::LAYOUT,
    TraceMsg::LAYOUT,
];
