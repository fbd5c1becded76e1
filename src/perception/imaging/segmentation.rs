//! Region-based segmentation of Sect. 10.2.1: pixels grow together into connected regions as long as a uniformity predicate holds.
//!
//! All pairs of neighbouring pixels (by sides) are looked at once, those that differ least first and equal ones in reading order; a
//! pair whose regions may merge merges them. So what is most alike comes together first, and no result depends on a seed. Then
//! regions that are too small go to the neighbour that they differ least from, if that is asked for.
//!
//! Time and memory are proportional to the number of pixels, 34 bytes each, for at most as many as the buffers were made for.

use super::moments::MomentSums;
use super::{ImageView, Plane, Run};
use thiserror::Error;

/// The image has more pixels than the buffers were made for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("an image of {pixels} pixels is more than the {limit} that the segmentation was made for")]
pub struct TooManyPixels {
    /// Pixels of the image.
    pub pixels: usize,
    /// Pixels that there is room for.
    pub limit: usize,
}

/// When two regions are one: the uniformity predicate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Uniformity {
    /// The levels of a region lie in an interval of this many steps: its greatest level less its least one is at most this.
    Range(u8),
    /// The mean levels of both differ by at most this.
    Means(f64),
}

/// A region that has grown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct GreyRegion {
    /// Moments of its pixels, each of weight one.
    pub sums: MomentSums,
    /// Sum of its levels.
    pub level_sum: u64,
    /// Least level.
    pub low: u8,
    /// Greatest level.
    pub high: u8,
    /// First column.
    pub x0: u32,
    /// Column behind the last.
    pub x1: u32,
    /// First row.
    pub y0: u32,
    /// Row behind the last.
    pub y1: u32,
}

impl GreyRegion {
    /// Mean level.
    #[must_use]
    pub fn mean(&self) -> f64 {
        self.level_sum as f64 / self.sums.m00.max(1) as f64
    }
}

/// What the predicate looks at.
#[derive(Debug, Clone, Copy, Default)]
struct RegionLevels {
    count: u32,
    low: u8,
    high: u8,
    sum: u64,
}

impl RegionLevels {
    fn with(&self, other: &Self) -> Self {
        Self {
            count: self.count + other.count,
            low: self.low.min(other.low),
            high: self.high.max(other.high),
            sum: self.sum + other.sum,
        }
    }
}

impl Uniformity {
    fn holds(&self, a: &RegionLevels, b: &RegionLevels) -> bool {
        match *self {
            Self::Range(most) => a.high.max(b.high) - a.low.min(b.low) <= most,
            Self::Means(most) => {
                let mean = |p: &RegionLevels| p.sum as f64 / f64::from(p.count.max(1));
                (mean(a) - mean(b)).abs() <= most
            }
        }
    }
}

/// Segments images into uniform regions. The buffers are reused.
#[derive(Debug, Clone)]
pub struct Segmentation {
    limit: usize,
    parents: Vec<u32>,
    parts: Vec<RegionLevels>,
    /// Pairs of neighbours by difference: twice the first pixel's index, odd for the one below.
    pairs: Vec<u32>,
    labels: Plane<u32>,
    regions: Vec<GreyRegion>,
}

impl Segmentation {
    /// Buffers for images of at most `limit` pixels (and never more than 2^30), allocated at once but those for the regions.
    #[must_use]
    pub fn with_limit(limit: usize) -> Self {
        let limit = limit.min(1 << 30);
        Self {
            limit,
            parents: Vec::with_capacity(limit),
            parts: Vec::with_capacity(limit),
            pairs: Vec::with_capacity(2 * limit),
            labels: Plane::with_size(limit, 1),
            regions: Vec::new(),
        }
    }

    /// The regions found last, in the reading order of their first pixels.
    #[must_use]
    pub fn as_slice(&self) -> &[GreyRegion] {
        &self.regions
    }

    /// Of each pixel of the last image, the index of its region in [`Segmentation::as_slice`].
    #[must_use]
    pub fn labels(&self) -> &Plane<u32> {
        &self.labels
    }

    /// Segments an image. Regions below `min_area_px` are given to neighbours, whether that is uniform or not; 0 or 1 leaves all.
    ///
    /// # Errors
    /// [`TooManyPixels`] when the buffers are too small; nothing is found then.
    pub fn find(
        &mut self,
        image: &ImageView<'_>,
        uniformity: Uniformity,
        min_area_px: u32,
    ) -> Result<(), TooManyPixels> {
        let (width, height) = (image.width(), image.height());
        let (pixels, limit) = (width.saturating_mul(height), self.limit);
        self.regions.clear();
        if pixels > limit {
            self.labels.reshape(0, 0);
            return Err(TooManyPixels { pixels, limit });
        }
        self.parents.clear();
        self.parents.extend(0..pixels as u32);
        self.parts.clear();
        for piece in image.pieces() {
            self.parts.extend(piece.iter().map(|&p| RegionLevels {
                count: 1,
                low: p,
                high: p,
                sum: p.into(),
            }));
        }
        self.sort_pairs(image);
        self.merge_pairs(width, |a, b| uniformity.holds(a, b));
        if min_area_px > 1 {
            self.merge_pairs(width, |a, b| a.count.min(b.count) < min_area_px);
        }
        self.gather(image);
        Ok(())
    }

    /// Counting sort of all pairs by their difference, stable.
    fn sort_pairs(&mut self, image: &ImageView<'_>) {
        let (width, height) = (image.width(), image.height());
        let mut starts = [0usize; 257];
        each_pair(image, |_, difference| {
            if let Some(count) = starts.get_mut(usize::from(difference) + 1) {
                *count += 1;
            }
        });
        for i in 1..257 {
            starts[i] += starts[i - 1];
        }
        self.pairs.clear();
        self.pairs.resize((width - 1) * height + width * (height - 1), 0);
        let pairs = &mut self.pairs;
        each_pair(image, |pair, difference| {
            let start = &mut starts[usize::from(difference)];
            if let Some(slot) = pairs.get_mut(*start) {
                *slot = pair;
            }
            *start += 1;
        });
    }

    /// Merges the regions of each pair that may; the pairs that may not are left.
    fn merge_pairs(&mut self, width: usize, may: impl Fn(&RegionLevels, &RegionLevels) -> bool) {
        let mut left = 0;
        for at in 0..self.pairs.len() {
            let Some(&pair) = self.pairs.get(at) else { break };
            if !self.merge(pair, width, &may) {
                if let Some(slot) = self.pairs.get_mut(left) {
                    *slot = pair;
                }
                left += 1;
            }
        }
        self.pairs.truncate(left);
    }

    /// Merges the regions of a pair if they may; whether they are one then.
    #[inline]
    fn merge(&mut self, pair: u32, width: usize, may: impl Fn(&RegionLevels, &RegionLevels) -> bool) -> bool {
        let first = pair / 2;
        let second = if pair & 1 == 1 { first + width as u32 } else { first + 1 };
        let (a, b) = (self.root(first), self.root(second));
        if a == b {
            return true;
        }
        let (Some(&pa), Some(&pb)) = (self.parts.get(a as usize), self.parts.get(b as usize)) else {
            return true;
        };
        if !may(&pa, &pb) {
            return false;
        }
        let (root, child) = if pa.count >= pb.count { (a, b) } else { (b, a) };
        if let (Some(parent), Some(part)) =
            (self.parents.get_mut(child as usize), self.parts.get_mut(root as usize))
        {
            *parent = root;
            *part = pa.with(&pb);
        }
        true
    }

    #[inline]
    fn root(&mut self, mut at: u32) -> u32 {
        while let Some(&parent) = self.parents.get(at as usize) {
            if parent == at {
                break;
            }
            let grand = self.parents.get(parent as usize).copied().unwrap_or(parent);
            if let Some(slot) = self.parents.get_mut(at as usize) {
                *slot = grand;
            }
            at = grand;
        }
        at
    }

    /// Numbers the regions in reading order, labels the pixels, and adds up moments by runs.
    fn gather(&mut self, image: &ImageView<'_>) {
        let (width, height) = (image.width(), image.height());
        self.labels.reshape(width, height);
        for y in 0..height {
            let start = (y * width) as u32;
            let (mut x0, mut current) = (0, u32::MAX);
            for x in 0..width as u32 {
                let root = self.root(start + x);
                if root != current {
                    self.add_run(Run { y: y as u32, x0, x1: x }, current);
                    (x0, current) = (x, root);
                }
            }
            self.add_run(Run { y: y as u32, x0, x1: width as u32 }, current);
        }
    }

    fn add_run(&mut self, run: Run, root: u32) {
        if run.x0 == run.x1 {
            return;
        }
        let Some(part) = self.parts.get_mut(root as usize) else { return };
        // the count has served: a numbered region has 0, and its number in place of the sum of levels
        if part.count > 0 {
            let (x, y) = (run.x0, run.y);
            self.regions.push(GreyRegion {
                sums: MomentSums::default(),
                level_sum: part.sum,
                low: part.low,
                high: part.high,
                x0: x,
                x1: x,
                y0: y,
                y1: y,
            });
            (part.count, part.sum) = (0, self.regions.len() as u64 - 1);
        }
        let label = part.sum as u32;
        if let Some(region) = self.regions.get_mut(label as usize) {
            region.sums += MomentSums::of_run(&run);
            (region.x0, region.x1) = (region.x0.min(run.x0), region.x1.max(run.x1));
            region.y1 = run.y + 1;
        }
        if let Some(pixels) = self.labels.row_mut(run.y as usize).get_mut(run.x0 as usize..run.x1 as usize) {
            pixels.fill(label);
        }
    }
}

/// All pairs of neighbours in reading order, to the right before down, with their difference.
#[inline(always)]
fn each_pair(image: &ImageView<'_>, mut take: impl FnMut(u32, u8)) {
    let (width, height) = (image.width(), image.height());
    for y in 0..height {
        let (row, below) = (image.row(y), image.row(y + 1));
        let mut pair = (y * width) as u32 * 2;
        for (x, &p) in row.iter().enumerate() {
            if let Some(&right) = row.get(x + 1) {
                take(pair, p.abs_diff(right));
            }
            if let Some(&down) = below.get(x) {
                take(pair + 1, p.abs_diff(down));
            }
            pair += 2;
        }
    }
}

#[cfg(test)]
mod tests;
