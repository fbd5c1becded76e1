//! A single free outline on a plate: a polygon, or an ellipse.
//!
//! A polygon's points are its corners, without those at which the outline hardly turns, and at most 64 of them: images of the corners
//! are told by the whole outline. An ellipse has no point but its centre.

use super::mark::double_area;
use super::{ClosedOutline, Mark, Plate, Symmetry, TargetError, TargetPoint};
use crate::messages::MAX_FEATURES;
use nalgebra::{Point3, Vector2};

/// Most corners of a polygon. Chosen by hand: twice as many as any drawn shape needs; the finder's time grows with it.
const MAX_CORNERS: usize = 256;
/// Tolerance of symmetry, as a share of the size. Chosen by hand: coordinates in run files have six digits.
const ALIKE: f64 = 1e-6;
/// A corner becomes a point of the target when it lies off the line between its neighbours by this share of the size. Chosen by hand: a
/// fifth of a pixel where the shape takes 100 px.
const STRAIGHT: f64 = 2e-3;

/// A free shape, in the object frame (m).
#[derive(Debug, Clone, PartialEq)]
pub struct Shape {
    mark: Mark,
    margin_m: f64,
    light_on_dark: bool,
    centroid_m: Vector2<f64>,
    points: Box<[TargetPoint]>,
}

impl Shape {
    /// A closed polygon by its corners, in either order, and the plate's margin about it; m.
    ///
    /// # Errors
    /// [`TargetError`] when there are fewer than 3 corners or more than 256, sides cross each other, or a length is no number.
    pub fn polygon(corners_m: &[Vector2<f64>], margin_m: f64) -> Result<Self, TargetError> {
        TargetError::if_not_positive([("margin_m", margin_m)])?;
        if !(3..=MAX_CORNERS).contains(&corners_m.len()) {
            return Err(TargetError::OutlineCorners { count: corners_m.len() });
        }
        if let Some(wrong) = corners_m.iter().flat_map(|c| c.iter()).find(|x| !x.is_finite()) {
            return Err(TargetError::Length { name: "outline_m", value_m: *wrong });
        }
        let twice = double_area(corners_m);
        let first = corners_m.first().copied().unwrap_or_default();
        let size2 = corners_m.iter().map(|c| (c - first).norm_squared()).fold(0.0, f64::max);
        // an area that may be rounding alone is none
        if crosses_itself(corners_m) || !(twice.abs() > 1e-9 * size2) {
            return Err(TargetError::OutlineCrosses);
        }
        let mut outline: Vec<_> = corners_m.to_vec();
        if twice < 0.0 {
            outline.reverse();
        }
        let next = outline.iter().cycle().skip(1);
        let sum: Vector2<f64> = outline.iter().zip(next).map(|(a, b)| (a + b) * a.perp(b)).sum();
        let centroid_m = sum / (3.0 * twice.abs());
        let points = points(&sample(&outline, size2.sqrt()));
        let mark = Mark::Polygon([ClosedOutline::from(outline)].into());
        Ok(Self { mark, margin_m, light_on_dark: false, centroid_m, points })
    }

    /// An ellipse about the origin, by half its axes and the angle from x_o to the first; and the plate's margin about it; m, rad.
    ///
    /// # Errors
    /// [`TargetError`] when a length is not positive, or the angle is no number.
    pub fn ellipse(semi_axes_m: [f64; 2], turn_rad: f64, margin_m: f64) -> Result<Self, TargetError> {
        let [a, b] = semi_axes_m;
        TargetError::if_not_positive([("semi_axes_m", a), ("semi_axes_m", b), ("margin_m", margin_m)])?;
        if !turn_rad.is_finite() {
            return Err(TargetError::Length { name: "turn_rad", value_m: turn_rad });
        }
        let mark = Mark::Ellipse { centre_m: Vector2::zeros(), semi_axes_m, turn_rad };
        let centroid_m = Vector2::zeros();
        Ok(Self { mark, margin_m, light_on_dark: false, centroid_m, points: points(&[centroid_m]) })
    }

    /// The same shape, light on a dark plate, or not.
    #[must_use]
    pub fn light_on_dark(self, light_on_dark: bool) -> Self {
        Self { light_on_dark, ..self }
    }

    /// The shape.
    #[must_use]
    pub fn mark(&self) -> &Mark {
        &self.mark
    }

    /// Centroid of its area, m.
    #[must_use]
    pub fn centroid_m(&self) -> Vector2<f64> {
        self.centroid_m
    }

    /// Its points in their order along the outline, at most 64: corners of a polygon, the centre of an ellipse.
    #[must_use]
    pub fn points(&self) -> &[TargetPoint] {
        &self.points
    }

    /// The plate.
    #[must_use]
    pub fn plate(&self) -> Plate {
        let loops = self.mark.loops(1e-6);
        let corners = loops.iter().flat_map(|l| l.iter());
        let (mut low_m, mut high_m) = (Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY));
        for corner in corners {
            low_m = low_m.inf(corner);
            high_m = high_m.sup(corner);
        }
        let margin = Vector2::repeat(self.margin_m);
        Plate { low_m: low_m - margin, high_m: high_m + margin, light: !self.light_on_dark }
    }

    /// Which turns and mirror images of the shape look like it.
    #[must_use]
    pub fn symmetry(&self) -> Symmetry {
        let outline = match &self.mark {
            Mark::Disc(_) => return Symmetry { turns: u32::MAX, mirrored: true },
            Mark::Ellipse { semi_axes_m: [a, b], .. } => {
                let round = (a - b).abs() < ALIKE * a;
                return Symmetry { turns: if round { u32::MAX } else { 2 }, mirrored: true };
            }
            Mark::Polygon(loops) => loops.first().map_or(&[][..], |l| l),
        };
        let centre = self.centroid_m;
        let from_centre: Vec<_> = outline.iter().map(|corner| corner - centre).collect();
        let size = from_centre.iter().map(|c| c.norm()).fold(0.0, f64::max);
        let count = from_centre.len();
        let corner = |i: usize| from_centre.get(i % count).copied().unwrap_or_default();
        let turned = |shift: &usize| {
            let (a, b) = (corner(0), corner(*shift));
            let turn = nalgebra::Rotation2::new(a.perp(&b).atan2(a.dot(&b)));
            (0..count).all(|i| (turn * corner(i) - corner(i + shift)).norm() < ALIKE * size)
        };
        let turns = (0..count).filter(turned).count();
        // a mirror image runs the other way round: corner i falls on corner shift - i
        let mirrored = (0..count).any(|shift| {
            let (a, b) = (corner(0), corner(shift));
            let (sin, cos) = (a.y.atan2(a.x) + b.y.atan2(b.x)).sin_cos();
            (0..count).all(|i| {
                let c = corner(i);
                let image = Vector2::new(cos * c.x + sin * c.y, sin * c.x - cos * c.y);
                (image - corner(count + shift - i)).norm() < ALIKE * size
            })
        });
        Symmetry { turns: (turns as u32).max(1), mirrored }
    }
}

fn points(places: &[Vector2<f64>]) -> Box<[TargetPoint]> {
    let point =
        |(id, place): (u32, &Vector2<f64>)| TargetPoint { id, p_O: Point3::new(place.x, place.y, 0.0) };
    (0..).zip(places).map(point).collect()
}

/// The corners at which a closed outline turns most: one by one that goes which leaves the line between its neighbours least, until
/// all that are left leave theirs by [`STRAIGHT`] of `size`, and there are few enough.
fn sample(outline: &[Vector2<f64>], size: f64) -> Vec<Vector2<f64>> {
    let mut kept = outline.to_vec();
    while kept.len() > 3 {
        let count = kept.len();
        let at = |i: usize| kept.get(i % count).copied().unwrap_or_default();
        let height = |i: usize| {
            let (before, corner, behind) = (at(i + count - 1), at(i), at(i + 1));
            let chord = behind - before;
            let reach = (corner - before).norm().min((corner - behind).norm());
            if chord.norm() > 0.0 {
                (chord.perp(&(corner - before)).abs() / chord.norm()).min(reach)
            } else {
                reach
            }
        };
        let least = (0..count).map(|i| (height(i), i)).min_by(|a, b| a.0.total_cmp(&b.0));
        match least {
            Some((height, i)) if height < STRAIGHT * size || count > MAX_FEATURES => drop(kept.remove(i)),
            _ => break,
        }
    }
    kept
}

/// Whether two sides that are no neighbours meet, or a side has no length.
fn crosses_itself(corners: &[Vector2<f64>]) -> bool {
    let sides: Vec<_> = corners.iter().zip(corners.iter().cycle().skip(1)).collect();
    let count = sides.len();
    sides.iter().enumerate().any(|(i, (a, b))| {
        a == b
            || sides.iter().enumerate().skip(i + 1).any(|(j, (c, d))| {
                let neighbours = j == i + 1 || i + count == j + 1;
                let side = |p: &Vector2<f64>| (*b - *a).perp(&(p - *a));
                let other = |p: &Vector2<f64>| (*d - *c).perp(&(p - *c));
                // sides in line meet where their extents do
                let in_line = side(c) == 0.0 && side(d) == 0.0;
                let apart = |k: usize| a[k].max(b[k]) < c[k].min(d[k]) || c[k].max(d[k]) < a[k].min(b[k]);
                let meet = side(c) * side(d) <= 0.0 && other(a) * other(b) <= 0.0;
                !neighbours && meet && !(in_line && (apart(0) || apart(1)))
            })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(corners: &[[f64; 2]]) -> Result<Shape, TargetError> {
        let corners: Vec<_> = corners.iter().map(|c| Vector2::from(*c)).collect();
        Shape::polygon(&corners, 0.01)
    }

    #[test]
    fn the_centroid_is_that_of_the_area_whichever_way_round() {
        // an L: unit square below, half a one to the side; centroid by parts
        let corners = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 1.0], [1.0, 2.0], [0.0, 2.0]];
        let wanted = (Vector2::new(1.0, 0.5) * 2.0 + Vector2::new(0.5, 1.5)) / 3.0;
        let mut backwards = corners;
        backwards.reverse();
        for corners in [corners, backwards] {
            let shape = of(&corners).unwrap();
            assert!((shape.centroid_m() - wanted).norm() < 1e-12);
            assert_eq!(shape.points().len(), 6);
            let Mark::Polygon(loops) = shape.mark() else { unreachable!() };
            assert!(double_area(&loops[0]) > 0.0);
            assert_eq!(shape.plate().high_m, Vector2::new(2.01, 2.01));
        }
    }

    #[test]
    fn points_are_the_corners_at_which_the_outline_turns() {
        // a straight side in three parts
        let corners = [[0.0, 0.0], [1.0, 0.0], [2.0, 1e-5], [3.0, 0.0], [3.0, 2.0], [0.0, 1.0]];
        let shape = of(&corners).unwrap();
        let places: Vec<_> = shape.points().iter().map(|p| [p.p_O.x, p.p_O.y]).collect();
        assert_eq!(places, [[0.0, 0.0], [3.0, 0.0], [3.0, 2.0], [0.0, 1.0]]);
        assert!(shape.points().iter().zip(0..).all(|(p, id)| p.id == id));
        // a curve
        let curve: Vec<_> = (0..200)
            .map(|i| {
                let (sin, cos) = (f64::from(i) * std::f64::consts::TAU / 200.0).sin_cos();
                [(2.0 + 0.5 * cos) * cos, 1.3 * sin]
            })
            .collect();
        let shape = of(&curve).unwrap();
        assert!((20..=64).contains(&shape.points().len()), "{}", shape.points().len());
        assert_eq!(Shape::ellipse([0.2, 0.1], 0.3, 0.01).unwrap().points().len(), 1);
    }

    #[test]
    fn symmetries_of_polygons() {
        let square = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        assert_eq!(of(&square).unwrap().symmetry(), Symmetry { turns: 4, mirrored: true });
        let slanted = [[0.0, 0.0], [2.0, 0.0], [3.0, 1.0], [1.0, 1.0]];
        assert_eq!(of(&slanted).unwrap().symmetry(), Symmetry { turns: 2, mirrored: false });
        let flag = [[0.0, 0.0], [3.0, 0.0], [0.0, 1.0]];
        assert_eq!(of(&flag).unwrap().symmetry(), Symmetry { turns: 1, mirrored: false });
        let kite = [[0.0, 0.0], [2.0, 0.0], [1.0, 3.0]];
        assert_eq!(of(&kite).unwrap().symmetry(), Symmetry { turns: 1, mirrored: true });
        let ellipse = Shape::ellipse([0.2, 0.1], 0.3, 0.01).unwrap();
        assert_eq!(ellipse.symmetry(), Symmetry { turns: 2, mirrored: true });
    }

    #[test]
    fn impossible_shapes_are_refused() {
        assert!(matches!(of(&[[0.0, 0.0], [1.0, 0.0]]), Err(TargetError::OutlineCorners { count: 2 })));
        let bow = [[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]];
        assert_eq!(of(&bow), Err(TargetError::OutlineCrosses));
        assert_eq!(of(&[[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]), Err(TargetError::OutlineCrosses));
        assert_eq!(of(&[[0.0, 0.0], [0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]), Err(TargetError::OutlineCrosses));
        assert!(matches!(of(&[[0.0, 0.0], [f64::NAN, 1.0], [2.0, 0.0]]), Err(TargetError::Length { .. })));
        assert!(Shape::ellipse([0.0, 1.0], 0.0, 0.1).is_err());
    }
}
