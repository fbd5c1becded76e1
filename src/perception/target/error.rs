//! Why a target is refused.

use thiserror::Error;

/// A target that cannot be built, or whose corners cannot be identified.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum TargetError {
    /// A length is not a positive, finite number.
    #[error("target: {name} is {value_m} m; give a length greater than zero")]
    Length {
        /// Which length.
        name: &'static str,
        /// Its value.
        value_m: f64,
    },
    /// P1 must be larger than the other dots by a fifth, or identity is lost in noise.
    #[error(
        "target: P1's radius {first_radius_m} m must be at least 1.2 times the other radius {radius_m} m, \
         else the corners cannot be told apart"
    )]
    Radii {
        /// Radius of P1.
        first_radius_m: f64,
        /// Radius of the others.
        radius_m: f64,
    },
    /// P2 must be larger than P3 and P4, and smaller than P1, by a fifth each.
    #[error(
        "target: P2's radius {second_radius_m} m must be 1.2 times the other radius {radius_m} m or more, and P1's radius \
         {first_radius_m} m as much larger than it: try the root of their product"
    )]
    SecondRadius {
        /// Radius of P1.
        first_radius_m: f64,
        /// Radius of P2.
        second_radius_m: f64,
        /// Radius of the others.
        radius_m: f64,
    },
    /// Neighbouring dots touch.
    #[error(
        "target: dots of {first_radius_m} m and {radius_m} m touch on a side of {side_m} m; make them smaller"
    )]
    Overlap {
        /// Side of the square.
        side_m: f64,
        /// Radius of P1.
        first_radius_m: f64,
        /// Radius of the others.
        radius_m: f64,
    },
    /// Neighbouring dots of a grid touch.
    #[error(
        "target: dots of {radius_m} m and {mark_radius_m} m touch at a pitch of {pitch_m} m; make them smaller"
    )]
    Pitch {
        /// Distance of neighbours.
        pitch_m: f64,
        /// Radius of the small dots.
        radius_m: f64,
        /// Radius of the large dots.
        mark_radius_m: f64,
    },
    /// A grid is too small to be identified, or too large.
    #[error("target: {columns} x {rows} dots; give 3 to 32 columns and rows")]
    Count {
        /// Dots in a row.
        columns: usize,
        /// Dots in a column.
        rows: usize,
    },
    /// A chessboard has too few corners or too many.
    #[error("target: {columns} x {rows} inner corners; give 3 to 32 columns and rows")]
    Corners {
        /// Corners in a row.
        columns: usize,
        /// Corners in a column.
        rows: usize,
    },
    /// A body has too few dots or too many.
    #[error("target: {count} dots on the faces; give 5 to 24")]
    DotCount {
        /// How many.
        count: usize,
    },
    /// A dot is cut by the edge of its face.
    #[error("target: dot {} with a radius of {radius_m} m reaches beyond its face; make the face larger, or move the dot", dot + 1)]
    DotBeyondFace {
        /// Its place in the list, from 0.
        dot: usize,
        /// Radius of the dots, m.
        radius_m: f64,
    },
    /// Two dots of a face touch.
    #[error("target: dot {} touches another one of its face with a radius of {radius_m} m; move it, or make dots smaller", dot + 1)]
    DotsTouch {
        /// Its place in the list, from 0.
        dot: usize,
        /// Radius of the dots, m.
        radius_m: f64,
    },
    /// A body whose dots cannot be told apart.
    #[error(
        "target: a turn of the body puts its dots on one another, so that they cannot be told apart; move one of them"
    )]
    DotsAlike,
    /// A plate without tags, or with too many.
    #[error("target: {count} tags; give 1 to 128")]
    TagCount {
        /// How many.
        count: usize,
    },
    /// A tag that the family does not have.
    #[error("target: family {family} has the ids 0 to {}, not {id}", count - 1)]
    TagId {
        /// The family.
        family: &'static str,
        /// The id.
        id: u32,
        /// How many there are.
        count: u32,
    },
    /// Two tags with the same id.
    #[error("target: tag {id} is there twice; give each its own id")]
    TagTwice {
        /// The id.
        id: u32,
    },
    /// Tags without a light margin between them.
    #[error(
        "target: tags {other} and {id} are less than a cell ({cell_m} m) apart; move them apart, or make them smaller"
    )]
    TagsTouch {
        /// The one.
        id: u32,
        /// The other.
        other: u32,
        /// Side of a cell, m.
        cell_m: f64,
    },
    /// An outline has too few corners or too many.
    #[error("target: an outline of {count} corners; give 3 to 256")]
    OutlineCorners {
        /// How many.
        count: usize,
    },
    /// An outline is no border of an area.
    #[error("target: the outline's sides cross or touch each other, or enclose nothing")]
    OutlineCrosses,
    /// An ellipse where more than its centre is needed.
    #[error(
        "target: of an ellipse only the centre is told, which fixes no pose; give a polygon without symmetry"
    )]
    OutlineEllipse,
    /// Too few corners to tell one from another in perspective.
    #[error(
        "target: an outline with {count} corners; in perspective any of them may be the first: give five or more"
    )]
    OutlineSimple {
        /// Corners at which the outline turns.
        count: usize,
    },
    /// A turned outline that looks the same.
    #[error(
        "target: the outline looks the same after 1/{turns} of a turn, so that its corners cannot be told apart; \
         make it asymmetric"
    )]
    OutlineSymmetric {
        /// Turns within a full one.
        turns: u32,
    },
    /// An outline that looks as if it were turned when seen aslant.
    #[error(
        "target: seen aslant, corner {to} of the outline may be taken for its first one (all within {off_percent} % \
         of the size); make it more asymmetric"
    )]
    OutlineAlike {
        /// Which corner, from 0.
        to: usize,
        /// How far the corners then are from where they should be, percent of the size.
        off_percent: f64,
    },
    /// P1 reaches over the plate's edge.
    #[error("target: the plate's margin {margin_m} m must exceed P1's radius {first_radius_m} m")]
    Margin {
        /// Margin around the square.
        margin_m: f64,
        /// Radius of P1.
        first_radius_m: f64,
    },
}

impl TargetError {
    /// The first of some lengths, m, that is not positive and finite.
    pub(super) fn if_not_positive<const N: usize>(lengths: [(&'static str, f64); N]) -> Result<(), Self> {
        let wrong = lengths.into_iter().find(|(_, m)| !(*m > 0.0 && m.is_finite()));
        wrong.map_or(Ok(()), |(name, value_m)| Err(Self::Length { name, value_m }))
    }
}
