//! Sums of a region from its border alone: Green's theorem in its discrete form.

use super::{MomentSums, power_sums};
use crate::imaging::Point;

impl MomentSums {
    /// Sums over what a border encloses: exactly those of the filled region for an outer border, and those of the hole, negative, for
    /// the border of a hole, so that a region's outer border and its holes' add up to the region. The border is one of
    /// [`Contours`](crate::imaging::Contours) (pixels that share a corner belong together).
    ///
    /// Between the step that comes to a pixel and the one that leaves it, the border turns by the pixels beside the region; where one
    /// of these lies to the left or to the right, a vertical side of the outline is passed.
    #[must_use]
    pub fn of_border(border: &[Point]) -> Self {
        let mut sums = Self::default();
        let (Some(&last), Some(&first)) = (border.last(), border.first()) else { return sums };
        let mut before = last;
        for (i, &at) in border.iter().enumerate() {
            let next = border.get(i + 1).copied().unwrap_or(first);
            let (back, out) = (direction(at, before), direction(at, next));
            let (left, right) = match (back, out) {
                (Some(back), Some(out)) => (passes(back, out, WEST), passes(back, out, EAST)),
                // a region of one pixel
                _ => (true, true),
            };
            // sums over all columns left of the side; the difference of two is a run
            if left {
                let (n, s1, s2, s3) = power_sums(0, at.x);
                sums -= Self::of_row([n.into(), s1.into(), s2.into(), s3 as i128], at.y.into());
            }
            if right {
                let (n, s1, s2, s3) = power_sums(0, at.x.saturating_add(1));
                sums += Self::of_row([n.into(), s1.into(), s2.into(), s3 as i128], at.y.into());
            }
            before = at;
        }
        sums
    }
}

/// Directions in eighths of a turn, so that half of a turn is four.
const EAST: u8 = 0;
const WEST: u8 = 4;

/// One of eight directions, counted from the columns' axis away from the rows' one: east 0, north 2, west 4, south 6.
fn direction(from: Point, to: Point) -> Option<u8> {
    Some(match (to.x.cmp(&from.x), to.y.cmp(&from.y)) {
        (std::cmp::Ordering::Greater, std::cmp::Ordering::Equal) => EAST,
        (std::cmp::Ordering::Greater, std::cmp::Ordering::Less) => 1,
        (std::cmp::Ordering::Equal, std::cmp::Ordering::Less) => 2,
        (std::cmp::Ordering::Less, std::cmp::Ordering::Less) => 3,
        (std::cmp::Ordering::Less, std::cmp::Ordering::Equal) => WEST,
        (std::cmp::Ordering::Less, std::cmp::Ordering::Greater) => 5,
        (std::cmp::Ordering::Equal, std::cmp::Ordering::Greater) => 6,
        (std::cmp::Ordering::Greater, std::cmp::Ordering::Greater) => 7,
        (std::cmp::Ordering::Equal, std::cmp::Ordering::Equal) => return None,
    })
}

/// Whether the turn from `back` to `out`, counting up, comes by `side`, ends not included; a full turn where they are equal.
fn passes(back: u8, out: u8, side: u8) -> bool {
    let turn = |to: u8| (to + 8 - back) % 8;
    let (to_side, to_out) = (turn(side), if out == back { 8 } else { turn(out) });
    to_side > 0 && to_side < to_out
}
