//! The search of a whole frame: which threshold shows the shape, and which region it is.
//!
//! ```text
//! one for the frame (Otsu) ─► between local extremes: half-way, then nearer to either ─► a sweep over the frame's levels
//! ```
//! The first one that shows the outline ends the search, by the outline or, where it is there twice, without.

use super::fit::Fitted;
use super::outline::whitening;
use super::warp::{Oval, Projective, Warp};
use super::{FittedShape, REACH_PX, SEEN, ShapeFinder, ShapeMiss};
use crate::imaging::{Component, Connectivity, Histogram, ImageView, Moments, Polarity, Window};
use nalgebra::{SVector, Vector2};

/// Regions of one threshold that are looked at, the largest first.
pub(super) const MAX_CANDIDATES: usize = 40;
/// Fits that one search tries, of all thresholds: two thresholds' worth of regions, each in all its turns. A fit takes about a millisecond;
/// a poster would call for 3000.
const MAX_FITS: usize = 400;
/// Least area, px^2, and greatest share of the frame.
const MIN_AREA_PX2: u64 = 120;
const MAX_OF_FRAME: f64 = 0.7;
/// How far spread over area may be from the outline's own: a ratio that affine maps do not change, and perspective does a little.
const SPREADS: (f64, f64) = (0.6, 1.7);
/// The same for an ellipse, whose images are ellipses.
const SPREADS_ELLIPSE: (f64, f64) = (0.93, 1.08);
/// How far the area may be from that of the outline where it was found.
const AREAS: (f64, f64) = (0.9, 1.11);
/// Rows that the histogram samples.
const SAMPLED_ROWS: usize = 120;
/// Least contrast of a part of the frame in which something may lie, levels.
const CONTRAST: u8 = 22;
/// Places of a threshold between the local extremes, in 256ths of their difference.
const SHARES: [u8; 4] = [128, 80, 176, 48];
/// Thresholds of the sweep, and pixels beyond it, as share of all.
const SWEEP: u32 = 11;
const TAIL: f64 = 5e-4;
/// Two ways that differ by less than this share of the size are one.
const SAME: f64 = 0.1;
/// A second way must not fit worse than so many times the first one, to make it doubtful.
const DOUBTFUL: f64 = 2.0;

impl ShapeFinder {
    pub(super) fn search_thresholds(&mut self, image: &ImageView<'_>) -> Result<FittedShape, ShapeMiss> {
        self.left = MAX_FITS;
        let polarity = if self.light_on_dark { Polarity::Light } else { Polarity::Dark };
        let histogram = Histogram::of_rows(image, image.height() / SAMPLED_ROWS);
        let otsu = histogram.otsu().ok_or(ShapeMiss::NoContrast)?;
        let window = Window::whole(image);
        self.runs.binarize(image, &window, otsu.threshold, polarity);
        let mut why = match self.search_runs(image) {
            Err(ShapeMiss::NoMatch) => ShapeMiss::NoMatch,
            Err(ShapeMiss::NoRegion) => ShapeMiss::NoRegion,
            sure => return sure,
        };
        // what is neither dark nor light stays background
        let otherwise = if self.light_on_dark { 255 } else { 0 };
        let greatest = self.local.set(image, CONTRAST, otherwise);
        if greatest < CONTRAST {
            return Err(ShapeMiss::NoContrast);
        }
        for share in SHARES {
            self.local.move_to(share);
            self.runs.binarize_local(image, &mut self.local, polarity);
            match self.search_runs(image) {
                Err(ShapeMiss::NoMatch) => why = ShapeMiss::NoMatch,
                Err(ShapeMiss::NoRegion) => {}
                sure => return sure,
            }
        }
        let (low, high) = tails(&histogram);
        for k in 1..=SWEEP {
            let threshold = low + (high - low) * k / (SWEEP + 1);
            self.runs.binarize(image, &window, threshold as u8, polarity);
            match self.search_runs(image) {
                Err(ShapeMiss::NoMatch) => why = ShapeMiss::NoMatch,
                Err(ShapeMiss::NoRegion) => {}
                sure => return sure,
            }
        }
        Err(why)
    }

    /// The outline among the regions of the current runs.
    fn search_runs(&mut self, image: &ImageView<'_>) -> Result<FittedShape, ShapeMiss> {
        if self.runs.overflowed() {
            return Err(ShapeMiss::NoRegion);
        }
        self.components.find(&self.runs, &Window::whole(image), Connectivity::Eight);
        self.gather(image);
        if self.order.is_empty() {
            return Err(ShapeMiss::NoRegion);
        }
        self.contours.find(&self.runs, Connectivity::Eight);
        let mut order = std::mem::take(&mut self.order);
        let mut first: Option<FittedShape> = None;
        let mut several = false;
        for (_, region) in &order {
            if self.left == 0 {
                break;
            }
            let seen = match self.region(image, *region) {
                Ok(Some(seen)) => seen,
                Ok(None) => continue,
                Err(()) => {
                    several = true;
                    break;
                }
            };
            // a hole's surroundings and the like may show the same edges again
            if first.is_some_and(|first| self.apart(&first, &seen) > SAME) {
                several = true;
                break;
            }
            first = first.or(Some(seen));
        }
        order.clear();
        self.order = order;
        if several {
            return Err(ShapeMiss::Several);
        }
        // what was found may be there again among what was not looked at
        if self.left == 0 {
            return Err(ShapeMiss::GivenUp);
        }
        first.ok_or(ShapeMiss::NoMatch)
    }

    /// Regions whose area and spread are possible, the largest first.
    fn gather(&mut self, image: &ImageView<'_>) {
        self.order.clear();
        let most = MAX_OF_FRAME * image.width() as f64 * image.height() as f64;
        let own = spread_ratio(self.outline.spread, self.outline.area);
        let (low, high) = if self.ellipse { SPREADS_ELLIPSE } else { SPREADS };
        for (i, c) in self.components.as_slice().iter().enumerate() {
            if c.m00 < MIN_AREA_PX2 || c.touches_border || c.m00 as f64 > most {
                continue;
            }
            let [xx, xy, yy] = c.covariance();
            let ratio = spread_ratio([xx + 1.0 / 12.0, xy, yy + 1.0 / 12.0], c.m00 as f64) / own;
            // glare and dust: the region may have holes
            if !(ratio > low && ratio < high) {
                continue;
            }
            let at = self.order.partition_point(|(area, _)| *area >= c.m00);
            if at < MAX_CANDIDATES {
                self.order.insert(at, (c.m00, i));
                self.order.truncate(MAX_CANDIDATES);
            }
        }
    }

    /// The outline on one region; an error where it fits in two ways.
    fn region(&mut self, image: &ImageView<'_>, region: usize) -> Result<Option<FittedShape>, ()> {
        let Some(component) = self.components.as_slice().get(region).copied() else { return Ok(None) };
        let Some(moments) = self.components.sums(&self.runs, region).central() else { return Ok(None) };
        if self.ellipse {
            self.left = self.left.saturating_sub(1);
            return Ok(self.oval(image, &component, &moments));
        }
        let of_region = |c: &&crate::imaging::Contour| !c.hole && c.region as usize == region;
        let Some(contour) = self.contours.as_slice().iter().find(of_region).copied() else { return Ok(None) };
        self.candidate.set(&moments, self.contours.points(&contour));
        let mut turns = [0.0; super::candidate::MAX_TURNS];
        let count = self.candidate.turns(&self.outline, &mut turns);
        let mut best: Option<Fitted<8, Projective>> = None;
        let mut second = f64::INFINITY;
        for turn in turns.iter().take(count) {
            if self.left == 0 {
                break;
            }
            self.left -= 1;
            let Some(start) = self.candidate.settle(&self.camera, &self.outline, *turn) else { continue };
            let rise = self.rise();
            let fitted = self.fitter.fit(image, &self.camera, &self.outline, start, REACH_PX, rise);
            let good = |f: &Fitted<8, Projective>| self.is_good(&FittedShape::Polygon(*f), SEEN);
            let Some(fitted) = fitted.filter(good) else { continue };
            if !self.has_area(&FittedShape::Polygon(fitted), contour.area_px2) {
                continue;
            }
            match best {
                Some(first)
                    if self.apart(&FittedShape::Polygon(first), &FittedShape::Polygon(fitted)) < SAME => {}
                Some(first) if first.rms_px <= fitted.rms_px => second = second.min(fitted.rms_px),
                Some(first) => {
                    second = first.rms_px;
                    best = Some(fitted);
                }
                None => best = Some(fitted),
            }
        }
        match best {
            Some(best) if second < DOUBTFUL * best.rms_px => Err(()),
            best => Ok(best.map(FittedShape::Polygon)),
        }
    }

    /// An ellipse with the region's moments, and the one that its edges are on.
    fn oval(
        &mut self,
        image: &ImageView<'_>,
        component: &Component,
        moments: &Moments,
    ) -> Option<FittedShape> {
        let m = moments.of_squares();
        let [xx, xy, yy] = [m.mu20 / m.m00, m.mu11 / m.m00, m.mu02 / m.m00];
        // its image is the circle's by twice the root of the spread
        let det = (xx * yy - xy * xy).sqrt();
        let trace = (xx + yy + 2.0 * det).sqrt();
        let i = self.camera.intrinsics();
        let per = |a: f64, fa: f64, fb: f64| 2.0 * a / trace / (fa * fb).sqrt();
        let centre = self.camera.normalized_of(&Vector2::new(m.x, m.y));
        let start = Oval::of(SVector::from([
            centre.x,
            centre.y,
            per(xx + det, i.fx_px, i.fx_px),
            per(xy, i.fx_px, i.fy_px),
            per(yy + det, i.fy_px, i.fy_px),
        ]));
        if !start.is_plausible(1.0) {
            return None;
        }
        let rise = self.rise();
        let fitted = self.fitter.fit(image, &self.camera, &self.outline, start, REACH_PX, rise)?;
        let seen = FittedShape::Ellipse(fitted);
        (self.is_good(&seen, SEEN) && self.has_area(&seen, component.m00)).then_some(seen)
    }

    /// Whether a fit covers the region.
    fn has_area(&self, seen: &FittedShape, area_px2: u64) -> bool {
        let area: f64 = self.polygon_px(seen);
        let ratio = area_px2 as f64 / area;
        ratio > AREAS.0 && ratio < AREAS.1
    }

    /// Area of the outline in the image, px^2.
    fn polygon_px(&self, seen: &FittedShape) -> f64 {
        const COUNT: u32 = 256;
        let at = |i: u32| {
            let s = self.outline.length() * f64::from(i) / f64::from(COUNT);
            self.image_of(seen, &self.outline.at(s).0)
        };
        let origin = at(0);
        (0..COUNT).map(|i| 0.5 * (at(i) - origin).perp(&(at(i + 1) - origin))).sum()
    }

    /// How far apart two fits put the outline, as share of its size.
    fn apart(&self, a: &FittedShape, b: &FittedShape) -> f64 {
        let size = self.polygon_px(a).abs().sqrt().max(1.0);
        let off = |i: u32| {
            let u = self.outline.at(self.outline.length() * f64::from(i) / 16.0).0;
            (self.image_of(a, &u) - self.image_of(b, &u)).norm()
        };
        (0..16).map(off).fold(0.0, f64::max) / size
    }
}

/// Determinant of the spread over the squared area; `None` of a whitened region's.
fn spread_ratio(spread: [f64; 3], area: f64) -> f64 {
    let [xx, xy, yy] = spread;
    if whitening(spread).is_some() { (xx * yy - xy * xy) / (area * area) } else { 0.0 }
}

/// Levels below and above which few pixels lie.
fn tails(histogram: &Histogram) -> (u32, u32) {
    let bins = histogram.bins();
    let few = TAIL * bins.iter().map(|&n| f64::from(n)).sum::<f64>();
    let beyond = |sum: &mut f64, &n: &u32| {
        *sum += f64::from(n);
        Some(*sum)
    };
    let low = bins.iter().scan(0.0, beyond).take_while(|sum| *sum <= few).count();
    let high = bins.iter().rev().scan(0.0, beyond).take_while(|sum| *sum <= few).count();
    (low.min(255) as u32, 255_usize.saturating_sub(high).max(low.min(255)) as u32)
}
