//! Sub-pixel centroids from grey levels.
//!
//! Each pixel counts with `w = clamp((hi - I) / (hi - lo), 0, 1)`. `lo` lies above the dot's own level and `hi` below
//! the plate's by what noise may reach, so that only the rim is weighed: noise and uneven light inside the dot and on
//! the plate do not enter. Sums are integers, row by row, within an ellipse a little larger than the dot.

use super::blob::Blob;
use super::sums::{Ellipse, inner_sums, weighted_sums};
use crate::imaging::ImageView;
use nalgebra::Vector2;

/// How far the plate is sampled beyond the rim, px.
const REACH_PX: f64 = 3.0;
/// Least difference between plate and dot, grey levels.
const LEAST_CONTRAST: f64 = 12.0;
/// Points of the plate that are sampled around a dot.
const RING: usize = 24;
/// Sine and cosine of the angle between two of them, 15 degrees.
const TURN: (f64, f64) = (0.258_819_045_102_520_74, 0.965_925_826_289_068_3);
/// What remains without noise: pixels are squares, levels are rounded (px, for a rim of 1 px of length).
const FLOOR_PX: f64 = 0.02;
/// A dot whose roughness (squared difference of neighbours) exceeds that of the others so many times, and by so much, does
/// not show the camera's noise: something lies on it.
const ROUGH_TIMES: f64 = 5.0;
const ROUGH_LEVELS2: f64 = 1.0;
/// Light that changes across the dot moves the centroid: by this part of its half axis, under a tenth of vignetting.
const UNEVEN: f64 = 4e-4;

/// One point of the target, found and measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Found {
    /// Which point.
    pub id: u32,
    /// Centroid of its dot in the distorted image, px.
    pub px: Vector2<f64>,
    /// One standard deviation of each coordinate of `px`, px.
    pub sigma_px: f64,
    /// Area, px^2.
    pub area_px2: f64,
    /// Covariance `[xx, xy, yy]` of a point uniform in the dot's image, px^2.
    pub covariance_px2: [f64; 3],
    /// Grey level of the dot.
    pub dark_level: f64,
    /// Grey level of the plate around it.
    pub plate_level: f64,
    /// How far what is dark on the plate around it, on one side more than on the other, may have moved `px`: a shadow's
    /// edge, a neighbour; px.
    pub disturbance_px: f64,
}

/// Levels around one dot.
#[derive(Debug, Clone, Copy)]
struct Levels {
    dark: f64,
    plate: f64,
    /// Sum of squared differences of neighbours inside the dot, and their number.
    rough: u32,
    pairs: u32,
    /// The plate around the dot, in turn; 255 outside of the picture.
    ring: [u8; RING],
    /// The darkest of it.
    ring_least: u8,
}

impl Levels {
    /// Mean squared difference of neighbours.
    fn roughness(&self) -> f64 {
        f64::from(self.rough) / f64::from(self.pairs.max(1))
    }
}

/// Measures dots. Owns its buffers.
#[derive(Debug, Clone)]
pub(super) struct DotMeter {
    /// Least free distance around a dot, in its radii.
    gap: f64,
    levels: Vec<Option<Levels>>,
    roughness: Vec<f64>,
}

impl DotMeter {
    /// For up to `most` dots at a time, with `gap` radii of free plate about each.
    pub(super) fn new(gap: f64, most: usize) -> Self {
        Self { gap, levels: Vec::with_capacity(most), roughness: Vec::with_capacity(most) }
    }

    /// Measures dots near the given ellipses into `found`. Those without contrast to their surroundings are left out.
    pub(super) fn measure(&mut self, image: &ImageView<'_>, blobs: &[(u32, Blob)], found: &mut Vec<Found>) {
        found.clear();
        let mut levels = std::mem::take(&mut self.levels);
        levels.clear();
        levels.extend(blobs.iter().map(|(_, blob)| self.levels(image, blob)));
        let noise = noise_of(&levels, &mut self.roughness);
        for ((id, blob), level) in blobs.iter().zip(&levels) {
            found.extend(level.as_ref().and_then(|level| self.dot(*id, image, blob, level, noise)));
        }
        self.levels = levels;
    }

    /// How far the plate is looked at beyond the end of an axis, px.
    fn reach(&self, axis: f64) -> f64 {
        REACH_PX.min(0.75 * self.gap * axis)
    }

    /// Ellipse about a blob, its axes longer by at most [`REACH_PX`] and by three quarters of the free distance.
    fn around(&self, blob: &Blob) -> [f64; 3] {
        let [xx, xy, yy] = blob.covariance;
        let (major, minor) = blob.axes();
        let longer = |axis: f64| (axis + self.reach(axis)).powi(2);
        let (big, small) = (longer(major), longer(minor));
        // S = p I + q C has C's directions and the wanted axes
        let (c_big, c_small) = (0.25 * major * major, 0.25 * minor * minor);
        let q = if c_big - c_small > 1e-9 * c_big { (big - small) / (c_big - c_small) } else { 0.0 };
        let p = big - q * c_big;
        [p + q * xx, q * xy, p + q * yy]
    }

    /// Grey levels inside and around the dot.
    fn levels(&self, image: &ImageView<'_>, blob: &Blob) -> Option<Levels> {
        // the inner 36 % of the area: free of blur
        let inner = Ellipse::new(blob.x, blob.y, blob.covariance.map(|c| 4.0 * 0.36 * c));
        let (sum, count, rough, pairs) = inner_sums(image, &inner);
        if count == 0 {
            return None;
        }
        let [xx, xy, yy] = self.around(blob);
        // points on the ellipse: L (cos, sin) with S = L L^T
        let l11 = xx.max(0.0).sqrt();
        let l21 = if l11 > 0.0 { xy / l11 } else { 0.0 };
        let l22 = (yy - l21 * l21).max(0.0).sqrt();
        let (mut around, mut ring) = ([255u8; RING], [0u8; RING]);
        let mut used = 0;
        let (turn_sin, turn_cos) = TURN;
        let (mut cos, mut sin) = (1.0f64, 0.0f64);
        for seen in &mut around {
            // rounded by a cast: `round` is a call on the baseline processor
            let (x, y) = (blob.x + l11 * cos + 0.5, blob.y + l21 * cos + l22 * sin + 0.5);
            (cos, sin) = (cos * turn_cos - sin * turn_sin, sin * turn_cos + cos * turn_sin);
            if x >= 0.0
                && y >= 0.0
                && let Some(&p) = image.row(y as u32 as usize).get(x as u32 as usize)
                && let Some(slot) = ring.get_mut(used)
            {
                (*slot, *seen) = (p, p);
                used += 1;
            }
        }
        let ring = ring.get_mut(..used)?;
        ring.sort_unstable();
        // mean of the middle half: neighbours and the plate's edge do not matter
        let middle = ring.get(used / 4..used - used / 4)?;
        let plate = middle.iter().map(|&p| f64::from(p)).sum::<f64>() / middle.len().max(1) as f64;
        let dark = f64::from(sum) / f64::from(count);
        let ring_least = ring.first().copied().unwrap_or_default();
        (plate - dark >= LEAST_CONTRAST).then_some(Levels {
            dark,
            plate,
            rough,
            pairs,
            ring: around,
            ring_least,
        })
    }

    fn dot(&self, id: u32, image: &ImageView<'_>, blob: &Blob, levels: &Levels, noise: f64) -> Option<Found> {
        let contrast = levels.plate - levels.dark;
        let dead = (3.2 * noise + 1.0).min(0.3 * contrast);
        let (lo, hi) = ((levels.dark + dead).round(), (levels.plate - dead).round());
        let span = hi - lo;
        if span.is_nan() || span < 2.0 {
            return None;
        }
        let ellipse = Ellipse::new(blob.x, blob.y, self.around(blob));
        let sums = weighted_sums(image, &ellipse, hi as u8, span as u8);
        if sums.w == 0 {
            return None;
        }
        let w = sums.w as f64;
        let px = Vector2::new(sums.wx as f64 / w, sums.wy as f64 / w);
        let area = w / span;
        // each rim pixel moves the centroid by its distance from it times its weight's error over the area
        let rim2 = f64::from(sums.rim) * (blob.covariance[0] + blob.covariance[2]);
        let from_noise = noise.max(0.3) / span * rim2.sqrt() / area;
        let floor = FLOOR_PX / f64::from(sums.rim.max(1)).sqrt();
        let scale = area / blob.area;
        Some(Found {
            id,
            px,
            sigma_px: from_noise.hypot(floor).hypot(UNEVEN * blob.axes().0),
            area_px2: area,
            covariance_px2: blob.covariance.map(|c| c * scale),
            dark_level: levels.dark,
            plate_level: levels.plate,
            disturbance_px: self.disturbance_px(blob, levels, hi, span),
        })
    }

    /// What counts as dark between rim and ring, as the ring's points have it, moves the centroid towards it: by
    /// `2 g mean(w u)` for a circle and a gap of `g` px, with the weight `w` of the point in the direction `u`. Blur, of
    /// optics or motion, is the same on opposite sides.
    fn disturbance_px(&self, blob: &Blob, levels: &Levels, hi: f64, span: f64) -> f64 {
        if f64::from(levels.ring_least) >= hi {
            return 0.0;
        }
        let (turn_sin, turn_cos) = TURN;
        let (mut cos, mut sin) = (1.0f64, 0.0f64);
        let mut sum = Vector2::zeros();
        for &p in &levels.ring {
            let w = ((hi - f64::from(p)) / span).clamp(0.0, 1.0);
            sum += Vector2::new(cos, sin) * w;
            (cos, sin) = (cos * turn_cos - sin * turn_sin, sin * turn_cos + cos * turn_sin);
        }
        let (major, _) = blob.axes();
        2.0 * self.reach(major) * sum.norm() / RING as f64
    }
}

/// Standard deviation of the pixels' noise, grey levels: neighbours differ by twice its variance. Dots on which something
/// lies are left out: the smoothest quarter tells what is rough.
fn noise_of(levels: &[Option<Levels>], roughness: &mut Vec<f64>) -> f64 {
    roughness.clear();
    roughness.extend(levels.iter().flatten().map(Levels::roughness));
    roughness.sort_unstable_by(f64::total_cmp);
    let Some(quarter) = roughness.get(roughness.len() / 4) else { return 0.0 };
    let most = ROUGH_TIMES * quarter + ROUGH_LEVELS2;
    let (mut rough, mut pairs) = (0, 0);
    for level in levels.iter().flatten().filter(|l| l.roughness() <= most) {
        rough += level.rough;
        pairs += level.pairs;
    }
    (f64::from(rough) / (2.0 * f64::from(pairs.max(1)))).sqrt()
}
