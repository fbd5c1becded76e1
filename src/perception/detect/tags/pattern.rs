//! The cells of a tag as bits (1 for white), in a layout that eight pixels can look up in parallel.

/// Cells along a side of the largest family, 36h11, with the margin: 6 of bits, 2 of border, 2 of margin, as its specification has it.
pub(super) const MAX_CELLS: usize = 10;
/// White cells are 1: by rows, as the image shows the tag that was read.
pub(super) type Whites = [[f64; MAX_CELLS]; MAX_CELLS];

/// Cells before the first one that may be asked for. Pixels lie at most 0.6 cells outside of the black square and are reached by 3 cells more
/// (`whole::AROUND_CELLS`, `whole_model::MAX_BESIDE`), so that 4 would do; with 8 the widest row has 26 bits and still fits its 32.
const BEFORE: i32 = 8;
const ROWS: usize = MAX_CELLS + 2 * BEFORE as usize;

/// A tag as the image shows it, its margin white.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CellPattern {
    /// Bit `i + BEFORE` of row `j + BEFORE` is the cell in column `i`, row `j`.
    rows: [u32; ROWS],
    /// Cells along a side.
    pub(super) cells: usize,
}

impl CellPattern {
    pub(super) fn new(white: &Whites, cells: usize) -> Self {
        let mut rows = [u32::MAX; ROWS];
        for (slot, row) in rows.iter_mut().skip(BEFORE as usize).zip(white).take(cells) {
            for (bit, cell) in (BEFORE..).zip(row).take(cells) {
                *slot &= !(u32::from(*cell < 0.5) << bit);
            }
        }
        Self { rows, cells }
    }

    /// The cells of row `j` from column `i` (-8 or more) on, at least 16 of them: bit 0 is column `i`.
    #[inline(always)]
    pub(super) fn bits_at(&self, i: i32, j: i32) -> u32 {
        let row = self.rows.get((j + BEFORE).max(0) as usize).copied().unwrap_or(u32::MAX);
        // beyond the last bit it is white, too
        !(!row >> (i + BEFORE).clamp(0, 31))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_where_they_were_put() {
        let mut white = [[0.0; MAX_CELLS]; MAX_CELLS];
        white[2][5] = 1.0;
        let pattern = CellPattern::new(&white, 6);
        for j in -8..18 {
            for i in -8..12 {
                let inside = (0..6).contains(&i) && (0..6).contains(&j);
                let wanted = !inside || (i, j) == (5, 2);
                assert_eq!(pattern.bits_at(i, j) & 1 == 1, wanted, "{i} {j}");
                assert_eq!(pattern.bits_at(i - 3, j) >> 3 & 1 == 1, wanted || i < -5, "{i} {j}");
            }
        }
        assert_eq!(pattern.bits_at(i32::MIN / 2, i32::MIN / 2), u32::MAX);
    }
}
