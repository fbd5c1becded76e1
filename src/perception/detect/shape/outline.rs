//! The outline of the target in normalized coordinates: origin at its centroid, farthest point at distance 1.
//!
//! It is divided into parts at its sharp corners; between them it is smooth, either straight or curved by many small turns. Edges are measured only
//! on smooth parts, away from the corners, and only within the free distance to other parts of the outline.

use crate::imaging::Moments;
use crate::target::{Mark, Shape};
use nalgebra::{Matrix2, Vector2};

/// Turns above this are corners, rad. Chosen by hand: one such turn in the middle of a piece of 10 px lies 0.35 px off its chord, most of which the
/// piece's parabola takes up; half of it parts curves that are drawn with 50 corners, twice of it leaves corners within pieces.
const SHARP: f64 = 0.14;
/// Directions that differ by less are one, rad. Chosen by hand: two degrees, which people hardly see.
const SAME_WAY: f64 = 0.035;
/// Corners of the polygon that stands for a circle. Derived: it lies `1 - cos(pi / 360)` of the radius inside, 0.004 px of 100 px.
const CIRCLE: u32 = 360;
/// Places along the outline at which it is known how much room there is. Chosen by hand: two for each piece of an outline of 200; the room of a
/// piece is the least of its places, so that fewer could miss a notch.
const ROOMS: usize = 512;
/// Directions from the centroid in which the outline's extent is known. Chosen by hand: of 512 border pixels seven lie in each, and the turn that
/// they give is off by up to 2.5 degrees, which the alignment takes up; twice as many cost four times the comparisons.
pub(super) const DIRECTIONS: usize = 72;

/// A smooth part of the outline, by arc length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct OutlinePart {
    pub(super) from: f64,
    pub(super) to: f64,
    /// Whether it is closed, so that it has no ends.
    pub(super) closed: bool,
    /// For a straight part the index of the first part parallel to it (or its own); `None` for a curve.
    pub(super) class: Option<usize>,
}

/// The outline.
#[derive(Debug, Clone)]
pub(super) struct ShapeOutline {
    corners: Box<[Vector2<f64>]>,
    /// Arc length to each corner, and to the first again.
    arc: Box<[f64]>,
    pub(super) parts: Box<[OutlinePart]>,
    /// Free distance inside and outside, at equal steps of arc length.
    rooms: Box<[[f64; 2]]>,
    /// Origin in the object's plane, and the length of the unit, m.
    centre_m: Vector2<f64>,
    scale_m: f64,
    pub(super) area: f64,
    /// `[xx, xy, yy]` of a point uniform in the area.
    pub(super) spread: [f64; 3],
    /// Extent in each direction after [`whitening`].
    pub(super) extents: [f64; DIRECTIONS],
    /// Images of the target's points.
    pub(super) points: Box<[Vector2<f64>]>,
}

/// The map that takes a region of the given spread `[xx, xy, yy]` to one that spreads alike in all directions; `None` for a line.
pub(super) fn whitening([xx, xy, yy]: [f64; 3]) -> Option<Matrix2<f64>> {
    // inverse of the Cholesky factor
    let a = xx.sqrt();
    let b = xy / a;
    let c = (yy - b * b).sqrt();
    (a > 0.0 && c > 0.0 && a.is_finite()).then(|| Matrix2::new(1.0 / a, 0.0, -b / (a * c), 1.0 / c))
}

/// The greatest distance from 0 in each direction, of points along a closed curve; directions without a point have their neighbours'.
pub(super) fn extents(points: impl Iterator<Item = Vector2<f64>>) -> [f64; DIRECTIONS] {
    let mut extents = [0.0f64; DIRECTIONS];
    for p in points {
        let turn = p.y.atan2(p.x) / std::f64::consts::TAU + 1.0;
        let i = (turn * DIRECTIONS as f64) as usize % DIRECTIONS;
        if let Some(extent) = extents.get_mut(i) {
            *extent = extent.max(p.norm());
        }
    }
    let known = extents;
    for (i, extent) in extents.iter_mut().enumerate() {
        if *extent == 0.0 {
            let at = |k: usize| known.get(k % DIRECTIONS).copied().filter(|e| *e > 0.0);
            let neighbour = (1..=DIRECTIONS / 2).find_map(|k| at(i + k).or_else(|| at(i + DIRECTIONS - k)));
            *extent = neighbour.unwrap_or(0.0);
        }
    }
    extents
}

impl ShapeOutline {
    /// The outline of a shape; that of an ellipse is a unit circle.
    pub(super) fn of(shape: &Shape) -> Self {
        let plate = shape.plate();
        let mut outline: Vec<Vector2<f64>> = match shape.mark() {
            Mark::Polygon(loops) => loops.first().map_or(&[][..], |l| l).to_vec(),
            Mark::Disc(_) | Mark::Ellipse { .. } => Vec::new(),
        };
        let circle = outline.is_empty();
        let centre_m = shape.centroid_m();
        if circle {
            let corner = |i: u32| {
                let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / f64::from(CIRCLE)).sin_cos();
                Vector2::new(cos, sin)
            };
            outline = (0..CIRCLE).map(corner).collect();
        }
        let scale_m = if circle {
            1.0
        } else {
            outline.iter().map(|c| (c - centre_m).norm()).fold(f64::MIN_POSITIVE, f64::max)
        };
        if !circle {
            outline.iter_mut().for_each(|c| *c = (*c - centre_m) / scale_m);
        }
        // of an ellipse the margin in lengths of the longer half axis
        let room = if let Mark::Ellipse { semi_axes_m: [a, b], .. } = shape.mark() {
            let half = 0.5 * (plate.high_m - plate.low_m).min();
            1.0 + ((half - a.min(*b)) / a.max(*b)).max(0.0)
        } else {
            0.0
        };
        let (low, high) = if circle {
            (Vector2::repeat(-room), Vector2::repeat(room))
        } else {
            ((plate.low_m - centre_m) / scale_m, (plate.high_m - centre_m) / scale_m)
        };
        let points = if circle {
            [Vector2::zeros()].into()
        } else {
            shape.points().iter().map(|p| (p.p_O.coords.xy() - centre_m) / scale_m).collect()
        };
        Self::new(outline, points, (low, high), centre_m, scale_m)
    }

    fn new(
        corners: Vec<Vector2<f64>>,
        points: Box<[Vector2<f64>]>,
        plate: (Vector2<f64>, Vector2<f64>),
        centre_m: Vector2<f64>,
        scale_m: f64,
    ) -> Self {
        let count = corners.len();
        let corner = |i: usize| corners.get(i % count.max(1)).copied().unwrap_or_default();
        let mut arc = vec![0.0];
        let mut sum = 0.0;
        for i in 0..count {
            sum += (corner(i + 1) - corner(i)).norm();
            arc.push(sum);
        }
        let sharp: Vec<f64> = (0..count)
            .filter(|i| {
                let (a, b) = (corner(*i) - corner(i + count - 1), corner(i + 1) - corner(*i));
                a.perp(&b).atan2(a.dot(&b)).abs() > SHARP
            })
            .filter_map(|i| arc.get(i).copied())
            .collect();
        let parts = match sharp.first() {
            None => vec![OutlinePart { from: 0.0, to: sum, closed: true, class: None }],
            Some(first) => {
                let ends = sharp.iter().skip(1).copied().chain([first + sum]);
                let part =
                    |(from, to): (&f64, f64)| OutlinePart { from: *from, to, closed: false, class: None };
                sharp.iter().zip(ends).map(part).collect()
            }
        };
        let flat: Vec<[f64; 2]> = corners.iter().map(|c| [c.x, c.y]).collect();
        let m = Moments::of_polygon(&flat).unwrap_or_default();
        let spread = [m.mu20 / m.m00, m.mu11 / m.m00, m.mu02 / m.m00];
        let mut this = Self {
            corners: corners.into(),
            arc: arc.into(),
            parts: parts.into(),
            rooms: Box::default(),
            centre_m,
            scale_m,
            area: m.m00,
            spread,
            extents: [0.0; DIRECTIONS],
            points,
        };
        this.sort_parallels();
        let white = whitening(spread).unwrap_or_else(Matrix2::identity);
        this.extents = extents((0..4096).map(|i| white * this.at(sum * f64::from(i) / 4096.0).0));
        this.rooms = (0..ROOMS).map(|i| this.room_at(sum * i as f64 / ROOMS as f64, &plate)).collect();
        this
    }

    /// Classifies straight parts by their directions.
    fn sort_parallels(&mut self) {
        let chord = |part: &OutlinePart| {
            let (a, b) = (self.at(part.from).0, self.at(part.to).0);
            let straight =
                !part.closed && (b - a).norm() > (1.0 - SAME_WAY * SAME_WAY) * (part.to - part.from);
            straight.then(|| (b - a).normalize())
        };
        let ways: Vec<_> = self.parts.iter().map(chord).collect();
        let class = |i: usize| {
            let way = ways.get(i).copied().flatten()?;
            let along = |other: &Option<Vector2<f64>>| other.is_some_and(|o| o.perp(&way).abs() < SAME_WAY);
            ways.iter().position(along)
        };
        let classes: Vec<_> = (0..ways.len()).map(class).collect();
        self.parts.iter_mut().zip(classes).for_each(|(part, class)| part.class = class);
    }

    /// Length of the outline.
    pub(super) fn length(&self) -> f64 {
        self.arc.last().copied().unwrap_or(0.0)
    }

    /// Position at arc length `s`, which may exceed the length of the outline, and the direction of the outline there; its inside lies
    /// from x towards y.
    pub(super) fn at(&self, s: f64) -> (Vector2<f64>, Vector2<f64>) {
        let s = s.rem_euclid(self.length());
        let i =
            self.arc.partition_point(|a| *a <= s).saturating_sub(1).min(self.corners.len().saturating_sub(1));
        let corner = |i: usize| self.corners.get(i % self.corners.len().max(1)).copied().unwrap_or_default();
        let (a, b) = (corner(i), corner(i + 1));
        let from = self.arc.get(i).copied().unwrap_or(0.0);
        let side = b - a;
        let direction = side / side.norm().max(f64::MIN_POSITIVE);
        (a + direction * (s - from), direction)
    }

    /// Least free distance inside and outside between two arc lengths.
    pub(super) fn room(&self, from: f64, to: f64) -> [f64; 2] {
        let per = ROOMS as f64 / self.length();
        let (first, last) = ((from * per).floor() as usize, (to * per).ceil() as usize);
        let mut least = [f64::INFINITY; 2];
        for i in first..=last.min(first + ROOMS) {
            if let Some([a, b]) = self.rooms.get(i % ROOMS) {
                least = [least[0].min(*a), least[1].min(*b)];
            }
        }
        least
    }

    /// A point of the object's plane (m) in the outline's coordinates.
    pub(super) fn of_plane(&self, r_m: &Vector2<f64>) -> Vector2<f64> {
        (r_m - self.centre_m) / self.scale_m
    }

    /// Free distance from the outline to its next side, or to the plate's edge, along the normal inward and outward.
    fn room_at(&self, s: f64, plate: &(Vector2<f64>, Vector2<f64>)) -> [f64; 2] {
        let (p, t) = self.at(s);
        let inward = Vector2::new(-t.y, t.x);
        let count = self.corners.len();
        let way = |n: Vector2<f64>| {
            let mut free = f64::INFINITY;
            for i in 0..count {
                let (Some(a), Some(b)) = (self.corners.get(i), self.corners.get((i + 1) % count)) else {
                    continue;
                };
                let side = b - a;
                let det = n.perp(&side);
                // parallel: rounding alone would say where they meet
                if det.abs() < 1e-12 {
                    continue;
                }
                let (along, across) = ((a - p).perp(&side) / det, (a - p).perp(&n) / det);
                // beyond rounding, else the side meets itself
                if along > 1e-6 && (0.0..=1.0).contains(&across) {
                    free = free.min(along);
                }
            }
            free
        };
        let outward = -inward;
        let edge = |low: f64, high: f64, p: f64, n: f64| {
            // along the plate's edge it is never met: rounding must not say that it is
            if n > 1e-9 {
                (high - p) / n
                // nor must it of the opposite edge
            } else if n < -1e-9 {
                (low - p) / n
            } else {
                f64::INFINITY
            }
        };
        let (low, high) = plate;
        let over = edge(low.x, high.x, p.x, outward.x).min(edge(low.y, high.y, p.y, outward.y)).max(0.0);
        [way(inward), way(outward).min(over)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shape(corners: &[[f64; 2]]) -> Shape {
        Shape::polygon(&corners.iter().map(|c| Vector2::from(*c)).collect::<Vec<_>>(), 0.5).unwrap()
    }

    #[test]
    fn sides_and_rooms_of_an_l() {
        let l = ShapeOutline::of(&shape(&[
            [0.0, 0.0],
            [2.0, 0.0],
            [2.0, 1.0],
            [1.0, 1.0],
            [1.0, 3.0],
            [0.0, 3.0],
        ]));
        assert_eq!(l.parts.len(), 6);
        let classes: Vec<_> = l.parts.iter().map(|p| p.class).collect();
        assert_eq!(classes, [0, 1, 0, 1, 0, 1].map(Some));
        assert!((l.length() * l.scale_m - 10.0).abs() < 1e-12);
        assert!((l.area * l.scale_m.powi(2) - 4.0).abs() < 1e-12);
        // in the middle of the upper side of the foot: the foot is 1 high, and above it there is the plate up to 3.5
        let [inside, outside] = l.room(3.4 / l.scale_m, 3.6 / l.scale_m);
        assert!((inside * l.scale_m - 1.0).abs() < 1e-9 && (outside * l.scale_m - 2.5).abs() < 1e-9);
        let (p, t) = l.at(3.5 / l.scale_m + 3.0 * l.length());
        assert!((p * l.scale_m + l.centre_m - Vector2::new(1.5, 1.0)).norm() < 1e-9);
        assert!((t - Vector2::new(-1.0, 0.0)).norm() < 1e-9);
        assert!((l.of_plane(&Vector2::new(1.5, 1.0)) - p).norm() < 1e-9);
    }

    #[test]
    fn an_ellipse_is_a_circle_without_ends() {
        let e = ShapeOutline::of(&Shape::ellipse([0.04, 0.02], 0.5, 0.02).unwrap());
        assert_eq!(e.parts.len(), 1);
        assert!(
            e.parts[0].closed && e.parts[0].class.is_none() && (e.area - std::f64::consts::PI).abs() < 1e-3
        );
        assert!(e.extents.iter().all(|r| (r - 2.0).abs() < 1e-3));
        let [inside, outside] = e.room(1.0, 1.1);
        assert!((inside - 2.0).abs() < 0.01 && outside > 0.2 && outside < 1.0, "{outside}");
    }

    #[test]
    fn whitened_regions_spread_alike() {
        let white = whitening([4.0, 1.0, 2.0]).unwrap();
        let spread = white * Matrix2::new(4.0, 1.0, 1.0, 2.0) * white.transpose();
        assert!((spread - Matrix2::identity()).norm() < 1e-12);
        assert!(whitening([1.0, 1.0, 1.0]).is_none() && whitening([f64::NAN, 0.0, 1.0]).is_none());
    }
}
