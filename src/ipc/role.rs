//! The parts that the processes of an instance play.

use crate::messages::{CameraId, MAX_CAMERAS};
use std::fmt;

/// The part that a process plays.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Role {
    /// Starts and ends the others.
    Supervisor,
    /// Produces the frames of a camera.
    Camera(CameraId),
    /// Measures in them.
    Vision(CameraId),
    /// Moves the arm.
    Control,
    /// Stands for the arm: the program of an external drive.
    Drive,
    /// Stands for a camera: the program of an external one. Holds no lock.
    CameraProgram(CameraId),
    /// Writes down what the others send.
    Recorder,
    /// Keeps the last minute of it, and writes that down at a fault.
    BlackBox,
    /// Watches control's commands to an external drive, and can only stop.
    Guardian,
}

impl Role {
    /// All roles of an instance.
    pub fn all() -> impl Iterator<Item = Self> {
        let cameras = (0..MAX_CAMERAS as u8).map(CameraId);
        let of_cameras = cameras.flat_map(|id| [Self::Camera(id), Self::Vision(id)]);
        let others =
            [Self::Supervisor, Self::Control, Self::Drive, Self::Recorder, Self::BlackBox, Self::Guardian];
        others.into_iter().chain(of_cameras)
    }

    /// The name of its sub-command.
    #[must_use]
    pub fn command(self) -> &'static str {
        match self {
            Self::Supervisor => "supervisor",
            Self::Camera(_) => "camera",
            Self::Vision(_) => "vision",
            Self::Control => "control",
            Self::Drive => "drive",
            Self::CameraProgram(_) => "camera program",
            Self::Recorder | Self::BlackBox => "record",
            Self::Guardian => "guardian",
        }
    }

    /// Whether it only writes down what the others do: no run waits for it, and it ends with the others.
    #[must_use]
    pub fn only_records(self) -> bool {
        matches!(self, Self::Recorder | Self::BlackBox)
    }

    /// The camera that it is about.
    #[must_use]
    pub fn camera(self) -> Option<CameraId> {
        match self {
            Self::Camera(id) | Self::Vision(id) | Self::CameraProgram(id) => Some(id),
            Self::Supervisor
            | Self::Control
            | Self::Drive
            | Self::Recorder
            | Self::BlackBox
            | Self::Guardian => None,
        }
    }
}

/// The role's name, which is also that of its lock: `camera`, and `camera-1` for the second one.
impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Camera(id) | Self::Vision(id) | Self::CameraProgram(id) if *id != CameraId::FIRST => {
                write!(f, "{}-{id}", self.command())
            }
            Self::Recorder => f.pad("recorder"),
            Self::BlackBox => f.pad("black-box"),
            _ => f.pad(self.command()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn every_role_has_a_name_of_its_own() {
        let names: HashSet<_> = Role::all().map(|role| role.to_string()).collect();
        assert_eq!(names.len(), 6 + 2 * MAX_CAMERAS);
        assert!(names.contains("camera") && names.contains("camera-1") && names.contains("vision-3"));
    }
}
