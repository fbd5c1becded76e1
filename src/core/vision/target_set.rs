//! Several targets, one at a time: each has its own finder and buffers, made at the start, and control says with every joint state which one it wants
//! ([`TargetChoice`](super::TargetChoice)).

use super::{Frame, Prior, Vision};
use crate::camera_model::CameraModel;
use crate::messages::{Measurement, TargetStatus};

/// The visions of all targets of a run, of which one at a time looks at the frames.
#[derive(Debug, Clone)]
pub struct TargetSet {
    /// By the targets' numbers; never empty.
    all: Vec<Vision>,
    now: usize,
}

impl TargetSet {
    /// `first` for the target 0, and one vision for each of the others.
    #[must_use]
    pub fn new(first: Vision, further: impl IntoIterator<Item = Vision>) -> Self {
        Self { all: std::iter::once(first).chain(further).collect(), now: 0 }
    }

    /// The vision that looks at present.
    fn present(&self) -> &Vision {
        &self.all[self.now]
    }

    /// The model of the camera.
    #[must_use]
    pub fn camera(&self) -> &CameraModel {
        self.present().camera()
    }

    /// Number of the target that is looked for.
    #[must_use]
    pub fn wanted(&self) -> u32 {
        self.now as u32
    }

    /// As [`Vision::missed_in_words`], of the target that is looked for.
    #[must_use]
    pub fn missed_in_words(&self, status: TargetStatus) -> String {
        self.present().missed_in_words(status)
    }

    /// As [`Vision::unstated_noise_px`], of the target that is looked for.
    #[must_use]
    pub fn unstated_noise_px(&self) -> f64 {
        self.present().unstated_noise_px()
    }

    /// Measures the target with the number `wanted` in one frame, as [`Vision::process`]; a number that no target has leaves the choice as it is, so that
    /// control, which knows the number of the measurement, refuses it. Allocates nothing.
    pub fn process(&mut self, wanted: u32, frame: &Frame<'_>, prior: &Prior) -> Measurement {
        let wanted = wanted as usize;
        if wanted != self.now && wanted < self.all.len() {
            self.now = wanted;
            // Where this target was when it was last looked for may be long ago.
            self.all[wanted].begin_anew();
        }
        let measurement = self.all[self.now].process(frame, prior);
        let target_lost = self.all.iter().map(|vision| vision.lost).sum();
        Measurement { target_number: self.now as u32, target_lost, ..measurement }
    }
}
