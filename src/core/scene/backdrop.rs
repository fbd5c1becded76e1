//! The background in the object's plane: a mottled surface, and shapes that are no target (clutter).

use super::error::{SceneError, in_range};
use super::layers::PaintedPlane;
use super::rays::Rays;
use super::sensor::LEVEL_BITS;
use crate::geometry::Pose;
use crate::linalg::Random;
use crate::target::{ClosedOutline, Disc, Mark, Plate};
use nalgebra::{Matrix3, Vector2, Vector3};
use std::ops::RangeInclusive;

/// Sizes of spots: each half as large as the one before, and half as strong, so that a fifth would add a sixteenth. Chosen by eye.
const OCTAVES: u32 = 4;
/// Columns between two places at which the surface's level is exact; between them it is interpolated, which hardly shows because a spot is twice as
/// wide. Chosen by hand: half takes twice the time, twice bends the spots.
const STEP: usize = 4;
/// Smallest spots that are drawn, px, so that two steps lie in each.
const MIN_SPOT_PX: f64 = 8.0;

/// The surroundings of the plate. Without texture and clutter they are the plain background.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Backdrop {
    /// Largest deviation of the mottled surface from the background's level, grey levels, [`Self::TEXTURE_LEVELS`]; 0: none.
    pub texture_levels: f64,
    /// Size of its largest spots, m, [`Self::SIZE_M`].
    pub texture_size_m: f64,
    /// How many shapes lie about, light and dark discs and quadrangles, at most [`Self::MAX_CLUTTER`].
    pub clutter: u32,
    /// Their size, m, [`Self::SIZE_M`].
    pub clutter_size_m: f64,
    /// How far from the plate's edge they may lie, m, [`Self::SIZE_M`].
    pub clutter_reach_m: f64,
    /// Seed of the random spots and shapes.
    pub seed: u64,
}

impl Default for Backdrop {
    /// A plain background.
    fn default() -> Self {
        Self {
            texture_levels: 0.0,
            texture_size_m: 0.05,
            clutter: 0,
            clutter_size_m: 0.02,
            clutter_reach_m: 0.3,
            seed: 0,
        }
    }
}

impl Backdrop {
    /// What [`Self::texture_levels`] may be: more than all levels that there are would change nothing.
    pub const TEXTURE_LEVELS: RangeInclusive<f64> = 0.0..=255.0;
    /// What sizes and the reach may be, m: chosen, since a tenth of a millimetre is no spot and a hundred metres no table.
    pub const SIZE_M: RangeInclusive<f64> = 1e-4..=100.0;
    /// Most shapes that lie about: chosen, so that a frame takes milliseconds and not seconds.
    pub const MAX_CLUTTER: u32 = 2000;

    pub(super) fn check(&self) -> Result<(), SceneError> {
        in_range("texture_levels", self.texture_levels, &Self::TEXTURE_LEVELS)?;
        in_range("texture_size_m", self.texture_size_m, &Self::SIZE_M)?;
        in_range("clutter", f64::from(self.clutter), &(0.0..=f64::from(Self::MAX_CLUTTER)))?;
        in_range("clutter_size_m", self.clutter_size_m, &Self::SIZE_M)?;
        in_range("clutter_reach_m", self.clutter_reach_m, &Self::SIZE_M)
    }

    /// The shapes that lie about `plate`, as many sheets as grey levels: `dark` and `light`.
    pub(super) fn sheets(&self, plate: &Plate, dark: f64, light: f64) -> Vec<PaintedPlane> {
        let mut random = Random::new(self.seed ^ 0x00c1_077e);
        let sheet =
            |level| PaintedPlane { X_OS: Pose::identity(), loops: Vec::new(), level, both_sides: true };
        // one loop for each shape, because shapes may overlap
        let mut sheets = Vec::new();
        let (low, high) =
            (plate.low_m.add_scalar(-self.clutter_reach_m), plate.high_m.add_scalar(self.clutter_reach_m));
        for _ in 0..self.clutter {
            let centre_m =
                low + (high - low).component_mul(&Vector2::new(random.uniform(), random.uniform()));
            let radius_m = self.clutter_size_m * (0.25 + 0.25 * random.uniform());
            let mut sheet = sheet(if random.uniform() < 0.5 { dark } else { light });
            let turn = std::f64::consts::TAU * random.uniform();
            if random.uniform() < 0.5 {
                sheet.loops.extend(Mark::Disc(Disc { centre_m, radius_m }).loops(1e-3 * radius_m));
            } else {
                let outline: ClosedOutline = (0..4)
                    .map(|i| {
                        let angle =
                            turn + f64::from(i) * std::f64::consts::FRAC_PI_2 + 0.6 * random.uniform();
                        centre_m + Vector2::new(angle.cos(), angle.sin()) * radius_m
                    })
                    .collect();
                sheet.loops.push(outline);
            }
            sheets.push(sheet);
        }
        sheets
    }
}

/// The mottled surface as the camera sees it at one instant.
#[derive(Debug, Clone)]
pub(super) struct Texture {
    /// Rows of the inverse of `[r1 r2 p]`: place in the plane from direction; `None` where the camera lies in it.
    inverse: Option<Matrix3<f64>>,
}

impl Texture {
    pub(super) fn new() -> Self {
        Self { inverse: None }
    }

    pub(super) fn set(&mut self, X_CO: &Pose) {
        let R = X_CO.rotation.to_rotation_matrix();
        let m = R.matrix();
        let columns = [m.column(0).into(), m.column(1).into(), X_CO.translation.vector];
        self.inverse = Matrix3::from_columns(&columns).try_inverse();
    }

    /// Fills row `v` with the surface; beyond its horizon with the plain background.
    pub(super) fn fill(&self, backdrop: &Backdrop, background: f64, rays: &Rays, v: f64, levels: &mut [u16]) {
        let scale = f64::from(1u32 << LEVEL_BITS);
        let plain = (background * scale + 0.5) as u16;
        let Some(inverse) = &self.inverse else {
            levels.fill(plain);
            return;
        };
        let at = |u: f64| {
            let ray = rays.at(u, v);
            inverse * Vector3::new(ray.x, ray.y, 1.0)
        };
        let (mut from, mut last) = (at(0.0), None);
        for (k, chunk) in levels.chunks_mut(STEP).enumerate() {
            let next = at(((k + 1) * STEP) as f64);
            // how much of the surface a pixel covers
            let per_px = if next.z > 0.0 && from.z > 0.0 {
                ((next.xy() / next.z - from.xy() / from.z) / STEP as f64).norm()
            } else {
                f64::INFINITY
            };
            let strengths = strengths(backdrop.texture_size_m, per_px);
            let level = |h: &Vector3<f64>| {
                if h.z > 0.0 && strengths[0] > 0.0 {
                    let spots = spots(h.xy() / (h.z * backdrop.texture_size_m), &strengths, backdrop.seed);
                    (background + backdrop.texture_levels * spots).clamp(0.0, 255.0) * scale
                } else {
                    background * scale
                }
            };
            let start = last.unwrap_or_else(|| level(&from));
            let end = level(&next);
            for (i, out) in chunk.iter_mut().enumerate() {
                *out = (start + (end - start) * (i as f64 / STEP as f64) + 0.5) as u16;
            }
            (from, last) = (next, Some(end));
        }
    }
}

/// Strength of each size of spots: those that a pixel does not resolve are left out, softly.
fn strengths(size_m: f64, per_px_m: f64) -> [f64; OCTAVES as usize] {
    let (mut size, mut strength) = (size_m, 0.53);
    [(); OCTAVES as usize].map(|()| {
        let now = strength * (size / (MIN_SPOT_PX * per_px_m) - 1.0).clamp(0.0, 1.0);
        size *= 0.5;
        strength *= 0.5;
        now
    })
}

/// Sum of all sizes at a place in units of the largest, -1 to 1.
fn spots(r: Vector2<f64>, strengths: &[f64; OCTAVES as usize], seed: u64) -> f64 {
    let (mut place, mut sum) = (r, 0.0);
    for (i, strength) in (0u64..).zip(strengths) {
        if *strength > 0.0 {
            sum += strength * value_noise(place, seed.wrapping_add(i << 32));
        }
        place *= 2.0;
    }
    sum
}

/// Smooth between random values, -1 to 1, at whole coordinates.
fn value_noise(r: Vector2<f64>, seed: u64) -> f64 {
    // What is farther away than whole numbers of a double's precision has no place between two of them.
    let floor = r.map(|x| x.floor().clamp(-1e9, 1e9));
    let part = r - floor;
    let smooth = part.map(|t| t * t * (3.0 - 2.0 * t));
    let (x, y) = (floor.x as i64, floor.y as i64);
    let corner = |dx: i64, dy: i64| {
        let mut h =
            (x + dx) as u64 ^ ((y + dy) as u64).rotate_left(32) ^ seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        h = (h ^ (h >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        h = (h ^ (h >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (h >> 11) as f64 * (2.0 / (1u64 << 53) as f64) - 1.0
    };
    let (top, bottom) = (
        corner(0, 0) + (corner(1, 0) - corner(0, 0)) * smooth.x,
        corner(0, 1) + (corner(1, 1) - corner(0, 1)) * smooth.x,
    );
    top + (bottom - top) * smooth.y
}

/// The loops of a plate.
pub(super) fn rectangle(low: &Vector2<f64>, high: &Vector2<f64>) -> ClosedOutline {
    [[low.x, low.y], [high.x, low.y], [high.x, high.y], [low.x, high.y]].map(Vector2::from).into()
}
