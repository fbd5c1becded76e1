//! Detection of the ellipses of a frame, and tracking of one near its prediction.
//!
//! ```text
//! whole frame:  edges -> chains -> arcs that an ellipse explains -> rim of that ellipse
//! tracking:     rim of the predicted ellipse
//! rim:          scans of rows and columns across it -> robust fit -> again, until it converges
//! ```
//! Where something hides the rim (glare, an occluder, the frame's edge) only the scans there are lost: the fit uses the others. Scans share no
//! pixels, so the covariance follows from their noise, which the scans measure too. The bias of a curved rim by blur is
//! corrected: the chord of row `y` appears longer by `s^2 x''(y) / 2` for a blur of variance `s^2`, which the scans also measure.
//!
//! All positions are pixels of the distorted image, pixel centres integers.

mod rim;

use crate::imaging::{Chains, EdgePixel, EdgePoint, EdgeThresholds, Edges, Ellipse, EllipseFit, ImageView};
use nalgebra::Vector2;
pub(super) use rim::RimMeter;
use thiserror::Error;

/// Fewest points of an arc. Chosen by hand: half the rim of the smallest ellipse, 31 px; of shorter ones the bend is that of noise.
const MIN_ARC: usize = 16;
/// Points of an arc that are fitted. Chosen by hand: ten for each number of an ellipse; it is only where scans of the rim begin, and twice as many
/// take twice the time.
const ARC_POINTS: usize = 48;

/// Which ellipses are detected.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EllipseSettings {
    /// Thresholds of edge detection.
    pub thresholds: EdgeThresholds,
    /// Least half axis, px; below 5 px a rim cannot be scanned.
    pub min_axis_px: f64,
    /// Least visible share of the rim, 0..=1.
    pub min_share: f64,
    /// Least step across the rim, grey levels.
    pub min_step: f32,
    /// Light ellipses on dark ground, dark ones on light, or both.
    pub light: Option<bool>,
    /// Most ellipses of a frame.
    pub max_count: usize,
}

impl Default for EllipseSettings {
    fn default() -> Self {
        Self {
            thresholds: EdgeThresholds::default(),
            min_axis_px: 5.0,
            min_share: 0.4,
            min_step: 16.0,
            light: None,
            max_count: 64,
        }
    }
}

/// A detected ellipse.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EllipseDetection {
    /// Centre, shape and their covariance.
    pub fit: EllipseFit,
    /// Whether it is lighter than its ground.
    pub light: bool,
    /// Share of the rim that is visible and lies on the ellipse, 0..=1.
    pub share: f64,
    /// Standard deviation of the noise beside the rim, grey levels.
    pub noise_levels: f64,
    /// Standard deviation of the blur of the rim, px, with the pixel's own.
    pub blur_px: f64,
}

/// Why no ellipse was detected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum EllipseMiss {
    /// No edge is strong enough: no light, no contrast, out of focus.
    #[error("no edges in the frame")]
    NoEdges,
    /// More edges than the buffers take: noise or a fine texture.
    #[error("too many edges in the frame: noise or texture")]
    TooManyEdges,
    /// There are edges, but none is an arc of an ellipse of the requested size.
    #[error("no edge bends like an ellipse")]
    NoArc,
    /// Too little of a rim is visible: occluded, outside of the frame, or absent.
    #[error("too little of the rim is seen")]
    Hidden,
    /// What was found is not of the requested size, or far from an ellipse.
    #[error("the rim is no ellipse of the wanted size")]
    NoEllipse,
}

/// Finder of ellipses. Owns its buffers: nothing is allocated after the largest frame.
#[derive(Debug, Clone)]
pub struct EllipseFinder {
    settings: EllipseSettings,
    edges: Edges,
    chains: Chains,
    points: Vec<EdgePoint>,
    rim: RimMeter,
    ranges: Vec<(usize, usize)>,
}

impl EllipseFinder {
    /// A finder for frames of at most `width x height` px.
    #[must_use]
    pub fn new(width: usize, height: usize, settings: EllipseSettings) -> Self {
        Self {
            settings,
            edges: Edges::with_limit((width.saturating_mul(height) / 8).clamp(4096, 1 << 21)),
            chains: Chains::default(),
            points: Vec::with_capacity(ARC_POINTS),
            rim: RimMeter::new(&settings),
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
        found: &mut Vec<EllipseDetection>,
    ) -> Result<(), EllipseMiss> {
        found.clear();
        self.edges.find(image, &self.settings.thresholds);
        if self.edges.overflowed() {
            return Err(EllipseMiss::TooManyEdges);
        }
        self.chains.link(&self.edges, MIN_ARC);
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
        let area = |e: &EllipseDetection| e.fit.ellipse.axes_px().0 * e.fit.ellipse.axes_px().1;
        found.sort_unstable_by(|a, b| area(b).total_cmp(&area(a)));
        Ok(())
    }

    /// Tracks the ellipse near a prediction whose centre and rim are within `slack_px`.
    ///
    /// # Errors
    /// Why it was not detected.
    pub fn track(
        &mut self,
        image: &ImageView<'_>,
        expected: &Ellipse,
        light: bool,
        slack_px: f64,
    ) -> Result<EllipseDetection, EllipseMiss> {
        self.rim.measure(image, expected, light, slack_px)
    }

    /// The ellipses of one chain: of all of it, or of its halves, and theirs.
    fn search_chain(
        &mut self,
        image: &ImageView<'_>,
        points: &[EdgePixel],
        found: &mut Vec<EllipseDetection>,
        miss: &mut EllipseMiss,
    ) {
        self.ranges.clear();
        self.ranges.push((0, points.len()));
        while let Some((from, to)) = self.ranges.pop() {
            let Some(arc) = points.get(from..to) else { return };
            if found.len() >= self.settings.max_count || arc.len() < MIN_ARC {
                continue;
            }
            // on an ellipse that is known nothing new begins
            let known = |e: &EllipseDetection| {
                let on = |p: &EdgePixel| {
                    // chosen by hand: an edge's pixels lie within one pixel of it, half a pixel is for blur
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
    fn of_arc(&mut self, image: &ImageView<'_>, arc: &[EdgePixel]) -> Result<EllipseDetection, EllipseMiss> {
        let step = arc.len().div_ceil(ARC_POINTS).max(1);
        self.points.clear();
        let point =
            |p: &EdgePixel| EdgePoint { px: Vector2::new(f64::from(p.x_px), f64::from(p.y_px)), sd_px: 0.15 };
        self.points.extend(arc.iter().step_by(step).map(point));
        let start = Ellipse::fit_direct(&self.points).ok_or(EllipseMiss::NoArc)?;
        let (a, b) = start.axes_px();
        let size = (image.width() + image.height()) as f64;
        // chosen by hand: a fit to part of a rim may be off by a fifth; the rim's own decides in the end
        if b < 0.8 * self.settings.min_axis_px || a > size {
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
        self.rim.measure(image, &start, light, 2.0)
    }
}

/// Whether two ellipses are one: from two parts of one rim they are much nearer to each other than this, and two rims about one centre, as of
/// a ring, mostly further apart. Chosen by hand.
fn same(a: &Ellipse, b: &Ellipse) -> bool {
    let ((a1, a2), (b1, b2)) = (a.axes_px(), b.axes_px());
    let near = (a.centre_px - b.centre_px).norm() < 0.2 * a2.min(b2); // chosen by hand, as above
    // chosen by hand, as above: 0.15 is a ring whose line is a seventh of its radius
    near && (a1 / b1 - 1.0).abs() < 0.15 && (a2 / b2 - 1.0).abs() < 0.15
}

#[cfg(test)]
mod tests;
