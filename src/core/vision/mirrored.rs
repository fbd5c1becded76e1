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
        if self.is_over || !may_be_mirrored(status) {
            return status;
        }
        if self.missed.is_multiple_of(EACH) {
            self.is_mirrored = self.shows(image, finds);
        }
        self.missed = self.missed.wrapping_add(1);
        if self.is_mirrored { TargetStatus::Mirrored } else { status }
    }

    /// The same of a single image.
    pub(super) fn look_once(
        &mut self,
        status: TargetStatus,
        image: &ImageView<'_>,
        finds: impl FnOnce(&ImageView<'_>) -> bool,
    ) -> TargetStatus {
        let is_mirrored = may_be_mirrored(status) && self.shows(image, finds);
        if is_mirrored { TargetStatus::Mirrored } else { status }
    }

    /// Whether the mirrored image shows what `finds` looks for.
    fn shows(&mut self, image: &ImageView<'_>, finds: impl FnOnce(&ImageView<'_>) -> bool) -> bool {
        let fits = image.width() * image.height() <= self.pixels.capacity();
        self.pixels.clear();
        for row in (0..image.height()).map(|row| image.row(row)).filter(|_| fits) {
            self.pixels.extend(row.iter().rev());
        }
        let mirrored = ImageView::new(&self.pixels, image.width(), image.height());
        fits && mirrored.is_ok_and(|mirrored| finds(&mirrored))
    }
}

/// Whether a frame of this status may be mirrored. Tags of other ids were read, so that it is not; the other reasons say that there is nothing to look at, or that a search takes too long as it is.
fn may_be_mirrored(status: TargetStatus) -> bool {
    matches!(status, TargetStatus::NoMatch | TargetStatus::TooFewRegions)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera_model::{Distortion, Intrinsics};

    #[test]
    fn only_what_may_be_mirrored_is_searched_again() {
        let lens = Intrinsics { fx_px: 9.0, fy_px: 9.0, cx_px: 8.0, cy_px: 8.0, width_px: 16, height_px: 16 };
        let camera = CameraModel::new(lens, Distortion::default()).unwrap();
        let pixels: Vec<u8> = (0..=255).collect();
        let image = ImageView::new(&pixels, 16, 16).unwrap();
        let exchanged = |mirrored: &ImageView<'_>| mirrored.row(3).iter().rev().eq(image.row(3));
        let mut search = MirroredSearch::with_room_for(&camera);
        for status in [
            TargetStatus::OtherTags,
            TargetStatus::NoContrast,
            TargetStatus::GivenUp,
            TargetStatus::Ambiguous,
        ] {
            assert_eq!(search.look(status, &image, |_| panic!("{status:?} is no mirrored frame")), status);
        }
        assert_eq!(search.look(TargetStatus::NoMatch, &image, exchanged), TargetStatus::Mirrored);
        // In between the last answer stands, and what is found as it is ends the question.
        for _ in 1..EACH {
            assert_eq!(
                search.look(TargetStatus::NoMatch, &image, |_| panic!("too soon")),
                TargetStatus::Mirrored
            );
        }
        assert_eq!(search.look(TargetStatus::NoMatch, &image, |_| false), TargetStatus::NoMatch);
        search.found();
        for _ in 0..2 * EACH {
            assert_eq!(search.look(TargetStatus::NoMatch, &image, |_| true), TargetStatus::NoMatch);
        }
    }
}
