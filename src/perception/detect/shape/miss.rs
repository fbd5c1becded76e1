//! Reasons for which no shape was detected.

use crate::messages::TargetStatus;
use thiserror::Error;

/// Why a shape was not found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum ShapeMiss {
    /// The image does not have the size that the finder was made for.
    #[error("the image does not have the size that the finder was made for")]
    WrongSize,
    /// There is no contrast.
    #[error("nothing in the image stands out from what is around it")]
    NoContrast,
    /// No region could be the shape by its moments.
    #[error("no region that lies whole in the image has the shape's proportions")]
    NoRegion,
    /// Regions, but none has the outline.
    #[error("no region has the outline that is looked for")]
    NoMatch,
    /// The best fit is not better than an accidental one among so many similar outlines.
    #[error(
        "what fits the outline is no better than chance makes it among so many regions that are much like it"
    )]
    ByChance,
    /// More regions similar to the shape than one search examines.
    #[error("too many regions with the shape's proportions: the search was given up")]
    GivenUp,
    /// Two regions have the outline, or one has it in two ways.
    #[error("the outline is there more than once, or may lie in more than one way")]
    Several,
}

impl ShapeMiss {
    /// Whether another threshold may show the shape.
    pub(super) fn may_change(self) -> bool {
        matches!(self, Self::NoRegion | Self::NoMatch | Self::ByChance)
    }

    /// Of two that may change the one that came further.
    pub(super) fn telling(self, other: Self) -> Self {
        let rank = |miss: Self| match miss {
            Self::NoRegion => 0,
            Self::NoMatch => 1,
            _ => 2,
        };
        if rank(other) > rank(self) { other } else { self }
    }
}

impl From<ShapeMiss> for TargetStatus {
    fn from(miss: ShapeMiss) -> Self {
        match miss {
            ShapeMiss::WrongSize => Self::WrongSize,
            ShapeMiss::NoContrast => Self::NoContrast,
            ShapeMiss::NoRegion => Self::TooFewRegions,
            ShapeMiss::NoMatch | ShapeMiss::ByChance => Self::NoMatch,
            ShapeMiss::GivenUp => Self::GivenUp,
            ShapeMiss::Several => Self::Ambiguous,
        }
    }
}
