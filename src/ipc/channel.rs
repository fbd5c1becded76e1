//! The names of the services, each from this one place.

use crate::messages::CameraId;
use std::fmt;

/// A service of an instance.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Channel {
    /// A camera's frames.
    Frame(CameraId),
    /// Images that another program gives to the camera process.
    Image(CameraId),
    /// How a real camera stands.
    Health(CameraId),
    /// What vision measured in them.
    Measurement(CameraId),
    /// The arm at each tick.
    JointState,
    /// Everything about each tick.
    Trace,
    /// Where the run stands.
    Status,
    /// Requests to control.
    Command,
    /// Requests that control has answered.
    Request,
    /// Commands to an external drive.
    DriveCommand,
    /// States of an external drive.
    DriveState,
    /// Words of an external drive.
    DriveText,
}

/// The service's name.
impl fmt::Display for Channel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Frame(id) => write!(f, "camera/{id}/frame"),
            Self::Image(id) => write!(f, "camera/{id}/image"),
            Self::Health(id) => write!(f, "camera/{id}/health"),
            Self::Measurement(id) => write!(f, "vision/{id}/measurement"),
            Self::JointState => f.write_str("control/joint_state"),
            Self::Trace => f.write_str("control/trace"),
            Self::Status => f.write_str("control/status"),
            Self::Request => f.write_str("control/request"),
            Self::Command => f.write_str("control/command"),
            Self::DriveCommand => f.write_str("drive/command"),
            Self::DriveState => f.write_str("drive/state"),
            Self::DriveText => f.write_str("drive/text"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_carry_the_camera() {
        assert_eq!(Channel::Frame(CameraId::FIRST).to_string(), "camera/0/frame");
        assert_eq!(Channel::Health(CameraId(2)).to_string(), "camera/2/health");
        assert_eq!(Channel::Measurement(CameraId(3)).to_string(), "vision/3/measurement");
    }
}
