//! From the outline of a region to a convex quadrilateral: four corner points are chosen on it, a straight line is fitted to the points of each side, and
//! the corners are the intersections of these lines. Pixels of the window.

use crate::imaging::WindowPoint;
use crate::imaging::simd::kernel;
use nalgebra::Vector2;
use std::array::from_fn;

/// Shortest side, px. Chosen by hand: one pixel for each cell of the smallest family, below which no cell can be read; half costs time for regions
/// that are no tags, the double loses tilted tags.
pub(super) const MIN_SIDE_PX: f64 = 6.0;
/// Points of a side that are left out at each end: the share of the side, and at least so many px, because blur rounds the corners of outlines. Chosen
/// by hand: at a blur of 1 px the contour of half the contrast lies 0.1 px inside of the side 1.45 px before its end, and more behind. Half bends the
/// lines of blurred tags inward, the double leaves a side of 6 px without points.
const END_SHARE: f64 = 0.08;
const END_PX: f64 = 1.5;
/// Points may lie off their side by this on average (rms): px, and share of the side for curved ones. Chosen by hand: above the 0.29 px of outlines
/// through whole pixels; half would refuse noisy outlines. A quarter of a circle lies off its line by 0.04 of the chord, so that circles of more
/// than 50 px are refused (`what_is_no_quadrilateral_is_refused` has one of 60 px); with the double none would be.
const OFF_PX: f64 = 0.75;
const OFF_SHARE: f64 = 0.02;
/// Sine of the least angle at a corner, 15 degrees. Chosen by hand: a square that is turned about its diagonal has it at 82 degrees, where nothing is
/// read any more; half lets slivers through, the double refuses tags from 74 degrees on.
const MIN_SINE: f64 = 0.26;

/// Corners of a convex quadrilateral, px, clockwise on the screen.
pub(super) type Quad = [Vector2<f64>; 4];

/// A straight line: `normal . x = offset`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct NormalFormLine {
    pub(super) normal: Vector2<f64>,
    pub(super) offset: f64,
}

impl NormalFormLine {
    /// Intersection of two lines; `None` when they are parallel.
    pub(super) fn meet(&self, other: &Self) -> Option<Vector2<f64>> {
        let (a, b) = (self.normal, other.normal);
        let det = a.x * b.y - a.y * b.x;
        // Sine of the angle between the lines: anything above rounding would do, since the quadrilateral is checked afterwards.
        if !(det.abs() > 1e-6) {
            return None;
        }
        let (p, q) = (self.offset, other.offset);
        Some(Vector2::new(p * b.y - q * a.y, a.x * q - b.x * p) / det)
    }
}

/// Twice the area of the triangle `a b c`, positive where it goes clockwise on the screen.
fn turn(a: Vector2<f64>, b: Vector2<f64>, c: Vector2<f64>) -> f64 {
    (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x)
}

/// Whether the corners go clockwise around a convex quadrilateral with sides of at least [`MIN_SIDE_PX`] and angles of at least 15 degrees.
pub(super) fn is_sound(quad: &Quad) -> bool {
    let [a, b, c, d] = *quad;
    [(d, a, b), (a, b, c), (b, c, d), (c, d, a)].into_iter().all(|(p, q, r)| {
        let (one, two) = ((q - p).norm(), (r - q).norm());
        one >= MIN_SIDE_PX && turn(p, q, r) >= MIN_SINE * one * two
    })
}

/// The quadrilateral of a closed outline, px of the window; `None` when the outline has not four straight sides.
pub(super) fn of_outline(points: &[WindowPoint]) -> Option<Quad> {
    let mut at = corners(points)?;
    at.sort_unstable();
    let mut lines = [NormalFormLine { normal: Vector2::zeros(), offset: 0.0 }; 4];
    for (i, line) in lines.iter_mut().enumerate() {
        let (from, to) = (*at.get(i)?, *at.get((i + 1) % 4)?);
        *line = side(points, from, to)?;
    }
    let [a, b, c, d] = lines;
    let quad = [d.meet(&a)?, a.meet(&b)?, b.meet(&c)?, c.meet(&d)?];
    is_sound(&quad).then_some(quad)
}

fn place(points: &[WindowPoint], i: usize) -> Vector2<f64> {
    points.get(i).map_or_else(Vector2::zeros, |p| Vector2::new(f64::from(p[0]), f64::from(p[1])))
}

kernel!(
    /// Index of the first of the points that are farthest from `from`, and its squared distance.
    fn farthest_from(points: &[WindowPoint], from: WindowPoint) -> (usize, f32) = farthest_from_body
);

#[inline(always)]
fn farthest_from_body(points: &[WindowPoint], [x0, y0]: WindowPoint) -> (usize, f32) {
    farthest(points, |x, y| (x - x0) * (x - x0) + (y - y0) * (y - y0))
}

kernel!(
    /// Index of the first of the points that are farthest to the right of the line from `p` to `q`, and its distance times the line's length.
    fn farthest_right(points: &[WindowPoint], p: WindowPoint, q: WindowPoint) -> (usize, f32) = farthest_right_body
);

#[inline(always)]
fn farthest_right_body(points: &[WindowPoint], p: WindowPoint, q: WindowPoint) -> (usize, f32) {
    let (dx, dy) = (q[0] - p[0], q[1] - p[1]);
    farthest(points, |x, y| dx * (y - p[1]) - dy * (x - p[0]))
}

/// Index of the first of the points with the greatest `measure`, and that measure.
#[inline(always)]
#[allow(clippy::indexing_slicing)] // 0..8 of eight
fn farthest(points: &[WindowPoint], measure: impl Fn(f32, f32) -> f32) -> (usize, f32) {
    // of each eighth point
    let (mut most, mut at) = ([f32::MIN; 8], [0u32; 8]);
    let (eights, rest) = points.as_chunks::<8>();
    for (k, eight) in (0u32..).zip(eights) {
        let value: [f32; 8] = from_fn(|i| measure(eight[i][0], eight[i][1]));
        for i in 0..8 {
            at[i] = if value[i] > most[i] { k } else { at[i] };
            most[i] = if value[i] > most[i] { value[i] } else { most[i] };
        }
    }
    let mut best = (0, f32::MIN);
    for (i, (&most, &k)) in most.iter().zip(&at).enumerate() {
        let index = 8 * k as usize + i;
        if most > best.1 || (most == best.1 && index < best.0) {
            best = (index, most);
        }
    }
    for (i, p) in (points.len() - rest.len()..).zip(rest) {
        let value = measure(p[0], p[1]);
        if value > best.1 {
            best = (i, value);
        }
    }
    best
}

/// Indices of the four corners: of a convex outline the point that is farthest from any other is a corner, and each corner is the point
/// farthest from the line through its neighbours.
fn corners(points: &[WindowPoint]) -> Option<[usize; 4]> {
    if points.len() < 16 {
        return None;
    }
    let count = points.len() as f32;
    let sum = points.iter().fold([0.0f32; 2], |s, p| [s[0] + p[0], s[1] + p[1]]);
    let point = |i: usize| points.get(i).copied().unwrap_or_default();
    let (a, _) = farthest_from(points, [sum[0] / count, sum[1] / count]);
    let (b, _) = farthest_from(points, point(a));
    // from the line through two points, to its right
    let right_of = |i: usize, j: usize| farthest_right(points, point(i), point(j));
    let (c, to_c) = right_of(a, b);
    let (d, to_d) = right_of(b, a);
    // the outline goes clockwise: its order is the order of indices. Where nearly nothing lies on one side of `a b` it is a side, else a diagonal; the
    // share is chosen by hand: half takes rough sides for diagonals, the double diagonals of tags in steep perspective for sides.
    let mut quad = if to_c.min(to_d) > 0.08 * to_c.max(to_d) {
        [a, c, b, d]
    } else {
        // `a b` is a side: the fourth corner is farthest from the triangle's other sides
        let e = if to_c > to_d { c } else { d };
        let sides = if to_c > to_d { [(b, e), (e, a)] } else { [(a, e), (e, b)] };
        let [(one, off_one), (two, off_two)] = sides.map(|(i, j)| right_of(j, i));
        let norm = |(i, j): (usize, usize)| (point(i)[0] - point(j)[0]).hypot(point(i)[1] - point(j)[1]);
        let far = if off_one * norm(sides[1]) > off_two * norm(sides[0]) { one } else { two };
        [a, b, e, far]
    };
    for _ in 0..2 {
        quad.sort_unstable();
        let before = quad;
        for i in 0..4 {
            let (last, next) = (*quad.get((i + 3) % 4)?, *quad.get((i + 1) % 4)?);
            // the corner lies left of the line from the next corner to the previous one
            let (best, off) = right_of(next, last);
            if off > 0.0
                && let Some(corner) = quad.get_mut(i)
            {
                *corner = best;
            }
        }
        if quad == before {
            break;
        }
    }
    quad.sort_unstable();
    quad.windows(2).all(|w| w.first() != w.last()).then_some(quad)
}

/// The line through the points from index `from` to `to` without the ends of the side, by orthogonal least squares in three rounds, in the later ones
/// without outliers. `None` when it is too short or its points do not lie on a line.
fn side(points: &[WindowPoint], from: usize, to: usize) -> Option<NormalFormLine> {
    let (a, b) = (place(points, from), place(points, to));
    let along = b - a;
    let length = along.norm();
    if length < MIN_SIDE_PX {
        return None;
    }
    let along = along / length;
    let skip = (END_SHARE * length).max(END_PX);
    let (until, rest) = if to > from { (to + 1, 0) } else { (points.len(), to + 1) };
    let (first, rest) = (points.get(from..until)?, points.get(..rest)?);
    let used = || {
        let all = first.iter().chain(rest).map(|p| Vector2::new(f64::from(p[0]), f64::from(p[1])));
        all.filter(move |p| {
            let s = (p - a).dot(&along);
            s >= skip && s <= length - skip
        })
    };
    let mut line = NormalFormLine { normal: Vector2::new(along.y, -along.x), offset: 0.0 };
    let mut most = f64::INFINITY;
    for round in 0..3 {
        let (mut n, mut sum, mut xx, mut xy, mut yy) = (0.0, Vector2::zeros(), 0.0, 0.0, 0.0);
        for p in used() {
            let r = p - a;
            if (line.normal.dot(&p) - line.offset).abs() <= most {
                n += 1.0;
                sum += r;
                xx += r.x * r.x;
                xy += r.x * r.y;
                yy += r.y * r.y;
            }
        }
        // A line takes two points, its scatter needs more.
        if n < 4.0 {
            return None;
        }
        let mean = sum / n;
        let (xx, xy, yy) = (xx / n - mean.x * mean.x, xy / n - mean.x * mean.y, yy / n - mean.y * mean.y);
        // direction of least spread
        let root = (0.25 * (xx - yy).powi(2) + xy * xy).sqrt();
        let small = (0.5 * (xx + yy) - root).max(0.0);
        let normal = if xx > yy { Vector2::new(-xy, xx - small) } else { Vector2::new(yy - small, -xy) };
        let normal = normal.try_normalize(1e-12)?;
        line = NormalFormLine { normal, offset: normal.dot(&(mean + a)) };
        let rms = small.sqrt();
        // 1.2 % of normal errors lie beyond 2.5 deviations. An outline through whole pixels has a deviation of 1/12^0.5, about 0.3 px, so that no
        // point of a clean one is left out; with half of it most would be where all lie on one line.
        most = (2.5 * rms).max(0.3);
        if round == 2 && rms > OFF_PX + OFF_SHARE * length {
            return None;
        }
        // Chosen by hand: with strays still among the points; half refuses sides with a bump, the double only costs time.
        if round == 0 && rms > 3.0 * (OFF_PX + OFF_SHARE * length) {
            return None;
        }
        // without outliers the later rounds would compute the same line
        if round == 0 && used().all(|p| (line.normal.dot(&p) - line.offset).abs() <= most) {
            return (rms <= OFF_PX + OFF_SHARE * length).then_some(line);
        }
    }
    Some(line)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points along the sides of a quadrilateral, about a pixel apart.
    fn outline(quad: &Quad) -> Vec<WindowPoint> {
        let mut points = Vec::new();
        for i in 0..4 {
            let (a, b) = (quad[i], quad[(i + 1) % 4]);
            let n = (b - a).norm().ceil() as usize;
            points.extend((0..n).map(|k| a.lerp(&b, k as f64 / n as f64)).map(|p| [p.x as f32, p.y as f32]));
        }
        points
    }

    #[test]
    fn quadrilaterals_are_found_wherever_the_outline_begins() {
        let v = Vector2::new;
        for quad in [
            [v(10.0, 10.0), v(50.0, 12.0), v(48.0, 55.0), v(8.0, 50.0)],
            [v(10.0, 10.0), v(90.0, 30.0), v(92.0, 42.0), v(12.0, 25.0)],
            [v(30.0, 10.0), v(60.0, 40.0), v(30.0, 70.0), v(0.0, 40.0)],
            // a long side that is the longest distance
            [v(0.0, 0.0), v(100.0, 0.0), v(70.0, 30.0), v(40.0, 30.0)],
        ] {
            let mut points = outline(&quad);
            for _ in 0..7 {
                points.rotate_left(9);
                let found = of_outline(&points).unwrap();
                for corner in &quad {
                    let off = found.iter().map(|p| (p - corner).norm()).fold(f64::MAX, f64::min);
                    assert!(off < 0.05, "{quad:?} {found:?}");
                }
                assert!(is_sound(&found));
            }
        }
    }

    #[test]
    fn what_is_no_quadrilateral_is_refused() {
        let round: Vec<WindowPoint> = (0..100)
            .map(|i| f64::from(i) * 0.0628)
            .map(|t| [40.0 + 30.0 * t.cos() as f32, 40.0 + 30.0 * t.sin() as f32])
            .collect();
        assert_eq!(of_outline(&round), None);
        assert_eq!(of_outline(&[[1.0, 1.0]; 50]), None);
        assert_eq!(of_outline(&[]), None);
        assert_eq!(of_outline(&[[f32::NAN; 2]; 50]), None);
        let v = Vector2::new;
        let triangle = outline(&[v(0.0, 0.0), v(60.0, 0.0), v(30.0, 50.0), v(15.0, 25.0)]);
        assert_eq!(of_outline(&triangle), None);
    }
}
