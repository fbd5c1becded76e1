//! The finder of each kind of target behind one face: a frame in, the points that are seen out.

use super::chessboard::ChessboardFinder;
use super::shape::ShapeFinder;
use super::tags::{TagFound, TagPlateFinder};
use super::{DotFinder, Expected, Found};
use crate::camera_model::{CameraModel, Response};
use crate::geometry::Pose;
use crate::imaging::ImageView;
use crate::messages::TargetStatus;
use crate::target::Target;
use nalgebra::Vector2;

/// Finds one target. Owns all buffers: nothing is allocated after construction.
#[derive(Debug, Clone)]
#[allow(clippy::large_enum_variant)] // one in a process
pub enum Finder {
    /// Dots on a plate.
    Dots(DotFinder),
    /// Squares.
    Chessboard(Box<ChessboardFinder>),
    /// Tags.
    Tags(TagPlateFinder),
    /// A free outline.
    Shape(Box<ShapeFinder>),
}

impl Finder {
    /// A finder for frames of `camera` and one target.
    #[must_use]
    pub fn new(camera: CameraModel, target: &Target) -> Self {
        match target {
            Target::FourDots(_) | Target::DotGrid(_) => {
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

    /// The same for a camera of this response, of which images were made linear as far as it is known. Where it is not, corners of tags get
    /// estimates of what it moved, and covariances that hold for them ([`super::tags::TagFinder::for_unknown_response`]); other targets are
    /// found as before.
    #[must_use]
    pub fn for_response(self, response: &Response) -> Self {
        match (self, response) {
            (Self::Tags(finder), Response::Unknown) => Self::Tags(finder.for_unknown_response()),
            (finder, _) => finder,
        }
    }

    /// Searches the whole frame: fills `found` with the points that are seen, ids rising.
    ///
    /// # Errors
    /// The status that says why there is no target; never [`TargetStatus::Found`] or `WrongSize`. `found` is then empty.
    pub fn search(&mut self, image: &ImageView<'_>, found: &mut Vec<Found>) -> Result<(), TargetStatus> {
        match self {
            Self::Dots(finder) => finder.search(image, found),
            Self::Chessboard(finder) => finder.search(image, found),
            Self::Tags(finder) => finder.search(image, found),
            Self::Shape(finder) => finder.search(image, found),
        }
    }

    /// Looks once more at what was found in `image`, for what lies on a part of a point: where the rest tells the point's place, it counts
    /// alone, and the point's id goes into `harmed`.
    pub fn look_closely(&self, image: &ImageView<'_>, found: &mut [Found], harmed: &mut Vec<u32>) {
        harmed.clear();
        if let Self::Dots(finder) = self {
            finder.look_closely(image, found, harmed);
        }
    }

    /// Looks for the points where they are expected, ids rising: fills `found` with those that are there alone and whole. Whether they
    /// can be the target; `found` is empty when not.
    pub fn track(&mut self, image: &ImageView<'_>, expected: &[Expected], found: &mut Vec<Found>) -> bool {
        match self {
            Self::Dots(finder) => finder.track(image, expected, found),
            Self::Chessboard(finder) => finder.track(image, expected, found),
            Self::Tags(finder) => finder.track(image, expected, found),
            Self::Shape(finder) => finder.track(image, expected, found),
        }
    }

    /// How far what is measured of point `id` lies from the image of the point, px, for the target at `X_CO`.
    #[must_use]
    pub fn bias_px(&self, id: u32, X_CO: &Pose) -> Vector2<f64> {
        match self {
            Self::Dots(finder) => finder.bias_px(id, X_CO),
            Self::Tags(finder) => finder.bias_px(id, X_CO),
            Self::Chessboard(_) | Self::Shape(_) => Vector2::zeros(),
        }
    }

    /// All tags that were seen last, also those that are no part of the target; empty for other kinds of targets.
    #[must_use]
    pub fn tags(&self) -> &[TagFound] {
        match self {
            Self::Tags(finder) => finder.tags(),
            _ => &[],
        }
    }
}
