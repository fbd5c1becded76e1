//! Outlines of regions: closed ways along the pixel sides between a region and what is not it, and which lies in which.
//!
//! A run has a left and a right end. With the region on the left hand, an outline comes down past left ends and up past right
//! ends, and between two ends it goes along a row. So the ends of all runs, each with the one that follows it, hold all outlines:
//! one pass over neighbouring rows links them, and no pixel is looked at.
//!
//! ```text
//!      L0━━━━━━━R0            left end of run 0 -> left end of run 1 (SW of it) -> ... -> right end of run 1
//!   L1━━━━R1  L2━━R2          -> left end of run 2 (the gap above belongs to both) -> ... -> right end of run 0
//! ```
//! The first end of an outer outline, in reading order, is a left one, that of a hole a right one. What lies left of it in
//! its row tells what it lies in (Suzuki and Abe 1985).

use super::{Connectivity, Run, Runs};
use std::ops::Range;

/// Stands for "none" and "not seen yet".
pub(super) const NONE: u32 = u32::MAX;

/// An outline: of a region from outside, or of a hole in it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Outline {
    /// Run where it starts: at its left end for an outer outline, at its right end for a hole.
    pub run: u32,
    /// Whether it is a hole's.
    pub hole: bool,
    /// Which region it belongs to, counted in reading order: the index in [`Components`](super::Components) of the same runs.
    pub region: u32,
    /// What is within it, px^2, with all that may lie in its holes.
    pub area_px2: u64,
    pub(super) parent: u32,
}

impl Outline {
    /// The outline around it: for a hole the outer outline of its region, for an outer one the hole in which it lies.
    #[must_use]
    pub fn parent(&self) -> Option<usize> {
        (self.parent != NONE).then_some(self.parent as usize)
    }
}

/// Finds the outlines of all regions of a binarised image. The buffers are reused.
#[derive(Debug, Clone, Default)]
pub struct Outlines {
    /// Of each end the next one: the left end of run i is 2 i, the right one 2 i + 1.
    next: Vec<u32>,
    /// Of each end the outline that it belongs to.
    of: Vec<u32>,
    list: Vec<Outline>,
}

impl Outlines {
    /// Buffers for at most `limit` runs, allocated at once.
    #[must_use]
    pub fn with_limit(limit: usize) -> Self {
        let buffer = || Vec::with_capacity(limit.saturating_mul(2));
        Self { next: buffer(), of: buffer(), list: Vec::with_capacity(limit) }
    }

    /// The outlines found last, in the reading order of their first ends: each behind the one that it lies in.
    #[must_use]
    pub fn as_slice(&self) -> &[Outline] {
        &self.list
    }

    /// Finds all outlines.
    pub fn find(&mut self, runs: &Runs, connectivity: Connectivity) {
        let mut none = ();
        self.find_with(runs, connectivity, &mut none);
    }

    /// Finds all outlines and tells `walker` each step.
    #[inline(always)]
    pub(super) fn find_with(&mut self, runs: &Runs, connectivity: Connectivity, walker: &mut impl Walker) {
        let runs = runs.as_slice();
        self.link(runs, connectivity);
        self.of.clear();
        self.of.resize(self.next.len(), NONE);
        self.list.clear();
        let mut regions = 0;
        // the last end to the left in the same row, and the row
        let (mut left, mut row) = (NONE, u32::MAX);
        for (i, run) in (0u32..).zip(runs) {
            if run.y != row {
                (left, row) = (NONE, run.y);
            }
            for end in [2 * i, 2 * i + 1] {
                let hole = end & 1 == 1;
                let mut own = self.of.get(end as usize).copied().unwrap_or(0);
                if own == NONE {
                    own = self.list.len() as u32;
                    // a neighbour of the same kind is a sibling, one of the other kind is around
                    let around = self.list.get(left as usize);
                    let parent = around.map_or(NONE, |o| if o.hole == hole { o.parent } else { left });
                    let region = match self.list.get(parent as usize) {
                        Some(outer) if hole => outer.region,
                        _ => regions,
                    };
                    regions += u32::from(!hole);
                    let area_px2 = self.walk(runs, end, own, walker);
                    self.list.push(Outline { run: i, hole, region, area_px2, parent });
                }
                left = own;
            }
        }
    }

    /// Goes along an outline found last once more, and tells `walker` each step.
    #[inline(always)]
    pub(super) fn retrace(&self, runs: &[Run], outline: &Outline, walker: &mut impl Walker) {
        trace(&self.next, runs, 2 * outline.run + u32::from(outline.hole), walker, |_, _| {});
    }

    /// Goes once along the outline `own` from its first end, and returns its area.
    #[inline(always)]
    fn walk(&mut self, runs: &[Run], first: u32, own: u32, walker: &mut impl Walker) -> u64 {
        let mut area = 0i64;
        let of = &mut self.of;
        trace(&self.next, runs, first, walker, |end, run| {
            if let Some(of) = of.get_mut(end as usize) {
                *of = own;
            }
            area += if end & 1 == 1 { i64::from(run.x1) } else { -i64::from(run.x0) };
        });
        area.unsigned_abs()
    }

    /// Which end follows which.
    fn link(&mut self, runs: &[Run], connectivity: Connectivity) {
        let count = runs.len().min(u32::MAX as usize / 2 - 1);
        self.next.clear();
        // without a neighbour the outline goes around the run
        self.next.extend((0..count as u32).flat_map(|i| [2 * i + 1, 2 * i]));
        let reach = u32::from(connectivity == Connectivity::Eight);
        let mut row = 0..0;
        while row.end < count {
            let Some(y) = runs.get(row.end).map(|run| run.y) else { return };
            let adjacent =
                row.end > 0 && runs.get(row.start).is_some_and(|run| run.y.checked_add(1) == Some(y));
            let above = if adjacent { row.clone() } else { row.end..row.end };
            row = row.end..count;
            row.end =
                row.start + runs.get(row.clone()).unwrap_or(&[]).iter().take_while(|run| run.y == y).count();
            if !above.is_empty() {
                self.link_rows(runs, &above, &row, reach);
            }
        }
    }

    /// Links the left ends of a row with what lies below, and the right ends of the row below with what lies above: the same, turned
    /// by half a turn.
    #[inline(always)]
    fn link_rows(&mut self, runs: &[Run], above: &Range<usize>, below: &Range<usize>, reach: u32) {
        let (Some(top), Some(bottom)) = (runs.get(above.clone()), runs.get(below.clone())) else { return };
        let left = |row: &Range<usize>, i: usize| 2 * (row.start + i) as u32;
        let right = |row: &Range<usize>, i: usize| left(row, i) + 1;
        let mut j = 0;
        for (i, run) in top.iter().enumerate() {
            while bottom.get(j).is_some_and(|under| under.x1 + reach <= run.x0) {
                j += 1;
            }
            let Some(under) = bottom.get(j) else { break };
            let to = if under.x0 <= run.x0 {
                // along the top of `under` to the left, to its end or to the run before
                match i.checked_sub(1).and_then(|k| top.get(k)) {
                    Some(before) if before.x1 + reach > under.x0 => right(above, i - 1),
                    _ => left(below, j),
                }
            } else if under.x0 < run.x1 + reach {
                left(below, j)
            } else {
                continue;
            };
            if let Some(slot) = self.next.get_mut(left(above, i) as usize) {
                *slot = to;
            }
        }
        let mut j = 0;
        for (i, run) in bottom.iter().enumerate() {
            while top.get(j).is_some_and(|over| over.x0 < run.x1 + reach) {
                j += 1;
            }
            let Some((k, over)) = j.checked_sub(1).and_then(|k| Some((k, top.get(k)?))) else { continue };
            let to = if over.x1 >= run.x1 {
                // along the bottom of `over` to the right, to its end or to the run behind
                match bottom.get(i + 1) {
                    Some(behind) if behind.x0 < over.x1 + reach => left(below, i + 1),
                    _ => right(above, k),
                }
            } else if over.x1 + reach > run.x0 {
                right(above, k)
            } else {
                continue;
            };
            if let Some(slot) = self.next.get_mut(right(below, i) as usize) {
                *slot = to;
            }
        }
    }
}

/// Goes once along the outline from its end `first`: `visit` is told each end with its run, `walker` each step.
#[inline(always)]
fn trace(next: &[u32], runs: &[Run], first: u32, walker: &mut impl Walker, mut visit: impl FnMut(u32, &Run)) {
    let mut end = first;
    let Some(&(mut run)) = runs.get(first as usize / 2) else { return };
    walker.start(&run, first & 1 == 1);
    // each end is passed once
    for _ in 0..next.len() {
        visit(end, &run);
        let Some(&next) = next.get(end as usize) else { break };
        let Some(&to) = runs.get(next as usize / 2) else { break };
        walker.step(end & 1 == 1, &run, next & 1 == 1, &to);
        (end, run) = (next, to);
        if end == first {
            break;
        }
    }
    walker.end();
}

/// Is told the steps of all outlines, one after the other.
pub(super) trait Walker {
    /// A new outline begins at an end of `run`.
    fn start(&mut self, run: &Run, right: bool);
    /// From an end of one run to an end of another, or of the same.
    fn step(&mut self, from_right: bool, from: &Run, to_right: bool, to: &Run);
    /// The outline is closed.
    fn end(&mut self);
}

/// For those who want no steps.
impl Walker for () {
    #[inline(always)]
    fn start(&mut self, _: &Run, _: bool) {}
    #[inline(always)]
    fn step(&mut self, _: bool, _: &Run, _: bool, _: &Run) {}
    #[inline(always)]
    fn end(&mut self) {}
}

#[cfg(test)]
mod tests;
