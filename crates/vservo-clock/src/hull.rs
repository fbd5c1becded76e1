//! The line below points: the edge of their lower convex hull above the middle of their time.

/// The quickest package of a window: when, by the controller's clock, and the difference of both clocks, ns from an origin.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Point {
    pub(crate) t: f64,
    pub(crate) d: f64,
}

/// `d` over `t`.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Line {
    pub(crate) t: f64,
    pub(crate) d: f64,
    pub(crate) slope: f64,
}

impl Line {
    pub(crate) fn at(&self, t: f64) -> f64 {
        self.d + self.slope * (t - self.t)
    }

    /// The highest line of this slope that no point is below.
    pub(crate) fn below(points: &[Point], slope: f64) -> Self {
        let height = |p: &Point| p.d - slope * p.t;
        let lowest = points.iter().min_by(|a, b| height(a).total_cmp(&height(b)));
        lowest.map_or(Self::default(), |p| Self { t: p.t, d: p.d, slope })
    }
}

/// The slope of the line that no point is below and that is nearest to all of them: the sum of their distances is least for the edge of the hull above their mean time.
pub(crate) fn slope_below(points: &[Point]) -> f64 {
    let middle = points.iter().map(|p| p.t).sum::<f64>() / points.len().max(1) as f64;
    let is_below = |a: &Point, b: &Point| {
        let slope = (b.d - a.d) / (b.t - a.t);
        points.iter().all(|p| p.d >= a.d + slope * (p.t - a.t) - 1e-3).then_some(slope)
    };
    // Sixteen points have a hundred pairs that span the middle: no stack of a hull is needed.
    let left = points.iter().filter(|p| p.t <= middle);
    let mut pairs = left.flat_map(|a| points.iter().filter(|p| p.t > middle).map(move |b| (a, b)));
    pairs.find_map(|(a, b)| is_below(a, b)).unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(of: &[(f64, f64)]) -> Vec<Point> {
        of.iter().map(|&(t, d)| Point { t, d }).collect()
    }

    #[test]
    fn the_line_touches_two_points_and_none_is_below() {
        let all = points(&[(0.0, 5.0), (1.0, 1.0), (2.0, 9.0), (3.0, 2.0), (4.0, 30.0), (5.0, 3.0)]);
        let slope = slope_below(&all);
        assert_eq!(slope, 0.5);
        let line = Line::below(&all, slope);
        assert!(all.iter().all(|p| p.d >= line.at(p.t)));
        assert_eq!(all.iter().filter(|p| p.d == line.at(p.t)).count(), 3);
        // The same from all pairs of a line that is known: whatever lies above it changes nothing.
        let drifting: Vec<_> = (0..16).map(|k| (f64::from(k), 2.0 - 0.25 * f64::from(k))).collect();
        let mut lifted = points(&drifting);
        for (k, p) in lifted.iter_mut().enumerate().filter(|(k, _)| k % 3 == 1) {
            p.d += 1.0 + k as f64;
        }
        assert!((slope_below(&lifted) + 0.25).abs() < 1e-12);
    }
}
