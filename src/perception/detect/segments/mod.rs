//! Detection of the straight segments of a frame, and tracking of one near its prediction.
//!
//! ```text
//! whole frame:  edges -> chains -> parts within a pixel of their chord -> rim of that segment
//! tracking:     rim of the predicted segment
//! rim:          scans of the rows (or columns) across it -> robust line -> again, on beyond both ends -> ends
//! ```
//! Each row or column is scanned once, so that errors of the points are independent and the line's covariance is that of the noise
//! that the scans measure too. A segment is described by its ends, or by midpoint, length and orientation (Sect. 10.2.2).
//!
//! All positions are pixels of the distorted image, pixel centres integers.

mod segment;

use crate::imaging::{
    Chains, Crossing, EdgePixel, EdgePoint, EdgeScan, EdgeThresholds, Edges, ImageView, Line, ScanAxis,
};
use nalgebra::Vector2;
pub use segment::Segment;
use thiserror::Error;

/// Scans of one segment; longer ones are scanned in every second line, or fewer. Chosen by hand: errors fall with their root, time grows with them.
const MAX_SCANS: usize = 1024;
/// Median of the scatter of a scan of noise 1: chi-square of four degrees of freedom.
const MEDIAN_SCATTER: f64 = 3.357;
/// Share of an edge's position that no noise explains, px. Chosen by hand: rounding of levels and square pixels, which along a straight edge
/// differ from scan to scan; without it, images without noise would state nothing.
const FLOOR_PX: f64 = 0.004;
/// Lines in a row without edge that end a segment. Chosen by hand: a speck takes one or two; with twice as many, segments in line become one.
const GAP: usize = 3;
/// Distance of a point of a chain from its chord from which on the chain is divided there, px. Chosen by hand: the pixels of a straight chain lie within a
/// pixel of the line; half divides noisy edges, the double takes slightly curved ones for segments.
const STRAIGHT_PX: f64 = 1.0;
/// An edge's point this far from the line is not on the segment, px; or five of its deviations. Chosen by hand: a slightly bent edge stays one,
/// and half of it breaks those up.
const BESIDE_PX: f64 = 0.6;
/// How far beyond the last scan an end may lie, px: near a corner no scan has room. Derived: a scan takes five pixels on either side of the
/// edge, which at 45 degrees are seven along it.
const END_REACH_PX: f64 = 8.0;

/// Which segments are detected.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SegmentSettings {
    /// Thresholds of edge detection.
    pub thresholds: EdgeThresholds,
    /// Least length, px, at least 8.
    pub min_length_px: f64,
    /// Least step across the edge, grey levels.
    pub min_step: f32,
    /// Pixels over which the edge spreads on either side of its middle, see [`EdgeScan::half_px`].
    pub half_px: usize,
    /// Most segments of a frame.
    pub max_count: usize,
}

impl Default for SegmentSettings {
    fn default() -> Self {
        Self {
            thresholds: EdgeThresholds::default(),
            min_length_px: 20.0,
            min_step: 12.0,
            half_px: 2,
            max_count: 256,
        }
    }
}

/// Why no segment was detected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum SegmentMiss {
    /// No edge is strong enough: no light, no contrast, out of focus.
    #[error("no edges in the frame")]
    NoEdges,
    /// More edges than the buffers take: noise or a fine texture.
    #[error("too many edges in the frame: noise or texture")]
    TooManyEdges,
    /// No edge is straight over the requested length.
    #[error("no edge is straight over the wanted length")]
    NoneStraight,
    /// The predicted segment is outside of the frame.
    #[error("the predicted segment is outside of the frame")]
    Outside,
    /// Near the prediction there is no straight edge with the light on that side.
    #[error("no straight edge where the segment is predicted")]
    Lost,
}

/// Finder of segments. Owns its buffers: nothing is allocated after the largest frame.
#[derive(Debug, Clone)]
pub struct SegmentFinder {
    settings: SegmentSettings,
    edges: Edges,
    chains: Chains,
    scans: Vec<(i64, Crossing)>,
    points: Vec<EdgePoint>,
    values: Vec<f64>,
    ranges: Vec<(usize, usize)>,
}

impl SegmentFinder {
    /// A finder for frames of at most `width x height` px.
    #[must_use]
    pub fn new(width: usize, height: usize, settings: SegmentSettings) -> Self {
        Self {
            settings,
            edges: Edges::with_limit((width.saturating_mul(height) / 8).clamp(4096, 1 << 21)),
            chains: Chains::default(),
            scans: Vec::with_capacity(MAX_SCANS),
            points: Vec::with_capacity(MAX_SCANS),
            values: Vec::with_capacity(MAX_SCANS),
            ranges: Vec::with_capacity(64),
        }
    }

    /// Searches the whole frame: fills `found`, the longest first.
    ///
    /// # Errors
    /// Why there is none; `found` is then empty.
    pub fn search(&mut self, image: &ImageView<'_>, found: &mut Vec<Segment>) -> Result<(), SegmentMiss> {
        found.clear();
        self.edges.find(image, &self.settings.thresholds);
        if self.edges.overflowed() {
            return Err(SegmentMiss::TooManyEdges);
        }
        if self.edges.pixels().is_empty() {
            return Err(SegmentMiss::NoEdges);
        }
        // chosen by hand: with fewer scans of 0.1 px a direction is off by a degree and more
        let min_px = self.settings.min_length_px.max(8.0);
        self.chains.link(&self.edges, (0.7 * min_px) as usize);
        let chains = std::mem::take(&mut self.chains);
        for chain in chains.as_slice() {
            let points = chains.of(chain);
            self.ranges.clear();
            self.ranges.push((0, points.len()));
            while let Some((from, to)) = self.ranges.pop() {
                let Some(part) = points.get(from..to) else { break };
                let Some((at, length)) = divide(part) else { continue };
                if let Some(at) = at {
                    self.ranges.push((from + at, to));
                    self.ranges.push((from, from + at + 1));
                } else if length >= min_px && found.len() < self.settings.max_count {
                    found.extend(self.of_part(image, part, found));
                }
            }
        }
        self.chains = chains;
        found.sort_unstable_by(|a, b| b.length_px().total_cmp(&a.length_px()));
        if found.is_empty() { Err(SegmentMiss::NoneStraight) } else { Ok(()) }
    }

    /// Tracks the segment near a prediction whose ends are within `slack_px`.
    ///
    /// # Errors
    /// Why it was not detected.
    pub fn track(
        &mut self,
        image: &ImageView<'_>,
        expected: &Segment,
        slack_px: f64,
    ) -> Result<Segment, SegmentMiss> {
        let (slack, size) =
            (slack_px.clamp(0.0, 60.0), Vector2::new(image.width() as f64, image.height() as f64));
        let d = expected.ends_px[1] - expected.ends_px[0];
        let (low, high) =
            (expected.ends_px[0].inf(&expected.ends_px[1]), expected.ends_px[0].sup(&expected.ends_px[1]));
        // negated: numbers that are none are outside too
        let inside = high.x > -slack && high.y > -slack && low.x < size.x + slack && low.y < size.y + slack;
        if !(inside && d.norm() > 0.0 && d.norm().is_finite()) {
            return Err(SegmentMiss::Outside);
        }
        self.measure(image, expected.ends_px, slack + 2.0, slack + 8.0).ok_or(SegmentMiss::Lost)
    }

    /// The segment along a straight part of a chain, unless it is one of those that are known.
    fn of_part(&mut self, image: &ImageView<'_>, part: &[EdgePixel], known: &[Segment]) -> Option<Segment> {
        let px = |p: &EdgePixel| Vector2::new(f64::from(p.x_px), f64::from(p.y_px));
        let (a, b) = (px(part.first()?), px(part.last()?));
        let segment = self.measure(image, [a, b], 2.0, 4.0)?;
        let middle = segment.midpoint_px();
        let along = segment.ends_px[1] - segment.ends_px[0];
        let same = |other: &Segment| {
            let t = (other.ends_px[1] - other.ends_px[0]).normalize();
            let at = t.dot(&(middle - other.ends_px[0]));
            other.line.distance_px(&middle).abs() < 1.0
                && at > 0.0
                && at < other.length_px()
                // chosen by hand: 26 degrees, when the middles are within a pixel of the other's line
                && t.dot(&along) > 0.9 * along.norm()
        };
        (!known.iter().any(same)).then_some(segment)
    }

    /// Scans across the segment between these ends, within `search_px`; the result may reach `beyond_px` farther.
    fn measure(
        &mut self,
        image: &ImageView<'_>,
        ends_px: [Vector2<f64>; 2],
        search_px: f64,
        beyond_px: f64,
    ) -> Option<Segment> {
        let expected = Segment::expected(ends_px)?;
        let mut line = expected.line;
        let mut ends = ends_px;
        let mut search = search_px.ceil() as usize;
        let mut known = false;
        let mut result = None;
        for _ in 0..3 {
            let found = self.measure_once(image, &line, ends, known, search, beyond_px)?;
            (line, ends, known) = (found.line, found.ends_px, true);
            search = 1;
            result = Some(found);
        }
        result.filter(|s: &Segment| {
            // chosen by hand: more than half of it is edge, and each end may have lost a pixel
            s.share > 0.6 && s.length_px() >= self.settings.min_length_px.max(8.0) - 2.0
        })
    }

    /// One round: scans, line, ends.
    fn measure_once(
        &mut self,
        image: &ImageView<'_>,
        predicted: &Line,
        ends_px: [Vector2<f64>; 2],
        ends_known: bool,
        search_px: usize,
        beyond_px: f64,
    ) -> Option<Segment> {
        let normal = predicted.normal();
        let row = normal.x.abs() >= normal.y.abs();
        let (axis, along_scan, across_scan) =
            if row { (ScanAxis::Row, normal.x, normal.y) } else { (ScanAxis::Column, normal.y, normal.x) };
        let coordinate = |p: &Vector2<f64>| if row { p.y } else { p.x };
        let lines = if row { image.height() } else { image.width() } as f64;
        let (a, b) = (coordinate(&ends_px[0]), coordinate(&ends_px[1]));
        let low = (a.min(b) - beyond_px).max(0.0).ceil() as i64;
        let high = (a.max(b) + beyond_px).min(lines - 1.0).floor() as i64;
        let step = (high.saturating_sub(low) / MAX_SCANS as i64 + 1).max(1);
        let scan = EdgeScan { half_px: self.settings.half_px, search_px, min_step: self.settings.min_step };
        let middle = predicted.px;
        self.scans.clear();
        for y in (low..=high).step_by(step as usize) {
            let d = y as f64 - coordinate(&middle);
            let place = if row { middle.x } else { middle.y } - across_scan / along_scan * d;
            let crossing = scan.cross(image, axis, y, place, along_scan > 0.0);
            self.scans.extend(crossing.map(|c| (y, c)));
        }
        // derived: rounding to whole levels alone has a variance of 1 / 12, which 0.25 is over the median
        let noise = (self.median(|c| c.scatter).max(0.25) / MEDIAN_SCATTER).sqrt();
        self.points.clear();
        let point = |&(y, ref c): &(i64, Crossing)| {
            let sd = (c.sd_px_per_level * noise).hypot(FLOOR_PX) * along_scan.abs();
            let (at, y) = (c.position_px, y as f64);
            EdgePoint { px: if row { Vector2::new(at, y) } else { Vector2::new(y, at) }, sd_px: sd }
        };
        // the line from what lies between the ends: once they are known, without the scans that reach around a corner
        let reach =
            if ends_known { (scan.half_px + 3) as f64 * (normal.x * normal.y).abs() + 2.0 } else { -1.0 };
        let reach = reach.min(0.2 * (b - a).abs()); // chosen by hand: three fifths of it must remain
        let between =
            |&&(y, _): &&(i64, Crossing)| (y as f64) > a.min(b) + reach && (y as f64) < a.max(b) - reach;
        self.points.extend(self.scans.iter().filter(between).map(point));
        let mut line = Line::fit(&self.points)?;
        // the normal towards the light
        if line.normal().dot(&normal) < 0.0 {
            line.normal_rad += std::f64::consts::PI;
        }
        // chosen by hand: 37 degrees off is another edge, and rows and columns would change places
        if line.normal().dot(&normal) < 0.8 {
            return None;
        }
        let on = |scan: &(i64, Crossing)| {
            let p = point(scan);
            // of normal errors none is five deviations off by chance: derived, 6e-7
            line.distance_px(&p.px).abs() < BESIDE_PX.max(5.0 * p.sd_px)
        };
        let (first, last) = longest(&self.scans, GAP as i64 * step, on)?;
        let (y0, y1) = (first as f64, last as f64);
        let count = self.scans.iter().filter(|s| s.0 >= first && s.0 <= last && on(s)).count();
        let share = count as f64 / ((last - first) / step + 1) as f64;
        let n = line.normal();
        let foot = |y: f64| {
            let d = y - coordinate(&line.px);
            let (along, across) = if row { (n.x, n.y) } else { (n.y, n.x) };
            let at = if row { line.px.x } else { line.px.y } - across / along * d;
            if row { Vector2::new(at, y) } else { Vector2::new(y, at) }
        };
        let mut ends_px = [foot(y0), foot(y1)];
        // the light on the right: the normal is the direction turned from x towards y
        let d = ends_px[1] - ends_px[0];
        if n.x * -d.y + n.y * d.x < 0.0 {
            ends_px.swap(0, 1);
        }
        let step_levels = self.median(|c| (c.behind - c.before).abs());
        let along = (ends_px[1] - ends_px[0]).try_normalize(0.0)?;
        ends_px[0] = end(image, &ends_px[0], &-along, &n, step_levels);
        ends_px[1] = end(image, &ends_px[1], &along, &n, step_levels);
        Some(Segment { ends_px, line, step_levels, noise_levels: noise, share })
    }

    fn median(&mut self, value: impl Fn(&Crossing) -> f64) -> f64 {
        self.values.clear();
        self.values.extend(self.scans.iter().map(|(_, c)| value(c)));
        let middle = self.values.len() / 2;
        if self.values.is_empty() {
            return 0.0;
        }
        *self.values.select_nth_unstable_by(middle, f64::total_cmp).1
    }
}

/// Where the difference across the edge falls below half of its step, going on from a point of the edge.
fn end(
    image: &ImageView<'_>,
    from: &Vector2<f64>,
    along: &Vector2<f64>,
    normal: &Vector2<f64>,
    step: f64,
) -> Vector2<f64> {
    let at = |s: f64| {
        let p = from + along * s;
        Some(bilinear(image, &(p + normal * 1.5))? - bilinear(image, &(p - normal * 1.5))? - 0.5 * step)
    };
    let (mut s, mut before) = (0.0, at(0.0).unwrap_or(-1.0));
    while before > 0.0 && s < END_REACH_PX {
        let Some(now) = at(s + 0.5) else { break };
        if now <= 0.0 {
            s += 0.5 * before / (before - now);
            break;
        }
        (s, before) = (s + 0.5, now);
    }
    from + along * s
}

/// Bilinearly interpolated level; `None` outside of the pixels' centres.
fn bilinear(image: &ImageView<'_>, p: &Vector2<f64>) -> Option<f64> {
    // beyond any image, so that the next pixel's place does not overflow
    if !(p.x >= 0.0 && p.y >= 0.0 && p.x < 1e9 && p.y < 1e9) {
        return None;
    }
    let (x, y) = (p.x as usize, p.y as usize);
    let (u, v) = (p.x - x as f64, p.y - y as f64);
    let at = |x: usize, y: usize| image.row(y).get(x).map(|&l| f64::from(l));
    let above = at(x, y)? * (1.0 - u) + at(x + 1, y)? * u;
    let below = at(x, y + 1)? * (1.0 - u) + at(x + 1, y + 1)? * u;
    Some(above * (1.0 - v) + below * v)
}

/// First and last line of the longest run of scans on the line, with gaps of at most `gap` lines.
fn longest(scans: &[(i64, Crossing)], gap: i64, on: impl Fn(&(i64, Crossing)) -> bool) -> Option<(i64, i64)> {
    let mut best: Option<(i64, i64)> = None;
    let mut run: Option<(i64, i64)> = None;
    for scan in scans.iter().filter(|s| on(s)) {
        run = match run {
            Some((first, last)) if scan.0 - last <= gap => Some((first, scan.0)),
            _ => Some((scan.0, scan.0)),
        };
        if let (Some((a, b)), longest) = (run, best.map_or(-1, |(a, b)| b - a))
            && b - a > longest
        {
            best = run;
        }
    }
    best
}

/// Where to divide a chain, if it is not straight, and the length of its chord, px. `None` for less than two points.
fn divide(points: &[EdgePixel]) -> Option<(Option<usize>, f64)> {
    let px = |p: &EdgePixel| Vector2::new(f64::from(p.x_px), f64::from(p.y_px));
    let (a, b) = (px(points.first()?), px(points.last()?));
    if points.len() < 3 {
        return None;
    }
    let d = b - a;
    let length = d.norm();
    // a closed chain has no chord: the point farthest from its start
    let distance = |p: &Vector2<f64>| {
        if length > 2.0 { (d.x * (p.y - a.y) - d.y * (p.x - a.x)).abs() / length } else { (p - a).norm() }
    };
    let (mut worst, mut at) = (STRAIGHT_PX, None);
    for (i, p) in points.iter().enumerate().skip(1).take(points.len() - 2) {
        let off = distance(&px(p));
        if off > worst {
            (worst, at) = (off, Some(i));
        }
    }
    Some((at, length))
}

#[cfg(test)]
mod tests;
