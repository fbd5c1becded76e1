//! The placement of a lattice on the board: the quarter turn and the shift that are consistent with colours, size and visible ends.
//!
//! Corner (0, 0) of a board has dark squares above left and below right of it, so colours alternate as `column + row`:
//!
//! | inner corners | turns that keep the colours | convention |
//! |---|---|---|
//! | columns + rows odd (9x6) | none | corner 0 is the one at a dark corner square of the board, as OpenCV has it |
//! | columns + rows even, unequal (8x6) | half | of both, corner 0 is the one with the least x + y in the image |
//! | equal and odd (7x7) | half | the same |
//! | equal and even (6x6) | all | the same, of four |

use super::miss::ChessboardMiss;

/// A lattice's bounds, what is known of its ends, and the colour of its squares.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LatticeExtent {
    /// Least place along both directions.
    pub(super) low: [i16; 2],
    /// Greatest place along both directions.
    pub(super) high: [i16; 2],
    /// Whether the board is seen to end beyond `low[0]`, `high[0]`, `low[1]`, `high[1]`.
    pub(super) ends: [bool; 4],
    /// Whether the square between both directions is light at places with an even sum.
    pub(super) even_light: bool,
}

/// Transformation from lattice coordinates to columns and rows of the board.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct BoardPlacement {
    /// Quarter turns from the lattice's directions to the board's.
    pub(super) turn: u8,
    /// Added after the turn.
    pub(super) shift: [i16; 2],
}

impl BoardPlacement {
    /// Column and row for lattice coordinates.
    pub(super) fn corner(&self, at: [i16; 2]) -> [i16; 2] {
        let [u, v] = turned(at, self.turn);
        [u + self.shift[0], v + self.shift[1]]
    }

    /// Lattice coordinates of a column and row.
    pub(super) fn at(&self, [column, row]: [i16; 2]) -> [i16; 2] {
        turned([column - self.shift[0], row - self.shift[1]], (4 - self.turn) % 4)
    }
}

/// `at` after quarter turns that bring the second direction to the first's place.
fn turned([u, v]: [i16; 2], turn: u8) -> [i16; 2] {
    match turn % 4 {
        0 => [u, v],
        1 => [v, -u],
        2 => [-u, -v],
        _ => [-v, u],
    }
}

/// The consistent placements; more than one only where the board is symmetric.
///
/// # Errors
/// [`ChessboardMiss::TooLarge`] when the lattice does not fit on the board, [`ChessboardMiss::NoBorder`] when its placement is ambiguous.
pub(super) fn placements(
    extent: &LatticeExtent,
    columns: i16,
    rows: i16,
    out: &mut Vec<BoardPlacement>,
) -> Result<(), ChessboardMiss> {
    out.clear();
    let mut fits = false;
    // what one placement makes of the lattice's middle, up to the board's symmetry
    let mut class: Option<[i16; 2]> = None;
    let mut several = false;
    for turn in 0..4u8 {
        let (a, b) = (turned(extent.low, turn), turned(extent.high, turn));
        let low = [a[0].min(b[0]), a[1].min(b[1])];
        let high = [a[0].max(b[0]), a[1].max(b[1])];
        let ends = turned_ends(extent.ends, turn);
        let (span_x, span_y) = (high[0] - low[0], high[1] - low[1]);
        if span_x >= columns || span_y >= rows {
            continue;
        }
        fits = true;
        for x in 0..columns - span_x {
            for y in 0..rows - span_y {
                let shift = [x - low[0], y - low[1]];
                let against = (ends[0] && x != 0)
                    || (ends[1] && x + span_x != columns - 1)
                    || (ends[2] && y != 0)
                    || (ends[3] && y + span_y != rows - 1);
                // the square between both directions, as the board has it at the image of place (0, 0); odd turns swap
                let wanted = (shift[0] + shift[1]).rem_euclid(2) == 1;
                if against || (extent.even_light != (turn % 2 == 1)) != wanted {
                    continue;
                }
                out.push(BoardPlacement { turn, shift });
                // twice the middle of what is covered, by its distance from the board's middle
                let off = [2 * x + span_x - (columns - 1), 2 * y + span_y - (rows - 1)];
                let this = canonical(off, turn, columns, rows);
                several |= class.is_some_and(|c| c != this);
                class = Some(this);
            }
        }
    }
    match (fits, out.is_empty() || several) {
        (false, _) => Err(ChessboardMiss::TooLarge),
        (true, true) => {
            let none = out.is_empty();
            out.clear();
            Err(if none { ChessboardMiss::NoMatch } else { ChessboardMiss::NoBorder })
        }
        (true, false) => Ok(()),
    }
}

/// The offset of a placement as the lattice sees it: equal for placements that a symmetry of the board carries into each other.
fn canonical(off: [i16; 2], turn: u8, columns: i16, rows: i16) -> [i16; 2] {
    let half = (columns + rows) % 2 == 0;
    let quarter = columns == rows && columns % 2 == 0;
    let back = turned(off, (4 - turn) % 4);
    // without a symmetry each placement is its own
    if quarter || half {
        let key = if quarter { 0 } else { i16::from(turn % 2) * 1000 };
        [back[0] + key, back[1]]
    } else {
        [back[0] + 1000 * i16::from(turn), back[1]]
    }
}

/// The ends by the board's directions: low x, high x, low y, high y.
fn turned_ends([lu, hu, lv, hv]: [bool; 4], turn: u8) -> [bool; 4] {
    match turn % 4 {
        0 => [lu, hu, lv, hv],
        // x = v, y = -u
        1 => [lv, hv, hu, lu],
        2 => [hu, lu, hv, lv],
        // x = -v, y = u
        _ => [hv, lv, lu, hu],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn colour(column: i16, row: i16) -> bool {
        (column + row).rem_euclid(2) == 1
    }

    /// Every window of every board in every turn, with the ends that touch the rim seen or not: what is told is true.
    #[test]
    fn what_is_told_is_true() {
        let mut told = 0;
        for (columns, rows) in [(9, 6), (6, 9), (8, 6), (7, 7), (6, 6), (4, 3), (3, 3)] {
            for turn in 0..4u8 {
                let truth = BoardPlacement { turn, shift: [3, -2] };
                for (x0, x1) in pairs(columns) {
                    for (y0, y1) in pairs(rows) {
                        for seen in 0..16u8 {
                            check(columns, rows, truth, [x0, x1, y0, y1], seen, &mut told);
                        }
                    }
                }
            }
        }
        assert!(told > 5000, "{told}");
    }

    fn pairs(n: i16) -> impl Iterator<Item = (i16, i16)> {
        (0..n).flat_map(move |a| (a + 1..n).map(move |b| (a, b)))
    }

    fn check(
        columns: i16,
        rows: i16,
        truth: BoardPlacement,
        [x0, x1, y0, y1]: [i16; 4],
        seen: u8,
        told: &mut i32,
    ) {
        let places: Vec<([i16; 2], [i16; 2])> = (-30..30)
            .flat_map(|u| (-30..30).map(move |v| [u, v]))
            .map(|at| (at, truth.corner(at)))
            .filter(|(_, [x, y])| (x0..=x1).contains(x) && (y0..=y1).contains(y))
            .collect();
        let low =
            [places.iter().map(|p| p.0[0]).min().unwrap(), places.iter().map(|p| p.0[1]).min().unwrap()];
        let high =
            [places.iter().map(|p| p.0[0]).max().unwrap(), places.iter().map(|p| p.0[1]).max().unwrap()];
        // an end is what leads off the board
        let middle = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2];
        let off = |at: [i16; 2]| {
            let [x, y] = truth.corner(at);
            x < 0 || y < 0 || x >= columns || y >= rows
        };
        let mut ends = [
            off([low[0] - 1, middle[1]]),
            off([high[0] + 1, middle[1]]),
            off([middle[0], low[1] - 1]),
            off([middle[0], high[1] + 1]),
        ];
        for (i, end) in ends.iter_mut().enumerate() {
            *end &= seen >> i & 1 == 1;
        }
        let (at, [x, y]) = places.iter().find(|(at, _)| (at[0] + at[1]).rem_euclid(2) == 0).copied().unwrap();
        assert_eq!(at[0].rem_euclid(2), at[1].rem_euclid(2));
        let even_light = colour(x, y) != (truth.turn % 2 == 1);
        let mut out = Vec::new();
        let extent = LatticeExtent { low, high, ends, even_light };
        if placements(&extent, columns, rows, &mut out).is_err() {
            assert!(out.is_empty());
            return;
        }
        *told += 1;
        assert!(out.contains(&truth), "{columns}x{rows} {extent:?} {truth:?} {out:?}");
        let most = match ((columns + rows) % 2, columns == rows && columns % 2 == 0) {
            (1, _) => 1,
            (_, true) => 4,
            _ => 2,
        };
        assert!(out.len() <= most);
        // all are one and the same board, turned about its middle
        for other in &out {
            for (at, [x, y]) in &places {
                let [p, q] = other.corner(*at);
                let k = (other.turn + 4 - truth.turn) % 4;
                let off = turned([2 * x - columns + 1, 2 * y - rows + 1], k);
                assert_eq!([2 * p - columns + 1, 2 * q - rows + 1], off);
            }
        }
    }
}
