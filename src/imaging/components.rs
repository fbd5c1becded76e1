//! Connected regions of dark runs, with their moments.
//!
//! ```text
//! m_rs = sum of x^r y^s over the region's pixels                              (10.1)
//! mu_rs = sum of (x - x_c)^r (y - y_c)^s,  x_c = m10 / m00, y_c = m01 / m00   (10.2)
//! ```
//! All sums are exact integers, of whole runs at a time.

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

/// Principal axes of a region: those of the ellipse with the same moments.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PrincipalAxes {
    /// Half of the longer axis, px.
    pub major_px: f64,
    /// Half of the shorter axis, px.
    pub minor_px: f64,
    /// Angle from the columns' axis to the longer one, towards the rows' axis, in (-pi/2, pi/2].
    pub angle_rad: f64,
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

    /// Axes of the ellipse with the same second moments.
    #[must_use]
    pub fn principal_axes(&self) -> PrincipalAxes {
        let [xx, xy, yy] = self.covariance();
        let (mean, half) = (0.5 * (xx + yy), (0.25 * (xx - yy).powi(2) + xy * xy).sqrt());
        PrincipalAxes {
            major_px: 2.0 * (mean + half).max(0.0).sqrt(),
            minor_px: 2.0 * (mean - half).max(0.0).sqrt(),
            angle_rad: 0.5 * (2.0 * xy).atan2(xx - yy),
        }
    }

    #[inline(always)]
    fn of_run(run: &Run, window: &Window) -> Self {
        let (x0, x1, y) = (u64::from(run.x0), u64::from(run.x1), u64::from(run.y));
        let n = x1 - x0;
        let sum = n * (x0 + x1 - 1) / 2;
        // sum of squares below k is (k - 1) k (2 k - 1) / 6
        let squares = |k: u64| (k.wrapping_sub(1)).wrapping_mul(k).wrapping_mul((2 * k).wrapping_sub(1)) / 6;
        Self {
            m00: n,
            m10: sum,
            m01: n * y,
            m20: squares(x1) - if x0 == 0 { 0 } else { squares(x0) },
            m11: sum * y,
            m02: n * y * y,
            x0: run.x0,
            x1: run.x1,
            y0: run.y,
            y1: run.y + 1,
            touches_border: run.x0 as usize == window.x0
                || run.x1 as usize == window.x1
                || run.y as usize == window.y0
                || run.y as usize + 1 == window.y1,
        }
    }

    #[inline(always)]
    fn add(&mut self, other: &Self) {
        self.m00 += other.m00;
        self.m10 += other.m10;
        self.m01 += other.m01;
        self.m20 += other.m20;
        self.m11 += other.m11;
        self.m02 += other.m02;
        self.x0 = self.x0.min(other.x0);
        self.x1 = self.x1.max(other.x1);
        self.y0 = self.y0.min(other.y0);
        self.y1 = self.y1.max(other.y1);
        self.touches_border |= other.touches_border;
    }
}

/// Labels runs and gathers their regions. The buffers are reused.
#[derive(Debug, Clone, Default)]
pub struct Components {
    labels: Vec<u32>,
    parents: Vec<u32>,
    parts: Vec<Component>,
    list: Vec<Component>,
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
            let part = Component::of_run(run, window);
            if let Some(known) = self.parts.get_mut(label as usize) {
                known.add(&part);
            } else {
                label = self.parts.len() as u32;
                self.parts.push(part);
                self.parents.push(label);
            }
            self.labels.push(label);
        }
        self.gather();
    }

    /// Adds each part to its root; parents are always smaller, so one pass from behind is enough.
    fn gather(&mut self) {
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
                self.list.push(*part);
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
mod tests {
    use super::*;
    use crate::imaging::ImageView;
    use proptest::prelude::*;

    fn find(pixels: &[u8], width: usize, connectivity: Connectivity) -> Vec<Component> {
        let image = ImageView::new(pixels, width, pixels.len() / width).unwrap();
        let window = Window::whole(&image);
        let mut runs = Runs::with_limit(10_000);
        runs.find(&image, &window, 100);
        let mut components = Components::with_limit(10_000);
        components.find(&runs, &window, connectivity);
        components.as_slice().to_vec()
    }

    /// Flood fill, pixel by pixel.
    fn slow(pixels: &[u8], width: usize, connectivity: Connectivity) -> Vec<Component> {
        let height = pixels.len() / width;
        let mut seen = vec![false; pixels.len()];
        let mut out = Vec::new();
        for start in 0..pixels.len() {
            if seen[start] || pixels[start] > 100 {
                continue;
            }
            let mut c = Component { x0: u32::MAX, y0: u32::MAX, ..Component::default() };
            let mut stack = vec![start];
            seen[start] = true;
            while let Some(at) = stack.pop() {
                let (x, y) = ((at % width) as u64, (at / width) as u64);
                c.m00 += 1;
                c.m10 += x;
                c.m01 += y;
                c.m20 += x * x;
                c.m11 += x * y;
                c.m02 += y * y;
                c.x0 = c.x0.min(x as u32);
                c.x1 = c.x1.max(x as u32 + 1);
                c.y0 = c.y0.min(y as u32);
                c.y1 = c.y1.max(y as u32 + 1);
                c.touches_border |= x == 0 || y == 0 || x as usize + 1 == width || y as usize + 1 == height;
                for (dx, dy) in [(-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1)] {
                    if connectivity == Connectivity::Four && dx != 0 && dy != 0 {
                        continue;
                    }
                    let (nx, ny) = (x as i64 + dx, y as i64 + dy);
                    if nx < 0 || ny < 0 || nx >= width as i64 || ny >= height as i64 {
                        continue;
                    }
                    let next = ny as usize * width + nx as usize;
                    if !seen[next] && pixels[next] <= 100 {
                        seen[next] = true;
                        stack.push(next);
                    }
                }
            }
            out.push(c);
        }
        out
    }

    proptest! {
        #[test]
        fn components_are_those_of_flood_fill(
            width in 1usize..80, height in 1usize..40, seed in any::<u64>(), density in 1u64..255,
        ) {
            let mut state = seed;
            let pixels: Vec<u8> = (0..width * height).map(|_| {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                if state >> 56 < density { 0 } else { 255 }
            }).collect();
            for connectivity in [Connectivity::Four, Connectivity::Eight] {
                let (mut got, mut wanted) = (find(&pixels, width, connectivity), slow(&pixels, width, connectivity));
                got.sort_by_key(|c| (c.y0, c.x0, c.m10, c.m01, c.m00));
                wanted.sort_by_key(|c| (c.y0, c.x0, c.m10, c.m01, c.m00));
                prop_assert_eq!(got, wanted);
            }
        }
    }

    #[test]
    fn axes_of_an_ellipse() {
        let (a, b, angle) = (40.0f64, 25.0, 0.5f64);
        let mut pixels = vec![255; 200 * 150];
        for y in 0..150 {
            for x in 0..200 {
                let (dx, dy) = (f64::from(x) - 100.3, f64::from(y) - 70.8);
                let (u, v) = (dx * angle.cos() + dy * angle.sin(), dy * angle.cos() - dx * angle.sin());
                if (u / a).powi(2) + (v / b).powi(2) < 1.0 {
                    pixels[(y * 200 + x) as usize] = 0;
                }
            }
        }
        let found = find(&pixels, 200, Connectivity::Eight);
        assert_eq!(found.len(), 1);
        let axes = found[0].principal_axes();
        assert!((axes.major_px - a).abs() < 0.1 && (axes.minor_px - b).abs() < 0.1, "{axes:?}");
        assert!((axes.angle_rad - angle).abs() < 0.01);
        let (x, y) = found[0].centroid();
        assert!((x - 100.3).abs() < 0.05 && (y - 70.8).abs() < 0.05);
    }
}
