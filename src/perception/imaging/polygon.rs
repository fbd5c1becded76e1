//! Polygon approximation of a contour: the fewest corners that a recursive split needs (Douglas and Peucker 1973).
//!
//! Between two kept points all others lie within the tolerance of the chord; where one does not, the farthest is kept too, and both
//! parts are looked at again. A closed contour starts with two points that are far apart.

use super::Point;

/// Finds polygons. The buffers are reused.
#[derive(Debug, Clone, Default)]
pub struct Polygons {
    keep: Vec<bool>,
    stack: Vec<(u32, u32)>,
    corners: Vec<Point>,
}

impl Polygons {
    /// Buffers for contours of at most `points` pixels, allocated at once.
    #[must_use]
    pub fn with_limit(points: usize) -> Self {
        Self {
            keep: Vec::with_capacity(points),
            stack: Vec::with_capacity(points),
            corners: Vec::with_capacity(points),
        }
    }

    /// Corners of the closed contour, in its order: each of its points lies within `tolerance_px` of the side between the corners before
    /// and behind it. A negative tolerance or NaN counts as 0. A contour of at most two points is its own polygon; one that lies
    /// within the tolerance of a line has two corners.
    pub fn closed(&mut self, points: &[Point], tolerance_px: f64) -> &[Point] {
        let count = points.len();
        self.begin(count);
        if count > 0 {
            // the farthest point from any, and the farthest from that: a diameter, or nearly
            let from = farthest_point(points, 0);
            let to = farthest_point(points, from);
            let (low, high) = (from.min(to), from.max(to));
            self.split(points, low, high, tolerance_px);
            self.split(points, high, low + count, tolerance_px);
        }
        self.end(points)
    }

    /// The same for a chain with two ends, which are kept.
    pub fn open(&mut self, points: &[Point], tolerance_px: f64) -> &[Point] {
        self.begin(points.len());
        if let Some(last) = points.len().checked_sub(1) {
            self.split(points, 0, last, tolerance_px);
        }
        self.end(points)
    }

    fn begin(&mut self, count: usize) {
        self.keep.clear();
        self.keep.resize(count, false);
        self.stack.clear();
        self.corners.clear();
    }

    fn end(&mut self, points: &[Point]) -> &[Point] {
        self.corners
            .extend(points.iter().zip(&self.keep).filter(|(_, keep)| **keep).map(|(point, _)| *point));
        &self.corners
    }

    /// Keeps both ends and what the way between them needs; indices go on behind the last point at the first.
    fn split(&mut self, points: &[Point], first: usize, last: usize, tolerance_px: f64) {
        let square = tolerance_px.max(0.0).powi(2);
        self.stack.push((first as u32, last as u32));
        while let Some((first, last)) = self.stack.pop() {
            let (a, b) = (first as usize, last as usize);
            for at in [a, b] {
                let at = if at >= points.len() { at - points.len() } else { at };
                if let Some(keep) = self.keep.get_mut(at) {
                    *keep = true;
                }
            }
            if let Some((at, distance2)) = farthest_from_chord(points, a, b)
                && distance2 > square
            {
                self.stack.extend([(at as u32, last), (first, at as u32)]);
            }
        }
    }
}

fn difference(a: Point, b: Point) -> (i64, i64) {
    (i64::from(b.x) - i64::from(a.x), i64::from(b.y) - i64::from(a.y))
}

/// The first of the points that are farthest from the one with the given index.
fn farthest_point(points: &[Point], from: usize) -> usize {
    let Some(&origin) = points.get(from) else { return 0 };
    let mut best = (0, from);
    for (i, &p) in points.iter().enumerate() {
        let (dx, dy) = difference(origin, p);
        let (dx, dy) = (dx.unsigned_abs(), dy.unsigned_abs());
        let d2 = (dx * dx).saturating_add(dy * dy);
        if d2 > best.0 {
            best = (d2, i);
        }
    }
    best.1
}

/// Of the points between two, the one farthest from the segment that joins them, with the squared distance in px^2.
fn farthest_from_chord(points: &[Point], first: usize, last: usize) -> Option<(usize, f64)> {
    let at = |i: usize| points.get(if i >= points.len() { i - points.len() } else { i }).copied();
    let (a, b) = (at(first)?, at(last)?);
    let (ux, uy) = difference(a, b);
    let (ux, uy) = (ux as f64, uy as f64);
    let length2 = ux * ux + uy * uy;
    let (mut best, mut best_at) = (-1.0, first);
    let mut look = |start: usize, part: &[Point]| {
        for (i, &p) in part.iter().enumerate() {
            let (dx, dy) = difference(a, p);
            let (dx, dy) = (dx as f64, dy as f64);
            let along = ux * dx + uy * dy;
            let cross = ux * dy - uy * dx;
            // times the chord's squared length, where there is one; beyond its ends the distance is that to an end
            let d2 = if along < 0.0 || length2 == 0.0 {
                (dx * dx + dy * dy) * length2.max(1.0)
            } else if along > length2 {
                let (ex, ey) = (dx - ux, dy - uy);
                (ex * ex + ey * ey) * length2
            } else {
                cross * cross
            };
            if d2 > best {
                (best, best_at) = (d2, start + i);
            }
        }
    };
    let count = points.len();
    let (low, high) = (first + 1, last);
    look(low, points.get(low..high.min(count)).unwrap_or(&[]));
    if high > count {
        let low = low.max(count);
        look(low, points.get(low - count..high - count).unwrap_or(&[]));
    }
    (best >= 0.0).then(|| (best_at, best / length2.max(1.0)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn distance(a: Point, b: Point, p: Point) -> f64 {
        let v = |p: Point| (f64::from(p.x), f64::from(p.y));
        let (a, b, p) = (v(a), v(b), v(p));
        let (dx, dy) = (b.0 - a.0, b.1 - a.1);
        let (ex, ey) = (p.0 - a.0, p.1 - a.1);
        let n = dx * dx + dy * dy;
        let t = if n == 0.0 { 0.0 } else { ((ex * dx + ey * dy) / n).clamp(0.0, 1.0) };
        (ex - dx * t).hypot(ey - dy * t)
    }

    #[test]
    fn a_rectangle_has_four_corners() {
        let mut points = Vec::new();
        points.extend((10..30).map(|y| Point { x: 5, y }));
        points.extend((5..60).map(|x| Point { x, y: 30 }));
        points.extend((11..=30).rev().map(|y| Point { x: 60, y }));
        points.extend((6..=60).rev().map(|x| Point { x, y: 10 }));
        let mut polygons = Polygons::default();
        let corners = [(5, 10), (5, 30), (60, 30), (60, 10)].map(|(x, y)| Point { x, y });
        for tolerance in [-1.0, f64::NAN, 0.0, 0.5, 3.0] {
            assert_eq!(polygons.closed(&points, tolerance), &corners, "{tolerance}");
        }
        assert_eq!(polygons.closed(&points, 100.0).len(), 2);
        // from any start, the same corners
        for _ in 0..points.len() {
            points.rotate_left(1);
            let mut found = polygons.closed(&points, 1.0).to_vec();
            let first = found.iter().position(|p| *p == corners[0]).unwrap();
            found.rotate_left(first);
            assert_eq!(found, corners);
        }
    }

    #[test]
    fn little_is_its_own_polygon() {
        let mut polygons = Polygons::default();
        assert!(polygons.closed(&[], 1.0).is_empty());
        assert!(polygons.open(&[], 1.0).is_empty());
        let points = [Point { x: 3, y: 4 }, Point { x: u32::MAX, y: 5 }];
        assert_eq!(polygons.closed(&points[..1], 1.0), &points[..1]);
        assert_eq!(polygons.closed(&points, 1.0), &points);
        assert_eq!(polygons.open(&points, f64::INFINITY), &points);
    }

    proptest! {
        /// Every point is within the tolerance of its side, and the corners are points of the contour in its order.
        #[test]
        fn no_point_is_farther_than_the_tolerance(
            points in prop::collection::vec((0u32..50, 0u32..50), 1..80), tolerance in 0.0..20.0, closed in any::<bool>(),
        ) {
            let points: Vec<_> = points.iter().map(|&(x, y)| Point { x, y }).collect();
            let mut polygons = Polygons::with_limit(10);
            let found = if closed { polygons.closed(&points, tolerance) } else { polygons.open(&points, tolerance) }.to_vec();
            let kept: Vec<usize> = polygons.keep.iter().enumerate().filter(|(_, k)| **k).map(|(i, _)| i).collect();
            prop_assert_eq!(kept.iter().map(|&i| points[i]).collect::<Vec<_>>(), found);
            let n = points.len();
            for (&a, &b) in kept.iter().zip(kept.iter().cycle().skip(1)) {
                if b <= a && !closed {
                    continue;
                }
                let b = if b > a { b } else { b + n };
                for i in a..b {
                    prop_assert!(distance(points[a], points[b % n], points[i % n]) <= tolerance + 1e-9);
                }
            }
        }
    }
}
