//! Contours of a binarised image with their hierarchy: the border pixels of each region and of each hole in it, in order.
//!
//! A contour is the sequence of pixels at the region's side of an outline ([`Outlines`]), each one a neighbour of the last (by side or
//! corner): outer ones counter-clockwise as seen (down the left side first), those of holes clockwise. An outer contour starts at
//! the first pixel of its region in reading order, that of a hole left of the hole's first pixel. The meaning is that of border
//! following after Suzuki and Abe (1985); what is beyond the image or window counts as background.

use super::outlines::{NONE, Outlines, Walker};
use super::{Connectivity, Run, Runs};

/// A pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Point {
    /// Column, px.
    pub x: u32,
    /// Row, px.
    pub y: u32,
}

/// One contour; its pixels are with [`Contours::points`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Contour {
    /// Whether it is the border of a hole; its pixels are those of the region around the hole.
    pub hole: bool,
    /// Which region it belongs to: the index in [`Components`](super::Components) of the same runs.
    pub region: u32,
    /// How many contours it lies in: even for outer ones, odd for holes.
    pub depth: u32,
    /// Area within the outline, px^2: that of the filled region, or that of the hole with all that lies in it.
    pub area_px2: u64,
    parent: u32,
    first_child: u32,
    next_sibling: u32,
    start: u32,
    end: u32,
}

fn index(link: u32) -> Option<usize> {
    (link != NONE).then_some(link as usize)
}

impl Contour {
    /// The contour around it: for a hole the outer contour of its region, for an outer one that of the hole in which it lies.
    #[must_use]
    pub fn parent(&self) -> Option<usize> {
        index(self.parent)
    }

    /// The first contour directly within it.
    #[must_use]
    pub fn first_child(&self) -> Option<usize> {
        index(self.first_child)
    }

    /// The next contour with the same parent.
    #[must_use]
    pub fn next_sibling(&self) -> Option<usize> {
        index(self.next_sibling)
    }

    /// Number of its pixels; one that is passed twice counts twice.
    #[must_use]
    pub fn len(&self) -> usize {
        (self.end - self.start) as usize
    }

    /// Whether it has no pixels: never, for one that was found.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Finds contours. The buffers are reused.
#[derive(Debug, Clone)]
pub struct Contours {
    outlines: Outlines,
    chain: ContourCollector,
    list: Vec<Contour>,
    /// Of each contour the child that was found last.
    last_child: Vec<u32>,
}

impl Contours {
    /// Buffers for at most `runs` runs and contours of `points` pixels together, allocated at once.
    #[must_use]
    pub fn with_limits(runs: usize, points: usize) -> Self {
        let points = points.min(NONE as usize - 1);
        Self {
            outlines: Outlines::with_limit(runs),
            chain: ContourCollector {
                points: vec![Point::default(); points],
                ends: Vec::with_capacity(runs),
                at: 0,
                full: false,
            },
            list: Vec::with_capacity(runs),
            last_child: Vec::with_capacity(runs),
        }
    }

    /// The contours found last, in the reading order of their first pixels: each behind its parent.
    #[must_use]
    pub fn as_slice(&self) -> &[Contour] {
        &self.list
    }

    /// Pixels of a contour of [`Contours::as_slice`], in order.
    #[must_use]
    pub fn points(&self, contour: &Contour) -> &[Point] {
        self.chain.points.get(contour.start as usize..contour.end as usize).unwrap_or(&[])
    }

    /// Whether there were more pixels than the buffer holds: the contours from there on are missing.
    #[must_use]
    pub fn overflowed(&self) -> bool {
        self.chain.full
    }

    /// Finds the contours of all regions. Which pixels belong together says `connectivity`; steps of a contour go over corners in
    /// any case.
    pub fn find(&mut self, runs: &Runs, connectivity: Connectivity) {
        self.chain.ends.clear();
        (self.chain.at, self.chain.full) = (0, false);
        self.outlines.find_with(runs, connectivity, &mut self.chain);
        self.list.clear();
        self.last_child.clear();
        let mut start = 0;
        let mut last_root = NONE;
        for (i, (outline, &end)) in (0u32..).zip(self.outlines.as_slice().iter().zip(&self.chain.ends)) {
            let parent = outline.parent;
            // brothers and sisters are linked as they come
            let before = self.last_child.get_mut(parent as usize).unwrap_or(&mut last_root);
            let elder = std::mem::replace(before, i);
            if let Some(elder) = self.list.get_mut(elder as usize) {
                elder.next_sibling = i;
            } else if let Some(parent) = self.list.get_mut(parent as usize) {
                parent.first_child = i;
            }
            let depth = self.list.get(parent as usize).map_or(0, |p| p.depth + 1);
            self.list.push(Contour {
                hole: outline.hole,
                region: outline.region,
                depth,
                area_px2: outline.area_px2,
                parent,
                first_child: NONE,
                next_sibling: NONE,
                start,
                end,
            });
            self.last_child.push(NONE);
            start = end;
        }
    }
}

/// Collects the pixels on the left hand of the way along an outline.
#[derive(Debug, Clone)]
struct ContourCollector {
    /// All of the buffer; `at` of it are in use.
    points: Vec<Point>,
    at: usize,
    /// Where each contour ends.
    ends: Vec<u32>,
    full: bool,
}

impl ContourCollector {
    #[inline(always)]
    fn push(&mut self, x: u32, y: u32) {
        if let Some(slot) = self.points.get_mut(self.at) {
            *slot = Point { x, y };
            self.at += 1;
        } else {
            self.full = true;
        }
    }

    /// Pixels `from..to` of a row, to the right.
    #[inline(always)]
    fn east(&mut self, from: u32, to: u32, y: u32) {
        let mut x = from;
        while x < to {
            self.push(x, y);
            x += 1;
        }
    }

    /// Pixels `to..from` of a row, to the left.
    #[inline(always)]
    fn west(&mut self, from: u32, to: u32, y: u32) {
        let mut x = from;
        while x > to {
            x -= 1;
            self.push(x, y);
        }
    }
}

impl Walker for ContourCollector {
    #[inline(always)]
    fn start(&mut self, run: &Run, right: bool) {
        self.push(if right { run.x1 - 1 } else { run.x0 }, run.y);
    }

    #[inline(always)]
    fn step(&mut self, from_right: bool, from: &Run, to_right: bool, to: &Run) {
        let (a, b) = (from.x0, from.x1);
        match (from_right, to_right) {
            // down: along the top of the run below, or along the own bottom
            (false, false) if to.x0 < a => self.west(a, to.x0, to.y),
            (false, false) => {
                self.east(a + 1, to.x0, from.y);
                self.push(to.x0, to.y);
            }
            // up: along the bottom of the run above, or along the own top
            (true, true) if to.x1 > b => self.east(b, to.x1, to.y),
            (true, true) => {
                self.west(b - 1, to.x1, from.y);
                self.push(to.x1 - 1, to.y);
            }
            // around the lower end
            (false, true) if to.x0 == a => self.east(a + 1, b, from.y),
            // around the upper end
            (true, false) if to.x0 == a => self.west(b - 1, a, from.y),
            // over to the run before, by the one below that joins both
            (false, true) => {
                self.west(a, to.x1, from.y + 1);
                self.push(to.x1 - 1, to.y);
            }
            // over to the run behind, by the one above
            (true, false) => {
                self.east(b, to.x0, from.y - 1);
                self.push(to.x0, to.y);
            }
        }
    }

    #[inline(always)]
    fn end(&mut self) {
        // the last step came back to the first pixel
        let start = self.ends.last().map_or(0, |&end| end as usize);
        if self.at > start + 1 {
            self.at -= 1;
        }
        if !self.full {
            self.ends.push(self.at as u32);
        }
    }
}

#[cfg(test)]
mod tests;
