//! Reasons for which no chessboard was detected.

use crate::messages::TargetStatus;
use thiserror::Error;

/// Why a chessboard was not found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum ChessboardMiss {
    /// The image does not have the size that the finder was made for.
    #[error("the image does not have the size that the finder was made for")]
    WrongSize,
    /// No two grey levels far enough apart for a corner.
    #[error("no contrast in the image")]
    NoContrast,
    /// Nowhere do four squares meet.
    #[error("no corners of squares in the image")]
    NoCorners,
    /// Corners, but too few of them form a lattice.
    #[error("too few corners that form a part of a chessboard")]
    TooFewCorners,
    /// A lattice with more corners than the board has: another board.
    #[error("a chessboard with more squares than the one that is looked for")]
    TooLarge,
    /// Colours, size and ends contradict every place on the board.
    #[error("a chessboard whose size or colours are not those of the one that is looked for")]
    NoMatch,
    /// A part whose placement on the board is ambiguous: too little of the border is visible.
    #[error(
        "a part of a chessboard without enough of its border to tell which part; bring an end of both directions, with its light margin, into view"
    )]
    NoBorder,
    /// More parts of chessboards than one search examines.
    #[error("too many parts of chessboards in the image: the search was given up")]
    GivenUp,
    /// Two boards that look alike.
    #[error("two chessboards that could both be the one that is looked for; cover one, or take it away")]
    Several,
}

impl From<ChessboardMiss> for TargetStatus {
    fn from(miss: ChessboardMiss) -> Self {
        match miss {
            ChessboardMiss::WrongSize => Self::WrongSize,
            ChessboardMiss::NoContrast => Self::NoContrast,
            ChessboardMiss::NoCorners | ChessboardMiss::TooFewCorners => Self::TooFewRegions,
            ChessboardMiss::TooLarge | ChessboardMiss::NoMatch => Self::NoMatch,
            ChessboardMiss::GivenUp => Self::GivenUp,
            ChessboardMiss::NoBorder | ChessboardMiss::Several => Self::Ambiguous,
        }
    }
}

/// Of two reasons the one of the later stage.
pub(super) fn telling(a: ChessboardMiss, b: ChessboardMiss) -> ChessboardMiss {
    let rank = |m: &ChessboardMiss| match m {
        ChessboardMiss::WrongSize | ChessboardMiss::NoContrast | ChessboardMiss::NoCorners => 0,
        ChessboardMiss::TooFewCorners => 1,
        ChessboardMiss::TooLarge | ChessboardMiss::NoMatch => 2,
        ChessboardMiss::NoBorder => 3,
        ChessboardMiss::Several => 4,
        ChessboardMiss::GivenUp => 5,
    };
    if rank(&a) > rank(&b) { a } else { b }
}
