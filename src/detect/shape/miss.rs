//! Why there is no shape.

use crate::messages::TargetStatus;
use thiserror::Error;

/// Why a shape was not found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum ShapeMiss {
    /// The image does not have the size that the finder was made for.
    #[error("the image does not have the size that the finder was made for")]
    WrongSize,
    /// Nothing stands out.
    #[error("nothing in the image stands out from what is around it")]
    NoContrast,
    /// No region could be the shape by its moments.
    #[error("no region that lies whole in the image has the shape's proportions")]
    NoRegion,
    /// Regions, but none has the outline.
    #[error("no region has the outline that is looked for")]
    NoMatch,
    /// More regions that are much like the shape than one search looks at.
    #[error("too many regions with the shape's proportions: the search was given up")]
    GivenUp,
    /// Two regions have the outline, or one has it in two ways.
    #[error("the outline is there more than once, or may lie in more than one way")]
    Several,
}

impl From<ShapeMiss> for TargetStatus {
    fn from(miss: ShapeMiss) -> Self {
        match miss {
            ShapeMiss::WrongSize => Self::WrongSize,
            ShapeMiss::NoContrast => Self::NoContrast,
            ShapeMiss::NoRegion => Self::TooFewRegions,
            ShapeMiss::NoMatch => Self::NoMatch,
            ShapeMiss::GivenUp => Self::GivenUp,
            ShapeMiss::Several => Self::Ambiguous,
        }
    }
}
