//! The finder of each kind of target behind one interface: a grey frame in, detections of the target's points out.

use super::chessboard::ChessboardFinder;
use super::shape::ShapeFinder;
use super::tags::{TagDetection, TagPlateFinder};
use super::{Detection, DotFinder, PredictedPoint};
use crate::camera_model::{CameraModel, Response};
use crate::geometry::Pose;
use crate::imaging::ImageView;
use crate::messages::TargetStatus;
use crate::target::Target;
use nalgebra::Vector2;

/// Finder of one target. Owns all buffers: nothing is allocated after construction.
#[derive(Debug, Clone)]
#[allow(clippy::large_enum_variant)] // one in a process
pub enum Finder {
    /// Finder of four dots, of grids of dots, and of dots on the faces of a body.
    Dots(DotFinder),
    /// Finder of the inner corners of a chessboard.
    Chessboard(Box<ChessboardFinder>),
    /// Finder of the corners of tags.
    Tags(TagPlateFinder),
    /// Finder of a polygon or an ellipse by its outline.
    Shape(Box<ShapeFinder>),
}

impl Finder {
    /// A finder for frames of `camera` and one target.
    #[must_use]
    pub fn new(camera: CameraModel, target: &Target) -> Self {
        match target {
            Target::FourDots(_) | Target::DotGrid(_) | Target::DotBody(_) => {
                Self::Dots(DotFinder::new(camera, target, !target.plate().light))
            }
            Target::Tags(tags) => Self::Tags(TagPlateFinder::new(&camera, tags)),
            Target::Chessboard(board) => {
                let i = camera.intrinsics();
                let (width, height) = (i.width_px as usize, i.height_px as usize);
                Self::Chessboard(Box::new(ChessboardFinder::new(
                    board.columns(),
                    board.rows(),
                    width,
                    height,
                )))
            }
            Target::Shape(shape) => Self::Shape(Box::new(ShapeFinder::new(camera, shape))),
        }
    }

    /// The same for a camera of this response. Images must have been linearized where the response is known. Where it is unknown, corners of tags are
    /// corrected by an estimate of its effect, with covariances to match ([`super::tags::TagFinder::for_unknown_response`]); other targets are
    /// detected as before.
    #[must_use]
    pub fn for_response(self, response: &Response) -> Self {
        match (self, response) {
            (Self::Tags(finder), Response::Unknown) => Self::Tags(finder.for_unknown_response()),
            (finder, _) => finder,
        }
    }

    /// The same for a lens that is not known: four dots may look less like a square; other targets are detected as before.
    #[must_use]
    pub fn for_unknown_lens(self) -> Self {
        match self {
            Self::Dots(finder) => Self::Dots(finder.for_unknown_lens()),
            other => other,
        }
    }

    /// Searches the whole frame: fills `found` with the detected points, ids rising.
    ///
    /// # Errors
    /// The status that says why there is no target; never [`TargetStatus::Found`] or `WrongSize`. `found` is then empty.
    pub fn search(&mut self, image: &ImageView<'_>, found: &mut Vec<Detection>) -> Result<(), TargetStatus> {
        match self {
            Self::Dots(finder) => finder.search(image, found),
            Self::Chessboard(finder) => finder.search(image, found),
            Self::Tags(finder) => finder.search(image, found),
            Self::Shape(finder) => finder.search(image, found),
        }
    }

    /// Checks the detections `found` of `image` for partial occlusion: where the visible part of a dot's rim determines its centre, the centre is
    /// measured by that part alone, and the id is added to `harmed`.
    pub fn examine_occlusion(&self, image: &ImageView<'_>, found: &mut [Detection], harmed: &mut Vec<u32>) {
        harmed.clear();
        if let Self::Dots(finder) = self {
            finder.examine_occlusion(image, found, harmed);
        }
    }

    /// Tracks the points in windows about their predictions (ids rising): fills `found` with those that were detected unambiguously and not occluded.
    /// Returns whether they can be the target; `found` is empty when not.
    pub fn track(
        &mut self,
        image: &ImageView<'_>,
        expected: &[PredictedPoint],
        found: &mut Vec<Detection>,
    ) -> bool {
        match self {
            Self::Dots(finder) => finder.track(image, expected, found),
            Self::Chessboard(finder) => finder.track(image, expected, found),
            Self::Tags(finder) => finder.track(image, expected, found),
            Self::Shape(finder) => finder.track(image, expected, found),
        }
    }

    /// Bias of the measured point `id`: its offset from the projection of the point, px, for the target at `X_CO`.
    #[must_use]
    pub fn bias_px(&self, id: u32, X_CO: &Pose) -> Vector2<f64> {
        match self {
            Self::Dots(finder) => finder.bias_px(id, X_CO),
            Self::Tags(finder) => finder.bias_px(id, X_CO),
            Self::Chessboard(_) | Self::Shape(_) => Vector2::zeros(),
        }
    }

    /// What `status` does not tell of the last frame: which tags it showed, and which are looked for; or why a chessboard's corners are ambiguous.
    #[must_use]
    pub fn missed_in_words(&self, status: TargetStatus) -> Option<String> {
        match self {
            Self::Tags(finder) if status == TargetStatus::OtherTags => Some(finder.seen_in_words()),
            Self::Chessboard(finder) if status == TargetStatus::Ambiguous => {
                finder.miss().map(|miss| miss.to_string())
            }
            _ => None,
        }
    }

    /// All tags of the last frame, also those that do not belong to the target; empty for other kinds of targets.
    #[must_use]
    pub fn tags(&self) -> &[TagDetection] {
        match self {
            Self::Tags(finder) => finder.tags(),
            _ => &[],
        }
    }
}
