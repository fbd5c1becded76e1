//! A segment and its descriptions (Sect. 10.2.2): ends, or midpoint, length and orientation.

use crate::imaging::Line;
use nalgebra::{Matrix2, Vector2};

/// Standard deviation of an end along the segment, px. Chosen by hand: ends are where a step falls to half, which corners and blur move by some
/// tenths; no study tells more.
const END_SD_PX: f64 = 0.7;

/// A segment of an edge. The lighter side is on the right, as the image is displayed, looking from the first end to the second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    /// Its ends, px.
    pub ends_px: [Vector2<f64>; 2],
    /// The line through it with its covariance; the normal points to the light.
    pub line: Line,
    /// Difference of the levels on both sides.
    pub step_levels: f64,
    /// Standard deviation of the noise on both sides, grey levels.
    pub noise_levels: f64,
    /// Share of the rows (or columns) between the ends that show the edge, 0..=1.
    pub share: f64,
}

impl Segment {
    /// A predicted segment between these ends (px), with the lighter side on the right looking from the first to the second. `None` where
    /// both coincide or are not finite.
    #[must_use]
    pub fn expected(ends_px: [Vector2<f64>; 2]) -> Option<Self> {
        let d = ends_px[1] - ends_px[0];
        let normal_rad = d.x.atan2(-d.y);
        let line = Line {
            px: (ends_px[0] + ends_px[1]) * 0.5,
            normal_rad,
            covariance: Matrix2::zeros(),
            chi2: 0.0,
            used: 0,
        };
        let some = d.norm() > 0.0 && d.norm().is_finite() && line.px.norm().is_finite();
        some.then_some(Self { ends_px, line, step_levels: 0.0, noise_levels: 0.0, share: 0.0 })
    }

    /// Midpoint, px.
    #[must_use]
    pub fn midpoint_px(&self) -> Vector2<f64> {
        (self.ends_px[0] + self.ends_px[1]) * 0.5
    }

    /// Length, px.
    #[must_use]
    pub fn length_px(&self) -> f64 {
        (self.ends_px[1] - self.ends_px[0]).norm()
    }

    /// Direction from the first end to the second, rad from x towards y.
    #[must_use]
    pub fn orientation_rad(&self) -> f64 {
        let d = self.ends_px[1] - self.ends_px[0];
        d.y.atan2(d.x)
    }

    /// Covariance of an end, px^2: across the segment that of the line, along it half of a pixel squared.
    #[must_use]
    pub fn end_covariance_px2(&self, end: usize) -> Matrix2<f64> {
        let n = self.line.normal();
        let along = Vector2::new(-n.y, n.x);
        let px = self.ends_px[usize::from(end != 0)];
        let across2 = self.line.sd_px(along.dot(&(px - self.line.px))).powi(2);
        n * n.transpose() * across2 + along * along.transpose() * END_SD_PX.powi(2)
    }
}
