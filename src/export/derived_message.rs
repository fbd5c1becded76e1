//! What messages for viewers have in common: their form, and the names of frames.

use super::definitions::{definition, full_name};
use crate::config::{Config, FIRST_TARGET};
use crate::messages::CameraId;
use crate::time::MonoNs;

/// The name of the base's frame.
pub(super) const BASE: &str = "base";
/// That of the flange.
pub(super) const FLANGE: &str = "flange";
/// That of the target.
pub(super) const TARGET: &str = "target";

/// That of the target with this name in the run file.
pub(super) fn target_frame(name: &str) -> String {
    if name == FIRST_TARGET { TARGET.to_owned() } else { format!("{TARGET}_{name}") }
}

/// The names of the frames of the first target of `cell`, as one camera has it, and of the camera at its goal. A second camera that controls the arm has a target and a goal of its own.
pub(super) fn target_and_goal(cell: &Config) -> (String, String) {
    let of = |name: &str| match cell.camera.id {
        CameraId::FIRST => name.to_owned(),
        id => format!("{name}_{}", camera_frame(id)),
    };
    (of(TARGET), of("goal"))
}

/// Red, green, blue and opacity, 0 to 1.
pub(super) type AnnotationColour = [f64; 4];

/// One message on a topic that a viewer knows.
#[derive(Debug, Clone, PartialEq)]
pub struct DerivedMessage {
    /// Its topic.
    pub topic: String,
    /// The name of its definition.
    pub(super) definition: &'static str,
    /// The instant that it is about.
    pub stamp: MonoNs,
    /// The message in XCDR1.
    pub data: Vec<u8>,
}

impl DerivedMessage {
    /// The name of its type as ROS 2 has it, and its definition with those that it uses.
    #[must_use]
    pub fn schema(&self) -> (String, String) {
        (full_name(self.definition), definition(self.definition))
    }
}

/// The frame of a camera.
pub(super) fn camera_frame(camera: CameraId) -> String {
    format!("camera_{camera}")
}
