//! Sub-pixel centroids from grey levels.
//!
//! ```text
//! levels inside ─► dot's level, noise          rings on the plate ─► plate's level, light, its noise
//! weight of a pixel: 0 on the plate, 1 in the dot, between them by its level under the light of the centre
//! centroid: of the weights in an ellipse a little larger than the dot
//! ```
//! Levels that noise may explain count as those of plate or dot, so that only the rim has fractional weights. Blur widens the rim:
//! where it is wider than the ellipse allows for, everything is measured again in a larger one.

use super::blob::Blob;
use super::clipped::{END_SHARE, EndSlope};
use super::ellipse::PixelEllipse;
use super::light::{LightFit, Samples};
use super::noise::{Levels, common_noise, is_clipped, noise_of};
use super::ring::{RING, Ring, directions};
use super::sums::{Scale, WeightSums, inner_sums, weighted_sums};
use crate::detect::Detection;
use crate::imaging::ImageView;
use nalgebra::Vector2;

/// Distance beyond the rim at which the plate is sampled, px: in sharp images, and at most. Derived: three deviations of a blur of 0.8 px, of 3 px.
const REACH_PX: f64 = 3.0;
const LARGEST_REACH_PX: f64 = 10.0;
/// Shortest half axis of the inner ellipse whose pixels have full weight, px. Chosen by hand: seven pixels; the middle of a smaller dot is blurred, too.
const MIN_INNER_PX: f64 = 1.5;
/// Least difference between plate and dot, grey levels. Chosen by hand: half of it takes shade for dots, twice of it loses dim ones.
const MIN_CONTRAST: f64 = 12.0;
/// Standard deviation of rounding to whole levels, and a little for what neighbouring pixels have in common of it.
const ROUNDING: f64 = 0.32;
/// A normal deviate cut off at 0 has the variance of one that counts from here on, over all means. Derived: integrated over these, 0.377.
const FREE_SDS: f64 = 0.38;
/// Error of a pixel on the rim, as share of the contrast, because no pixel is a perfect square. This and the next seven were chosen by hand so that
/// stated deviations are true: twice states too much, half too little where each counts. `stated_deviations_are_honest` tests it, blur 0.3 to 1.5 px.
const PIXEL_SHARE: f64 = 0.0032;
/// Below this deviation of an edge, pixels included, centroids depend on where pixels lie: so much more for each px, as far as `SHARPEST_PX`
/// below it. Chosen by hand as [`PIXEL_SHARE`]: the sharpest edge, the pixel's own, has 0.29 px.
const SHARP_PX: f64 = 0.57;
const SHARPNESS: f64 = 12.0;
const SHARPEST_PX: f64 = 0.1;
/// Levels that count as the plate's or the dot's own cut the ends off a sharp edge, and what is left of it depends on where pixels lie: by
/// so much for each px that the edge is sharper than `SLACK + BY_DEAD d`, at most `MAX_SLACK`, where a share `d` of the contrast is cut
/// off at either end. Chosen by hand as [`PIXEL_SHARE`].
const CUT: f64 = 0.22;
const SLACK: f64 = 0.33;
const BY_DEAD: f64 = 1.27;
const MAX_SLACK: f64 = 0.63;
/// The first harmonic of the light around the dots counts from so many times that of noise on. Derived: chi-square of four dots, 8 numbers: 2.4 %.
const UNEVEN_TIMES: f64 = 2.2;
/// From this half axis on a point of a ring may be 3 x 3 pixels, px. Derived: 24 of them lie 3.1 px apart on the ring, 4 px further out.
const CLUSTERS_FROM_PX: f64 = 8.0;
/// Points of a ring, of 24, that must be lighter than the dot by this share of its contrast. Chosen by hand: a neighbour hides some.
const MIN_PLAIN: usize = 20;
const MIN_SHARE: f64 = 0.4;
/// The blur may reach so many times as far as the plate is sampled, before its tail is taken for uneven light. Chosen by hand: 2.3 deviations.
const MAX_SHORT: f64 = 1.3;
/// Standard deviation that uneven light may account for, as a part of the half axis: beyond that dots are to contradict each other. Chosen by
/// hand: 0.01 px of 25 px.
const MAX_UNEVEN: f64 = 4e-4;
/// Most samples that the light is fitted to. Chosen by hand: all rings of 32 dots; of more every second point, else time grows with dots.
const MAX_SAMPLES: usize = 768;

/// Weighted sums of one dot.
#[derive(Debug, Clone, Copy)]
struct Weighed {
    sums: WeightSums,
    scale: Scale,
    /// Dead zone, levels: levels this near to the plate's or the dot's count as these.
    dead: f64,
    /// Pixels of which the weight is in the last part ([`END_SHARE`]) before a clipped end; 0 where nothing is clipped.
    at_end: u32,
}

/// Measures centroids of dots. Owns its buffers.
#[derive(Debug, Clone)]
pub(super) struct DotMeter {
    /// Free distance around the dot of each id, in its radii.
    gaps: Box<[f64]>,
    min_gap: f64,
    /// Whether dots are lighter than the plate.
    light_on_dark: bool,
    levels: Vec<Option<Levels>>,
    weighed: Vec<Option<Weighed>>,
    roughness: Vec<f64>,
    dots: Samples,
    samples: Samples,
    /// Residuals of the light at each dot's ring.
    rests: Vec<[f64; RING]>,
}

impl DotMeter {
    /// `gaps`: free distance around the dot of each id, in its radii.
    pub(super) fn new(gaps: Box<[f64]>, light_on_dark: bool) -> Self {
        let most = gaps.len();
        Self {
            min_gap: gaps.iter().copied().fold(3.0, f64::min),
            gaps,
            light_on_dark,
            levels: Vec::with_capacity(most),
            weighed: Vec::with_capacity(most),
            roughness: Vec::with_capacity(most),
            dots: Samples::with_capacity(most),
            samples: Samples::with_capacity(MAX_SAMPLES.max(most) + RING),
            rests: Vec::with_capacity(most),
        }
    }

    /// Level half-way between a dot and the plate around it; `None` without contrast.
    pub(super) fn middle(&self, image: &ImageView<'_>, blob: &Blob) -> Option<f64> {
        let around = blob.with_axes(|axis| axis + REACH_PX.min(0.75 * self.min_gap * axis)); // chosen by hand, see `reach`
        let inner = PixelEllipse::new(blob.x, blob.y, blob.covariance.map(|c| 4.0 * 0.36 * c));
        let (sum, count, ..) = inner_sums(image, &inner);
        let plate = Ring::of(image, (blob.x, blob.y), &around, false).level()?;
        let dot = f64::from(sum) / f64::from(count);
        let contrast = if self.light_on_dark { dot - plate } else { plate - dot };
        // NaN, of no pixels, is no contrast
        (contrast >= MIN_CONTRAST).then_some(0.5 * (dot + plate))
    }

    /// Whether a region differs in level from nearly all of its surroundings, which clutter mostly does not. Cheaper than searching the target among all
    /// ellipses.
    pub(super) fn stands_out(&self, image: &ImageView<'_>, blob: &Blob) -> bool {
        let around = blob.with_axes(|axis| axis + REACH_PX.min(0.75 * self.min_gap * axis)); // chosen by hand, see `reach`
        let ring = Ring::of(image, (blob.x, blob.y), &around, false);
        let inner = PixelEllipse::new(blob.x, blob.y, blob.covariance.map(|c| 4.0 * 0.36 * c));
        let (sum, count, ..) = inner_sums(image, &inner);
        let (Some(plate), true) = (ring.level(), count > 0) else { return false };
        let dot = f64::from(sum) / f64::from(count);
        let sign = if self.light_on_dark { -1.0 } else { 1.0 };
        let contrast = sign * (plate - dot);
        let plain = ring.levels().filter(|level| sign * (level - dot) > MIN_SHARE * contrast).count();
        contrast >= MIN_CONTRAST && plain * RING >= MIN_PLAIN * ring.count()
    }

    /// Measures dots near the given ellipses into `found`. Those without contrast to their surroundings are left out.
    pub(super) fn measure(
        &mut self,
        image: &ImageView<'_>,
        blobs: &[(u32, Blob)],
        found: &mut Vec<Detection>,
    ) {
        found.clear();
        let mut reach = REACH_PX;
        // the blur is measured at the rim, of which a wider ellipse contains more
        for _ in 0..4 {
            let measured = self.measure_within(image, blobs, reach, found);
            let wanted = (measured + 0.2).min(LARGEST_REACH_PX);
            // NaN is no reason
            if !(wanted > reach + 0.5) {
                break;
            }
            reach = wanted;
        }
    }

    /// Measures with a given reach beyond the rim, px. Returns the reach that the measured blur requires.
    fn measure_within(
        &mut self,
        image: &ImageView<'_>,
        blobs: &[(u32, Blob)],
        reach: f64,
        found: &mut Vec<Detection>,
    ) -> f64 {
        let mut levels = std::mem::take(&mut self.levels);
        levels.clear();
        levels.extend(blobs.iter().map(|(id, blob)| self.levels(image, *id, blob, reach)));
        let (inside, most) = noise_of(&levels, &mut self.roughness);
        let clipped = is_clipped(&levels, self.light_on_dark, inside);
        let light = self.light(image, blobs, &levels, inside, clipped.then_some(reach));
        self.rests.clear();
        let nothing = [f64::NAN; RING];
        self.rests.extend(levels.iter().map(|l| l.as_ref().map_or(nothing, |l| light.rest_of(&l.ring))));
        let noise = common_noise(inside, &levels, &self.rests, &light).max(ROUNDING);
        self.weighed.clear();
        let (mut rim, mut length, mut share, mut free) = (0.0, 0.0, 0.0, 0.0);
        let mut at_end = 0.0;
        for ((id, blob), levels) in blobs.iter().zip(&levels) {
            let weighed = levels.as_ref().and_then(|l| {
                self.weigh(image, (*id, blob), l, (&light, noise), reach, [l.roughness() > most, clipped])
            });
            if let (Some(weighed), Some(levels)) = (&weighed, levels) {
                let (major, minor) = blob.axes();
                rim += f64::from(weighed.sums.rim);
                at_end += f64::from(weighed.at_end);
                let around = perimeter(major, minor);
                length += around;
                share += weighed.dead / levels.contrast() * around;
                free += self.reach(*id, minor, reach) * around;
            }
            self.weighed.push(weighed);
        }
        // standard deviation of the edge, from how wide it is between the dead zones
        let width = rim / length;
        let dead = share / length;
        let blur = width / (2.0 * deviate(dead));
        // within the blur of the rim the plate's light cannot be measured
        let wanted = 3.0 * blur + 0.5;
        let clear = wanted < MAX_SHORT * free / length;
        let end = EndSlope::of(at_end, length, deviate(dead), blur);
        let uneven = if clear { self.unevenness(&levels, noise) } else { 0.0 };
        let uneven = uneven.hypot(light.deviation);
        let share = PIXEL_SHARE * (1.0 + SHARPNESS * (SHARP_PX - blur).clamp(0.0, SHARPEST_PX));
        let share = share.hypot(CUT * ((SLACK + BY_DEAD * dead).min(MAX_SLACK) - blur).max(0.0));
        found.clear();
        for (((id, blob), levels), weighed) in blobs.iter().zip(&levels).zip(&self.weighed) {
            let (Some(levels), Some(weighed)) = (levels, weighed) else { continue };
            // light moves the level of half-way along the edge's slope
            let (dot, plate) = (levels.dot, levels.plate);
            let per_level = 0.5 * (dot + plate) / (levels.contrast() * plate.max(dot)) * 2.5 * blur;
            let light_px = (uneven * per_level).min(MAX_UNEVEN * blob.axes().0);
            let model_px = if clipped { light_px.hypot(end.sd_px(&blob.covariance)) } else { light_px };
            found.extend(self.dot(*id, blob, levels, weighed, (noise, share), model_px, reach));
        }
        self.levels = levels;
        wanted
    }

    /// Reach beyond the end of an axis within which the plate is sampled, px: three quarters of the free distance, and not beyond its middle for
    /// a strong blur, which the neighbour has too.
    fn reach(&self, id: u32, axis: f64, reach: f64) -> f64 {
        let free = self.gaps.get(id as usize).copied().unwrap_or(0.1) * axis;
        reach.min((0.5 * free).max(REACH_PX.min(0.75 * free))) // chosen by hand: a quarter is the neighbour's blur
    }

    /// Ellipse about a blob, its axes longer by at most `reach` and by what is free.
    fn around(&self, id: u32, blob: &Blob, reach: f64) -> [f64; 3] {
        blob.with_axes(|axis| axis + self.reach(id, axis, reach))
    }

    /// Grey levels inside and around the dot.
    fn levels(&self, image: &ImageView<'_>, id: u32, blob: &Blob, reach: f64) -> Option<Levels> {
        // the inner 36 % of the area: free of blur
        let inner = blob.covariance.map(|c| 4.0 * 0.36 * c);
        let (sum, count, rough, pairs) = inner_sums(image, &PixelEllipse::new(blob.x, blob.y, inner));
        if count == 0 {
            return None;
        }
        let clustered = blob.axes().1 >= CLUSTERS_FROM_PX;
        // a point's inner pixels lie where those of a smaller one would
        let reach = if clustered { reach + 1.0 } else { reach };
        let ring = Ring::of(image, (blob.x, blob.y), &self.around(id, blob, reach), clustered);
        let dot = f64::from(sum) / f64::from(count);
        let plate = ring.level()?;
        let contrast = if self.light_on_dark { dot - plate } else { plate - dot };
        (contrast >= MIN_CONTRAST).then_some(Levels { dot, plate, rough, pairs, ring })
    }

    /// The light over the lighter of plate and dots, or over the darker of both where the lighter is clipped.
    fn light(
        &mut self,
        image: &ImageView<'_>,
        blobs: &[(u32, Blob)],
        levels: &[Option<Levels>],
        noise: f64,
        clipped: Option<f64>,
    ) -> LightFit {
        self.dots.clear();
        self.samples.clear();
        let step = (blobs.len() * RING).div_ceil(MAX_SAMPLES).max(1);
        let by_dots = self.light_on_dark != clipped.is_some();
        let (mut largest, mut pixels, mut inner) = (0.0f64, 0, 0);
        for ((_, blob), levels) in blobs.iter().zip(levels) {
            let Some(levels) = levels else { continue };
            largest = largest.max(blob.axes().0);
            // chosen by hand: the blur of the rim, a third of the reach, lightens inner pixels that lie nearer to it than 2.4 of its deviations
            if clipped.is_some_and(|reach| by_dots && !(0.4 * blob.axes().1 > 0.8 * reach)) {
                continue;
            }
            let level = if by_dots { levels.dot } else { levels.plate };
            self.dots.push(blob.x, blob.y, level);
            pixels += levels.ring.pixels;
            inner += 2 * levels.pairs;
            if !by_dots {
                self.samples.take(&levels.ring, step);
            }
        }
        let samples = if by_dots { &self.dots } else { &self.samples };
        let half_diagonal = 0.5 * (image.width() as f64).hypot(image.height() as f64);
        let count = self.dots.len().max(1) as f64;
        let pixels = (pixels as f64 / count).max(1.0);
        let noise = noise.max(ROUNDING);
        let curved = if by_dots { 0.0 } else { largest };
        let light = LightFit::fit(&self.dots, samples, pixels, noise, curved, half_diagonal);
        if clipped.is_none() {
            return light;
        }
        let pixels = if by_dots { f64::from(inner) / count } else { pixels };
        light.of_the_darker(samples, noise * noise / pixels.max(1.0), largest, half_diagonal)
    }

    /// Weighted sums of a dot, which may be partly `covered` (occluded), and the lighter of it and its plate `clipped`.
    fn weigh(
        &self,
        image: &ImageView<'_>,
        (id, blob): (u32, &Blob),
        levels: &Levels,
        (light, noise): (&LightFit, f64),
        reach: f64,
        [covered, clipped]: [bool; 2],
    ) -> Option<Weighed> {
        let contrast = levels.contrast();
        let relative = light.relative(blob.x, blob.y, blob.axes().0 + reach);
        // what is clipped is even, and is not under the light that is taken off
        let lost = if clipped {
            levels.plate.max(levels.dot) * most_of(&relative, blob.axes().0 + reach)
        } else {
            0.0
        };
        // chosen by hand as for the dead zone: a rim of which more is lost is measured as it stands
        let (relative, lost) = if lost > 0.3 * contrast { ([0.0; 5], 0.0) } else { (relative, lost) };
        let dead = (3.2 * noise + 1.0).min(0.3 * contrast); // noise passes 3.2 deviations once in 1500; else too little is left
        let away = if self.light_on_dark { dead } else { -dead - lost };
        let edge = (16.0 * (levels.plate + away)).round();
        let span = (16.0 * (contrast - 2.0 * dead - lost)).round();
        // two levels: with less, rounding would be the weights
        if span.is_nan() || span < 32.0 || edge.is_nan() {
            return None;
        }
        let margin = (16.0 * FREE_SDS * noise).round() as i16;
        let scale =
            Scale { edge: edge as i16, span: span as i16, margin, light: self.light_on_dark, relative };
        let outer = PixelEllipse::new(blob.x, blob.y, self.around(id, blob, reach));
        let rim = PixelEllipse::new(blob.x, blob.y, blob.covariance.map(|c| 4.0 * c));
        // pixels well within a dot belong to it, also under glare
        let hollow = covered && blob.axes().1 - reach > MIN_INNER_PX;
        let inner = hollow.then(|| PixelEllipse::new(blob.x, blob.y, blob.with_axes(|axis| axis - reach)));
        let sums = weighted_sums(image, [&outer, &rim], inner.as_ref(), &scale);
        let at_end = if clipped {
            let part = (END_SHARE * f64::from(scale.span)) as i16;
            let from = if self.light_on_dark { scale.edge + scale.span - part } else { scale.edge };
            weighted_sums(image, [&outer, &rim], None, &Scale { edge: from, span: part, margin: 0, ..scale })
                .rim
        } else {
            0
        };
        (sums.w > 0).then_some(Weighed { sums, scale, dead, at_end })
    }

    fn dot(
        &self,
        id: u32,
        blob: &Blob,
        levels: &Levels,
        weighed: &Weighed,
        (noise, pixel_share): (f64, f64),
        model_px: f64,
        reach: f64,
    ) -> Option<Detection> {
        let Weighed { sums, scale, .. } = weighed;
        let (w, span) = (sums.w as f64, f64::from(scale.span));
        let px = Vector2::new(blob.x.round() + sums.wx as f64 / w, blob.y.round() + sums.wy as f64 / w);
        let area = w / span;
        // each rim pixel moves the centroid by its distance from it times its weight's error over the area
        let off = noise.hypot(pixel_share * levels.contrast());
        let from_noise = 16.0 * off / span * (0.5 * sums.rim_px4).sqrt() / area;
        let by_area = area / blob.area;
        Some(Detection {
            id,
            px,
            sd_px: from_noise.hypot(model_px),
            area_px2: area,
            covariance_px2: blob.covariance.map(|c| c * by_area),
            dark_level: levels.dot,
            plate_level: levels.plate,
            disturbance_px: self.disturbance_px(id, blob, levels, weighed, reach),
        })
    }

    /// Shift of the centroid by something between rim and ring that has the level of the dot, as the ring's points show: by
    /// `2 g mean(w u)` for a circle and a gap of `g` px, with the weight `w` of the point in the direction `u`. Blur, of
    /// optics or motion, is the same on opposite sides.
    fn disturbance_px(&self, id: u32, blob: &Blob, levels: &Levels, weighed: &Weighed, reach: f64) -> f64 {
        let scale = &weighed.scale;
        let [x, y, xx, xy, yy] = scale.relative;
        let most = most_of(&scale.relative, blob.axes().0 + reach);
        let (least, greatest) = levels.ring.range();
        let edge = f64::from(scale.edge) / 16.0;
        // nothing around looks like a dot, in whatever light there is
        if if scale.light { greatest * (1.0 + most) <= edge } else { least * (1.0 - most) >= edge } {
            return 0.0;
        }
        let mut sum = Vector2::zeros();
        let ring = &levels.ring;
        for (((at_x, at_y), level), u) in ring.x.iter().zip(&ring.y).zip(&ring.level).zip(directions()) {
            if level.is_nan() {
                continue;
            }
            let (dx, dy) = (at_x - blob.x, at_y - blob.y);
            let level = 16.0 * level * (1.0 + x * dx + y * dy + xx * dx * dx + xy * dx * dy + yy * dy * dy);
            let away = f64::from(scale.edge) - level;
            let w = (if scale.light { -away } else { away } / f64::from(scale.span)).clamp(0.0, 1.0);
            sum += u * w;
        }
        let (major, _) = blob.axes();
        2.0 * self.reach(id, major, reach) * sum.norm() / RING as f64
    }

    /// Standard deviation, per coordinate, of the first harmonic around the dots of light that the fit does not follow, levels.
    fn unevenness(&self, levels: &[Option<Levels>], noise: f64) -> f64 {
        if self.light_on_dark {
            return 0.0;
        }
        let (mut square, mut by_noise, mut count) = (0.0, 0.0, 0.0);
        for (levels, rest) in levels.iter().zip(&self.rests) {
            let Some(levels) = levels else { continue };
            let (mut sum, mut n) = (Vector2::zeros(), 0.0);
            for (off, u) in rest.iter().zip(directions()) {
                // points that the light does not explain are not used
                let (off, one) = if off.is_nan() { (0.0, 0.0) } else { (*off, 1.0) };
                sum += u * off;
                n += one;
            }
            if n > 0.5 * RING as f64 {
                square += (2.0 / n * sum).norm_squared();
                by_noise += 4.0 * noise * noise / (n * levels.ring.pixels as f64);
                count += 1.0;
            }
        }
        if square > UNEVEN_TIMES * by_noise { (0.5 * (square - by_noise) / count).sqrt() } else { 0.0 }
    }
}

/// Most that relative light differs from 1 within `far` px.
fn most_of([x, y, xx, xy, yy]: &[f64; 5], far: f64) -> f64 {
    (x.abs() + y.abs() + (xx.abs() + xy.abs() + yy.abs()) * far) * far
}

/// Length of an ellipse's rim (Ramanujan), px.
fn perimeter(a: f64, b: f64) -> f64 {
    std::f64::consts::PI * (3.0 * (a + b) - ((3.0 * a + b) * (a + 3.0 * b)).sqrt())
}

/// Normal deviate of the probability `1 - p` (Tukey's lambda, 0.14), for 0.002 to 0.4, where it follows the true one to 1 %.
fn deviate(p: f64) -> f64 {
    let p = p.clamp(0.002, 0.4); // no need of more: dead zones are at most 0.3
    4.91 * ((1.0 - p).powf(0.14) - p.powf(0.14))
}
