//! Whether a board ends where it should: one square beyond its last corners no further corners follow.
//!
//! ```text
//!   ─┬─ corner ── corner ─┤ outer square ├─ here a board that continues has a corner of four squares, and one that ends the corner of one square
//! ```
//! A tiled floor of which a part has the board's size, and a larger board that is half occluded, differ from the board in this alone.

use super::Board;
use crate::detect::chessboard::strongest::{BENT, FOLLOWS, MIN_REACH_PX, follows, strength};
use crate::imaging::ImageView;
use nalgebra::{Vector2, Vector3};

/// So many corners in a line, and one in so many of those that could be visible, are not by accident: objects lie on a floor, too. Chosen by hand: what
/// lies beside a board makes one corner in line, rarely two; with every second one asked for, a floor that is half hidden would be a board.
/// `a_floor_is_no_board` tests it.
const LEAST: usize = 2;
const SHARE: usize = 3;
/// So many corners behind an occluder of a side's end, and one in so many of the visible positions there, are not by accident either. Chosen by hand: more
/// corners than above, since these places are known by the whole board alone, and a smaller share, since most of them are hidden.
const MIN_BEHIND: usize = 3;
const SHARE_BEHIND: usize = 4;
/// How many squares beyond the last corners these are looked for: chosen by hand, as wide as what lies on a board may be.
const BEHIND: i64 = 3;

/// What lies beyond one side of a board.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::detect::chessboard) enum BoardSide {
    /// The image ends, or the board's last corners are hidden.
    Unseen,
    /// No more corners.
    End,
    /// More corners.
    More,
}

impl Board {
    /// What is beyond each side.
    pub(in crate::detect::chessboard) fn beyond(&self, image: &ImageView<'_>) -> [BoardSide; 4] {
        let (columns, rows) = (self.columns as i64, self.rows as i64);
        [
            self.beyond_line(image, rows, |k, i| (i, k)),
            self.beyond_line(image, rows, |k, i| (columns - 1 - i, k)),
            self.beyond_line(image, columns, |k, i| (k, i)),
            self.beyond_line(image, columns, |k, i| (k, rows - 1 - i)),
        ]
    }

    /// Whether the pattern continues behind something that hides the end of the board: corners lie where the homography of the board has the
    /// next ones.
    pub(in crate::detect::chessboard) fn goes_on_behind(&mut self, image: &ImageView<'_>) -> bool {
        let Some(whole) = self.homography() else { return false };
        self.values.clear();
        self.values
            .extend(self.slots.iter().filter_map(|s| Some(f64::from(strength(image, s.fit?.px, 1.0)?))));
        let middle = self.values.len() / 2;
        if self.values.is_empty() {
            return false;
        }
        let own = *self.values.select_nth_unstable_by(middle, f64::total_cmp).1;
        let at = |(column, row): (i64, i64)| {
            let v = whole * Vector3::new(column as f64, row as f64, 1.0);
            // else it lies at infinity or behind the camera: z is 1 in the board's middle
            (v.z > 1e-9).then(|| Vector2::new(v.x, v.y) / v.z)
        };
        let (columns, rows) = (self.columns as i64, self.rows as i64);
        let goes_on = |count: i64, corner: &dyn Fn(i64, i64) -> (i64, i64)| {
            let places = (-1..=count).flat_map(|k| (1..=BEHIND).map(move |i| (k, i)));
            let seen = places.filter_map(|(k, i)| {
                let (here, before) = (at(corner(k, i))?, at(corner(k, i - 1))?);
                let there = strength(image, here, MIN_REACH_PX + BENT * (here - before).norm())?;
                Some(f64::from(there) > f64::from(FOLLOWS) * own)
            });
            let (seen, more) = seen.fold((0, 0), |(n, more), follows| (n + 1, more + usize::from(follows)));
            more >= MIN_BEHIND && SHARE_BEHIND * more >= seen
        };
        goes_on(rows, &|k, i| (-i, k))
            || goes_on(rows, &|k, i| (columns - 1 + i, k))
            || goes_on(columns, &|k, i| (k, -i))
            || goes_on(columns, &|k, i| (k, rows - 1 + i))
    }

    /// Of one side: `corner` is the column and row of the k-th corner along it, i lines inwards.
    fn beyond_line(
        &self,
        image: &ImageView<'_>,
        count: i64,
        corner: impl Fn(i64, i64) -> (i64, i64),
    ) -> BoardSide {
        match self.line(image, count, corner) {
            (seen, _) if seen < LEAST => BoardSide::Unseen,
            (seen, more) if more >= LEAST && SHARE * more >= seen => BoardSide::More,
            _ => BoardSide::End,
        }
    }

    /// Number of its corners whose next position is visible, and at how many of these a corner follows.
    fn line(
        &self,
        image: &ImageView<'_>,
        count: i64,
        corner: impl Fn(i64, i64) -> (i64, i64),
    ) -> (usize, usize) {
        let fitted = |k: i64, i: i64| {
            let (c, r) = corner(k, i);
            self.slots.get(self.id(c, r)?)?.fit.map(|f| f.px)
        };
        let (mut seen, mut more) = (0, 0);
        for k in 0..count {
            let (Some(a), Some(b)) = (fitted(k, 0), fitted(k, 1)) else { continue };
            // constant second difference
            let next: Vector2<f64> = fitted(k, 2).map_or(2.0 * a - b, |c| 3.0 * a - 3.0 * b + c);
            if let Some(follows) = follows(image, a, next) {
                seen += 1;
                more += usize::from(follows);
            }
        }
        (seen, more)
    }
}
