//! Whether the camera's frames are mirrored: a target that was never found is looked for in the mirrored frame now and then. Webcams and the programs before them
//! mirror images for people who look at themselves.

use crate::camera_model::CameraModel;
use crate::imaging::ImageView;
use crate::messages::TargetStatus;

/// Of the frames without a target the first is looked at, and each so many after it. Chosen by hand: at 25 Hz twice a second, for a tenth of the time that searches take.
const EACH: u32 = 12;

/// The search in mirrored frames.
#[derive(Debug, Clone)]
pub(super) struct MirroredSearch {
    /// The mirrored frame.
    pixels: Vec<u8>,
    /// Frames without a target.
    missed: u32,
    /// Whether the target was in the last mirrored frame.
    is_mirrored: bool,
    /// Whether the target was found as it is: then frames are not mirrored.
    is_over: bool,
}

impl MirroredSearch {
    /// For frames of `camera`; nothing is allocated later.
    pub(super) fn with_room_for(camera: &CameraModel) -> Self {
        let i = camera.intrinsics();
        let count = i.width_px as usize * i.height_px as usize;
        Self { pixels: Vec::with_capacity(count), missed: 0, is_mirrored: false, is_over: false }
    }

    /// The target was found in a frame as it is.
    pub(super) fn found(&mut self) {
        self.is_over = true;
    }

    /// The status of a frame without the target, for which the search says `status`; `finds` searches an image.
    pub(super) fn look(
        &mut self,
        status: TargetStatus,
        image: &ImageView<'_>,
        finds: impl FnOnce(&ImageView<'_>) -> bool,
    ) -> TargetStatus {
        let is_vain = matches!(status, TargetStatus::WrongSize | TargetStatus::NoContrast);
        let fits = image.width() * image.height() <= self.pixels.capacity();
        if self.is_over || is_vain || !fits {
            return status;
        }
        if self.missed.is_multiple_of(EACH) {
            self.pixels.clear();
            for row in (0..image.height()).map(|row| image.row(row)) {
                self.pixels.extend(row.iter().rev());
            }
            let mirrored = ImageView::new(&self.pixels, image.width(), image.height());
            self.is_mirrored = mirrored.is_ok_and(|mirrored| finds(&mirrored));
        }
        self.missed = self.missed.wrapping_add(1);
        if self.is_mirrored { TargetStatus::Mirrored } else { status }
    }
}
