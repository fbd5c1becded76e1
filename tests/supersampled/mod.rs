//! A renderer that shares nothing with the project's own: every pixel near an edge is the mean of 15 x 15 rays.
//!
//! ```text
//! ray of a sample ─► place on the plate ─► level of dot, plate, background
//! 5 x 5 cells a pixel (of 3 x 3 rays) ─► Gaussian blur over cells ─► mean of a pixel's cells ─► light ─► noise ─► byte
//! ```
//! Cells are kept around the dots alone; the plate's edges are blurred on whole pixels. Pixel centres lie on integers.

#![allow(dead_code, unreachable_pub)] // each test binary uses a part
#![allow(non_snake_case)]
#![allow(clippy::unwrap_used)] // helpers of tests

mod clutter;

pub use clutter::Clutter;
use nalgebra::{Isometry3, Point3, Vector2, Vector3};

/// Cells along a pixel's side, and rays along a cell's.
const CELLS: usize = 5;
const RAYS: usize = 3;
/// Squares along the side of a block: larger ones are more often near an edge, of smaller ones there are more.
const BLOCK: usize = 8;

/// Repeatable random numbers.
pub struct Dice(pub u64);

impl Dice {
    pub fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Two numbers of a normal distribution (Box and Muller).
    pub fn normal(&mut self) -> [f64; 2] {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        let (sin, cos) = (std::f64::consts::TAU * self.unit()).sin_cos();
        [radius * cos, radius * sin]
    }
}

/// A square of four dots before a camera with one coefficient of radial distortion.
#[derive(Debug, Clone)]
pub struct Scene {
    pub width: usize,
    pub height: usize,
    pub f_px: f64,
    pub centre_px: Vector2<f64>,
    pub k1: f64,
    pub X_CO: Isometry3<f64>,
    /// Centres and radii of the discs, and the plate's corners, m.
    pub discs: Vec<(Vector2<f64>, f64)>,
    /// Corners of dark polygons, m.
    pub outlines: Vec<Vec<Vector2<f64>>>,
    pub plate_m: [Vector2<f64>; 2],
    pub dot_level: f64,
    pub plate_level: f64,
    pub background_level: f64,
    /// Amplitude of a texture on the background, levels, and its grain, px.
    pub texture: (f64, f64),
    pub blur_px: f64,
    pub noise_levels: f64,
    /// Share of light lost in the corners.
    pub vignetting: f64,
    /// Light falls to one part in so many from one side of the image to the other, along this direction, rad.
    pub gradient: (f64, f64),
    /// What lies beside the plate.
    pub clutter: Clutter,
    pub seed: u64,
}

impl Scene {
    /// The default target of four dots in a VGA image; levels 190 and 30.
    pub fn of_four_dots(X_CO: Isometry3<f64>) -> Self {
        let corner = |x: f64, y: f64| Vector2::new(x, y);
        Self {
            width: 640,
            height: 480,
            f_px: 600.0,
            centre_px: Vector2::new(319.5, 239.5),
            k1: 0.0,
            X_CO,
            discs: vec![
                (corner(0.0, 0.0), 0.015),
                (corner(0.1, 0.0), 0.010),
                (corner(0.1, 0.1), 0.010),
                (corner(0.0, 0.1), 0.010),
            ],
            outlines: Vec::new(),
            plate_m: [corner(-0.03, -0.03), corner(0.13, 0.13)],
            dot_level: 30.0,
            plate_level: 190.0,
            background_level: 90.0,
            texture: (0.0, 1.0),
            blur_px: 0.5,
            noise_levels: 2.0,
            vignetting: 0.0,
            gradient: (1.0, 0.0),
            clutter: Clutter::default(),
            seed: 1,
        }
    }

    pub fn project(&self, r: &Vector2<f64>) -> Vector2<f64> {
        let p = self.X_CO * Point3::new(r.x, r.y, 0.0);
        let s = Vector2::new(p.x / p.z, p.y / p.z);
        s * (1.0 + self.k1 * s.norm_squared()) * self.f_px + self.centre_px
    }

    /// Images of the discs' centres.
    pub fn truth(&self) -> Vec<Vector2<f64>> {
        self.discs.iter().map(|(centre, _)| self.project(centre)).collect()
    }

    /// Whether all discs are in the image, `margin` px from its border.
    pub fn in_view(&self, margin: f64) -> bool {
        self.discs.iter().all(|(c, radius)| {
            (0..32).all(|k| {
                let (sin, cos) = (f64::from(k) * std::f64::consts::TAU / 32.0).sin_cos();
                let r = c + Vector2::new(cos, sin) * *radius;
                let depth = (self.X_CO * Point3::new(r.x, r.y, 0.0)).z;
                let px = self.project(&r);
                depth > 0.02
                    && px.x > margin
                    && px.y > margin
                    && px.x < self.width as f64 - 1.0 - margin
                    && px.y < self.height as f64 - 1.0 - margin
            })
        })
    }

    /// The image.
    pub fn render(&self) -> Vec<u8> {
        let (width, height) = (self.width, self.height);
        let mut levels = self.whole();
        for (centre, radius) in &self.discs {
            let rim = (0..64).map(|k| {
                let (sin, cos) = (f64::from(k) * std::f64::consts::TAU / 64.0).sin_cos();
                centre + Vector2::new(cos, sin) * *radius
            });
            self.patch(rim, &mut levels);
        }
        for outline in &self.outlines {
            self.patch(outline.iter().copied(), &mut levels);
        }
        let mut dice = Dice(self.seed);
        let texture = self.texture_table(&mut dice);
        let middle = Vector2::new(0.5 * (width as f64 - 1.0), 0.5 * (height as f64 - 1.0));
        let (far, far2) = (middle.norm(), middle.norm_squared());
        let (sin, cos) = self.gradient.1.sin_cos();
        let low = 1.0 / self.gradient.0;
        let view = Plane::of(self);
        let beside =
            |px: &Vector2<f64>, margin_m| !view.at(self, px).is_some_and(|r| self.on_plate(&r, margin_m));
        let mut spare = None;
        let mut out = vec![0; width * height];
        for (y, (bytes, levels)) in out.chunks_mut(width).zip(levels.chunks(width)).enumerate() {
            for (x, (byte, level)) in bytes.iter_mut().zip(levels).enumerate() {
                let px = Vector2::new(x as f64, y as f64);
                let d = px - middle;
                let along = 0.5 + 0.5 * (d.x * cos + d.y * sin) / far;
                let light = (1.0 - self.vignetting * d.norm_squared() / far2) * (low + (1.0 - low) * along);
                let mut level = f64::from(*level);
                if self.texture.0 > 0.0 && beside(&px, 0.002) {
                    level += self.texture_at(&texture, &px);
                }
                if !self.clutter.is_empty() && beside(&px, 0.0) {
                    level = self.clutter.over(level, &px, self.blur_px);
                }
                let noise = spare.take().unwrap_or_else(|| {
                    let [a, b] = if self.noise_levels > 0.0 { dice.normal() } else { [0.0; 2] };
                    spare = Some(b);
                    a
                });
                // a cast keeps to what bytes can hold
                *byte = (level * light + noise * self.noise_levels + 0.5) as u8;
            }
        }
        out
    }

    fn on_plate(&self, r: &Vector2<f64>, margin_m: f64) -> bool {
        let [low, high] = &self.plate_m;
        r.x > low.x - margin_m && r.y > low.y - margin_m && r.x < high.x + margin_m && r.y < high.y + margin_m
    }

    fn texture_table(&self, dice: &mut Dice) -> Vec<f64> {
        (0..64 * 64).map(|_| dice.within(-1.0, 1.0)).collect()
    }

    fn texture_at(&self, table: &[f64], px: &Vector2<f64>) -> f64 {
        let (u, v) = (px.x / self.texture.1, px.y / self.texture.1);
        let at = |i: f64, j: f64| table[(j as usize % 64) * 64 + i as usize % 64];
        let (i, j) = (u.floor(), v.floor());
        let (a, b) = (u - i, v - j);
        let top = at(i, j) * (1.0 - a) + at(i + 1.0, j) * a;
        let bottom = at(i, j + 1.0) * (1.0 - a) + at(i + 1.0, j + 1.0) * a;
        self.texture.0 * (top * (1.0 - b) + bottom * b)
    }

    /// Level of a place on the object's plane, and its distance from the nearest edge, m.
    #[inline]
    fn surface(&self, r: Option<Vector2<f64>>) -> (f64, f64) {
        let Some(r) = r else { return (self.background_level, f64::INFINITY) };
        let [low, high] = &self.plate_m;
        let inside = (r.x - low.x).min(high.x - r.x).min(r.y - low.y).min(high.y - r.y);
        if inside < 0.0 {
            return (self.background_level, -inside);
        }
        let mut nearest = inside;
        for (centre, radius) in &self.discs {
            let distance = (r - centre).norm() - radius;
            if distance < 0.0 {
                return (self.dot_level, -distance);
            }
            nearest = nearest.min(distance);
        }
        for outline in &self.outlines {
            let (mut inside, mut distance) = (false, f64::INFINITY);
            for (a, b) in outline.iter().zip(outline.iter().cycle().skip(1)) {
                let (side, to) = (b - a, r - a);
                let along = (to.dot(&side) / side.norm_squared()).clamp(0.0, 1.0);
                distance = distance.min((to - side * along).norm());
                // sides that a ray along x crosses
                inside ^= (a.y > r.y) != (b.y > r.y) && r.x < a.x + side.x * (r.y - a.y) / side.y;
            }
            if inside {
                return (self.dot_level, distance);
            }
            nearest = nearest.min(distance);
        }
        (self.plate_level, nearest)
    }

    /// Mean levels of the squares of a grid, `width` by `height` of them, of which `cells` make a pixel's side, about the pixels that `place` tells; of `rays` by `rays`
    /// samples where an edge may cross a square. Blocks of squares that no edge comes near are looked at once.
    fn means(
        &self,
        [width, height]: [usize; 2],
        cells: usize,
        rays: usize,
        place: impl Fn(usize, usize) -> Vector2<f64>,
    ) -> Vec<f32> {
        let view = Plane::of(self);
        let side = 1.0 / cells as f64;
        let part = |i: usize| ((i as f64 + 0.5) / rays as f64 - 0.5) * side;
        let offsets: Vec<_> =
            (0..rays * rays).map(|k| Vector2::new(part(k % rays), part(k / rays))).collect();
        let mut levels = vec![0.0; width * height];
        for (y0, x0) in
            (0..height).step_by(BLOCK).flat_map(|y| (0..width).step_by(BLOCK).map(move |x| (y, x)))
        {
            // the block's ends lie behind its last squares: a straight camera sees all of it between them
            let middle = view.at(self, &place(x0 + BLOCK / 2, y0 + BLOCK / 2));
            let farthest_m = [(0, 0), (BLOCK, 0), (0, BLOCK), (BLOCK, BLOCK)]
                .map(|(x, y)| {
                    let end = view.at(self, &place(x0 + x, y0 + y));
                    middle.zip(end).map_or(f64::INFINITY, |(r, q)| (q - r).norm())
                })
                .into_iter()
                .fold(0.0, f64::max);
            let (level, distance) = self.surface(middle);
            // by more than a lens bends
            let flat = distance > 1.5 * farthest_m;
            // more than twice what a square spans from its middle
            let reach_m = 3.0 * farthest_m / BLOCK as f64;
            for y in y0..(y0 + BLOCK).min(height) {
                for x in x0..(x0 + BLOCK).min(width) {
                    levels[y * width + x] = if flat {
                        level as f32
                    } else {
                        let px = place(x, y);
                        let (level, distance) = self.surface(view.at(self, &px));
                        if distance > reach_m {
                            level as f32
                        } else {
                            let seen = offsets.iter().map(|o| self.surface(view.at(self, &(px + o))).0);
                            (seen.sum::<f64>() / (rays * rays) as f64) as f32
                        }
                    };
                }
            }
        }
        levels
    }

    /// The whole image, on whole pixels: the plate alone, since patches take the place of all that blur carries away from what is on it.
    fn whole(&self) -> Vec<f32> {
        let place = |x: usize, y: usize| Vector2::new(x as f64, y as f64);
        let plate = Self { discs: Vec::new(), outlines: Vec::new(), clutter: Clutter::default(), ..*self };
        let mut levels = plate.means([self.width, self.height], 1, 5, place);
        blur(&mut levels, self.width, self.height, self.blur_px);
        levels
    }

    /// The pixels about one disc or polygon, by cells.
    fn patch(&self, rim: impl Iterator<Item = Vector2<f64>>, levels: &mut [f32]) {
        let (mut low, mut high) = (Vector2::new(f64::MAX, f64::MAX), Vector2::new(f64::MIN, f64::MIN));
        for place in rim {
            let px = self.project(&place);
            low = low.inf(&px);
            high = high.sup(&px);
        }
        let free = (3.5 * self.blur_px).ceil() + 1.0;
        let room = 3.0 + (3.0 * self.blur_px).ceil();
        let limit = |v: f64, most: usize| v.clamp(0.0, most as f64) as usize;
        let (x0, y0) = (limit(low.x - room, self.width), limit(low.y - room, self.height));
        let (x1, y1) = (limit(high.x + room + 1.0, self.width), limit(high.y + room + 1.0, self.height));
        if x0 >= x1 || y0 >= y1 {
            return;
        }
        // cells reach further than the pixels that are taken from them, by what blur carries
        let (columns, rows) = (x1 - x0 + 2 * free as usize, y1 - y0 + 2 * free as usize);
        let (width, height) = (columns * CELLS, rows * CELLS);
        let side = 1.0 / CELLS as f64;
        let place = |k: usize, from: usize| {
            from as f64 - free + (k / CELLS) as f64 + ((k % CELLS) as f64 + 0.5) * side - 0.5
        };
        let mut cells =
            self.means([width, height], CELLS, RAYS, |x, y| Vector2::new(place(x, x0), place(y, y0)));
        blur(&mut cells, width, height, self.blur_px * CELLS as f64);
        for y in y0..y1 {
            for x in x0..x1 {
                let (u, v) = ((x - x0 + free as usize) * CELLS, (y - y0 + free as usize) * CELLS);
                let sum: f32 =
                    (0..CELLS).map(|j| cells[(v + j) * width + u..][..CELLS].iter().sum::<f32>()).sum();
                levels[y * self.width + x] = sum / (CELLS * CELLS) as f32;
            }
        }
    }
}

/// The object's plane as the camera sees it.
struct Plane {
    origin: Vector3<f64>,
    R_OC: nalgebra::Matrix3<f64>,
}

impl Plane {
    fn of(scene: &Scene) -> Self {
        let X_OC = scene.X_CO.inverse();
        Self { origin: X_OC.translation.vector, R_OC: *X_OC.rotation.to_rotation_matrix().matrix() }
    }

    /// The place on the plane that a pixel sees.
    #[inline]
    fn at(&self, scene: &Scene, px: &Vector2<f64>) -> Option<Vector2<f64>> {
        let bent = (px - scene.centre_px) / scene.f_px;
        let mut s = bent;
        if scene.k1 != 0.0 {
            for _ in 0..20 {
                let before = s;
                s = bent / (1.0 + scene.k1 * s.norm_squared());
                if s == before {
                    break;
                }
            }
        }
        let R = &self.R_OC;
        let along = |i: usize| R[(i, 0)] * s.x + R[(i, 1)] * s.y + R[(i, 2)];
        let ray = Vector3::new(along(0), along(1), along(2));
        let depth = -self.origin.z / ray.z;
        (depth > 0.0).then(|| (self.origin + ray * depth).xy())
    }
}

/// Gaussian blur of `sigma` px, rows and columns; borders go on as they are.
fn blur(levels: &mut [f32], width: usize, height: usize, sigma: f64) {
    if sigma <= 0.0 {
        return;
    }
    let reach = (3.5 * sigma).ceil() as usize;
    let mut kernel: Vec<f32> =
        (0..=2 * reach).map(|k| (-0.5 * ((k as f64 - reach as f64) / sigma).powi(2)).exp() as f32).collect();
    let sum: f32 = kernel.iter().sum();
    kernel.iter_mut().for_each(|k| *k /= sum);
    let mut line = vec![0.0f32; width.max(height) + 2 * reach];
    for y in 0..height {
        let row = &mut levels[y * width..][..width];
        line[..reach].fill(row[0]);
        line[reach..reach + width].copy_from_slice(row);
        line[reach + width..width + 2 * reach].fill(row[width - 1]);
        row.fill(0.0);
        for (k, weight) in kernel.iter().enumerate() {
            for (value, other) in row.iter_mut().zip(&line[k..]) {
                *value += weight * other;
            }
        }
    }
    // columns, as sums of whole rows
    let source = levels.to_vec();
    for y in 0..height {
        let out = &mut levels[y * width..][..width];
        out.fill(0.0);
        for (k, weight) in kernel.iter().enumerate() {
            let from = (y + k).saturating_sub(reach).min(height - 1);
            for (value, other) in out.iter_mut().zip(&source[from * width..][..width]) {
                *value += weight * other;
            }
        }
    }
}
