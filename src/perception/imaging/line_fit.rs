//! A straight line through edge points: robust, with covariance.
//!
//! The line is given by a point on it, the weighted mean `p` of what lies on it, and the angle of its normal `n`: `n^T (x - p) = 0`.
//! It minimises the squared distances across the line over their variances, with Tukey's weights, so that points beside the line
//! count less and those far off not at all.

use crate::linalg::Random;
use nalgebra::{Matrix2, Vector2};

/// Tukey's constant: 95 % efficient for Gaussian errors (a standard number of robust statistics).
const TUKEY: f64 = 4.685;
/// Residual, in standard deviations, above which a point does not belong to the line. Chosen by hand: by noise alone one in 16 000 lies beyond 4.
const CUT: f64 = 4.0;

/// A point of an edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgePoint {
    /// Where, px.
    pub px: Vector2<f64>,
    /// One standard deviation across the edge, px.
    pub sd_px: f64,
}

/// A straight line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// A point on it, in the middle of what it was fitted to, px.
    pub px: Vector2<f64>,
    /// Direction of its normal, rad, from x towards y.
    pub normal_rad: f64,
    /// Covariance of the offset along the normal at `px` (px) and of `normal_rad` (rad).
    pub covariance: Matrix2<f64>,
    /// Squared residuals over their variances, per degree of freedom, of the points that were used: 1 when these are stated correctly.
    pub chi2: f64,
    /// Number of points on the line.
    pub used: usize,
}

impl Line {
    /// The normal, of length 1.
    #[must_use]
    pub fn normal(&self) -> Vector2<f64> {
        Vector2::new(self.normal_rad.cos(), self.normal_rad.sin())
    }

    /// Signed distance of a point, px, positive towards the normal.
    #[must_use]
    pub fn distance_px(&self, px: &Vector2<f64>) -> f64 {
        self.normal().dot(&(px - self.px))
    }

    /// One standard deviation of the line's place across itself, `along_px` from [`Self::px`], px.
    #[must_use]
    pub fn sd_px(&self, along_px: f64) -> f64 {
        let c = &self.covariance;
        // turning the normal by an angle moves the line at this place by the angle times the distance
        (c[(0, 0)] - 2.0 * along_px * c[(0, 1)] + along_px * along_px * c[(1, 1)]).max(0.0).sqrt()
    }

    /// Fits a line. `None` for fewer than three points, points that all lie on one place, or numbers that are none.
    ///
    /// Points beside the line are left out as long as half of them lie on it. Where residuals are greater than the points'
    /// deviations explain, the covariance grows with them.
    #[must_use]
    pub fn fit(points: &[EdgePoint]) -> Option<Self> {
        let mut line = weighted(points, 3, |p| p.sd_px.powi(-2))?;
        // chosen by hand: honest deviations give 1; points that are elsewhere must not draw the start to them
        if line.chi2 > 4.0 {
            line = by_pairs(points).unwrap_or(line);
        }
        let mut scale = spread(points, &line);
        for _ in 0..30 {
            let before = line;
            let robust = |p: &EdgePoint| {
                let z = before.distance_px(&p.px) / (p.sd_px * scale * TUKEY);
                (1.0 - z * z).max(0.0).powi(2) * p.sd_px.powi(-2)
            };
            let Some(next) = weighted(points, 3, robust) else { break };
            line = next;
            let new_scale = spread(points, &line).min(scale);
            let moved = before.distance_px(&line.px).abs() + (line.normal_rad - before.normal_rad).abs();
            // chosen by hand: far below what any edge is known to, px and rad; the scale only weighs
            if moved < 1e-9 && (scale - new_scale).abs() < 1e-3 * scale {
                break;
            }
            scale = new_scale;
        }
        let scale = spread(points, &line).max(1.0);
        for _ in 0..3 {
            let before = line;
            let cut = |p: &EdgePoint| {
                let inside = before.distance_px(&p.px).abs() <= CUT * scale * p.sd_px;
                if inside { p.sd_px.powi(-2) } else { 0.0 }
            };
            line = weighted(points, 3, cut)?;
        }
        line.covariance *= super::robust::growth(line.chi2, line.used.saturating_sub(2));
        Some(line)
    }
}

/// Pairs of points from which a start is chosen. Derived: with half of the points wrong one pair in four is right, and all 40 pairs are wrong
/// with a chance of `0.75^40` = 1e-5.
const PAIRS: usize = 40;
/// Points by whose median distance a pair is judged. Chosen by hand, for its time.
const JUDGES: usize = 64;

/// The line through two points from which the median of all is nearest.
fn by_pairs(points: &[EdgePoint]) -> Option<Line> {
    let mut random = Random::new(points.len() as u64);
    let mut pick = || points.get((random.bits() % points.len().max(1) as u64) as usize);
    let mut best = (f64::INFINITY, None);
    for _ in 0..PAIRS {
        let (a, b) = (pick()?, pick()?);
        let Some(line) = weighted(&[*a, *b], 2, |_| 1.0) else { continue };
        let mut residuals = [0.0; JUDGES];
        let step = points.len().div_ceil(JUDGES).max(1);
        let mut count = 0;
        for (r, p) in residuals.iter_mut().zip(points.iter().step_by(step)) {
            *r = line.distance_px(&p.px).abs() / p.sd_px;
            count += 1;
        }
        let Some(used) = residuals.get_mut(..count) else { continue };
        let (_, median, _) = used.select_nth_unstable_by(count / 2, f64::total_cmp);
        if *median < best.0 {
            best = (*median, Some(line));
        }
    }
    best.1
}

/// Robust scale of the residuals over their deviations, at least 1.
fn spread(points: &[EdgePoint], line: &Line) -> f64 {
    super::robust::spread(points, |p| line.distance_px(&p.px) / p.sd_px)
}

/// Weighted least squares: the direction of least spread.
fn weighted(points: &[EdgePoint], least: usize, weight: impl Fn(&EdgePoint) -> f64) -> Option<Line> {
    let (mut sum, mut mean, mut used) = (0.0, Vector2::zeros(), 0);
    for p in points {
        let w = weight(p);
        sum += w;
        mean += p.px * w;
        used += usize::from(w > 0.0);
    }
    mean /= sum;
    if used < least || !(sum > 0.0 && sum.is_finite() && mean.x.is_finite() && mean.y.is_finite()) {
        return None;
    }
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for p in points {
        let (w, d) = (weight(p), p.px - mean);
        xx += w * d.x * d.x;
        xy += w * d.x * d.y;
        yy += w * d.y * d.y;
    }
    let size = ((xx - yy) * 0.5).hypot(xy);
    let (along, across) = (0.5 * (xx + yy) + size, (0.5 * (xx + yy) - size).max(0.0));
    if !(along > 0.0 && along.is_finite()) {
        return None;
    }
    let direction_rad = 0.5 * (2.0 * xy).atan2(xx - yy);
    let covariance = Matrix2::new(1.0 / sum, 0.0, 0.0, 1.0 / along);
    let chi2 = if used > 2 { across / (used - 2) as f64 } else { 0.0 };
    let normal_rad = direction_rad + std::f64::consts::FRAC_PI_2;
    Some(Line { px: mean, normal_rad, covariance, chi2, used })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(random: &mut Random, count: usize, outliers: usize) -> (Vec<EdgePoint>, Vector2<f64>, f64) {
        let angle = random.between(-3.0, 3.0);
        let (n, t) = (Vector2::new(angle.cos(), angle.sin()), Vector2::new(-angle.sin(), angle.cos()));
        let middle = Vector2::new(random.between(0.0, 600.0), random.between(0.0, 400.0));
        let points = (0..count)
            .map(|i| {
                let sd_px = random.between(0.02, 0.1);
                let mut off = sd_px * random.gaussian();
                if i < outliers {
                    off = random.between(1.0, 20.0);
                }
                EdgePoint { px: middle + t * random.between(-25.0, 25.0) + n * off, sd_px }
            })
            .collect();
        (points, middle, angle)
    }

    #[test]
    fn covariance_is_what_errors_show() {
        let mut random = Random::new(8);
        for outliers in [0, 15] {
            let (mut offset, mut turn, mut both) = (0.0, 0.0, 0.0);
            let n = 1000;
            for _ in 0..n {
                let (points, middle, angle) = sample(&mut random, 50, outliers);
                let line = Line::fit(&points).unwrap();
                assert!(line.used >= 48 - outliers && line.used <= 50 - outliers, "{}", line.used);
                let normal = Vector2::new(angle.cos(), angle.sin());
                let sign = normal.dot(&line.normal()).signum();
                // the error at the line's own point, and that of its angle
                let d = sign * normal.dot(&(line.px - middle));
                let a = (line.normal_rad - angle) * 2.0;
                let a = 0.5 * a.sin().atan2(a.cos());
                let c = &line.covariance;
                offset += d * d / c[(0, 0)] / f64::from(n);
                turn += a * a / c[(1, 1)] / f64::from(n);
                let at = 20.0 * Vector2::new(-angle.sin(), angle.cos());
                let e = line.distance_px(&(middle + at));
                let along =
                    Vector2::new(-line.normal_rad.sin(), line.normal_rad.cos()).dot(&(middle + at - line.px));
                both += (e / line.sd_px(along)).powi(2) / f64::from(n);
            }
            for share in [offset, turn, both] {
                assert!((0.8..1.25).contains(&share), "{outliers} {offset} {turn} {both}");
            }
        }
    }

    #[test]
    fn degenerate_points_have_no_line() {
        let p = |x: f64, y: f64| EdgePoint { px: Vector2::new(x, y), sd_px: 0.1 };
        assert!(Line::fit(&[]).is_none());
        assert!(Line::fit(&[p(1.0, 2.0), p(2.0, 3.0)]).is_none());
        assert!(Line::fit(&[p(1.0, 2.0); 9]).is_none());
        assert!(Line::fit(&[p(f64::NAN, 2.0); 9]).is_none());
        assert!(Line::fit(&[EdgePoint { sd_px: 0.0, ..p(1.0, 2.0) }; 9]).is_none());
        let exact: Vec<_> = (0..9).map(|i| p(f64::from(i), 2.0 * f64::from(i))).collect();
        let line = Line::fit(&exact).unwrap();
        assert!(line.distance_px(&Vector2::new(100.0, 200.0)).abs() < 1e-9);
    }
}
