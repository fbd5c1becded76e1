//! Families of AprilTags: which cells of which tag are black.
//!
//! ```text
//!  . . . . . . . .      .  white margin, one cell at least       columns to the right (x), rows down (y), (0, 0) is the
//!  . # # # # # # .      #  black border                          border's cell at the upper left. Corner places in
//!  . # 0 1 2 4 # .      n  bit n of the code, the first being    cells, as AprilTag 3 counts the corners:
//!  . # e 3 7 5 # .         the highest; 1 = white (16h5)
//!  . # d f b 6 # .                                               3 (0, 0) ---- 2 (w, 0)
//!  . # c a 9 8 # .      The layout has four equal quarters:          |             |
//!  . # # # # # # .      a turn of the tag by 90 degrees              |             |
//!  . . . . . . . .      rotates the code by a quarter.           0 (0, w) ---- 1 (w, w)
//! ```
//! Corners go counter-clockwise for who looks at the tag, from the lower left one, as in AprilTag 3 and ViSP. (ArUco counts
//! clockwise.) The object frame of a tag has x to the right, y down and z into it, as all targets here; its origin
//! is the business of the target.

mod tag16h5;
mod tag25h9;
mod tag36h11;

use std::fmt;
use std::str::FromStr;
use thiserror::Error;

/// The colour of a cell.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TagCell {
    /// Ink.
    Black,
    /// Paper.
    White,
}

/// A family of tags.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum TagFamily {
    /// 587 tags of 6 x 6 bits, 11 of which differ between any two.
    Tag36h11,
    /// 35 tags of 5 x 5 bits, distance 9.
    Tag25h9,
    /// 30 tags of 4 x 4 bits, distance 5: easily mistaken for clutter.
    Tag16h5,
}

/// No family has this name.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("unknown tag family `{0}`: 36h11, 25h9 and 16h5 are known")]
pub struct UnknownTagFamily(String);

impl TagFamily {
    /// All families.
    pub const ALL: [Self; 3] = [Self::Tag36h11, Self::Tag25h9, Self::Tag16h5];

    /// Its name, as [`FromStr`] reads it: `36h11`.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Tag36h11 => "36h11",
            Self::Tag25h9 => "25h9",
            Self::Tag16h5 => "16h5",
        }
    }

    /// Its code words; the index is the id.
    #[must_use]
    pub const fn codes(self) -> &'static [u64] {
        match self {
            Self::Tag36h11 => &tag36h11::CODES,
            Self::Tag25h9 => &tag25h9::CODES,
            Self::Tag16h5 => &tag16h5::CODES,
        }
    }

    /// How many tags there are: ids are `0..count()`.
    #[must_use]
    pub const fn count(self) -> u32 {
        self.codes().len() as u32
    }

    /// Bits along a side.
    #[must_use]
    pub const fn bits_per_side(self) -> u32 {
        match self {
            Self::Tag36h11 => 6,
            Self::Tag25h9 => 5,
            Self::Tag16h5 => 4,
        }
    }

    /// Bits of a code.
    #[must_use]
    pub const fn bits(self) -> u32 {
        self.bits_per_side() * self.bits_per_side()
    }

    /// Cells along a side of the black square, between its corners.
    #[must_use]
    pub const fn cells_per_side(self) -> u32 {
        self.bits_per_side() + 2
    }

    /// Least number of bits in which two tags differ, however they are turned.
    #[must_use]
    pub const fn distance(self) -> u32 {
        match self {
            Self::Tag36h11 => 11,
            Self::Tag25h9 => 9,
            Self::Tag16h5 => 5,
        }
    }

    /// Column and row of bit `index` of the code (0 the highest), within the black square: 1 to [`Self::bits_per_side`] each.
    /// Indices behind the last wrap.
    #[must_use]
    pub const fn place(self, index: u32) -> (u32, u32) {
        let (side, quarter) = (self.bits_per_side(), self.bits() / 4);
        let index = index % self.bits();
        if index == 4 * quarter {
            // an odd side has one in the middle
            return (side.div_ceil(2), side.div_ceil(2));
        }
        // the first quarter: of each ring its upper row, without the last
        let (mut left, mut ring) = (index % quarter, 1);
        while left >= side + 1 - 2 * ring {
            left -= side + 1 - 2 * ring;
            ring += 1;
        }
        let (mut column, mut row) = (ring + left, ring);
        let mut turns = index / quarter;
        while turns > 0 {
            (column, row) = (side + 1 - row, column);
            turns -= 1;
        }
        (column, row)
    }

    /// The cell in `column` and `row` of tag `id`, (0, 0) the upper left one of the black border; white all around that.
    /// `None` for an id that does not exist.
    #[must_use]
    pub fn cell(self, id: u32, column: i32, row: i32) -> Option<TagCell> {
        let code = *self.codes().get(id as usize)?;
        let cells = self.cells_per_side() as i32;
        if !(0..cells).contains(&column) || !(0..cells).contains(&row) {
            return Some(TagCell::White);
        }
        let place = (column as u32, row as u32);
        let bit = (0..self.bits()).find(|&i| self.place(i) == place);
        let white = bit.is_some_and(|i| code >> (self.bits() - 1 - i) & 1 == 1);
        Some(if white { TagCell::White } else { TagCell::Black })
    }

    /// Place of corner 0 to 3 of the black square, in cells from its upper left corner, x to the right, y down; 4 is 0 again.
    #[must_use]
    pub const fn corner(self, corner: usize) -> (u32, u32) {
        let w = self.cells_per_side();
        match corner % 4 {
            0 => (0, w),
            1 => (w, w),
            2 => (w, 0),
            _ => (0, 0),
        }
    }

    /// The code of a tag that is seen turned: what `code` reads as when the tag is turned by 90 degrees counter-clockwise `turns` times.
    #[must_use]
    pub const fn turned(self, code: u64, turns: u32) -> u64 {
        let middle = self.bits() % 4;
        let ring = self.bits() - middle;
        let quarter = ring / 4 * (turns % 4);
        let (outer, inner) = (code >> middle, code & ((1 << middle) - 1));
        let mask = (1u64 << ring) - 1;
        let outer = (outer << quarter | outer >> (ring - quarter)) & mask;
        outer << middle | inner
    }
}

impl fmt::Display for TagFamily {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for TagFamily {
    type Err = UnknownTagFamily;

    /// `36h11`, also with `tag` or `tag_` before it, and as ViSP writes it, `36_11`.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let lower = text.to_ascii_lowercase();
        let name = lower.strip_prefix("tag").unwrap_or(&lower).trim_start_matches('_').replace('_', "h");
        let family = Self::ALL.into_iter().find(|family| family.name() == name);
        family.ok_or_else(|| UnknownTagFamily(text.chars().take(32).collect()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The table of places as AprilTag 3 lists it for 16h5: (x, y) from the black square's corner.
    const PLACES_16H5: [(u32, u32); 16] = [
        (1, 1),
        (2, 1),
        (3, 1),
        (2, 2),
        (4, 1),
        (4, 2),
        (4, 3),
        (3, 2),
        (4, 4),
        (3, 4),
        (2, 4),
        (3, 3),
        (1, 4),
        (1, 3),
        (1, 2),
        (2, 3),
    ];

    #[test]
    fn places_are_those_of_apriltag_3() {
        for (i, &place) in (0..).zip(&PLACES_16H5) {
            assert_eq!(TagFamily::Tag16h5.place(i), place, "bit {i}");
        }
        let f = TagFamily::Tag25h9;
        assert_eq!([f.place(3), f.place(4), f.place(5), f.place(6)], [(4, 1), (2, 2), (3, 2), (5, 1)]);
        assert_eq!([f.place(17), f.place(23), f.place(24)], [(3, 4), (2, 3), (3, 3)]);
        let f = TagFamily::Tag36h11;
        assert_eq!([f.place(4), f.place(5), f.place(8), f.place(9)], [(5, 1), (2, 2), (3, 3), (6, 1)]);
        assert_eq!([f.place(17), f.place(26), f.place(34), f.place(35)], [(4, 3), (4, 4), (2, 3), (3, 4)]);
    }

    #[test]
    fn each_bit_has_its_own_cell() {
        for family in TagFamily::ALL {
            let mut seen: Vec<_> = (0..family.bits()).map(|i| family.place(i)).collect();
            seen.sort_unstable();
            seen.dedup();
            assert_eq!(seen.len(), family.bits() as usize);
            let side = 1..=family.bits_per_side();
            assert!(seen.iter().all(|(x, y)| side.contains(x) && side.contains(y)));
        }
    }

    /// The distance that a family promises, over all pairs and turns: a digit copied wrongly would break it.
    #[test]
    fn codes_keep_their_distance() {
        for family in TagFamily::ALL {
            let codes = family.codes();
            let mut least = u32::MAX;
            for (i, &a) in codes.iter().enumerate() {
                assert_eq!(a >> family.bits(), 0);
                for turns in 0..4 {
                    let turned = family.turned(a, turns);
                    for (j, &b) in codes.iter().enumerate().take(i + 1) {
                        if i != j || turns != 0 {
                            least = least.min((turned ^ b).count_ones());
                        }
                    }
                }
            }
            assert_eq!(least, family.distance(), "{family}");
        }
    }

    #[test]
    fn a_turned_tag_reads_as_the_turned_code() {
        for family in TagFamily::ALL {
            let (n, id) = (family.cells_per_side() as i32, family.count() - 1);
            for turns in 0..4 {
                let mut code = 0u64;
                for bit in 0..family.bits() {
                    let (x, y) = family.place(bit);
                    let (mut x, mut y) = (x as i32, y as i32);
                    // where the cell of the image lies in the tag: the image shows it turned counter-clockwise
                    for _ in 0..turns {
                        (x, y) = (n - 1 - y, x);
                    }
                    code = code << 1 | u64::from(family.cell(id, x, y) == Some(TagCell::White));
                }
                assert_eq!(code, family.turned(family.codes()[id as usize], turns));
            }
        }
    }

    #[test]
    fn border_black_margin_white() {
        let f = TagFamily::Tag36h11;
        assert_eq!(f.cell(0, 0, 0), Some(TagCell::Black));
        assert_eq!(f.cell(0, 7, 3), Some(TagCell::Black));
        assert_eq!(f.cell(0, -1, 3), Some(TagCell::White));
        assert_eq!(f.cell(0, 8, 8), Some(TagCell::White));
        assert_eq!(f.cell(587, 0, 0), None);
        // 0xd5d628584: the first bits are 1101
        let first: Vec<_> = (1..5).map(|x| f.cell(0, x, 1) == Some(TagCell::White)).collect();
        assert_eq!(first, [true, true, false, true]);
    }

    #[test]
    fn names() {
        for family in TagFamily::ALL {
            assert_eq!(family.name().parse(), Ok(family));
            assert_eq!(format!("tag{family}").parse(), Ok(family));
        }
        assert_eq!("TAG_36h11".parse(), Ok(TagFamily::Tag36h11));
        assert_eq!("36_11".parse(), Ok(TagFamily::Tag36h11));
        assert!("".parse::<TagFamily>().is_err() && "tagCircle21h7".parse::<TagFamily>().is_err());
    }
}
