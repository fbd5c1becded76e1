//! Connected regions of dark runs, with their moments.
//!
//! ```text
//! m_rs = sum of x^r y^s over the region's pixels                                (10.1)
//! ```
//! r + s <= 2 with every region, to the third order when they are asked for ([`Components::sums`]). All sums are exact integers, of whole
//! runs at a time; exact for images of up to 2^20 columns and rows.

mod labels;

use super::moments::power_sums;
use super::{Run, Runs, Window};

/// Which neighbours belong together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Connectivity {
    /// Pixels that share a side.
    Four,
    /// Pixels that share a side or a corner.
    Eight,
}

/// One connected region.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Component {
    /// Area, px^2.
    pub m00: u64,
    /// Sum of columns, px^3.
    pub m10: u64,
    /// Sum of rows, px^3.
    pub m01: u64,
    /// Sum of squared columns, px^4.
    pub m20: u64,
    /// Sum of products of column and row, px^4.
    pub m11: u64,
    /// Sum of squared rows, px^4.
    pub m02: u64,
    /// First column.
    pub x0: u32,
    /// Column behind the last.
    pub x1: u32,
    /// First row.
    pub y0: u32,
    /// Row behind the last.
    pub y1: u32,
    /// Whether a pixel lies on the border of the image or window that was searched.
    pub touches_border: bool,
}

impl Component {
    /// Centroid (column, row), px.
    #[must_use]
    pub fn centroid(&self) -> (f64, f64) {
        let n = self.m00.max(1) as f64;
        (self.m10 as f64 / n, self.m01 as f64 / n)
    }

    /// Central moments of second order divided by the area: `[mu20, mu11, mu02] / m00`, px^2.
    #[must_use]
    pub fn covariance(&self) -> [f64; 3] {
        // about the box's corner, in integers: no cancellation
        let (x0, y0) = (u128::from(self.x0), u128::from(self.y0));
        let n = u128::from(self.m00);
        let (sx, sy) = (u128::from(self.m10) - n * x0, u128::from(self.m01) - n * y0);
        let sxx = u128::from(self.m20) + n * x0 * x0 - 2 * x0 * u128::from(self.m10);
        let syy = u128::from(self.m02) + n * y0 * y0 - 2 * y0 * u128::from(self.m01);
        let sxy = u128::from(self.m11) + n * x0 * y0 - x0 * u128::from(self.m01) - y0 * u128::from(self.m10);
        let area = self.m00.max(1) as f64;
        let mean = |s: u128| s as f64 / area;
        [mean(sxx) - mean(sx).powi(2), mean(sxy) - mean(sx) * mean(sy), mean(syy) - mean(sy).powi(2)]
    }

    /// A region of one run, as far as is known without the window: not whether it touches its border.
    #[inline(always)]
    fn of_run(run: &Run) -> Self {
        let mut part = Self { x0: run.x0, y0: run.y, ..Self::default() };
        part.add_run(run);
        part
    }

    /// Adds the pixels of a run, which lies below those of before or beside them.
    #[inline(always)]
    pub(crate) fn add_run(&mut self, run: &Run) {
        let (y, (n, sum, squares, _)) = (u64::from(run.y), power_sums(run.x0, run.x1));
        let (ny, y2) = (n.wrapping_mul(y), y.wrapping_mul(y));
        self.m00 += n;
        self.m10 = self.m10.wrapping_add(sum);
        self.m01 = self.m01.wrapping_add(ny);
        self.m20 = self.m20.wrapping_add(squares);
        self.m11 = self.m11.wrapping_add(sum.wrapping_mul(y));
        self.m02 = self.m02.wrapping_add(n.wrapping_mul(y2));
        self.x0 = self.x0.min(run.x0);
        self.x1 = self.x1.max(run.x1);
        self.y1 = run.y + 1;
    }

    #[inline(always)]
    fn add(&mut self, other: &Self) {
        self.m00 += other.m00;
        self.m10 += other.m10;
        self.m01 += other.m01;
        self.m20 = self.m20.wrapping_add(other.m20);
        self.m11 = self.m11.wrapping_add(other.m11);
        self.m02 = self.m02.wrapping_add(other.m02);
        self.x0 = self.x0.min(other.x0);
        self.x1 = self.x1.max(other.x1);
        self.y0 = self.y0.min(other.y0);
        self.y1 = self.y1.max(other.y1);
    }
}

/// Labels runs and gathers their regions. The buffers are reused.
#[derive(Debug, Clone, Default)]
pub struct Components {
    labels: Vec<u32>,
    parents: Vec<u32>,
    parts: Vec<Component>,
    list: Vec<Component>,
    /// Region of each part, and of each run, when they were asked for.
    indices: Vec<u32>,
    of_runs: Vec<u32>,
}

impl Components {
    /// Buffers for at most `limit` runs, allocated at once.
    #[must_use]
    pub fn with_limit(limit: usize) -> Self {
        Self {
            labels: Vec::with_capacity(limit),
            parents: Vec::with_capacity(limit),
            parts: Vec::with_capacity(limit),
            list: Vec::with_capacity(limit),
            indices: Vec::with_capacity(limit),
            of_runs: Vec::with_capacity(limit),
        }
    }

    /// The regions found last, in the order of their first pixels.
    #[must_use]
    pub fn as_slice(&self) -> &[Component] {
        &self.list
    }

    /// Joins the runs of a window into regions.
    pub fn find(&mut self, runs: &Runs, window: &Window, connectivity: Connectivity) {
        let runs = runs.as_slice();
        self.labels.clear();
        self.parents.clear();
        self.parts.clear();
        self.list.clear();
        let reach = u32::from(connectivity == Connectivity::Eight);
        // `above` walks over the runs of the row above
        let (mut above, mut row_start, mut row) = (0, 0, u32::MAX);
        for (i, run) in runs.iter().enumerate() {
            if run.y != row {
                let adjacent = row != u32::MAX && run.y == row + 1;
                above = if adjacent { row_start } else { i };
                row_start = i;
                row = run.y;
            }
            let mut label = u32::MAX;
            while let Some(other) = runs.get(above).filter(|_| above < row_start) {
                if other.x1 + reach <= run.x0 {
                    above += 1;
                    continue;
                }
                if other.x0 >= run.x1 + reach {
                    break;
                }
                let root = self.root(self.labels.get(above).copied().unwrap_or(0));
                label = if label == u32::MAX { root } else { self.unite(label, root) };
                // a run that reaches further may touch the next run of this row too
                if other.x1 >= run.x1 + reach {
                    break;
                }
                above += 1;
            }
            if let Some(known) = self.parts.get_mut(label as usize) {
                known.add_run(run);
            } else {
                label = self.parts.len() as u32;
                self.parts.push(Component::of_run(run));
                self.parents.push(label);
            }
            self.labels.push(label);
        }
        self.gather(window);
    }

    /// Adds each part to its root; parents are always smaller, so one pass from behind is enough.
    fn gather(&mut self, window: &Window) {
        for i in (0..self.parts.len()).rev() {
            let (Some(&parent), Some(&part)) = (self.parents.get(i), self.parts.get(i)) else { continue };
            if parent as usize != i
                && let Some(root) = self.parts.get_mut(parent as usize)
            {
                root.add(&part);
            }
        }
        for (i, (&parent, part)) in self.parents.iter().zip(&self.parts).enumerate() {
            if parent as usize == i {
                // some pixel lies on the border where the box reaches it
                let touches_border = part.x0 as usize == window.x0
                    || part.x1 as usize == window.x1
                    || part.y0 as usize == window.y0
                    || part.y1 as usize == window.y1;
                self.list.push(Component { touches_border, ..*part });
            }
        }
    }

    #[inline]
    fn root(&mut self, mut label: u32) -> u32 {
        while let Some(&parent) = self.parents.get(label as usize) {
            if parent == label {
                break;
            }
            let grand = self.parents.get(parent as usize).copied().unwrap_or(parent);
            if let Some(slot) = self.parents.get_mut(label as usize) {
                *slot = grand;
            }
            label = grand;
        }
        label
    }

    fn unite(&mut self, a: u32, b: u32) -> u32 {
        let (a, b) = (self.root(a), self.root(b));
        let (low, high) = (a.min(b), a.max(b));
        if let Some(slot) = self.parents.get_mut(high as usize) {
            *slot = low;
        }
        low
    }
}

#[cfg(test)]
mod tests;
