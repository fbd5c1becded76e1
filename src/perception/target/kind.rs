//! Targets by one word, as commands take them: `chessboard:9x6:0.025`.

use super::{Chessboard, DotGrid, FourDots, Shape, Tags, Target, TargetError};
use nalgebra::Vector2;
use std::str::FromStr;
use thiserror::Error;

/// What is accepted.
const GRAMMAR: &str = "four_dots[:SIDE_M[:chiral]], dots:COLSxROWS:PITCH_M, chessboard:COLSxROWS:SQUARE_M (inner corners), tag:FAMILY:SIZE_M[:ID], polygon:X_M,Y_M;X_M,Y_M;... (corners), ellipse:AxB (half its axes, m)";

/// Margin of a shape's plate, as a share of its size. Chosen by hand: the border of the shape needs light ground beside it to be found.
const MARGIN: f64 = 0.25;

/// Largest extent of a target that a word names, m. Chosen by hand: twice the largest that are printed, on landing pads and ships' decks; of lengths in mm a target of
/// a tenth of that size would be 500 m large.
pub const MAX_EXTENT_M: f64 = 5.0;

/// A word that names no target.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum KindError {
    /// The kind is not known.
    #[error("`{0}` is no kind of target; accepted: {GRAMMAR}")]
    Unknown(String),
    /// A part is missing, or there is one too many.
    #[error("`{word}`: {what}; accepted: {GRAMMAR}")]
    Parts {
        /// What was given.
        word: String,
        /// What is wrong with it.
        what: &'static str,
    },
    /// A part is not what it should be.
    #[error("`{part}` is no {wanted}; accepted: {GRAMMAR}")]
    Part {
        /// The part.
        part: String,
        /// What it should be.
        wanted: &'static str,
    },
    /// The target would be larger than any that is meant.
    #[error(
        "`{word}` would be {extent_m:.1} m large, and the largest is {MAX_EXTENT_M} m: lengths are in m, 25 mm are 0.025; accepted: {GRAMMAR}"
    )]
    TooLarge {
        /// What was given.
        word: String,
        /// How large the target would be, m.
        extent_m: f64,
    },
    /// The parts make no target.
    #[error(transparent)]
    Target(#[from] TargetError),
}

/// A target, or any tag of a family, named by a word.
#[derive(Debug, Clone, PartialEq)]
pub struct Kind {
    /// The target; without an id in the word: tag 0.
    pub target: Target,
    /// The word names a family and a size, and no id: any tag of the family is meant.
    pub any_tag: bool,
}

impl FromStr for Kind {
    type Err = KindError;

    /// `four_dots[:SIDE_M[:chiral]]`, `dots:COLSxROWS:PITCH_M`, `chessboard:COLSxROWS:SQUARE_M`, `tag:FAMILY:SIZE_M[:ID]`,
    /// `polygon:X_M,Y_M;X_M,Y_M;...`, `ellipse:AxB`.
    fn from_str(word: &str) -> Result<Self, Self::Err> {
        let kind = Self::of_any_size(word)?;
        let extent_m = kind.target.extent_m();
        if extent_m > MAX_EXTENT_M {
            return Err(KindError::TooLarge { word: shown(word), extent_m });
        }
        Ok(kind)
    }
}

impl Kind {
    /// The same of any size, for those that judge it themselves.
    ///
    /// # Errors
    /// All others than [`KindError::TooLarge`].
    pub fn of_any_size(word: &str) -> Result<Self, KindError> {
        let parts: Vec<&str> = word.split(':').collect();
        let wrong = |what| Err(KindError::Parts { word: shown(word), what });
        let sure = |target: Target| Ok(Self { target, any_tag: false });
        match *parts.as_slice() {
            ["four_dots"] => sure(FourDots::default().into()),
            ["four_dots", side] => sure(four_dots(side)?.into()),
            ["four_dots", side, "chiral"] => {
                let dots = four_dots(side)?;
                let [first_m, _, third_m, _] = dots.radii_m();
                sure(dots.with_second_radius((first_m * third_m).sqrt())?.into())
            }
            ["dots", size, pitch] => {
                let (columns, rows) = counts(size)?;
                sure(DotGrid::with_pitch(columns, rows, length(pitch)?)?.into())
            }
            ["chessboard", size, square] => {
                let (columns, rows) = counts(size)?;
                sure(Chessboard::with_squares(columns, rows, length(square)?)?.into())
            }
            ["tag", family, size, ref id @ ..] if id.len() < 2 => {
                let family = family.parse().map_err(|_| KindError::Part {
                    part: shown(family),
                    wanted: "family: 36h11, 25h9 or 16h5",
                })?;
                let given = id.first().map(|id| {
                    id.parse::<u32>()
                        .map_err(|_| KindError::Part { part: shown(id), wanted: "id: a whole number" })
                });
                let id = given.transpose()?;
                let target = Tags::one(family, length(size)?, id.unwrap_or(0))?.into();
                Ok(Self { target, any_tag: id.is_none() })
            }
            ["polygon", list] => {
                let corners = list.split(';').map(corner).collect::<Result<Vec<_>, _>>()?;
                let size = corners.iter().map(|c| (c - corners.first().copied().unwrap_or_default()).norm());
                let shape = Shape::polygon(&corners, MARGIN * size.fold(1e-4, f64::max))?;
                shape.check_distinct()?;
                sure(shape.into())
            }
            ["ellipse", axes] => {
                let (a, b) = axes
                    .split_once('x')
                    .ok_or_else(|| KindError::Part { part: shown(axes), wanted: "AxB, such as 0.04x0.02" })?;
                let (a, b) = (length(a)?, length(b)?);
                sure(Shape::ellipse([a, b], 0.0, 2.0 * MARGIN * a.max(b))?.into())
            }
            ["polygon", ..] => wrong("give the corners"),
            ["ellipse", ..] => wrong("give half the axes"),
            ["four_dots", ..] => wrong("give a side, and `chiral` or nothing after it"),
            ["dots", ..] => wrong("give the number of dots and their pitch"),
            ["chessboard", ..] => wrong("give the number of inner corners and the side of a square"),
            ["tag", ..] => wrong("give a family, a size and at most one id"),
            _ => Err(KindError::Unknown(shown(word))),
        }
    }
}

/// The textbook's square with another side.
fn four_dots(side: &str) -> Result<FourDots, KindError> {
    let side_m = length(side)?;
    let of = |tenths: f64| tenths * side_m / 10.0;
    Ok(FourDots::new(side_m, of(1.5), of(1.0), of(3.0))?)
}

/// As much of a word as is shown.
fn shown(word: &str) -> String {
    word.chars().take(60).collect()
}

fn length(part: &str) -> Result<f64, KindError> {
    let wrong = || KindError::Part { part: shown(part), wanted: "length in m, from 0.0001 to 100" };
    part.parse().ok().filter(|m| (1e-4..=100.0).contains(m)).ok_or_else(wrong)
}

fn corner(part: &str) -> Result<Vector2<f64>, KindError> {
    let wrong = || KindError::Part { part: shown(part), wanted: "corner X_M,Y_M within 100 m" };
    let (x, y) = part.split_once(',').ok_or_else(wrong)?;
    // chosen by hand, as the longest length: no target is larger, and a slip in the unit is seen
    let of = |m: &str| m.parse::<f64>().ok().filter(|m| m.abs() <= 100.0).ok_or_else(wrong);
    Ok(Vector2::new(of(x)?, of(y)?))
}

fn counts(part: &str) -> Result<(usize, usize), KindError> {
    let wrong = || KindError::Part { part: shown(part), wanted: "COLSxROWS, such as 9x6" };
    let (columns, rows) = part.split_once('x').ok_or_else(wrong)?;
    let of = |count: &str| count.parse::<u16>().map(usize::from).map_err(|_| wrong());
    Ok((of(columns)?, of(rows)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn words_name_targets() {
        let of = |word: &str| word.parse::<Kind>().unwrap();
        assert_eq!(of("four_dots").target, FourDots::default().into());
        let double = of("four_dots:0.2").target;
        assert!(double.discs().iter().zip(FourDots::default().discs()).all(|(a, b)| {
            (a.radius_m - 2.0 * b.radius_m).abs() < 1e-12 && (a.centre_m - b.centre_m * 2.0).norm() < 1e-12
        }));
        assert_eq!(of("dots:7x5:0.03").target, DotGrid::with_pitch(7, 5, 0.03).unwrap().into());
        assert_eq!(of("chessboard:9x6:0.025").target, Chessboard::with_squares(9, 6, 0.025).unwrap().into());
        let l = of("polygon:0,0;0.02,0;0.02,0.01;0.01,0.01;0.01,0.03;0,0.03").target;
        assert_eq!(l.points().len(), 6);
        assert_eq!(of("ellipse:0.04x0.02").target.points().len(), 1);
        let family = super::super::TagFamily::Tag36h11;
        assert_eq!(of("tag:36h11:0.05:7").target, Tags::one(family, 0.05, 7).unwrap().into());
        assert!(of("tag:tag36h11:0.05").any_tag && !of("tag:36h11:0.05:7").any_tag);
    }

    #[test]
    fn lengths_in_millimetres_are_told() {
        for word in [
            "four_dots:100",
            "dots:7x5:30",
            "chessboard:9x6:25",
            "tag:36h11:50:7",
            "ellipse:40x20",
            "polygon:0,0;20,0;20,10;10,10;10,30;0,30",
        ] {
            let message = word.parse::<Kind>().unwrap_err().to_string();
            assert!(message.contains("lengths are in m") && message.contains(word), "{word}: {message}");
        }
        assert!("chessboard:9x6:0.3".parse::<Kind>().is_ok(), "a board on a wall");
    }

    #[test]
    fn what_is_wrong_is_told_with_what_is_accepted() {
        for (word, part) in [
            ("", "no kind"),
            ("cheese:3x3:1", "no kind"),
            ("dots:7x5", "pitch"),
            ("dots:7:0.03", "COLSxROWS"),
            ("dots:7x-5:0.03", "COLSxROWS"),
            ("chessboard:9x6:25mm", "length"),
            ("chessboard:9x6:nan", "length"),
            ("tag:41h12:0.1", "36h11"),
            ("tag:36h11:0.1:x", "whole number"),
            ("tag:36h11:0.1:1:2", "at most one"),
            ("four_dots:0.1:2", "`chiral` or nothing"),
            ("polygon:0,0;1", "corner"),
            ("ellipse:0.1", "AxB"),
        ] {
            let message = word.parse::<Kind>().unwrap_err().to_string();
            assert!(message.contains(part) && message.contains("chessboard:COLSxROWS"), "{word}: {message}");
        }
        for word in ["chessboard:2x6:0.02", "tag:16h5:0.05:30", "dots:99x2:0.01", "polygon:0,0;1,0;1,1;0,1"] {
            let message = word.parse::<Kind>().unwrap_err().to_string();
            assert!(message.contains("target: "), "{word}: {message}");
        }
    }

    proptest! {
        #[test]
        fn any_word_is_a_target_or_an_error(word in "(four_dots|dots|chessboard|tag|polygon|ellipse)?(:[0-9x.e:;,-]{0,12}){0,4}") {
            let _ = word.parse::<Kind>();
        }
    }
}
