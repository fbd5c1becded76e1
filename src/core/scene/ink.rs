//! Coverage of a row's pixels by polygons: exact for any number of edges in a pixel, acute corners and corners that touch.
//!
//! A pixel sees the image through the kernel `k(x) k(y)`: its own square, blurred by the optics. With `K` the integral of `k`, the
//! share of a region that a pixel at `p` sees is, by Green's theorem, a sum over the region's border alone:
//!
//! ```text
//! coverage(p) = - integral over the border of  K(p_x - x) dK(y - p_y)
//! ```
//! The border within the reach of a row is cut into short pieces. Each is a node: `dK` of its ends is its weight, and its share of the pixels
//! to its right; those within the kernel's reach see a part of it. Weights are added up along the row.

/// The kernel is cut off beyond this many standard deviations of the blur: 0.02 % of a step at each end is spread over the rest, which is a
/// twentieth of a level of 255. `coverage_is_that_of_brute_force` is the test of it, of the steps and of the phases.
const CUT_SIGMA: f64 = 3.5;
/// Steps of the table. It is interpolated, so that with a kernel seven deviations wide it is off by `(7 / 1024)^2 / 8` times the greatest
/// curvature of the distribution, 0.24: 1.4e-6.
const STEPS: usize = 1024;
/// Places of a node between two pixels for which its share of each pixel is kept; between them it is interpolated:
/// off by 7e-6 with a blur of half a pixel, by the same derivation.
const PHASES: usize = 128;
/// Shares of pixels that are added side by side, as many as single-precision numbers in a register of AVX, so that one instruction does.
const LANES: usize = 8;
/// Pixels that are painted together where no border is near. Chosen by hand: two registers of levels; in larger blocks more pixels far from a border
/// are computed one by one, in smaller ones more blocks are looked at.
const BLOCK: usize = 16;

/// A straight piece of a border, px.
#[derive(Debug, Clone, Copy)]
pub struct BorderSegment {
    /// Where it begins, (u, v).
    pub from: [f64; 2],
    /// Where it ends, (u, v); what is covered lies on one side of the way.
    pub to: [f64; 2],
}

impl BorderSegment {
    /// Its least v.
    pub fn top(&self) -> f64 {
        self.from[1].min(self.to[1])
    }

    /// Its largest v.
    pub fn bottom(&self) -> f64 {
        self.from[1].max(self.to[1])
    }
}

/// What one pixel sees, along one axis.
#[derive(Debug, Clone)]
pub struct PixelKernel {
    /// `K` from -reach to reach.
    table: Vec<f32>,
    /// How `K` grows from pixel to pixel over the pixels that a node reaches, [`Self::groups`] for each of `PHASES + 1` places.
    growth: Vec<[f32; LANES]>,
    /// Groups of pixels that a node reaches.
    groups: usize,
    reach_px: f64,
    steps_per_px: f64,
    /// Longest piece of a border that is one node, px.
    piece_px: f64,
}

impl PixelKernel {
    /// The kernel of a Gaussian blur with the standard deviation `sigma` px.
    pub fn new(sigma: f64) -> Self {
        let reach_px = 0.5 + CUT_SIGMA * sigma;
        let steps_per_px = STEPS as f64 / (2.0 * reach_px);
        let place = |i: usize| i as f64 / steps_per_px - reach_px;
        let ramp = |x: f64| super::profile::coverage(x, 1.0, 0.0, sigma);
        // what the cut leaves is spread over the rest, so that the ends are 0 and 1
        let (low, high) = (ramp(-reach_px), ramp(reach_px));
        let whole = |x: f64| (ramp(x.clamp(-reach_px, reach_px)) - low) / (high - low);
        let table = (0..=STEPS).map(|i| whole(place(i)) as f32).collect();
        let groups = (2.0 * reach_px + 2.0).ceil() as usize / LANES + 1;
        let first = |phase: usize| phase as f64 / PHASES as f64 - reach_px;
        let step = |phase: usize, i: usize| {
            let x = first(phase) + i as f64;
            if i == 0 { whole(x) } else { whole(x) - whole(x - 1.0) }
        };
        let group = |phase: usize, g: usize| std::array::from_fn(|lane| step(phase, g * LANES + lane) as f32);
        let growth =
            (0..=PHASES).flat_map(|phase| (0..groups).map(move |g| (phase, g))).map(|(p, g)| group(p, g));
        let growth = growth.collect();
        Self { table, growth, groups, reach_px, steps_per_px, piece_px: (0.15 + 0.2 * sigma).min(1.0) }
    }

    /// Distance from a border at which it no longer matters, px.
    pub fn reach_px(&self) -> f64 {
        self.reach_px
    }

    /// `K` at `x` px.
    #[inline(always)]
    fn integral(&self, x: f64) -> f32 {
        let place = ((x + self.reach_px) * self.steps_per_px).clamp(0.0, STEPS as f64);
        let below = (place as usize).min(STEPS - 1);
        let part = (place - below as f64) as f32;
        match self.table.get(below..below + 2) {
            Some([a, b]) => a + (b - a) * part,
            _ => 0.0,
        }
    }
}

/// Adds up what the borders give to the pixels of one row.
#[derive(Debug, Clone)]
pub struct Ink {
    /// What each pixel's coverage has more than that of the pixel to its left.
    steps: Vec<f32>,
    /// Blocks that have steps.
    touched: Vec<bool>,
    /// What lies to the left of the row.
    before: f32,
    width: usize,
    /// Pixels behind the row's last, which nodes near its end reach.
    behind: usize,
}

impl Ink {
    /// For rows of `width` pixels.
    pub fn new(width: usize, kernel: &PixelKernel) -> Self {
        let blocks = width.div_ceil(BLOCK);
        let behind = kernel.groups * LANES;
        Self {
            steps: vec![0.0; blocks * BLOCK + behind],
            touched: vec![false; blocks],
            before: 0.0,
            width,
            behind,
        }
    }

    /// Adds a piece of a border to the row at `v`.
    pub fn add(&mut self, edge: &BorderSegment, v: f64, kernel: &PixelKernel) {
        let reach = kernel.reach_px;
        let ([x0, y0], [x1, y1]) = (edge.from, edge.to);
        let (y0, y1) = (y0 - v, y1 - v);
        let (height, dx) = (y1 - y0, x1 - x0);
        if y0.min(y1) >= reach || y0.max(y1) <= -reach || height == 0.0 {
            return;
        }
        // the part of it within the row's reach
        let at = |y: f64| ((y - y0) / height).clamp(0.0, 1.0);
        let (start, end) = if height > 0.0 { (at(-reach), at(reach)) } else { (at(reach), at(-reach)) };
        let width = self.width as f64;
        let (xa, xb) = (x0 + dx * start, x0 + dx * end);
        if xa.min(xb) > width + reach {
            return;
        }
        let k_start = kernel.integral(y0 + height * start);
        if xa.max(xb) < -reach - 1.0 {
            self.before += k_start - kernel.integral(y0 + height * end);
            return;
        }
        // what a piece leaves out grows with how far its ends are apart in x, and, because its weight is not even, in both
        let (wide, high) = ((dx * (end - start)).abs(), (height * (end - start)).abs());
        let pieces = ((wide * high).sqrt().max(0.5 * wide) / kernel.piece_px).ceil().clamp(1.0, 65536.0);
        let step = (end - start) / pieces;
        let mut last = k_start;
        for i in 0..pieces as u32 {
            let from = start + step * f64::from(i);
            let next = kernel.integral(y0 + height * (from + step));
            self.node(x0 + dx * (from + 0.5 * step), last - next, kernel);
            last = next;
        }
    }

    /// A node in column `x`: what lies to its right has `weight` more.
    #[inline(always)]
    fn node(&mut self, x: f64, weight: f32, kernel: &PixelKernel) {
        let start = x - kernel.reach_px;
        if start >= self.width as f64 || weight == 0.0 {
            return;
        }
        // a cast: `ceil` is a call on the baseline processor
        let whole = start as i32;
        let first = whole + i32::from(f64::from(whole) < start);
        let Ok(from) = usize::try_from(first) else { return self.node_at_start(x, weight, kernel) };
        // how far the first pixel lies behind the reach's begin, in phases
        let phase = (f64::from(first) - start) * PHASES as f64;
        let below = (phase as usize).min(PHASES - 1);
        let part = (phase - below as f64) as f32;
        let at = below * kernel.groups;
        let tables = kernel.growth.get(at..at + 2 * kernel.groups).map(|t| t.split_at(kernel.groups));
        let steps = self.steps.get_mut(from..).map(|steps| steps.as_chunks_mut::<LANES>().0);
        if let (Some((low, high)), Some(steps)) = (tables, steps) {
            for ((step, low), high) in steps.iter_mut().zip(low).zip(high) {
                // copies, so that the compiler sees eight lanes that do not depend on each other
                let (mut sum, low, high) = (*step, *low, *high);
                for i in 0..LANES {
                    sum[i] += weight * (low[i] + (high[i] - low[i]) * part);
                }
                *step = sum;
            }
        }
        self.touch(from, from + kernel.groups * LANES);
    }

    /// The same for a node whose reach begins before the row.
    #[cold]
    fn node_at_start(&mut self, x: f64, weight: f32, kernel: &PixelKernel) {
        let end = (x + kernel.reach_px).ceil();
        if end <= 0.0 {
            self.before += weight;
            return;
        }
        let to = (end as usize + 1).min(self.width);
        let mut last = 0.0;
        for (i, step) in self.steps.iter_mut().take(to).enumerate() {
            let next = kernel.integral(i as f64 - x);
            *step += weight * (next - last);
            last = next;
        }
        self.touch(0, to);
    }

    #[inline(always)]
    fn touch(&mut self, from: usize, to: usize) {
        for touched in self.touched.iter_mut().take(to.saturating_sub(1) / BLOCK + 1).skip(from / BLOCK) {
            *touched = true;
        }
    }

    /// Paints what is covered in `level`, and is empty again. `sign`: -1 where the borders run the other way round.
    pub fn paint(&mut self, sign: f32, level: f32, levels: &mut [u16]) {
        let mut sum = std::mem::take(&mut self.before) * sign;
        let blocks = levels.chunks_mut(BLOCK).zip(self.steps.chunks_mut(BLOCK)).zip(&mut self.touched);
        for ((levels, steps), touched) in blocks {
            if std::mem::take(touched) {
                let mut covered = [0.0; BLOCK];
                for (covered, step) in covered.iter_mut().zip(steps) {
                    sum += std::mem::take(step) * sign;
                    *covered = sum.clamp(0.0, 1.0);
                }
                for (out, covered) in levels.iter_mut().zip(covered) {
                    let below = f32::from(*out);
                    *out = (below + (level - below) * covered + 0.5) as u16;
                }
            // A ten-thousandth of a step between black and white is a fortieth of a level, and would round to none.
            } else if sum > 0.9999 {
                levels.fill((level + 0.5) as u16);
            // So would this much of it.
            } else if sum > 0.0001 {
                for out in levels {
                    let below = f32::from(*out);
                    *out = (below + (level - below) * sum + 0.5) as u16;
                }
            }
        }
        let end = self.steps.len() - self.behind.min(self.steps.len());
        if let Some(behind) = self.steps.get_mut(end..) {
            behind.fill(0.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Coverage of a row by polygons.
    fn row(loops: &[Vec<[f64; 2]>], v: f64, sigma: f64) -> Vec<f64> {
        let kernel = PixelKernel::new(sigma);
        let mut ink = Ink::new(32, &kernel);
        for corners in loops {
            for (from, to) in corners.iter().zip(corners.iter().cycle().skip(1)) {
                ink.add(&BorderSegment { from: *from, to: *to }, v, &kernel);
            }
        }
        let mut levels = vec![0u16; 32];
        ink.paint(1.0, 32000.0, &mut levels);
        // and is empty again
        let mut again = vec![7u16; 32];
        ink.paint(1.0, 32000.0, &mut again);
        assert!(again.iter().all(|level| *level == 7));
        levels.into_iter().map(|level| f64::from(level) / 32000.0).collect()
    }

    /// Whether a place lies within polygons, by the parity of crossings.
    fn inside(loops: &[Vec<[f64; 2]>], x: f64, y: f64) -> bool {
        let sides = loops.iter().flat_map(|c| c.iter().zip(c.iter().cycle().skip(1)));
        let crossed = sides.filter(|([x0, y0], [x1, y1])| {
            (*y0 > y) != (*y1 > y) && x < x0 + (x1 - x0) * (y - y0) / (y1 - y0)
        });
        crossed.count() % 2 == 1
    }

    /// The same by brute force: many places in the pixel and in the blur, each weighed.
    fn brute_force(loops: &[Vec<[f64; 2]>], u: f64, v: f64, sigma: f64, weights: &[f64]) -> f64 {
        let reach = 0.5 + 4.0 * sigma;
        let count = 250;
        // in each cell of a grid at another place, so that no border runs along the grid
        let place = |i: u32, j: u32| {
            (f64::from(i) + (0.618_034 * f64::from(j) + 0.3).fract()) / f64::from(count) * 2.0 * reach - reach
        };
        let weight = |x: f64| weights[((x / reach * 0.5 + 0.5) * weights.len() as f64) as usize];
        let (mut sum, mut all) = (0.0, 0.0);
        for i in 0..count {
            for j in 0..count {
                let (x, y) = (place(i, j), place(j, i));
                let w = weight(x) * weight(y);
                all += w;
                sum += if inside(loops, u + x, v + y) { w } else { 0.0 };
            }
        }
        sum / all
    }

    /// Weights across the reach: the square seen through the blur, by 64 places in it.
    fn weights(sigma: f64) -> Vec<f64> {
        let reach = 0.5 + 4.0 * sigma;
        let weight = |x: f64| {
            if sigma == 0.0 {
                return 1.0;
            }
            let offset = |k: u32| x - (f64::from(k) + 0.5) / 64.0 + 0.5;
            (0..64).map(|k| (-0.5 * (offset(k) / sigma).powi(2)).exp()).sum()
        };
        (0..1000).map(|i| weight((f64::from(i) + 0.5) / 1000.0 * 2.0 * reach - reach)).collect()
    }

    #[test]
    fn coverage_is_that_of_brute_force() {
        let turned = |corners: &[[f64; 2]], angle: f64| -> Vec<[f64; 2]> {
            let (sin, cos) = angle.sin_cos();
            corners.iter().map(|[x, y]| [12.3 + cos * x - sin * y, 7.8 + sin * x + cos * y]).collect()
        };
        let square = |x: f64, y: f64, s: f64| [[x, y], [x + s, y], [x + s, y + s], [x, y + s]];
        let mut greatest = [0.0f64; 3];
        for angle in [0.0, 0.02, 0.3, 0.785, 1.2, 2.9] {
            let board = vec![turned(&square(-6.0, -6.0, 6.0), angle), turned(&square(0.0, 0.0, 6.0), angle)];
            let needle = vec![turned(&[[-7.0, 0.0], [7.0, -0.6], [7.0, 0.6]], angle)];
            let mut hole = square(-2.0, -2.0, 4.0);
            hole.reverse();
            let frame = vec![turned(&square(-3.0, -3.0, 6.0), angle), turned(&hole, angle)];
            let small = vec![turned(&square(-0.2, -0.2, 0.4), angle)];
            for loops in [board, needle, frame, small] {
                for (k, sigma) in [0.0, 0.3, 0.8].into_iter().enumerate() {
                    let weights = weights(sigma);
                    for v in [6.0, 8.0, 9.0] {
                        let found = row(&loops, v, sigma);
                        for u in (7..20).step_by(3) {
                            let wanted = brute_force(&loops, f64::from(u), v, sigma, &weights);
                            let error = (found[u as usize] - wanted).abs();
                            greatest[k] = greatest[k].max(error);
                        }
                    }
                }
            }
        }
        assert!(greatest.iter().all(|error| *error < 0.007), "{greatest:?}");
    }

    #[test]
    fn what_lies_far_to_the_left_covers_and_to_the_right_does_not() {
        let far = |x: f64| vec![vec![[x, -1e5], [x + 1e4, -1e5], [x + 1e4, 1e5], [x, 1e5]]];
        assert!(row(&far(-5000.0), 3.0, 0.5).iter().all(|c| *c == 1.0));
        assert!(row(&far(-20000.0), 3.0, 0.5).iter().all(|c| *c == 0.0));
        assert!(row(&far(5000.0), 3.0, 0.5).iter().all(|c| *c == 0.0));
    }
}
