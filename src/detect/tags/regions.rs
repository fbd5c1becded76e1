//! Connected dark regions (4 neighbours) of a window: their boxes, and where each begins.
//!
//! Light pixels join by 8 neighbours, dark ones by 4: a thin white margin keeps a tag apart.

use super::threshold::DarkBits;

/// Of more regions the last are left out: no image of tags has them.
const MAX_REGIONS: usize = 1 << 17;

/// A dark region.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct DarkRegion {
    /// First pixel in reading order.
    pub(super) x: u32,
    /// Its row, the uppermost of the region.
    pub(super) y: u32,
    /// Least and greatest column.
    pub(super) left: u32,
    /// See `left`.
    pub(super) right: u32,
    /// Greatest row.
    pub(super) bottom: u32,
    /// Pixels.
    pub(super) count: u32,
    parent: u32,
}

/// Part of a row.
#[derive(Debug, Clone, Copy)]
struct DarkRun {
    x0: u32,
    x1: u32,
    region: u32,
}

/// Finds regions. Owns its buffers.
#[derive(Debug, Clone)]
pub(super) struct Regions {
    regions: Vec<DarkRegion>,
    above: Vec<DarkRun>,
    here: Vec<DarkRun>,
    limit: usize,
}

impl Regions {
    /// Buffers for windows of at most this size, allocated at once.
    pub(super) fn with_size(width: usize, height: usize) -> Self {
        let limit = (width * height / 8).clamp(64, MAX_REGIONS);
        let runs = || Vec::with_capacity(width / 2 + 1);
        Self { regions: Vec::with_capacity(limit), above: runs(), here: runs(), limit }
    }

    /// The regions found last.
    pub(super) fn iter(&self) -> impl Iterator<Item = &DarkRegion> {
        self.regions.iter().enumerate().filter(|(i, r)| r.parent as usize == *i).map(|(_, r)| r)
    }

    /// Finds all regions.
    pub(super) fn find(&mut self, bits: &DarkBits) {
        self.regions.clear();
        self.above.clear();
        let (_, height) = bits.size();
        for y in 0..height {
            self.here.clear();
            self.runs_of(bits.row(y));
            if !self.join(y as u32) {
                return;
            }
            std::mem::swap(&mut self.above, &mut self.here);
        }
    }

    fn runs_of(&mut self, words: &[u64]) {
        let (mut carry, mut start, mut at) = (0u64, 0u32, 0u32);
        for &word in words {
            let mut changes = word ^ (word << 1 | carry);
            while changes != 0 {
                let x = at + changes.trailing_zeros();
                if carry == 0 {
                    start = x;
                } else {
                    self.here.push(DarkRun { x0: start, x1: x, region: 0 });
                }
                carry ^= 1;
                changes &= changes - 1;
            }
            at += 64;
        }
        if carry == 1 {
            self.here.push(DarkRun { x0: start, x1: at, region: 0 });
        }
    }

    /// Joins the runs of row `y` to those above. False when there is no room for another region.
    fn join(&mut self, y: u32) -> bool {
        let mut first = 0;
        for run in &mut self.here {
            let mut own: Option<u32> = None;
            while self.above.get(first).is_some_and(|r| r.x1 <= run.x0) {
                first += 1;
            }
            for other in self.above.get(first..).unwrap_or(&[]).iter().take_while(|r| r.x0 < run.x1) {
                let root = root_of(&mut self.regions, other.region);
                own = Some(match own {
                    Some(own) if own != root => merge(&mut self.regions, own, root),
                    _ => root,
                });
            }
            run.region = match own {
                Some(own) => own,
                None if self.regions.len() < self.limit => {
                    let parent = self.regions.len() as u32;
                    let (left, right) = (run.x0, run.x1 - 1);
                    self.regions.push(DarkRegion { x: run.x0, y, left, right, bottom: y, count: 0, parent });
                    parent
                }
                None => return false,
            };
            if let Some(region) = self.regions.get_mut(run.region as usize) {
                region.left = region.left.min(run.x0);
                region.right = region.right.max(run.x1 - 1);
                region.bottom = y;
                region.count += run.x1 - run.x0;
            }
        }
        true
    }
}

fn root_of(regions: &mut [DarkRegion], mut at: u32) -> u32 {
    loop {
        let parent = regions.get(at as usize).map_or(at, |r| r.parent);
        if parent == at {
            return at;
        }
        let above = regions.get(parent as usize).map_or(parent, |r| r.parent);
        if let Some(region) = regions.get_mut(at as usize) {
            region.parent = above;
        }
        at = above;
    }
}

/// Joins two roots; the earlier one stays: it holds the first pixel.
fn merge(regions: &mut [DarkRegion], a: u32, b: u32) -> u32 {
    let (keep, gone) = (a.min(b), a.max(b));
    let Some(other) = regions.get(gone as usize).copied() else { return keep };
    if let Some(region) = regions.get_mut(keep as usize) {
        region.left = region.left.min(other.left);
        region.right = region.right.max(other.right);
        region.bottom = region.bottom.max(other.bottom);
        region.count += other.count;
    }
    if let Some(region) = regions.get_mut(gone as usize) {
        region.parent = keep;
    }
    keep
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::detect::tags::outline;
    use crate::imaging::{ImageView, Window};
    use proptest::prelude::*;

    /// Flood fill with 4 neighbours: first pixel, box, count.
    fn slow(bits: &DarkBits) -> Vec<[u32; 6]> {
        let (w, h) = bits.size();
        let (mut seen, mut all) = (vec![false; w * h], Vec::new());
        for start in 0..w * h {
            let (x, y) = (start % w, start / w);
            if seen[start] || !bits.is_dark(x as i32, y as i32) {
                continue;
            }
            seen[start] = true;
            let (mut stack, mut r) = (vec![(x, y)], [x, y, x, x, y, 0].map(|v| v as u32));
            while let Some((x, y)) = stack.pop() {
                r = [r[0], r[1], r[2].min(x as u32), r[3].max(x as u32), r[4].max(y as u32), r[5] + 1];
                for (u, v) in [(x + 1, y), (x.wrapping_sub(1), y), (x, y + 1), (x, y.wrapping_sub(1))] {
                    if u < w && v < h && !seen[v * w + u] && bits.is_dark(u as i32, v as i32) {
                        seen[v * w + u] = true;
                        stack.push((u, v));
                    }
                }
            }
            all.push(r);
        }
        all
    }

    proptest! {
        #[test]
        fn regions_are_those_of_a_flood_fill(width in 1usize..140, height in 1usize..40, seed in any::<u64>(), side in 1usize..9) {
            let pixels: Vec<u8> = (0..width * height).map(|i| {
                let at = (i % width / side + 777 * (i / width / side)) as u64 ^ seed;
                if at.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 63 == 1 { 200 } else { 20 }
            }).collect();
            let image = ImageView::new(&pixels, width, height).unwrap();
            let mut bits = DarkBits::with_size(width, height);
            bits.find(&image, &Window::whole(&image));
            // room for as many as single pixels can make
            let mut regions = Regions::with_size(8 * width.max(64), height.max(64));
            regions.find(&bits);
            let found: Vec<_> = regions.iter().map(|r| [r.x, r.y, r.left, r.right, r.bottom, r.count]).collect();
            prop_assert_eq!(&found, &slow(&bits));
            // outlines close, and reach as far as the region
            let mut points = Vec::new();
            for region in regions.iter() {
                prop_assert!(outline::follow(&image, (0, 0), &bits, region, 4 * width * height + 4, &mut points));
                let fold = |i: usize, pick: fn(f32, f32) -> f32, from: f32| points.iter().fold(from, |a, p: &outline::WindowPoint| pick(a, p[i]));
                for (edge, at) in [
                    (region.left as f32, fold(0, f32::min, f32::MAX)), (region.right as f32, fold(0, f32::max, f32::MIN)),
                    (region.y as f32, fold(1, f32::min, f32::MAX)), (region.bottom as f32, fold(1, f32::max, f32::MIN)),
                ] {
                    prop_assert!((edge - at).abs() <= 1.0, "{} {}", edge, at);
                }
            }
        }
    }
}
