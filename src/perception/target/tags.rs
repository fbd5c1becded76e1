//! AprilTags on a plate: one, several, a grid; or on the faces of a body.
//!
//! ```text
//!   3 +------+ 2     --> x_o     points: corners of the black squares, id = 4 x index in the list + corner, corners as AprilTag
//!     | .o   |       |           counts them. A tag's place is that of its centre; a single tag lies about the origin.
//!   0 +------+ 1     v y_o       z_o points away from the camera that looks at the plate.
//! ```

use super::mark::outlines;
use super::tag_family::{TagCell, TagFamily};
use super::{Mark, Plate, Symmetry, TargetError, TargetPoint};
use crate::geometry::Pose;
use nalgebra::{Point3, Rotation2, Vector2, Vector3};

/// Where a tag lies on the plate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TagPlace {
    /// Which tag of the family.
    pub id: u32,
    /// Its centre, m.
    pub centre_m: Vector2<f64>,
    /// From x_o towards y_o to the direction in which its own x points, rad.
    pub turn_rad: f64,
}

/// Tags of one family and size on one plate or on the faces of a body, in the object frame (m).
#[derive(Debug, Clone, PartialEq)]
pub struct Tags {
    family: TagFamily,
    size_m: f64,
    margin_m: f64,
    tags: Box<[TagPlace]>,
    points: Box<[TargetPoint]>,
    /// The face of each tag, X_OF: the tag lies about its origin, and z_F points into the body. Empty for a plate.
    faces: Box<[Pose]>,
}

impl Tags {
    /// Most tags of one plate. Chosen by hand: a plate of 8 x 16.
    pub const MOST: usize = 128;
    /// The light margin about the black squares where nothing else is said, in cells.
    pub const MARGIN_CELLS: f64 = 2.0;

    /// Tags whose black squares have sides of `size_m`, with a light margin of `margin_m` about them; m.
    ///
    /// # Errors
    /// [`TargetError`] when there are none or too many, an id does not exist or comes twice, tags lie less than a cell apart, or
    /// a length is not positive.
    pub fn new(
        family: TagFamily,
        size_m: f64,
        margin_m: f64,
        tags: &[TagPlace],
    ) -> Result<Self, TargetError> {
        TargetError::if_not_positive([("size_m", size_m), ("margin_m", margin_m)])?;
        if !(1..=Self::MOST).contains(&tags.len()) {
            return Err(TargetError::TagCount { count: tags.len() });
        }
        let cell_m = size_m / f64::from(family.cells_per_side());
        for (i, tag) in tags.iter().enumerate() {
            if tag.id >= family.count() {
                return Err(TargetError::TagId { family: family.name(), id: tag.id, count: family.count() });
            }
            let [x, y] = [tag.centre_m.x, tag.centre_m.y];
            if let Some(value_m) = [x, y, tag.turn_rad].into_iter().find(|x| !x.is_finite()) {
                return Err(TargetError::Length { name: "a tag's place", value_m });
            }
            for other in tags.get(..i).unwrap_or(&[]) {
                if other.id == tag.id {
                    return Err(TargetError::TagTwice { id: tag.id });
                }
                // one cell, but for the rounding of lengths that are written with few digits
                if apart_m(tag, other, size_m) < 0.999 * cell_m {
                    return Err(TargetError::TagsTouch { id: tag.id, other: other.id, cell_m });
                }
            }
        }
        let points = tags.iter().enumerate().flat_map(|(i, tag)| {
            (0..4).map(move |corner| {
                let (x, y) = family.corner(corner);
                let from_corner = Vector2::new(f64::from(x), f64::from(y)) * cell_m;
                let place = tag.place(&from_corner.add_scalar(-0.5 * size_m));
                TargetPoint { id: (4 * i + corner) as u32, p_O: Point3::new(place.x, place.y, 0.0) }
            })
        });
        let (points, faces) = (points.collect(), Box::default());
        Ok(Self { family, size_m, margin_m, points, tags: tags.into(), faces })
    }

    /// One tag on each face of a body: its id, and the face's pose X_OF, with the tag about the origin and z_F pointing into the body.
    ///
    /// # Errors
    /// As for [`Self::new`]; whether faces lie one in another is not examined.
    pub fn on_faces(
        family: TagFamily,
        size_m: f64,
        margin_m: f64,
        tags: &[(u32, Pose)],
    ) -> Result<Self, TargetError> {
        if !(1..=Self::MOST).contains(&tags.len()) {
            return Err(TargetError::TagCount { count: tags.len() });
        }
        let (mut places, mut points) = (Vec::new(), Vec::new());
        for (i, (id, X_OF)) in tags.iter().enumerate() {
            let place = TagPlace { id: *id, centre_m: Vector2::zeros(), turn_rad: 0.0 };
            let one = Self::new(family, size_m, margin_m, &[place])?;
            if let Some(value_m) = X_OF.translation.vector.iter().find(|x| !x.is_finite()) {
                return Err(TargetError::Length { name: "a face's place", value_m: *value_m });
            }
            if places.iter().any(|other: &TagPlace| other.id == *id) {
                return Err(TargetError::TagTwice { id: *id });
            }
            let corner = |p: &TargetPoint| TargetPoint { id: 4 * i as u32 + p.id, p_O: X_OF * p.p_O };
            points.extend(one.points.iter().map(corner));
            places.push(place);
        }
        let faces = tags.iter().map(|(_, X_OF)| *X_OF).collect();
        Ok(Self { family, size_m, margin_m, tags: places.into(), points: points.into(), faces })
    }

    /// The face of each tag of a body, X_OF; empty for a plate.
    #[must_use]
    pub fn faces(&self) -> &[Pose] {
        &self.faces
    }

    /// Whether the tag of point `i` is turned towards a camera that has the target at `X_CO`; of a plate that is not asked.
    #[must_use]
    pub fn is_turned_to_camera(&self, i: usize, X_CO: &Pose) -> bool {
        self.faces.get(i / 4).is_none_or(|X_OF| {
            let X_CF = X_CO * X_OF;
            (X_CF.rotation * Vector3::z()).dot(&X_CF.translation.vector) > 0.0
        })
    }

    /// What a face's tag is drawn on, about the face's origin.
    #[must_use]
    pub fn face_plate(&self) -> Plate {
        let reach = Vector2::repeat(0.5 * self.size_m + self.margin_m);
        Plate { low_m: -reach, high_m: reach, light: true }
    }

    /// One tag about the origin, with the usual margin.
    ///
    /// # Errors
    /// As for [`Self::new`].
    pub fn one(family: TagFamily, size_m: f64, id: u32) -> Result<Self, TargetError> {
        Self::grid(family, size_m, (1, 1), size_m, id)
    }

    /// `(columns, rows)` of tags, their centres `pitch_m` apart, ids rising from `first_id` row by row; the first one about the origin.
    ///
    /// # Errors
    /// As for [`Self::new`].
    pub fn grid(
        family: TagFamily,
        size_m: f64,
        (columns, rows): (usize, usize),
        pitch_m: f64,
        first_id: u32,
    ) -> Result<Self, TargetError> {
        TargetError::if_not_positive([("pitch_m", pitch_m)])?;
        let count = columns.saturating_mul(rows);
        if !(1..=Self::MOST).contains(&count) {
            return Err(TargetError::TagCount { count });
        }
        let place = |i: usize| TagPlace {
            id: first_id.saturating_add(i as u32),
            centre_m: Vector2::new((i % columns) as f64, (i / columns) as f64) * pitch_m,
            turn_rad: 0.0,
        };
        let tags: Vec<_> = (0..count).map(place).collect();
        let margin_m = Self::MARGIN_CELLS * size_m / f64::from(family.cells_per_side());
        Self::new(family, size_m, margin_m, &tags)
    }

    /// Their family.
    #[must_use]
    pub fn family(&self) -> TagFamily {
        self.family
    }

    /// Side of each black square, m.
    #[must_use]
    pub fn size_m(&self) -> f64 {
        self.size_m
    }

    /// The tags: tag `i` has the points `4 i` to `4 i + 3`.
    #[must_use]
    pub fn tags(&self) -> &[TagPlace] {
        &self.tags
    }

    /// The corners of the black squares.
    #[must_use]
    pub fn points(&self) -> &[TargetPoint] {
        &self.points
    }

    /// What is black: a mark for each tag.
    #[must_use]
    pub fn marks(&self) -> Vec<Mark> {
        let count = self.family.cells_per_side();
        let side_m = self.size_m / f64::from(count);
        let low = Vector2::repeat(-0.5 * self.size_m);
        let mark = |tag: &TagPlace| {
            let black = |i: u32| {
                self.family.cell(tag.id, (i % count) as i32, (i / count) as i32) == Some(TagCell::Black)
            };
            let cells: Vec<bool> = (0..count * count).map(black).collect();
            let loops = outlines(&cells, count as usize, side_m, &low);
            Mark::Polygon(loops.iter().map(|l| l.iter().map(|corner| tag.place(corner)).collect()).collect())
        };
        self.tags.iter().map(mark).collect()
    }

    /// The plate; of a body what it covers along x_o and y_o.
    #[must_use]
    pub fn plate(&self) -> Plate {
        let (mut low, mut high) = (Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY));
        for point in &self.points {
            let p = point.p_O.coords.xy();
            (low, high) = (low.inf(&p), high.sup(&p));
        }
        Plate { low_m: low.add_scalar(-self.margin_m), high_m: high.add_scalar(self.margin_m), light: true }
    }

    /// Codes differ from each other and from themselves, however they are turned; mirrored they are no codes.
    #[must_use]
    pub fn symmetry(&self) -> Symmetry {
        Symmetry { turns: 1, mirrored: false }
    }
}

impl TagPlace {
    /// The place on the plate of what lies at `own` in the tag's own frame.
    fn place(&self, own: &Vector2<f64>) -> Vector2<f64> {
        self.centre_m + Rotation2::new(self.turn_rad) * own
    }
}

/// Least distance of two squares along the sides of one of them (separating axes); not positive where they overlap.
fn apart_m(one: &TagPlace, other: &TagPlace, size_m: f64) -> f64 {
    let half = 0.5 * size_m;
    let between = other.centre_m - one.centre_m;
    let turn = (other.turn_rad - one.turn_rad).sin_cos();
    let reach = half + half * (turn.0.abs() + turn.1.abs());
    [one.turn_rad, other.turn_rad]
        .map(|angle| (Rotation2::new(-angle) * between).amax() - reach)
        .into_iter()
        .fold(f64::NEG_INFINITY, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(id: u32, x: f64, y: f64, turn_rad: f64) -> TagPlace {
        TagPlace { id, centre_m: Vector2::new(x, y), turn_rad }
    }

    #[test]
    fn corners_are_counted_from_the_lower_left_one() {
        let tag = Tags::one(TagFamily::Tag36h11, 0.08, 3).unwrap();
        let corners: Vec<_> = tag.points().iter().map(|p| (p.p_O.x, p.p_O.y)).collect();
        let wanted = [(-0.04, 0.04), (0.04, 0.04), (0.04, -0.04), (-0.04, -0.04)];
        for (found, wanted) in corners.iter().zip(wanted) {
            assert!((found.0 - wanted.0).abs() < 1e-12 && (found.1 - wanted.1).abs() < 1e-12, "{corners:?}");
        }
        assert!((tag.plate().high_m.x - 0.06).abs() < 1e-12);
    }

    #[test]
    fn the_marks_are_the_cells() {
        for turn in [0.0, 0.4] {
            let tag = Tags::new(TagFamily::Tag25h9, 0.07, 0.01, &[at(7, 0.3, -0.1, turn)]).unwrap();
            let marks = tag.marks();
            let Mark::Polygon(loops) = &marks[0] else { unreachable!() };
            for row in -1..8 {
                for column in -1..8 {
                    let own = Vector2::new(f64::from(column) - 3.0, f64::from(row) - 3.0) * 0.01;
                    let p = tag.tags()[0].place(&own);
                    let crossed = loops
                        .iter()
                        .flat_map(|l| l.iter().zip(l.iter().cycle().skip(1)))
                        .filter(|(a, b)| {
                            (a.y > p.y) != (b.y > p.y) && p.x < a.x + (b.x - a.x) * (p.y - a.y) / (b.y - a.y)
                        })
                        .count();
                    let black = TagFamily::Tag25h9.cell(7, column, row) == Some(TagCell::Black);
                    assert_eq!(crossed % 2 == 1, black, "{column} {row}");
                }
            }
        }
    }

    #[test]
    fn a_body_has_its_tags_on_faces_that_turn_away() {
        let [top, side] = [
            Pose::translation(0.0, 0.0, -0.03),
            Pose::new([0.03, 0.0, 0.0].into(), [0.0, -std::f64::consts::FRAC_PI_2, 0.0].into()),
        ];
        let family = TagFamily::Tag36h11;
        let body = Tags::on_faces(family, 0.04, 0.005, &[(3, top), (8, side)]).unwrap();
        assert_eq!(body.points().len(), 8);
        assert!(body.points().iter().zip(0..).all(|(point, id)| point.id == id));
        assert!(body.points()[..4].iter().all(|p| (p.p_O.z + 0.03).abs() < 1e-12));
        assert!(body.points()[4..].iter().all(|p| (p.p_O.x - 0.03).abs() < 1e-12));
        // From above only the top is seen; from the side and above both are.
        let above = Pose::translation(0.0, 0.0, 0.4);
        assert_eq!([0, 4].map(|i| body.is_turned_to_camera(i, &above)), [true, false]);
        let aside = Pose::new([0.0, 0.0, 0.4].into(), [0.0, 0.8, 0.0].into());
        assert_eq!([0, 4].map(|i| body.is_turned_to_camera(i, &aside)), [true, true]);
        let refused = |tags: &[(u32, Pose)]| Tags::on_faces(family, 0.04, 0.005, tags).is_err();
        assert!(refused(&[]) && refused(&[(3, top), (3, side)]) && refused(&[(587, top)]));
        assert!(refused(&[(3, Pose::translation(f64::NAN, 0.0, 0.0))]));
    }

    #[test]
    fn impossible_plates_are_refused() {
        let family = TagFamily::Tag16h5;
        let of = |tags: &[TagPlace]| Tags::new(family, 0.06, 0.01, tags).map(|_| ());
        assert!(matches!(of(&[]), Err(TargetError::TagCount { count: 0 })));
        assert!(matches!(of(&[at(30, 0.0, 0.0, 0.0)]), Err(TargetError::TagId { id: 30, count: 30, .. })));
        assert!(matches!(
            of(&[at(1, 0.0, 0.0, 0.0), at(1, 1.0, 0.0, 0.0)]),
            Err(TargetError::TagTwice { .. })
        ));
        assert!(matches!(
            of(&[at(1, 0.0, 0.0, 0.0), at(2, 0.065, 0.0, 0.0)]),
            Err(TargetError::TagsTouch { id: 2, other: 1, .. })
        ));
        assert!(of(&[at(1, 0.0, 0.0, 0.0), at(2, 0.07, 0.0, 0.0)]).is_ok());
        // turned by half a right angle it reaches farther
        assert!(of(&[at(1, 0.0, 0.0, 0.0), at(2, 0.072, 0.0, 0.785)]).is_err());
        assert!(of(&[at(1, f64::NAN, 0.0, 0.0)]).is_err());
        assert!(Tags::grid(family, 0.06, (6, 6), 0.08, 0).is_err(), "only 30 ids");
        assert!(Tags::grid(family, 0.06, (usize::MAX, 6), 0.08, 0).is_err());
        assert_eq!(Tags::grid(family, 0.06, (5, 6), 0.08, 0).unwrap().points().len(), 120);
    }
}
