//! What is looked for, without pixels: points with ids and places on the object, and what is drawn of it.
//!
//! ```text
//!          points (id, p_O) ──► detect, vision, set-points: everything joins by id
//! Target ──┤
//!          marks, plate ──────► scene: what the synthetic camera draws; print: a sheet in true size
//! ```
//! Most targets are plates: their points lie in z_O = 0, and z_O points away from the camera that looks at them. Tags and dots may lie on the faces
//! of a body too; a face that is turned away is not seen.

mod chessboard;
mod dot_body;
mod dot_grid;
mod error;
mod four_dots;
mod kind;
mod mark;
mod shape;
mod tag_family;
mod tags;

pub use chessboard::Chessboard;
pub use dot_body::{DotBody, DotFace};
pub use dot_grid::DotGrid;
pub use error::TargetError;
pub use four_dots::FourDots;
pub use kind::{Kind, KindError, MAX_EXTENT_M};
pub use mark::{ClosedOutline, Disc, Mark, Plate};
pub use shape::Shape;
pub use tag_family::{TagCell, TagFamily, UnknownTagFamily};
pub use tags::{TagPlace, Tags};

use crate::geometry::Pose;
use crate::messages::MAX_FEATURES;
use nalgebra::Point3;

/// One point of a target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TargetPoint {
    /// Its name in measurements and set-points: its index in the target's list.
    pub id: u32,
    /// Its place in the object frame, m.
    pub p_O: Point3<f64>,
}

/// How a target may be turned or mirrored without looking different.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Symmetry {
    /// Turns about its normal, within a full one, after which it looks the same; 1: none but the full one, `u32::MAX`: all.
    pub turns: u32,
    /// It looks like a mirror image of itself: seen in a mirror it is taken for what it is not.
    pub mirrored: bool,
}

/// A flat part of a target.
#[derive(Debug, Clone, PartialEq)]
pub struct Sheet {
    /// Its frame in that of the object; its plate and its marks lie in the plane z_S = 0.
    pub X_OS: Pose,
    /// What it is drawn on.
    pub plate: Plate,
    /// What is drawn.
    pub marks: Vec<Mark>,
    /// Whether it is a face of a body, which hides it from behind.
    pub is_face: bool,
}

/// The kinds of targets.
#[derive(Debug, Clone, PartialEq)]
pub enum Target {
    /// Four dots at the corners of a square, one of them larger (Fig. 10.6).
    FourDots(FourDots),
    /// Dots in rows and columns, identified by the large ones among them; also usable where it is partly hidden.
    DotGrid(DotGrid),
    /// Dots on the faces of a body, identified by how they lie to each other.
    DotBody(DotBody),
    /// Dark and light squares by turns.
    Chessboard(Chessboard),
    /// AprilTags.
    Tags(Tags),
    /// A free outline.
    Shape(Shape),
}

/// What the points of a target are, as people call them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PointKind {
    /// Middles of dots.
    Dots,
    /// Inner corners of a chessboard.
    BoardCorners,
    /// Corners of tags.
    TagCorners,
    /// Corners or edges of an outline.
    Outline,
}

/// Calls a method that all kinds have.
macro_rules! each {
    ($target:expr, $name:ident => $call:expr) => {
        match $target {
            Target::FourDots($name) => $call,
            Target::DotGrid($name) => $call,
            Target::DotBody($name) => $call,
            Target::Chessboard($name) => $call,
            Target::Tags($name) => $call,
            Target::Shape($name) => $call,
        }
    };
}

impl Target {
    /// What its points are.
    #[must_use]
    pub fn point_kind(&self) -> PointKind {
        match self {
            Self::FourDots(_) | Self::DotGrid(_) | Self::DotBody(_) => PointKind::Dots,
            Self::Chessboard(_) => PointKind::BoardCorners,
            Self::Tags(_) => PointKind::TagCorners,
            Self::Shape(_) => PointKind::Outline,
        }
    }

    /// How large it is: the longer side of what it is drawn on, m.
    #[must_use]
    pub fn extent_m(&self) -> f64 {
        let plate = self.plate();
        (plate.high_m - plate.low_m).max()
    }

    /// Its points, ids rising.
    #[must_use]
    pub fn points(&self) -> &[TargetPoint] {
        each!(self, target => target.points())
    }

    /// What is drawn on a plate; of dots, mark `i` about point `i`. Of a body with dots nothing: [`Self::sheets`] tells what is on each face.
    #[must_use]
    pub fn marks(&self) -> Vec<Mark> {
        let drawn = |discs: &[Disc]| discs.iter().copied().map(Mark::Disc).collect();
        match self {
            Self::FourDots(target) => drawn(target.discs()),
            Self::DotGrid(target) => drawn(target.discs()),
            Self::DotBody(_) => Vec::new(),
            Self::Chessboard(target) => target.marks(),
            Self::Tags(target) => target.marks(),
            Self::Shape(target) => vec![target.mark().clone()],
        }
    }

    /// The dots of a plate that is made of dots, disc `i` about point `i`; empty for others.
    #[must_use]
    pub fn discs(&self) -> &[Disc] {
        match self {
            Self::FourDots(target) => target.discs(),
            Self::DotGrid(target) => target.discs(),
            Self::DotBody(_) | Self::Chessboard(_) | Self::Tags(_) | Self::Shape(_) => &[],
        }
    }

    /// Dot `i` of a target that is made of dots: the frame of the plate or face that it is on, X_OF, and its disc in that frame's plane.
    #[must_use]
    pub fn dot(&self, i: usize) -> Option<(Pose, Disc)> {
        match self {
            Self::DotBody(body) => body.dot(i),
            plate => plate.discs().get(i).map(|disc| (Pose::identity(), *disc)),
        }
    }

    /// The largest radius of its dots, m; 0 of a target without any.
    #[must_use]
    pub fn dot_radius_m(&self) -> f64 {
        (0..self.points().len()).map_while(|i| self.dot(i)).map(|(_, disc)| disc.radius_m).fold(0.0, f64::max)
    }

    /// What it is drawn on.
    #[must_use]
    pub fn plate(&self) -> Plate {
        each!(self, target => target.plate())
    }

    /// Its flat parts: one of a plate, one for each face of a body.
    #[must_use]
    pub fn sheets(&self) -> Vec<Sheet> {
        if let Self::DotBody(body) = self {
            return body.sheets();
        }
        if let Self::Tags(tags) = self
            && !tags.faces().is_empty()
        {
            let of = |(X_OS, mark): (&Pose, Mark)| Sheet {
                X_OS: *X_OS,
                plate: tags.face_plate(),
                marks: vec![mark],
                is_face: true,
            };
            return tags.faces().iter().zip(tags.marks()).map(of).collect();
        }
        let (plate, marks) = (self.plate(), self.marks());
        vec![Sheet { X_OS: Pose::identity(), plate, marks, is_face: false }]
    }

    /// Whether all of its points lie in the plane z_O = 0.
    #[must_use]
    pub fn is_flat(&self) -> bool {
        self.points().iter().all(|point| point.p_O.z == 0.0)
    }

    /// Whether point `i` is on a side that is turned towards a camera that has the target at `X_CO`; of a plate that is not asked.
    #[must_use]
    pub fn is_turned_to_camera(&self, i: usize, X_CO: &Pose) -> bool {
        match self {
            Self::Tags(tags) => tags.is_turned_to_camera(i, X_CO),
            Self::DotBody(body) => body.is_turned_to_camera(i, X_CO),
            Self::FourDots(_) | Self::DotGrid(_) | Self::Chessboard(_) | Self::Shape(_) => true,
        }
    }

    /// How it may be turned or mirrored without looking different.
    #[must_use]
    pub fn symmetry(&self) -> Symmetry {
        each!(self, target => target.symmetry())
    }

    /// Fewest points by which it can be found in a whole frame.
    #[must_use]
    pub fn min_to_find(&self) -> usize {
        match self {
            Self::FourDots(_) => 4,
            Self::DotGrid(grid) => grid.min_to_find(),
            Self::DotBody(_) => DotBody::LEAST,
            Self::Chessboard(_) => 9,
            Self::Tags(_) => 4,
            Self::Shape(shape) => shape.points().len(),
        }
    }

    /// Which of its points serve as features, by their index: all of them, or of too many every second, third ... of each row
    /// and column, so that a measurement carries them.
    pub fn features(&self) -> impl Iterator<Item = &TargetPoint> + Clone {
        let (columns, stride) = match self {
            // of every so manieth tag all corners
            Self::Tags(target) => (4, (target.points().len()).div_ceil(MAX_FEATURES)),
            Self::FourDots(_) | Self::DotBody(_) | Self::Shape(_) => (MAX_FEATURES, 1),
            Self::DotGrid(grid) => (grid.columns(), grid.feature_stride()),
            Self::Chessboard(board) => (board.columns(), board.feature_stride()),
        };
        let all_of_a_row = matches!(self, Self::Tags(_));
        let serves = move |(i, _): &(usize, &TargetPoint)| {
            (i / columns).is_multiple_of(stride) && (all_of_a_row || (i % columns).is_multiple_of(stride))
        };
        self.points().iter().enumerate().filter(serves).map(|(_, point)| point)
    }
}

/// Every how many of `columns` and `rows` a point serves as feature, so that a measurement carries them all.
fn stride(columns: usize, rows: usize) -> usize {
    let count = |stride: usize| columns.div_ceil(stride) * rows.div_ceil(stride);
    (1..).find(|stride| count(*stride) <= MAX_FEATURES).unwrap_or(1)
}

macro_rules! from {
    ($($kind:ident),*) => {$(
        impl From<$kind> for Target {
            fn from(target: $kind) -> Self {
                Self::$kind(target)
            }
        }
    )*};
}

from!(FourDots, DotGrid, DotBody, Chessboard, Tags, Shape);
