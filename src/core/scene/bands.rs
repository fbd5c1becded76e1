//! Which pixels lie near an edge of the scene: per row a few intervals, each with the set of edges it is near.
//!
//! Pixels outside of all bands show a single flat surface, so that only the pixels of bands are evaluated one by one.

/// Most intervals that a row keeps; further ones widen the first (slower, never wrong). Chosen so that a row of a dozen dots has one for
/// each side of each.
pub(super) const PER_ROW: usize = 24;

/// Columns `first..=last` of one row that lie near the edges in `mask`.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Band {
    pub(super) first: i32,
    pub(super) last: i32,
    pub(super) mask: u64,
}

#[derive(Debug, Clone, Copy, Default)]
struct BandRow {
    count: usize,
    bands: [Band; PER_ROW],
}

/// Bands of a whole image.
#[derive(Debug, Clone)]
pub(super) struct Bands {
    rows: Vec<BandRow>,
    width: i32,
    /// Rows that have bands: `top..bottom`.
    top: usize,
    bottom: usize,
}

impl Bands {
    pub(super) fn new(width: usize, height: usize) -> Self {
        Self { rows: vec![BandRow::default(); height], width: width as i32, top: height, bottom: 0 }
    }

    /// Forgets all bands.
    pub(super) fn clear(&mut self) {
        if let Some(used) = self.rows.get_mut(self.top..self.bottom) {
            used.iter_mut().for_each(|row| row.count = 0);
        }
        self.top = self.rows.len();
        self.bottom = 0;
    }

    /// Adds all pixels within `margin` px of the segment from `a` to `b`, and some about its ends.
    pub(super) fn add_segment(&mut self, a: [f64; 2], b: [f64; 2], margin: f64, mask: u64) {
        if !(a[0] + a[1] + b[0] + b[1]).is_finite() {
            return;
        }
        let ([x0, y0], [x1, y1]) = if a[1] <= b[1] { (a, b) } else { (b, a) };
        let limit = self.rows.len() as f64 - 1.0;
        if y1 + margin < 0.0 || y0 - margin > limit {
            return;
        }
        // Rounding by casts: ceil and floor are calls on the baseline processor.
        let (top, last) = ((y0 - margin).max(0.0), (y1 + margin).min(limit) as usize);
        let first = top as usize + usize::from(top > (top as usize) as f64);
        if first > last {
            return;
        }
        let (dx, height) = (x1 - x0, y1 - y0);
        let (low, high) = (x0.min(x1) - margin, x0.max(x1) + margin);
        // A row meets the strip of half width `margin` about the line within `margin / |normal's x|` of the line.
        // A billionth of a pixel is a level line, whose slope would be rounding.
        let steep = height > 1e-9;
        let (slope, half) = if steep {
            (dx / height, margin * (dx * dx + height * height).sqrt() / height)
        } else {
            (0.0, 0.0)
        };
        for y in first..=last {
            let middle = x0 + slope * (y as f64 - y0);
            let (from, to) = if steep { (middle - half, middle + half) } else { (low, high) };
            self.push(y, from.max(low), to.min(high), mask);
        }
        self.top = self.top.min(first);
        self.bottom = self.bottom.max(last + 1);
    }

    fn push(&mut self, y: usize, x0: f64, x1: f64, mask: u64) {
        let limit = f64::from(self.width - 1);
        if x1 < 0.0 || x0 > limit {
            return;
        }
        let left = x0.max(0.0);
        let first = left as i32 + i32::from(left > f64::from(left as i32));
        let last = x1.min(limit) as i32;
        if first > last {
            return;
        }
        let Some(row) = self.rows.get_mut(y) else { return };
        let count = row.count.min(PER_ROW);
        for band in row.bands.iter_mut().take(count) {
            if first <= band.last + 1 && last + 1 >= band.first {
                *band =
                    Band { first: band.first.min(first), last: band.last.max(last), mask: band.mask | mask };
                return;
            }
        }
        if let Some(free) = row.bands.get_mut(count) {
            *free = Band { first, last, mask };
            row.count = count + 1;
        } else if let Some(band) = row.bands.first_mut() {
            *band = Band { first: band.first.min(first), last: band.last.max(last), mask: band.mask | mask };
        }
    }

    /// Sorts each row's bands and joins those that touch; to be called before [`Self::row`].
    pub(super) fn finish(&mut self) {
        let Some(used) = self.rows.get_mut(self.top..self.bottom) else { return };
        for row in used {
            let count = row.count.min(PER_ROW);
            let Some(bands) = row.bands.get_mut(..count) else { continue };
            // a handful of almost sorted entries
            bands.sort_unstable_by_key(|band| band.first);
            let mut kept: usize = 0;
            for i in 1..bands.len() {
                let Some(next) = bands.get(i).copied() else { break };
                let Some(last) = bands.get_mut(kept) else { break };
                if next.first <= last.last + 1 {
                    last.last = last.last.max(next.last);
                    last.mask |= next.mask;
                } else {
                    kept += 1;
                    if let Some(slot) = bands.get_mut(kept) {
                        *slot = next;
                    }
                }
            }
            row.count = count.min(kept + 1);
        }
    }

    /// Bands of row `y`, from left to right, disjoint.
    pub(super) fn row(&self, y: usize) -> &[Band] {
        self.rows.get(y).and_then(|row| row.bands.get(..row.count)).unwrap_or(&[])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Every pixel near a segment is in a band that names it; bands are sorted, disjoint and in the image.
        #[test]
        fn bands_cover_their_segments(
            ends in prop::collection::vec((-20.0..60.0f64, -20.0..50.0f64, -20.0..60.0f64, -20.0..50.0f64), 1..30),
        ) {
            let mut bands = Bands::new(40, 30);
            for (i, &(x0, y0, x1, y1)) in ends.iter().enumerate() {
                bands.add_segment([x0, y0], [x1, y1], 1.5, 1 << (i % 8));
            }
            bands.finish();
            for y in 0..30 {
                let row = bands.row(y);
                for pair in row.windows(2) {
                    prop_assert!(pair[0].last + 1 < pair[1].first);
                }
                for band in row {
                    prop_assert!(band.first >= 0 && band.last < 40 && band.first <= band.last);
                }
                for x in 0..40 {
                    for (i, &(x0, y0, x1, y1)) in ends.iter().enumerate() {
                        let (dx, dy) = (x1 - x0, y1 - y0);
                        let (px, py) = (f64::from(x) - x0, y as f64 - y0);
                        let t = ((px * dx + py * dy) / (dx * dx + dy * dy).max(1e-12)).clamp(0.0, 1.0);
                        let distance = (px - t * dx).hypot(py - t * dy);
                        if distance < 1.4 {
                            let found = row.iter().any(|b| b.first <= x && x <= b.last && b.mask & (1 << (i % 8)) != 0);
                            prop_assert!(found, "pixel {x} {y}, segment {i}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn nan_adds_nothing() {
        let mut bands = Bands::new(10, 10);
        bands.add_segment([f64::NAN, 1.0], [2.0, f64::NAN], 1.0, 1);
        bands.finish();
        assert!((0..10).all(|y| bands.row(y).is_empty()));
    }
}
