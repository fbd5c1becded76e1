//! `[target]`: the target. Keys and bounds of all kinds in one place.

use super::check::{Validation, pose};
use crate::target::{
    Chessboard, DotBody, DotFace, DotGrid, FourDots, MAX_EXTENT_M, Shape, TagFamily, TagPlace, Tags, Target,
    TargetError,
};
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;

/// Tags in a row or column, and their ids: tag36h11, the largest family, has 587 by its specification.
const TAGS: RangeInclusive<u32> = 1..=Tags::MOST as u32;
const TAG_ID: RangeInclusive<u32> = 0..=586;

/// Lengths of targets. Chosen by hand: outside of them a number has another unit.
pub(super) const LENGTH_M: RangeInclusive<f64> = 1e-6..=100.0;

word! {
    /// Kind of target.
    TargetKind {
        /// Four dark dots on a light plate, the first one larger.
        FourDots,
        /// Dark dots in rows and columns, some of them larger.
        DotGrid,
        /// Dark and light squares by turns.
        Chessboard,
        /// AprilTags.
        Tags,
        /// A free outline.
        Shape,
        /// Points in space: the corners of tags, or dots, on the faces of a body.
        Points,
    }
}

table! {
    /// The target's geometry.
    RawTarget {
        /// Kind of target.
        kind: TargetKind = TargetKind::FourDots,
        /// Side of the square of dots, m.
        side_m: f64 = 0.1,
        /// Radius of dots 2 to 4, m, or of 3 and 4; of all dots on the faces of a body.
        radius_m: f64 = 0.010,
        /// Radius of dot 1, m.
        radius_p1_m: f64 = 0.015,
        /// Radius of dot 2, m, where it has one of its own: then a mirror image of the target is none.
        radius_p2_m: Option<f64> = None,
        /// Light margin of the plate around the square, m.
        margin_m: f64 = 0.030,
        /// Of dots and shapes: light on a dark plate.
        light_on_dark: bool = false,
        /// `[target.dot_grid]`
        dot_grid: RawDotGrid = RawDotGrid::default(),
        /// `[target.chessboard]`
        chessboard: RawChessboard = RawChessboard::default(),
        /// `[target.tags]`
        tags: RawTags = RawTags::default(),
        /// `[target.shape]`
        shape: RawShape = RawShape::default(),
        /// `[target.points]`
        points: RawPoints = RawPoints::default(),
    }
}

table! {
    /// Tags or dots on the faces of a body: the corners of the ones and the centres of the others are points in space.
    RawPoints {
        /// Family: 36h11, 25h9 or 16h5.
        family: String = "36h11".into(),
        /// Side of a tag's black square, m.
        size_m: f64 = 0.04,
        /// Light margin about the black squares, m; left out: two cells.
        margin_m: Option<f64> = None,
        /// `[[target.points.tags]]`
        #[serde(skip_serializing_if = "Vec::is_empty")]
        tags: Vec<RawFace> = Vec::new(),
        /// `[[target.points.faces]]`: instead of tags
        #[serde(skip_serializing_if = "Vec::is_empty")]
        faces: Vec<RawDotFace> = Vec::new(),
    }
}

pose_table! {
    /// One face with dots of the radius `target.radius_m`. Its z points into the body.
    RawDotFace {
        /// Its middle in the frame of the target, m.
        position_m: [f64; 3] = [0.0, 0.0, 0.0],
        /// Roll, pitch, yaw of its frame, rad.
        rotation_rpy_rad: [f64; 3] = [0.0, 0.0, 0.0],
        /// Its width along x and height along y, m.
        size_m: [f64; 2] = [0.06, 0.06],
        /// The centres of its dots, m.
        dots_m: Vec<[f64; 2]> = Vec::new(),
    }
}

pose_table! {
    /// One tag: where its centre is, and how it is turned. Its z points into the body, x and y are those of a single tag.
    RawFace {
        /// Its id.
        id: u32 = 0,
        /// Its centre in the frame of the target, m.
        position_m: [f64; 3] = [0.0, 0.0, 0.0],
        /// Roll, pitch, yaw of its frame, rad.
        rotation_rpy_rad: [f64; 3] = [0.0, 0.0, 0.0],
    }
}

table! {
    /// A polygon, or an ellipse.
    RawShape {
        /// Corners, m, in either order.
        outline_m: Vec<[f64; 2]> = ARROW.into(),
        /// Instead of corners: half the axes of an ellipse, m.
        semi_axes_m: Option<[f64; 2]> = None,
        /// Margin of the plate about it, m.
        margin_m: f64 = 0.03,
    }
}

/// An arrow with an asymmetric head, chosen by hand, so that no rotation or reflection maps it to itself.
const ARROW: [[f64; 2]; 7] = [
    [-0.05, -0.012],
    [0.01, -0.012],
    [0.01, -0.03],
    [0.05, 0.0],
    [0.01, 0.036],
    [0.01, 0.012],
    [-0.05, 0.012],
];

table! {
    /// A chessboard.
    RawChessboard {
        /// Inner corners in a row.
        columns: u32 = 9,
        /// Inner corners in a column.
        rows: u32 = 6,
        /// Side of a square, m.
        square_m: f64 = 0.025,
        /// Light margin about the outer squares, m; left out: half a square.
        margin_m: Option<f64> = None,
    }
}

table! {
    /// Tags in rows and columns, or where they are said to be.
    RawTags {
        /// Family: 36h11, 25h9 or 16h5.
        family: String = "36h11".into(),
        /// Side of a tag's black square, m.
        size_m: f64 = 0.1,
        /// Tags in a row.
        columns: u32 = 1,
        /// Tags in a column.
        rows: u32 = 1,
        /// Distance of neighbouring tags' centres, m.
        pitch_m: f64 = 0.15,
        /// Id of the first tag; the others follow row by row.
        first_id: u32 = 0,
        /// Light margin about the black squares, m; left out: two cells.
        margin_m: Option<f64> = None,
        /// `[[target.tags.places]]`: instead of rows and columns
        #[serde(skip_serializing_if = "Vec::is_empty")]
        places: Vec<RawTagPlace> = Vec::new(),
    }
}

table! {
    /// One tag.
    RawTagPlace {
        /// Its id.
        id: u32 = 0,
        /// Its centre, m.
        position_m: [f64; 2] = [0.0, 0.0],
        /// From x towards y to its own x, rad.
        turn_rad: f64 = 0.0,
    }
}

table! {
    /// A grid of dots.
    RawDotGrid {
        /// Dots in a row.
        columns: u32 = 7,
        /// Dots in a column.
        rows: u32 = 5,
        /// Distance of neighbouring dots, m.
        pitch_m: f64 = 0.03,
        /// Radius of the small dots, m; left out: a fifth of the pitch.
        radius_m: Option<f64> = None,
        /// Radius of the large dots, m; left out: 0.32 of the pitch.
        large_radius_m: Option<f64> = None,
        /// Light margin of the plate around the outer centres, m; left out: three quarters of the pitch.
        margin_m: Option<f64> = None,
    }
}

/// The target in the table `table`, where nothing is wrong with it.
pub(super) fn target(table: &str, raw: &RawTarget, check: &mut Validation<'_>) -> Option<Target> {
    let before = check.count_problems();
    let (grid, board, tags) = (&raw.dot_grid, &raw.chessboard, &raw.tags);
    let at = |key: &str| format!("{table}.{key}");
    for (key, length_m) in [
        ("side_m", Some(raw.side_m)),
        ("radius_m", Some(raw.radius_m)),
        ("radius_p1_m", Some(raw.radius_p1_m)),
        ("radius_p2_m", raw.radius_p2_m),
        ("margin_m", Some(raw.margin_m)),
        ("dot_grid.pitch_m", Some(grid.pitch_m)),
        ("dot_grid.radius_m", grid.radius_m),
        ("dot_grid.large_radius_m", grid.large_radius_m),
        ("dot_grid.margin_m", grid.margin_m),
        ("chessboard.square_m", Some(board.square_m)),
        ("chessboard.margin_m", board.margin_m),
        ("tags.size_m", Some(tags.size_m)),
        ("tags.pitch_m", Some(tags.pitch_m)),
        ("tags.margin_m", tags.margin_m),
        ("shape.margin_m", Some(raw.shape.margin_m)),
        ("points.size_m", Some(raw.points.size_m)),
        ("points.margin_m", raw.points.margin_m),
    ] {
        if let Some(length_m) = length_m {
            check.range(&at(key), length_m, LENGTH_M);
        }
    }
    check.count(&at("dot_grid.columns"), grid.columns, DotGrid::COUNT);
    check.count(&at("dot_grid.rows"), grid.rows, DotGrid::COUNT);
    check.count(&at("chessboard.columns"), board.columns, Chessboard::COUNT);
    check.count(&at("chessboard.rows"), board.rows, Chessboard::COUNT);
    check.count(&at("tags.columns"), tags.columns, TAGS);
    check.count(&at("tags.rows"), tags.rows, TAGS);
    check.count(&at("tags.first_id"), tags.first_id, TAG_ID);
    for (i, place) in tags.places.iter().enumerate() {
        let at = format!("{table}.tags.places[{i}]");
        check.count(&format!("{at}.id"), place.id, TAG_ID);
        for (k, m) in place.position_m.iter().enumerate() {
            check.range(&format!("{at}.position_m[{k}]"), *m, -100.0..=100.0);
        }
        check.range(&format!("{at}.turn_rad"), place.turn_rad, -6.3..=6.3);
    }
    let axes = raw.shape.semi_axes_m.iter().flatten().enumerate();
    for (k, m) in axes {
        check.range(&format!("{table}.shape.semi_axes_m[{k}]"), *m, LENGTH_M);
    }
    for (i, corner) in raw.shape.outline_m.iter().enumerate() {
        for (k, m) in corner.iter().enumerate() {
            check.range(&format!("{table}.shape.outline_m[{i}][{k}]"), *m, -100.0..=100.0);
        }
    }
    for (i, face) in raw.points.tags.iter().enumerate() {
        let at = format!("{table}.points.tags[{i}]");
        check.count(&format!("{at}.id"), face.id, TAG_ID);
        check.pose(&at, face.position_m, face.rotation_rpy_rad);
    }
    for (i, face) in raw.points.faces.iter().enumerate() {
        let at = format!("{table}.points.faces[{i}]");
        check.pose(&at, face.position_m, face.rotation_rpy_rad);
        for (k, m) in face.size_m.iter().enumerate() {
            check.range(&format!("{at}.size_m[{k}]"), *m, LENGTH_M);
        }
        for (k, m) in face.dots_m.iter().flatten().enumerate() {
            check.range(&format!("{at}.dots_m[{}][{}]", k / 2, k % 2), *m, -100.0..=100.0);
        }
    }
    if raw.kind == TargetKind::Points && !(raw.points.faces.is_empty() || raw.points.tags.is_empty()) {
        check.wrong(&at("points"), "has both tags and faces with dots: a body has the ones or the others");
    }
    for (key, family) in [("tags.family", &tags.family), ("points.family", &raw.points.family)] {
        if let Err(e) = family.parse::<TagFamily>() {
            check.wrong(&at(key), e.to_string());
        }
    }
    if check.count_problems() > before {
        return None;
    }
    let made = made(table, raw, check);
    if let Some(extent_m) = made.as_ref().map(Target::extent_m).filter(|extent_m| *extent_m > MAX_EXTENT_M) {
        let message = format!(
            "is {extent_m:.1} m large with its plate, which hardly anything is that a camera servoes by: lengths are in m, 25 mm are 0.025"
        );
        check.doubtful(table, message);
    }
    made
}

/// The target with these lengths, which are within their ranges; a target that cannot be built is reported at `key`.
pub(super) fn made(key: &str, raw: &RawTarget, check: &mut Validation<'_>) -> Option<Target> {
    let made = match raw.kind {
        TargetKind::FourDots => FourDots::new(raw.side_m, raw.radius_p1_m, raw.radius_m, raw.margin_m)
            .and_then(|dots| raw.radius_p2_m.map_or(Ok(dots), |radius_m| dots.with_second_radius(radius_m)))
            .map(|dots| dots.light_on_dark(raw.light_on_dark).into()),
        TargetKind::DotGrid => {
            let grid = &raw.dot_grid;
            let or = |given: Option<f64>, share: f64| given.unwrap_or(share * grid.pitch_m);
            DotGrid::new(
                grid.columns as usize,
                grid.rows as usize,
                grid.pitch_m,
                or(grid.radius_m, DotGrid::RADIUS),
                or(grid.large_radius_m, DotGrid::LARGE_RADIUS),
                or(grid.margin_m, DotGrid::MARGIN),
            )
            .map(|grid| grid.light_on_dark(raw.light_on_dark).into())
        }
        TargetKind::Chessboard => {
            let board = &raw.chessboard;
            let margin_m = board.margin_m.unwrap_or(Chessboard::MARGIN * board.square_m);
            Chessboard::new(board.columns as usize, board.rows as usize, board.square_m, margin_m)
                .map(Target::from)
        }
        TargetKind::Tags => tags(&raw.tags).map(Target::from),
        TargetKind::Shape => shape(&raw.shape).and_then(|shape| {
            shape.check_distinct()?;
            Ok(shape.light_on_dark(raw.light_on_dark).into())
        }),
        TargetKind::Points if !raw.points.faces.is_empty() => {
            let of = |face: &RawDotFace| DotFace {
                X_OF: pose(face.position_m, face.rotation_rpy_rad),
                size_m: face.size_m,
                centres_m: face.dots_m.iter().map(|dot| Vector2::from(*dot)).collect(),
            };
            DotBody::new(raw.radius_m, &raw.points.faces.iter().map(of).collect::<Vec<_>>())
                .map(|body| body.light_on_dark(raw.light_on_dark).into())
        }
        TargetKind::Points => points(&raw.points).map(Target::from),
    };
    made.map_err(|e| check.wrong(key, e.to_string())).ok()
}

fn shape(raw: &RawShape) -> Result<Shape, TargetError> {
    match raw.semi_axes_m {
        Some(semi_axes_m) => Shape::ellipse(semi_axes_m, 0.0, raw.margin_m),
        None => {
            let corners: Vec<_> = raw.outline_m.iter().map(|c| Vector2::from(*c)).collect();
            Shape::polygon(&corners, raw.margin_m)
        }
    }
}

fn points(raw: &RawPoints) -> Result<Tags, TargetError> {
    // which was looked at before
    let family = raw.family.parse().unwrap_or(TagFamily::Tag36h11);
    let cell_m = raw.size_m / f64::from(family.cells_per_side());
    let margin_m = raw.margin_m.unwrap_or(Tags::MARGIN_CELLS * cell_m);
    let of = |face: &RawFace| (face.id, pose(face.position_m, face.rotation_rpy_rad));
    Tags::on_faces(family, raw.size_m, margin_m, &raw.tags.iter().map(of).collect::<Vec<_>>())
}

fn tags(raw: &RawTags) -> Result<Tags, TargetError> {
    // which was looked at before
    let family = raw.family.parse().unwrap_or(TagFamily::Tag36h11);
    let cell_m = raw.size_m / f64::from(family.cells_per_side());
    let margin_m = raw.margin_m.unwrap_or(Tags::MARGIN_CELLS * cell_m);
    let place =
        |p: &RawTagPlace| TagPlace { id: p.id, centre_m: Vector2::from(p.position_m), turn_rad: p.turn_rad };
    if raw.places.is_empty() {
        let count = (raw.columns as usize, raw.rows as usize);
        let grid = Tags::grid(family, raw.size_m, count, raw.pitch_m, raw.first_id)?;
        Tags::new(family, raw.size_m, margin_m, grid.tags())
    } else {
        Tags::new(family, raw.size_m, margin_m, &raw.places.iter().map(place).collect::<Vec<_>>())
    }
}

impl RawTarget {
    /// The same target with all lengths times `scale`.
    pub(super) fn scaled(&self, scale: f64) -> Self {
        let grid = &self.dot_grid;
        let times = |given: Option<f64>| given.map(|m| m * scale);
        Self {
            side_m: self.side_m * scale,
            radius_m: self.radius_m * scale,
            radius_p1_m: self.radius_p1_m * scale,
            radius_p2_m: times(self.radius_p2_m),
            margin_m: self.margin_m * scale,
            dot_grid: RawDotGrid {
                pitch_m: grid.pitch_m * scale,
                radius_m: times(grid.radius_m),
                large_radius_m: times(grid.large_radius_m),
                margin_m: times(grid.margin_m),
                ..grid.clone()
            },
            chessboard: RawChessboard {
                square_m: self.chessboard.square_m * scale,
                margin_m: times(self.chessboard.margin_m),
                ..self.chessboard.clone()
            },
            tags: RawTags {
                size_m: self.tags.size_m * scale,
                pitch_m: self.tags.pitch_m * scale,
                margin_m: times(self.tags.margin_m),
                places: self
                    .tags
                    .places
                    .iter()
                    .map(|place| RawTagPlace {
                        position_m: place.position_m.map(|m| m * scale),
                        ..place.clone()
                    })
                    .collect(),
                ..self.tags.clone()
            },
            shape: RawShape {
                outline_m: self.shape.outline_m.iter().map(|c| c.map(|m| m * scale)).collect(),
                semi_axes_m: self.shape.semi_axes_m.map(|axes| axes.map(|m| m * scale)),
                margin_m: self.shape.margin_m * scale,
            },
            points: RawPoints {
                size_m: self.points.size_m * scale,
                margin_m: times(self.points.margin_m),
                tags: self
                    .points
                    .tags
                    .iter()
                    .map(|face| RawFace { position_m: face.position_m.map(|m| m * scale), ..face.clone() })
                    .collect(),
                faces: self
                    .points
                    .faces
                    .iter()
                    .map(|face| RawDotFace {
                        position_m: face.position_m.map(|m| m * scale),
                        size_m: face.size_m.map(|m| m * scale),
                        dots_m: face.dots_m.iter().map(|dot| dot.map(|m| m * scale)).collect(),
                        ..face.clone()
                    })
                    .collect(),
                ..self.points.clone()
            },
            ..self.clone()
        }
    }
}
