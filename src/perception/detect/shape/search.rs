//! Search of a whole frame: several thresholds, and for each the regions that may be the shape.
//!
//! ```text
//! one for the frame (Otsu) ─► between local extremes: half-way, then nearer to either ─► a sweep over the frame's levels
//! ```
//! The first threshold with which the outline is found ends the search; where it is found twice the result is ambiguous.

use super::candidate::MAX_TURNS;
use super::chance::Evidence;
use super::fit::Fitted;
use super::outline::whitening;
use super::warp::{Oval, Projective, Warp};
use super::{FittedShape, REACH_PX, SEEN, ShapeFinder, ShapeMiss};
use crate::imaging::{Connectivity, Contour, Histogram, ImageView, Polarity, Window};
use nalgebra::{SVector, Vector2};

/// Regions of one threshold that are examined, the largest first. Chosen by hand: half misses a shape among larger things, twice costs time
/// where [`MAX_WORK`] does not end the search before.
pub(super) const MAX_CANDIDATES: usize = 40;
/// Work of one search in all its thresholds, in pixels of a fit, chosen since it bounds the time: half a second of one core of the machine
/// where it was measured, 0.52 s the longest of 400 searches of posters. Other work on the core comes on top. Posters of a hundred polygons
/// call for more, and are given up.
const MAX_WORK: u64 = 6_000_000;
/// Distances of an alignment in the time of a pixel of a fit. Chosen by hand, from what both compute: a distance is a few sums and products, a
/// pixel of a fit takes an exponential and two passes. Half or twice changes when a search is given up, nothing else.
const DISTANCES: u64 = 12;
/// Borders that are expected to be as good by chance, among those that were aligned: with more, what was found is none. Measured: of 400
/// searches of posters of random polygons 10 found something, eight of them at more than 0.002. A tenth of it refuses honest views of simple
/// outlines (test `random_views_are_found_where_they_are`).
const MAX_CHANCE: f64 = 0.01;
/// Least area, px^2, and greatest share of the frame. Derived: six sides about 120 px^2 have some 7 px each, of which the corners' blur takes
/// 4.5, so that the shortest piece of an edge is left. The share was chosen by hand: what fills more is the background, and the plate about a
/// shape needs room in the image, too.
const MIN_AREA_PX2: u64 = 120;
const MAX_OF_FRAME: f64 = 0.7;
/// How far spread over area may be from the outline's own: a ratio that affine maps do not change, and perspective does a little. Chosen by
/// hand, wide, for it only saves time: what is left is aligned and fitted.
const SPREADS: (f64, f64) = (0.6, 1.7);
/// The same for an ellipse, whose images are ellipses. Chosen by hand: pixels and threshold change the ratio by some percent on the smallest
/// regions; twice as wide takes in rectangles (whose ratio is 1.1), which only cost time.
const SPREADS_ELLIPSE: (f64, f64) = (0.93, 1.08);
/// How far the area may be from that of the outline where it was found. Derived: a border that lies 0.3 px off all around changes the smallest
/// region by a tenth.
const AREAS: (f64, f64) = (0.9, 1.11);
/// Rows that the histogram samples. Chosen by hand: of a frame 640 px wide 77 000 pixels, of which [`TAIL`] is 38; a fourth would do as well.
const SAMPLED_ROWS: usize = 120;
/// Least contrast of a part of the frame in which something may lie, levels. Chosen by hand: nearly twice the least step of an edge, since both
/// extremes hold noise; half makes regions of noise everywhere, twice misses a shape in the shade.
const CONTRAST: u8 = 22;
/// Places of a threshold between the local extremes, in 256ths of their difference. Chosen by hand: half-way moves no edge; the others divide
/// what blur or a dirty plate joins there, on the darker side and on the lighter one.
const SHARES: [u8; 4] = [128, 80, 176, 48];
/// Thresholds of the sweep, and pixels beyond it, as share of all. Chosen by hand: steps of a twelfth of the levels; twice as many take twice the
/// time of a search that finds nothing, half as many miss a shape whose levels are like its surroundings'. The tail leaves out single pixels
/// that are dead or glare.
const SWEEP: u32 = 11;
const TAIL: f64 = 5e-4;
/// Two ways that differ by less than this share of the size are one. Chosen by hand: two fits to the same edges differ by hundredths of a pixel,
/// two copies of the shape by its size.
const SAME: f64 = 0.1;
/// A second way must not fit worse than so many times the first one, to make it doubtful.
const DOUBTFUL: f64 = 2.0;

impl ShapeFinder {
    pub(super) fn search_thresholds(&mut self, image: &ImageView<'_>) -> Result<FittedShape, ShapeMiss> {
        (self.fitter.work, self.candidate.work, self.aligned) = (0, 0, 0);
        let polarity = if self.light_on_dark { Polarity::Light } else { Polarity::Dark };
        let histogram = Histogram::of_rows(image, image.height() / SAMPLED_ROWS);
        let otsu = histogram.otsu().ok_or(ShapeMiss::NoContrast)?;
        let window = Window::whole(image);
        self.runs.binarize(image, &window, otsu.threshold, polarity);
        let mut why = match self.search_runs(image) {
            Err(miss) if miss.may_change() => miss,
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
                Err(miss) if miss.may_change() => why = why.telling(miss),
                sure => return sure,
            }
        }
        let (low, high) = tails(&histogram);
        for k in 1..=SWEEP {
            let threshold = low + (high - low) * k / (SWEEP + 1);
            self.runs.binarize(image, &window, threshold as u8, polarity);
            match self.search_runs(image) {
                Err(miss) if miss.may_change() => why = why.telling(miss),
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
        self.sort_by_extents();
        let mut order = std::mem::take(&mut self.order);
        let mut first: Option<FittedShape> = None;
        let mut several = false;
        self.by_chance = false;
        for (_, region) in &order {
            if self.spent() {
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
        // the shape may be there a second time among the regions that were not examined
        if self.spent() {
            return Err(ShapeMiss::GivenUp);
        }
        first.ok_or(if self.by_chance { ShapeMiss::ByChance } else { ShapeMiss::NoMatch })
    }

    /// Whether the search has used up its work.
    fn spent(&self) -> bool {
        self.fitter.work + self.candidate.work / DISTANCES > MAX_WORK
    }

    /// Whether a fit is better than the best accidental one among all borders that were aligned.
    fn is_told(&mut self, evidence: &Evidence) -> bool {
        let told = self.aligned as f64 * evidence.chance(self.candidate.reach_px()) <= MAX_CHANCE;
        self.by_chance |= !told;
        told
    }

    /// Sorts the regions by the agreement of their extents with the outline's; impossible ones are removed.
    fn sort_by_extents(&mut self) {
        let mut order = std::mem::take(&mut self.order);
        if !self.ellipse {
            for (rank, region) in &mut order {
                // no distance but one beyond all
                *rank = self.take(*region).map_or(u64::MAX, |(.., apart)| (apart * 1e6) as u64);
            }
            order.retain(|(rank, _)| *rank != u64::MAX);
            order.sort_unstable();
        }
        self.order = order;
    }

    /// Makes a region the candidate. Returns its rotations, their number, and the difference of its extents from the outline's.
    fn take(&mut self, region: usize) -> Option<([f64; MAX_TURNS], usize, f64)> {
        let moments = self.components.sums(&self.runs, region).central()?;
        let of_region = |c: &&Contour| !c.hole && c.region as usize == region;
        let contour = self.contours.as_slice().iter().find(of_region).copied()?;
        self.candidate.set(&moments, self.contours.points(&contour), contour.area_px2);
        let mut turns = [0.0; MAX_TURNS];
        let (count, apart) = self.candidate.turns(&self.outline, &mut turns);
        (count > 0).then_some((turns, count, apart))
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

    /// Fits the outline to one region; an error where it fits in two ways.
    fn region(&mut self, image: &ImageView<'_>, region: usize) -> Result<Option<FittedShape>, ()> {
        if self.ellipse {
            return Ok(self.oval(image, region));
        }
        let Some((turns, count, _)) = self.take(region) else { return Ok(None) };
        let mut best: Option<Fitted<8, Projective>> = None;
        let mut second = f64::INFINITY;
        for turn in turns.iter().take(count) {
            if self.spent() {
                break;
            }
            let Some(start) = self.candidate.settle(&self.camera, &self.outline, *turn) else { continue };
            self.aligned += 1;
            let rise = self.rise();
            let fitted = self.fitter.fit(image, &self.camera, &self.outline, start, REACH_PX, rise);
            let good = |f: &Fitted<8, Projective>| self.is_good(&FittedShape::Polygon(*f), SEEN);
            let Some(fitted) = fitted.filter(good) else { continue };
            if !self.has_area(&FittedShape::Polygon(fitted), self.candidate.area_px2)
                || !self.is_told(&fitted.evidence)
                || !self.has_corners(image, &fitted)
            {
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

    /// Fits an ellipse to one region, starting from its moments.
    fn oval(&mut self, image: &ImageView<'_>, region: usize) -> Option<FittedShape> {
        let component = self.components.as_slice().get(region).copied()?;
        let m = self.components.sums(&self.runs, region).central()?.of_squares();
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
        // the area of a circle by so many corners is short of it by a ten-thousandth: it follows from (2 pi / 256)^2 / 6
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
