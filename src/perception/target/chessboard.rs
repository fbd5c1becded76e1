//! Dark and light squares by turns; its points are the corners at which four squares meet.
//!
//! ```text
//!   ##  ##  ##        o: points, id = row x columns + column. Point 0 is the origin, and the square beyond it,
//!   ##o o##o o##      towards -x_o and -y_o, is dark.
//!     o##o o##o        --> x_o   along the columns; y_o down along the rows; z_o away from the camera that looks at it.
//!   ##o o##o o##      v y_o
//! ```
//! Rows and columns are counted in inner corners. Where one of them is even and the other odd no turn of the board looks like
//! itself; else a half turn does, and nothing tells which end is which.

use super::{ClosedOutline, Mark, Plate, Symmetry, TargetError, TargetPoint};
use nalgebra::{Point3, Vector2};
use std::ops::RangeInclusive;

/// A chessboard, in the object frame (m).
#[derive(Debug, Clone, PartialEq)]
pub struct Chessboard {
    columns: usize,
    rows: usize,
    square_m: f64,
    margin_m: f64,
    points: Box<[TargetPoint]>,
}

impl Chessboard {
    /// How many inner corners a row and a column may have. Chosen by hand: two rows show no bend of the board, and 33 squares across a
    /// frame 640 px wide are 19 px large.
    pub const COUNT: RangeInclusive<u32> = 3..=32;
    /// The light margin about the outer squares where nothing else is said, in squares.
    pub const MARGIN: f64 = 0.5;

    /// A board of `columns` x `rows` inner corners, `square_m` apart, with a margin of `margin_m` about the outer squares; m.
    ///
    /// # Errors
    /// [`TargetError`] when there are too few corners or too many, or a length is not positive.
    pub fn new(columns: usize, rows: usize, square_m: f64, margin_m: f64) -> Result<Self, TargetError> {
        let sizes = *Self::COUNT.start() as usize..=*Self::COUNT.end() as usize;
        if !sizes.contains(&columns) || !sizes.contains(&rows) {
            return Err(TargetError::Corners { columns, rows });
        }
        TargetError::if_not_positive([("square_m", square_m), ("margin_m", margin_m)])?;
        let points = (0..columns * rows)
            .map(|i| {
                let (x, y) = ((i % columns) as f64, (i / columns) as f64);
                TargetPoint { id: i as u32, p_O: Point3::new(x * square_m, y * square_m, 0.0) }
            })
            .collect();
        Ok(Self { columns, rows, square_m, margin_m, points })
    }

    /// A board with the usual margin.
    ///
    /// # Errors
    /// As for [`Self::new`].
    pub fn with_squares(columns: usize, rows: usize, square_m: f64) -> Result<Self, TargetError> {
        Self::new(columns, rows, square_m, Self::MARGIN * square_m)
    }

    /// Inner corners in a row.
    #[must_use]
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Inner corners in a column.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Side of a square, m.
    #[must_use]
    pub fn square_m(&self) -> f64 {
        self.square_m
    }

    /// The inner corners, row by row.
    #[must_use]
    pub fn points(&self) -> &[TargetPoint] {
        &self.points
    }

    /// The dark squares.
    #[must_use]
    pub fn marks(&self) -> Vec<Mark> {
        let side = self.square_m;
        let corner = |column: usize, row: usize| Vector2::new(column as f64 - 1.0, row as f64 - 1.0) * side;
        let squares = (0..(self.columns + 1) * (self.rows + 1)).filter_map(|i| {
            let (column, row) = (i % (self.columns + 1), i / (self.columns + 1));
            let square: ClosedOutline =
                [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(x, y)| corner(column + x, row + y)).into();
            (column + row).is_multiple_of(2).then_some(square)
        });
        vec![Mark::Polygon(squares.collect())]
    }

    /// The plate.
    #[must_use]
    pub fn plate(&self) -> Plate {
        let beyond = self.square_m + self.margin_m;
        let end = |count: usize| (count - 1) as f64 * self.square_m + beyond;
        Plate {
            low_m: Vector2::repeat(-beyond),
            high_m: Vector2::new(end(self.columns), end(self.rows)),
            light: true,
        }
    }

    /// Which turns and mirror images of the board look like it.
    #[must_use]
    pub fn symmetry(&self) -> Symmetry {
        let even = |count: usize| count.is_multiple_of(2);
        let (columns, rows) = (self.columns, self.rows);
        let turns = match (columns == rows, even(columns), even(rows)) {
            (true, true, _) => 4,
            (_, true, true) | (_, false, false) => 2,
            _ => 1,
        };
        Symmetry { turns, mirrored: even(columns) || even(rows) || columns == rows }
    }

    /// Every how many columns and rows a corner serves as feature.
    pub(super) fn feature_stride(&self) -> usize {
        super::stride(self.columns, self.rows)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether the square in which a place lies is dark, from the marks.
    fn dark(marks: &[Mark], place: Vector2<f64>) -> bool {
        let Mark::Polygon(squares) = &marks[0] else { unreachable!() };
        squares.iter().any(|s| place.x > s[0].x && place.x < s[2].x && place.y > s[0].y && place.y < s[2].y)
    }

    #[test]
    fn four_squares_meet_at_each_point_and_the_first_is_dark() {
        let board = Chessboard::with_squares(9, 6, 0.02).unwrap();
        assert_eq!(board.points().len(), 54);
        let marks = board.marks();
        assert!(dark(&marks, Vector2::new(-0.01, -0.01)));
        for point in board.points() {
            let p = point.p_O.coords.xy();
            let at = |x: f64, y: f64| dark(&marks, p + Vector2::new(x, y) * 0.01);
            let quarter = at(-1.0, -1.0);
            assert!(at(1.0, 1.0) == quarter && at(-1.0, 1.0) != quarter && at(1.0, -1.0) != quarter);
        }
        let plate = board.plate();
        assert_eq!(plate.high_m, Vector2::new(0.19, 0.13));
    }

    #[test]
    fn symmetries_are_those_of_the_squares() {
        for (columns, rows) in [(9, 6), (8, 6), (7, 5), (6, 6), (7, 7), (5, 4)] {
            let board = Chessboard::with_squares(columns, rows, 1.0).unwrap();
            let marks = board.marks();
            let middle = Vector2::new(columns as f64 - 1.0, rows as f64 - 1.0) * 0.5;
            let alike = |map: &dyn Fn(Vector2<f64>) -> Vector2<f64>| {
                (0..(columns + 1) * (rows + 1)).all(|i| {
                    let (x, y) = ((i % (columns + 1)) as f64 - 0.5, (i / (columns + 1)) as f64 - 0.5);
                    let from = Vector2::new(x, y) - middle;
                    let to = map(from);
                    let inside = to.x.abs() < middle.x + 1.0 && to.y.abs() < middle.y + 1.0;
                    inside && dark(&marks, from + middle) == dark(&marks, to + middle)
                })
            };
            let turns = [
                alike(&|p| Vector2::new(-p.y, p.x)),
                alike(&|p| Vector2::new(-p.x, -p.y)),
                alike(&|p| Vector2::new(p.y, -p.x)),
            ];
            let mirrored = alike(&|p| Vector2::new(-p.x, p.y))
                || alike(&|p| Vector2::new(p.x, -p.y))
                || alike(&|p| Vector2::new(p.y, p.x));
            let found = Symmetry { turns: 1 + turns.iter().filter(|t| **t).count() as u32, mirrored };
            assert_eq!(board.symmetry(), found, "{columns} x {rows}");
        }
    }

    #[test]
    fn impossible_boards_are_refused() {
        assert!(matches!(Chessboard::with_squares(2, 6, 0.02), Err(TargetError::Corners { .. })));
        assert!(matches!(Chessboard::with_squares(9, 33, 0.02), Err(TargetError::Corners { .. })));
        assert!(matches!(Chessboard::with_squares(9, 6, 0.0), Err(TargetError::Length { .. })));
        assert!(matches!(Chessboard::new(9, 6, 0.02, f64::NAN), Err(TargetError::Length { .. })));
    }
}
