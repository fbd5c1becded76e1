//! The rim of one ellipse: scans of rows and columns across it, a robust fit, and scans again, until it converges.

use super::{EllipseDetection, EllipseMiss, EllipseSettings};
use crate::imaging::{Crossing, EdgePoint, EdgeScan, Ellipse, ImageView, ScanAxis};
use nalgebra::Vector2;

/// Scans of one rim: of greater ones every second line, or fewer. Chosen by hand: errors fall with their root; twice as many take twice the time.
const MAX_SCANS: usize = 600;
/// Fewest scans that make an ellipse. Chosen by hand: five numbers, and seven scans that can contradict them.
const MIN_SCANS: usize = 12;
/// Fits of one rim. Chosen by hand, as a bound: a rim that moves less than 0.02 px ends them.
const ROUNDS: usize = 8;
/// Median of the scatter of a scan of noise 1: chi-square of four degrees of freedom.
const MEDIAN_SCATTER: f64 = 3.357;
/// Share of an edge's position that no noise explains: pixels are squares, levels are rounded; px. Chosen by hand: a sharp edge through square
/// pixels is off by some thousandths to hundredths; without it, images without noise would state nothing.
const FLOOR_PX: f64 = 0.01;
/// Largest root mean square distance of the rim's points from the ellipse, px. Chosen by hand: an ellipse without grey levels, thresholded, has 0.29; half
/// refuses those, the double takes rounded rectangles for ellipses.
const MAX_RMS_PX: f64 = 0.5;
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

/// Measures the rims of ellipses. Owns its buffers.
#[derive(Debug, Clone)]
pub(in crate::detect) struct RimMeter {
    min_axis_px: f64,
    min_share: f64,
    min_step: f32,
    scans: Vec<RimScan>,
    points: Vec<EdgePoint>,
    values: Vec<f64>,
}

impl RimMeter {
    /// A meter of rims of the settings' least size, share and step.
    pub(in crate::detect) fn new(settings: &EllipseSettings) -> Self {
        let EllipseSettings { min_axis_px, min_share, min_step, .. } = *settings;
        Self {
            min_axis_px,
            min_share,
            min_step,
            scans: Vec::with_capacity(MAX_SCANS),
            points: Vec::with_capacity(MAX_SCANS),
            values: Vec::with_capacity(MAX_SCANS),
        }
    }

    /// Scans the rim of `start`, fits, and scans again.
    pub(in crate::detect) fn measure(
        &mut self,
        image: &ImageView<'_>,
        start: &Ellipse,
        light: bool,
        slack_px: f64,
    ) -> Result<EllipseDetection, EllipseMiss> {
        let mut ellipse = *start;
        let mut scan = EdgeScan {
            // chosen by hand: with 2 a scan reaches five pixels inside, to the middle of the smallest rim
            half_px: if start.axes_px().1 < 8.0 { 1 } else { 2 },
            search_px: (slack_px.clamp(0.0, 60.0).ceil() as usize) + 2,
            min_step: self.min_step,
        };
        let mut best = Err(EllipseMiss::Hidden);
        for round in 0..ROUNDS {
            if !self.plausible(&ellipse, image) {
                return Err(EllipseMiss::NoEllipse);
            }
            let all = self.scan(image, &ellipse, light, &scan);
            if self.scans.len() < MIN_SCANS {
                return Err(EllipseMiss::Hidden);
            }
            // derived: rounding to whole levels alone has a variance of 1 / 12, which 0.25 is over the median
            let noise2 = self.median(|s| s.crossing.scatter).max(0.25) / MEDIAN_SCATTER;
            // the pixel's own is 1 / 12 px^2; the upper bound was chosen by hand: 4 px of blur
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
            best = Ok(EllipseDetection {
                fit,
                light,
                share,
                noise_levels: noise2.sqrt(),
                blur_px: blur_px2.sqrt(),
            });
            // chosen by hand: the next step would be a small part of it, below the floor
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
        if found.share < self.min_share {
            return Err(EllipseMiss::Hidden);
        }
        // what is drawn without grey levels has steps of half a pixel
        let sigma2 = self.points.iter().map(|p| p.sd_px * p.sd_px).sum::<f64>() / self.points.len() as f64;
        if b < self.min_axis_px || !(found.fit.chi2 * sigma2 < MAX_RMS_PX * MAX_RMS_PX) {
            return Err(EllipseMiss::NoEllipse);
        }
        Ok(found)
    }

    fn plausible(&self, ellipse: &Ellipse, image: &ImageView<'_>) -> bool {
        let (a, b) = ellipse.axes_px();
        let size = (image.width() + image.height()) as f64;
        // chosen by hand, wide: between rounds an ellipse may be a third too small, and of a large one only a part is visible
        ellipse.is_real() && b >= 0.7 * self.min_axis_px && a <= size && ellipse.centre_px.norm() < 4.0 * size
    }

    /// Fills `scans`; the number of lines that cross the rim, in the image or not.
    fn scan(&mut self, image: &ImageView<'_>, ellipse: &Ellipse, light: bool, scan: &EdgeScan) -> usize {
        self.scans.clear();
        let mut all = 0;
        let [xx, _, yy] = ellipse.shape_px2;
        let lines = 2.9 * (xx.sqrt() + yy.sqrt());
        let step = (lines / MAX_SCANS as f64).ceil().max(1.0) as usize;
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
                    if along * along < 0.5 || self.scans.len() >= MAX_SCANS {
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
            let sd = scan.crossing.sd_px_per_level * noise2.sqrt();
            let px = if row { Vector2::new(place, scan.line) } else { Vector2::new(scan.line, place) };
            self.points.push(EdgePoint { px, sd_px: sd.hypot(FLOOR_PX) * scan.along });
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
