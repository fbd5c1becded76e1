//! Ellipses in a frame, and one tracked near its predicted place.
//!
//! ```text
//! whole frame:  edges -> chains -> arcs that an ellipse explains -> rim of that ellipse
//! tracking:     rim of the predicted ellipse
//! rim:          scans of rows and columns across it -> robust fit -> again, until it stands
//! ```
//! Whatever covers the rim (glare, an occluder, the frame's edge) costs the scans there, no more: the rest decides. Scans share no
//! pixels, so the covariance is that of their noise, which the scans measure themselves. What blur does to a curved rim is taken
//! out: the chord of row `y` is seen longer by `s^2 x''(y) / 2` for a blur of variance `s^2`, which the scans tell too.
//!
//! All positions are pixels of the distorted image, pixel centres integers.

use crate::imaging::{
    Chains, Crossing, EdgePixel, EdgePoint, EdgeScan, EdgeThresholds, Edges, Ellipse, EllipseFit, ImageView,
    ScanAxis,
};
use nalgebra::Vector2;
use thiserror::Error;

/// Scans of one rim: of greater ones every second line, or fewer.
const MOST_SCANS: usize = 600;
/// Fewest scans that make an ellipse.
const LEAST_SCANS: usize = 12;
/// Fits of one rim.
const ROUNDS: usize = 8;
/// Median of the scatter of a scan of noise 1: chi-square of four degrees of freedom.
const MEDIAN_SCATTER: f64 = 3.357;
/// Share of an edge's position that no noise explains: pixels are squares, levels are rounded; px.
const FLOOR_PX: f64 = 0.01;
/// Most that the rim's points may be off the ellipse, root mean square, px.
const MOST_RMS_PX: f64 = 0.5;
/// Fewest points of an arc.
const LEAST_ARC: usize = 16;
/// Points of an arc that are fitted.
const ARC_POINTS: usize = 48;

/// What counts as an ellipse.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EllipseSettings {
    /// What counts as an edge.
    pub thresholds: EdgeThresholds,
    /// Least half axis, px; below 5 px a rim cannot be scanned.
    pub least_axis_px: f64,
    /// Least share of the rim that is seen, 0..=1.
    pub least_share: f64,
    /// Least step across the rim, grey levels.
    pub least_step: f32,
    /// Light ellipses on dark ground, dark ones on light, or both.
    pub light: Option<bool>,
    /// Most ellipses of a frame.
    pub most: usize,
}

impl Default for EllipseSettings {
    fn default() -> Self {
        Self {
            thresholds: EdgeThresholds::default(),
            least_axis_px: 5.0,
            least_share: 0.4,
            least_step: 16.0,
            light: None,
            most: 64,
        }
    }
}

/// An ellipse, found and measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FoundEllipse {
    /// Centre, shape and their covariance.
    pub fit: EllipseFit,
    /// Whether it is lighter than its ground.
    pub light: bool,
    /// Share of the rim that was seen and lies on the ellipse, 0..=1.
    pub share: f64,
    /// Standard deviation of the noise beside the rim, grey levels.
    pub noise_levels: f64,
    /// Standard deviation of the blur of the rim, px, with the pixel's own.
    pub blur_px: f64,
}

/// Why there is no ellipse.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum EllipseMiss {
    /// No edge is strong enough: no light, no contrast, out of focus.
    #[error("no edges in the frame")]
    NoEdges,
    /// More edges than the buffers take: noise or a fine texture.
    #[error("too many edges in the frame: noise or texture")]
    TooManyEdges,
    /// There are edges, but none bends like an ellipse of the wanted size.
    #[error("no edge bends like an ellipse")]
    NoArc,
    /// Too little of a rim is seen: covered, out of the frame, or not there.
    #[error("too little of the rim is seen")]
    Hidden,
    /// What was found is not of the wanted size, or far from an ellipse.
    #[error("the rim is no ellipse of the wanted size")]
    NoEllipse,
}

/// Finds ellipses. Owns its buffers: nothing is allocated once the largest frame has been seen.
#[derive(Debug, Clone)]
pub struct EllipseFinder {
    settings: EllipseSettings,
    edges: Edges,
    chains: Chains,
    scans: Vec<RimScan>,
    points: Vec<EdgePoint>,
    values: Vec<f64>,
    ranges: Vec<(usize, usize)>,
}

/// One scan across a rim.
#[derive(Debug, Clone, Copy)]
struct RimScan {
    axis: ScanAxis,
    line: f64,
    /// Whether it is the second of the line's two crossings.
    second: bool,
    /// Amount of the rim's normal along the scan.
    along: f64,
    crossing: Crossing,
}

impl EllipseFinder {
    /// A finder for frames of at most `width x height` px.
    #[must_use]
    pub fn new(width: usize, height: usize, settings: EllipseSettings) -> Self {
        Self {
            settings,
            edges: Edges::with_limit((width.saturating_mul(height) / 8).clamp(4096, 1 << 21)),
            chains: Chains::default(),
            scans: Vec::with_capacity(MOST_SCANS),
            points: Vec::with_capacity(MOST_SCANS),
            values: Vec::with_capacity(MOST_SCANS),
            ranges: Vec::with_capacity(64),
        }
    }

    /// Searches the whole frame: fills `found`, the largest first.
    ///
    /// # Errors
    /// Why there is none; `found` is then empty.
    pub fn search(
        &mut self,
        image: &ImageView<'_>,
        found: &mut Vec<FoundEllipse>,
    ) -> Result<(), EllipseMiss> {
        found.clear();
        self.edges.find(image, &self.settings.thresholds);
        if self.edges.overflowed() {
            return Err(EllipseMiss::TooManyEdges);
        }
        self.chains.link(&self.edges, LEAST_ARC);
        if self.edges.pixels().is_empty() {
            return Err(EllipseMiss::NoEdges);
        }
        let chains = std::mem::take(&mut self.chains);
        let mut miss = EllipseMiss::NoArc;
        for chain in chains.as_slice() {
            self.search_chain(image, chains.of(chain), found, &mut miss);
        }
        self.chains = chains;
        if found.is_empty() {
            return Err(miss);
        }
        let area = |e: &FoundEllipse| e.fit.ellipse.axes_px().0 * e.fit.ellipse.axes_px().1;
        found.sort_unstable_by(|a, b| area(b).total_cmp(&area(a)));
        Ok(())
    }

    /// Measures the ellipse that is predicted within `slack_px` (centre and rim).
    ///
    /// # Errors
    /// Why it is not there.
    pub fn track(
        &mut self,
        image: &ImageView<'_>,
        expected: &Ellipse,
        light: bool,
        slack_px: f64,
    ) -> Result<FoundEllipse, EllipseMiss> {
        self.measure(image, expected, light, slack_px)
    }

    /// The ellipses of one chain: of all of it, or of its halves, and theirs.
    fn search_chain(
        &mut self,
        image: &ImageView<'_>,
        points: &[EdgePixel],
        found: &mut Vec<FoundEllipse>,
        miss: &mut EllipseMiss,
    ) {
        self.ranges.clear();
        self.ranges.push((0, points.len()));
        while let Some((from, to)) = self.ranges.pop() {
            let Some(arc) = points.get(from..to) else { return };
            if found.len() >= self.settings.most || arc.len() < LEAST_ARC {
                continue;
            }
            // on an ellipse that is known nothing new begins
            let known = |e: &FoundEllipse| {
                let on = |p: &EdgePixel| {
                    e.fit.ellipse.distance_px(&Vector2::new(f64::from(p.x_px), f64::from(p.y_px))).abs() < 1.5
                };
                arc.iter().step_by(4).filter(|p| on(p)).count() * 5 >= arc.len().div_ceil(4) * 4
            };
            if found.iter().any(known) {
                continue;
            }
            match self.of_arc(image, arc) {
                Ok(ellipse) => {
                    if !found.iter().any(|other| same(&other.fit.ellipse, &ellipse.fit.ellipse)) {
                        found.push(ellipse);
                    }
                    continue;
                }
                Err(why) if why != EllipseMiss::NoArc => *miss = why,
                Err(_) => {}
            }
            let middle = from + arc.len() / 2;
            self.ranges.push((middle, to));
            self.ranges.push((from, middle));
        }
    }

    /// The ellipse that an arc is part of.
    fn of_arc(&mut self, image: &ImageView<'_>, arc: &[EdgePixel]) -> Result<FoundEllipse, EllipseMiss> {
        let step = arc.len().div_ceil(ARC_POINTS).max(1);
        self.points.clear();
        let point = |p: &EdgePixel| EdgePoint {
            px: Vector2::new(f64::from(p.x_px), f64::from(p.y_px)),
            sigma_px: 0.15,
        };
        self.points.extend(arc.iter().step_by(step).map(point));
        let start = Ellipse::fit_direct(&self.points).ok_or(EllipseMiss::NoArc)?;
        let (a, b) = start.axes_px();
        let size = (image.width() + image.height()) as f64;
        if b < 0.8 * self.settings.least_axis_px || a > size {
            return Err(EllipseMiss::NoArc);
        }
        let (mut near, mut inward) = (0, 0i32);
        for (p, point) in arc.iter().step_by(step).zip(&self.points) {
            near += usize::from(start.distance_px(&point.px).abs() < 1.0);
            let d = start.centre_px - point.px;
            inward += if d.x * f64::from(p.dx) + d.y * f64::from(p.dy) > 0.0 { 1 } else { -1 };
        }
        let light = inward > 0;
        if 4 * near < 3 * self.points.len() || self.settings.light.is_some_and(|wanted| wanted != light) {
            return Err(EllipseMiss::NoArc);
        }
        self.measure(image, &start, light, 2.0)
    }

    /// Scans the rim of `start`, fits, and scans again.
    fn measure(
        &mut self,
        image: &ImageView<'_>,
        start: &Ellipse,
        light: bool,
        slack_px: f64,
    ) -> Result<FoundEllipse, EllipseMiss> {
        let mut ellipse = *start;
        let mut scan = EdgeScan {
            half_px: if start.axes_px().1 < 8.0 { 1 } else { 2 },
            search_px: (slack_px.clamp(0.0, 60.0).ceil() as usize) + 2,
            least_step: self.settings.least_step,
        };
        let mut best = Err(EllipseMiss::Hidden);
        for round in 0..ROUNDS {
            if !self.plausible(&ellipse, image) {
                return Err(EllipseMiss::NoEllipse);
            }
            let all = self.scan(image, &ellipse, light, &scan);
            if self.scans.len() < LEAST_SCANS {
                return Err(EllipseMiss::Hidden);
            }
            let noise2 = self.median(|s| s.crossing.scatter).max(0.25) / MEDIAN_SCATTER;
            let blur_px2 = self.median(|s| s.crossing.blur_px2 * s.along * s.along).clamp(0.05, 16.0);
            self.collect(&ellipse, noise2, blur_px2);
            let fit =
                if scan.search_px > 3 { Ellipse::fit(&self.points) } else { ellipse.refine(&self.points) };
            let fit = fit.ok_or(EllipseMiss::NoEllipse)?;
            let share = fit.used as f64 / all.max(1) as f64;
            let moved = (fit.ellipse.centre_px - ellipse.centre_px).norm()
                + (fit.ellipse.axes_px().0 - ellipse.axes_px().0).abs()
                + (fit.ellipse.axes_px().1 - ellipse.axes_px().1).abs();
            ellipse = fit.ellipse;
            best =
                Ok(FoundEllipse { fit, light, share, noise_levels: noise2.sqrt(), blur_px: blur_px2.sqrt() });
            if moved < 0.02 && round > 0 {
                break;
            }
            scan.search_px = if moved > 2.0 { 4 } else { 1 };
            // wide enough for the blur, as far as the ellipse has room
            let room = ((0.5 * ellipse.axes_px().1) as usize).saturating_sub(2).clamp(1, 8);
            scan.half_px = ((2.5 * blur_px2.sqrt() - 0.2).ceil() as usize).clamp(1, room);
        }
        let found = best?;
        let (_, b) = found.fit.ellipse.axes_px();
        if found.share < self.settings.least_share {
            return Err(EllipseMiss::Hidden);
        }
        // what is drawn without grey levels has steps of half a pixel
        let sigma2 =
            self.points.iter().map(|p| p.sigma_px * p.sigma_px).sum::<f64>() / self.points.len() as f64;
        if b < self.settings.least_axis_px || !(found.fit.chi2 * sigma2 < MOST_RMS_PX * MOST_RMS_PX) {
            return Err(EllipseMiss::NoEllipse);
        }
        Ok(found)
    }

    fn plausible(&self, ellipse: &Ellipse, image: &ImageView<'_>) -> bool {
        let (a, b) = ellipse.axes_px();
        let size = (image.width() + image.height()) as f64;
        ellipse.is_real()
            && b >= 0.7 * self.settings.least_axis_px
            && a <= size
            && ellipse.centre_px.norm() < 4.0 * size
    }

    /// Fills `scans`; the number of lines that cross the rim, in the image or not.
    fn scan(&mut self, image: &ImageView<'_>, ellipse: &Ellipse, light: bool, scan: &EdgeScan) -> usize {
        self.scans.clear();
        let mut all = 0;
        let [xx, _, yy] = ellipse.shape_px2;
        let lines = 2.9 * (xx.sqrt() + yy.sqrt());
        let step = (lines / MOST_SCANS as f64).ceil().max(1.0) as usize;
        for (axis, middle, half) in [
            (ScanAxis::Row, ellipse.centre_px.y, yy.sqrt()),
            (ScanAxis::Column, ellipse.centre_px.x, xx.sqrt()),
        ] {
            let row = axis == ScanAxis::Row;
            for line in ((middle - half).ceil() as i64..=(middle + half).floor() as i64).step_by(step) {
                let Some(places) = ellipse.crossings(line as f64, row) else { continue };
                for (second, place) in [(false, places[0]), (true, places[1])] {
                    let px =
                        if row { Vector2::new(place, line as f64) } else { Vector2::new(line as f64, place) };
                    let normal = ellipse.normal_at(&px);
                    let along = if row { normal.x } else { normal.y }.abs();
                    // each point of the rim is scanned along the axis that lies closer to its normal
                    if along * along < 0.5 || self.scans.len() >= MOST_SCANS {
                        continue;
                    }
                    all += 1;
                    let crossing = scan.cross(image, axis, line, place, light != second);
                    let new = |crossing| RimScan { axis, line: line as f64, second, along, crossing };
                    self.scans.extend(crossing.map(new));
                }
            }
        }
        all
    }

    /// Points from the scans, for noise of variance `noise2` and a blur of variance `blur_px2`.
    fn collect(&mut self, ellipse: &Ellipse, noise2: f64, blur_px2: f64) {
        self.points.clear();
        for scan in &self.scans {
            let row = scan.axis == ScanAxis::Row;
            let bend = ellipse.bend(scan.line, row) * if scan.second { 1.0 } else { -1.0 };
            let shift = 0.5 * blur_px2 * bend;
            // at the ends of an axis, where the formula does not hold, there are no scans
            let place = scan.crossing.position_px - shift.clamp(-0.5, 0.5);
            let sigma = scan.crossing.sigma_px_per_level * noise2.sqrt();
            let px = if row { Vector2::new(place, scan.line) } else { Vector2::new(scan.line, place) };
            self.points.push(EdgePoint { px, sigma_px: sigma.hypot(FLOOR_PX) * scan.along });
        }
    }

    fn median(&mut self, value: impl Fn(&RimScan) -> f64) -> f64 {
        self.values.clear();
        self.values.extend(self.scans.iter().map(value));
        let middle = self.values.len() / 2;
        if self.values.is_empty() {
            return 0.0;
        }
        *self.values.select_nth_unstable_by(middle, f64::total_cmp).1
    }
}

/// Whether two ellipses are one.
fn same(a: &Ellipse, b: &Ellipse) -> bool {
    let ((a1, a2), (b1, b2)) = (a.axes_px(), b.axes_px());
    let near = (a.centre_px - b.centre_px).norm() < 0.2 * a2.min(b2);
    near && (a1 / b1 - 1.0).abs() < 0.15 && (a2 / b2 - 1.0).abs() < 0.15
}

#[cfg(test)]
mod tests;
