//! Images of tags for tests and benches: nothing of them comes from the library but which cell is black.
//!
//! A pinhole camera looks at a tag; each pixel is the mean of jittered samples, spread as its own square and the blur spread it.

#![allow(dead_code)] // each test uses its own part

mod exact;

use vservo::target::{TagCell, TagFamily};

/// Repeatable random numbers (splitmix64).
pub(crate) struct Dice(pub(crate) u64);

impl Dice {
    pub(crate) fn word(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ z >> 31
    }

    pub(crate) fn unit(&mut self) -> f64 {
        (self.word() >> 11) as f64 / (1u64 << 53) as f64
    }

    pub(crate) fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    pub(crate) fn below(&mut self, n: u32) -> u32 {
        (self.unit() * f64::from(n)) as u32
    }

    pub(crate) fn normal(&mut self) -> f64 {
        let (u, v) = (self.unit().max(1e-300), self.unit());
        (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    }
}

/// A plane projective map, row by row.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Map(pub(crate) [f64; 9]);

impl Map {
    #[inline]
    pub(crate) fn at(&self, x: f64, y: f64) -> (f64, f64) {
        let m = &self.0;
        let w = m[6] * x + m[7] * y + m[8];
        ((m[0] * x + m[1] * y + m[2]) / w, (m[3] * x + m[4] * y + m[5]) / w)
    }

    pub(crate) fn inverse(&self) -> Self {
        let [a, b, c, d, e, f, g, h, i] = self.0;
        let det = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g);
        Self(
            [
                e * i - f * h,
                c * h - b * i,
                b * f - c * e,
                f * g - d * i,
                a * i - c * g,
                c * d - a * f,
                d * h - e * g,
                b * g - a * h,
                a * e - b * d,
            ]
            .map(|v| v / det),
        )
    }

    /// From cells to px: the tag's middle is seen at `(u, v)` px, about `side_px` long, turned by `roll` and tilted by `tilt` about the
    /// direction `about` (rad) in front of a camera of focal length `f`.
    #[allow(clippy::too_many_arguments)]
    pub(crate) fn view(
        cells: f64,
        u: f64,
        v: f64,
        side_px: f64,
        roll: f64,
        tilt: f64,
        about: f64,
        f: f64,
        centre: (f64, f64),
    ) -> Self {
        let (sa, ca) = about.sin_cos();
        let (st, ct) = tilt.sin_cos();
        // rotation about the axis (ca, sa, 0), of the axes turned by roll
        let turn = |x: f64, y: f64| {
            let along = ca * x + sa * y;
            let across = -sa * x + ca * y;
            (ca * along - sa * across * ct, sa * along + ca * across * ct, across * st)
        };
        let (sr, cr) = roll.sin_cos();
        let (ex, ey) = (turn(cr, sr), turn(-sr, cr));
        let depth = f / side_px * cells;
        let o = ((u - centre.0) / f * depth, (v - centre.1) / f * depth, depth);
        let half = 0.5 * cells;
        let o = (o.0 - half * (ex.0 + ey.0), o.1 - half * (ex.1 + ey.1), o.2 - half * (ex.2 + ey.2));
        let row = |e: f64, z: f64, c: f64| f * e + c * z;
        Self([
            row(ex.0, ex.2, centre.0),
            row(ey.0, ey.2, centre.0),
            row(o.0, o.2, centre.0),
            row(ex.1, ex.2, centre.1),
            row(ey.1, ey.2, centre.1),
            row(o.1, o.2, centre.1),
            ex.2,
            ey.2,
            o.2,
        ])
    }
}

/// How an image is taken.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Look {
    pub(crate) dark: f64,
    pub(crate) light: f64,
    /// Around the white margin.
    pub(crate) ground: f64,
    pub(crate) margin_cells: f64,
    pub(crate) blur_px: f64,
    /// How far the image moves while it is taken.
    pub(crate) motion_px: (f64, f64),
    pub(crate) noise: f64,
    /// Light at the right end of the image over that at the left.
    pub(crate) gradient: f64,
    /// Levels are `255 (light / 255)^(1 / gamma)`; noise comes after that.
    pub(crate) gamma: f64,
    /// Samples along a side of a pixel.
    pub(crate) samples: usize,
}

impl Default for Look {
    fn default() -> Self {
        let (dark, light, ground) = (40.0, 200.0, 120.0);
        Self {
            dark,
            light,
            ground,
            margin_cells: 1.0,
            blur_px: 0.7,
            motion_px: (0.0, 0.0),
            noise: 2.0,
            gradient: 1.0,
            gamma: 1.0,
            samples: 12,
        }
    }
}

/// A grey image under way.
pub(crate) struct Canvas {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) levels: Vec<f64>,
}

impl Canvas {
    pub(crate) fn new(width: usize, height: usize, level: f64) -> Self {
        Self { width, height, levels: vec![level; width * height] }
    }

    /// Draws a tag with its margin; true corners, px, in the order of the library.
    pub(crate) fn draw(
        &mut self,
        family: TagFamily,
        id: u32,
        map: &Map,
        look: &Look,
        dice: &mut Dice,
    ) -> [(f64, f64); 4] {
        let n = f64::from(family.cells_per_side());
        let cells: Vec<bool> = (0..n as i32 * n as i32)
            .map(|i| family.cell(id, i % n as i32, i / n as i32) == Some(TagCell::White))
            .collect();
        let back = map.inverse();
        let m = look.margin_cells;
        // 0 the ground, 1 ink, 2 paper
        let colour = |u: f64, v: f64| -> u8 {
            let (x, y) = back.at(u, v);
            if !(x >= -m && y >= -m && x < n + m && y < n + m) {
                0
            } else if x < 0.0 || y < 0.0 || x >= n || y >= n {
                2
            } else {
                1 + u8::from(cells[y as usize * n as usize + x as usize])
            }
        };
        let ends = [(-m, -m), (n + m, -m), (n + m, n + m), (-m, n + m)].map(|(x, y)| map.at(x, y));
        let (mu, mv) = look.motion_px;
        let reach = 0.5 + 4.0 * look.blur_px + 0.5 * mu.hypot(mv);
        let bound = |v: f64, most: usize| v.clamp(0.0, most as f64) as usize;
        let fold = |of: fn(&(f64, f64)) -> f64, pick: fn(f64, f64) -> f64, from: f64| {
            ends.iter().map(of).fold(from, pick)
        };
        let x0 = bound(fold(|p| p.0, f64::min, f64::MAX) - reach - 1.0, self.width);
        let x1 = bound(fold(|p| p.0, f64::max, f64::MIN) + reach + 2.0, self.width);
        let y0 = bound(fold(|p| p.1, f64::min, f64::MAX) - reach - 1.0, self.height);
        let y1 = bound(fold(|p| p.1, f64::max, f64::MIN) + reach + 2.0, self.height);
        // fine enough that the tails are those of the blur
        let quantiles = quantiles(look.blur_px, 1024);
        let k = look.samples;
        for y in y0..y1 {
            for x in x0..x1 {
                let (u, v) = (x as f64, y as f64);
                // cells are larger than a pixel: where 25 places agree all do
                let first = colour(u, v);
                let parts = [-1.0, 1.0, -0.5, 0.0, 0.5].map(|part| part * reach);
                let same = parts.iter().all(|dy| parts.iter().all(|dx| colour(u + dx, v + dy) == first));
                let at = y * self.width + x;
                let ground = self.levels[at];
                let level = |c: u8| [ground, look.dark, look.light][usize::from(c)];
                if same {
                    self.levels[at] = level(first);
                    continue;
                }
                let mut counts = [0.0; 3];
                for j in 0..k {
                    for i in 0..k {
                        let a = offset(&quantiles, (i as f64 + dice.unit()) / k as f64);
                        let b = offset(&quantiles, (j as f64 + dice.unit()) / k as f64);
                        // every instant once, in an order that goes with no place
                        let t = match (mu, mv) {
                            (0.0, 0.0) => 0.0,
                            _ => (((j * k + i) * 89 % (k * k)) as f64 + dice.unit()) / (k * k) as f64 - 0.5,
                        };
                        counts[usize::from(colour(u + a + t * mu, v + b + t * mv))] += 1.0;
                    }
                }
                self.levels[at] =
                    (0..3u8).map(|c| counts[usize::from(c)] * level(c)).sum::<f64>() / (k * k) as f64;
            }
        }
        [0, 1, 2, 3].map(|corner| {
            let (x, y) = family.corner(corner);
            map.at(f64::from(x), f64::from(y))
        })
    }

    /// Light and noise, as bytes.
    pub(crate) fn expose(&self, look: &Look, dice: &mut Dice) -> Vec<u8> {
        let mut pixels = Vec::with_capacity(self.levels.len());
        for (i, level) in self.levels.iter().enumerate() {
            let share = (i % self.width) as f64 / self.width as f64;
            let light = 2.0 * (1.0 + share * (look.gradient - 1.0)) / (1.0 + look.gradient);
            let noise = if look.noise > 0.0 { look.noise * dice.normal() } else { 0.0 };
            let level = 255.0 * (level * light / 255.0).powf(1.0 / look.gamma);
            pixels.push((level + noise).round().clamp(0.0, 255.0) as u8);
        }
        pixels
    }

    /// Polygons of any grey, some of them quadrilaterals.
    pub(crate) fn clutter(&mut self, count: usize, dice: &mut Dice) {
        for _ in 0..count {
            let (cx, cy) = (dice.within(0.0, self.width as f64), dice.within(0.0, self.height as f64));
            let (r, corners) = (dice.within(4.0, 60.0), 3 + dice.below(4));
            let begin = dice.within(0.0, 6.3);
            let places: Vec<(f64, f64)> = (0..corners)
                .map(|i| {
                    begin
                        + (f64::from(i) + dice.within(-0.2, 0.2)) * std::f64::consts::TAU / f64::from(corners)
                })
                .map(|t| (cx + r * t.cos(), cy + r * t.sin()))
                .collect();
            let level = dice.within(0.0, 255.0);
            for y in (cy - r).max(0.0) as usize..((cy + r + 1.0).max(0.0) as usize).min(self.height) {
                for x in (cx - r).max(0.0) as usize..((cx + r + 1.0).max(0.0) as usize).min(self.width) {
                    let p = (x as f64, y as f64);
                    let inside = (0..places.len()).all(|i| {
                        let (a, b) = (places[i], places[(i + 1) % places.len()]);
                        (b.0 - a.0) * (p.1 - a.1) - (b.1 - a.1) * (p.0 - a.0) >= 0.0
                    });
                    if inside {
                        self.levels[y * self.width + x] = level;
                    }
                }
            }
        }
    }
}

/// Where the distribution of a pixel's square blurred by a Gaussian reaches shares 0, 1/n ... 1.
fn quantiles(blur: f64, n: usize) -> Vec<f64> {
    let reach = 0.5 + 4.0 * blur;
    let fine = 4000;
    let density = |x: f64| {
        if blur > 0.0 {
            cdf((x + 0.5) / blur) - cdf((x - 0.5) / blur)
        } else {
            f64::from(u8::from(x.abs() <= 0.5))
        }
    };
    let step = 2.0 * reach / fine as f64;
    let mut sums = vec![0.0];
    for i in 0..fine {
        let x = -reach + (i as f64 + 0.5) * step;
        sums.push(sums[i] + density(x));
    }
    let total = sums[fine];
    (0..=n)
        .map(|q| {
            let wanted = total * q as f64 / n as f64;
            let i = sums.partition_point(|&s| s < wanted).clamp(1, fine);
            let part =
                if sums[i] > sums[i - 1] { (wanted - sums[i - 1]) / (sums[i] - sums[i - 1]) } else { 0.0 };
            -reach + (i as f64 - 1.0 + part) * step
        })
        .collect()
}

#[inline]
fn offset(quantiles: &[f64], share: f64) -> f64 {
    let at = share * (quantiles.len() - 1) as f64;
    let i = (at as usize).min(quantiles.len() - 2);
    quantiles[i] + (at - i as f64) * (quantiles[i + 1] - quantiles[i])
}

/// Distribution function of the normal distribution (Abramowitz, Stegun 7.1.26: 1e-7).
#[inline]
fn cdf(x: f64) -> f64 {
    let z = x.abs() / std::f64::consts::SQRT_2;
    let t = 1.0 / (1.0 + 0.327_591_1 * z);
    let poly = t
        * (0.254_829_592
            + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    let erf = 1.0 - poly * (-z * z).exp();
    if x >= 0.0 { 0.5 * (1.0 + erf) } else { 0.5 * (1.0 - erf) }
}
