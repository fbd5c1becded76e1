//! Alignment of a lattice with the grid: the shift, the quarter turn and the shear (steps along a diagonal) with the fewest contradicting sizes.

use super::{Lattice, LatticeDot};
use crate::detect::dots::blob::Blob;
use crate::messages::TargetStatus;

/// Share of the detected dots, beyond the first few, that may disagree with the grid: partly occluded dots, dots of other objects. Chosen by hand,
/// so that chance agrees less than once in a thousand views of a foreign grid; `grids_are_found_whatever_lies_around` tests both sides.
const WRONG_SHARE: f64 = 0.2;
const NONE_WRONG: usize = 12;
/// By how many dots the second-best way must be worse, where the best one is not without fault. Chosen by hand: with one, a single dot that is
/// taken for large would turn the choice; with six, half a grid in view is often ambiguous.
const CLEARLY_WORSE: usize = 3;
/// The grid's own steps in terms of those walked: turns follow by rotation.
const SHEARS: [[i32; 4]; 5] = [[1, 0, 0, 1], [1, 1, 0, 1], [1, -1, 0, 1], [1, 0, 1, 1], [1, 0, -1, 1]];

/// A transformation of lattice coordinates to columns and rows of the grid: `at' = M at + shift`.
#[derive(Debug, Clone, Copy)]
pub(super) struct GridTransform {
    M: [i32; 4],
    shift: [i32; 2],
    wrong: usize,
}

impl GridTransform {
    fn place(&self, [i, j]: [i32; 2]) -> [i32; 2] {
        let [a, b, c, d] = self.M;
        [a * i + b * j + self.shift[0], c * i + d * j + self.shift[1]]
    }
}

impl Lattice {
    /// The transformation with which the lattice is part of the grid, and by how many dots any other one is worse.
    pub(super) fn lay(&self) -> Result<(GridTransform, usize), TargetStatus> {
        let (columns, rows) = (self.grid.columns() as i32, self.grid.rows() as i32);
        let (mut best, mut second) = (None::<GridTransform>, usize::MAX);
        let max_wrong = (WRONG_SHARE * self.best.len().saturating_sub(NONE_WRONG) as f64) as usize;
        // one with more contradictions is neither the best nor near it
        let hopeless = max_wrong + CLEARLY_WORSE;
        for M in ways() {
            let (low, high) = self.extent(M);
            // a few cells may belong to something beside the grid
            let slack = 2;
            for y in -low[1] - slack..rows - high[1] + slack {
                for x in -low[0] - slack..columns - high[0] + slack {
                    let way = GridTransform { M, shift: [x, y], wrong: 0 };
                    let mut wrong = 0;
                    for cell in &self.best {
                        wrong += usize::from(self.fits(&way, cell).is_none());
                        if wrong > hopeless {
                            break;
                        }
                    }
                    let way = GridTransform { wrong, ..way };
                    match best {
                        Some(known) if wrong >= known.wrong => second = second.min(wrong),
                        _ => {
                            second = best.map_or(second, |known| second.min(known.wrong));
                            best = Some(way);
                        }
                    }
                }
            }
        }
        match best {
            Some(way) if way.wrong > max_wrong => Err(TargetStatus::NoMatch),
            // no two windows are alike, so that without a disagreement one way alone is without
            Some(way) if second < way.wrong + if way.wrong == 0 { 1 } else { CLEARLY_WORSE } => {
                Err(TargetStatus::Ambiguous)
            }
            Some(way) => Ok((way, second - way.wrong)),
            None => Err(TargetStatus::NoMatch),
        }
    }

    /// The id of a cell, if its dot has the size that the grid has there.
    pub(super) fn fits(&self, way: &GridTransform, cell: &LatticeDot) -> Option<u32> {
        let [x, y] = way.place(cell.at);
        let (column, row) = (usize::try_from(x).ok()?, usize::try_from(y).ok()?);
        let large = self.grid.is_large(column, row)?;
        (large == cell.large).then_some((row * self.grid.columns() + column) as u32)
    }

    /// Whether the identified dots contain a complete window, which is unique in the grid.
    pub(super) fn has_window(&self) -> bool {
        let (columns, rows, w) = (self.grid.columns(), self.grid.rows(), self.grid.window());
        let there = |x: usize, y: usize| self.present.get(y * columns + x).copied().unwrap_or(false);
        (0..=rows - w).any(|y| (0..=columns - w).any(|x| (0..w * w).all(|i| there(x + i % w, y + i / w))))
    }

    /// Ids of all cells of a grid of equal dots, in its orientation that is upright in the image.
    pub(super) fn lay_upright(
        &self,
        candidates: &[(f64, Blob)],
        chosen: &mut Vec<(u32, Blob)>,
    ) -> Result<(), TargetStatus> {
        let (columns, rows) = (self.grid.columns() as i32, self.grid.rows() as i32);
        if self.best.len() != self.grid.points().len() {
            return Err(TargetStatus::NoMatch);
        }
        let mut best = None::<(f64, GridTransform)>;
        for M in ways() {
            let (low, high) = self.extent(M);
            if [high[0] - low[0] + 1, high[1] - low[1] + 1] != [columns, rows] {
                continue;
            }
            let way = GridTransform { M, shift: [-low[0], -low[1]], wrong: 0 };
            let at = |place: [i32; 2]| {
                let cell = self.best.iter().find(|cell| way.place(cell.at) == place)?;
                self.points.get(cell.candidate).copied()
            };
            let (Some(first), Some(right), Some(below)) =
                (at([0, 0]), at([columns - 1, 0]), at([0, rows - 1]))
            else {
                continue;
            };
            let upright = (right - first).normalize().x + (below - first).normalize().y;
            if best.is_none_or(|(known, _)| upright > known) {
                best = Some((upright, way));
            }
        }
        let Some((_, way)) = best else { return Err(TargetStatus::NoMatch) };
        for cell in &self.best {
            if let (Some(id), Some((_, blob))) = (self.fits(&way, cell), candidates.get(cell.candidate)) {
                chosen.push((id, *blob));
            }
        }
        chosen.sort_unstable_by_key(|(id, _)| *id);
        if chosen.len() == self.best.len() { Ok(()) } else { Err(TargetStatus::NoMatch) }
    }

    /// Least and greatest places of the cells, turned and sheared.
    fn extent(&self, M: [i32; 4]) -> ([i32; 2], [i32; 2]) {
        let (mut low, mut high) = ([i32::MAX; 2], [i32::MIN; 2]);
        for cell in &self.best {
            let place = GridTransform { M, shift: [0, 0], wrong: 0 }.place(cell.at);
            for k in 0..2 {
                low[k] = low[k].min(place[k]);
                high[k] = high[k].max(place[k]);
            }
        }
        (low, high)
    }
}

/// All turns of all shears.
fn ways() -> impl Iterator<Item = [i32; 4]> {
    SHEARS
        .into_iter()
        .flat_map(|[a, b, c, d]| [[a, b, c, d], [-c, -d, a, b], [-a, -b, -c, -d], [c, d, -a, -b]])
}
