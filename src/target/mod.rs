//! What is looked for, without pixels: points with ids and places on the object, and what is drawn of it.
//!
//! ```text
//!          points (id, p_O) ──► detect, vision, set-points: everything joins by id
//! Target ──┤
//!          marks, plate ──────► scene: what the synthetic camera draws
//! ```
//! All targets of today are plates: their points lie in z_O = 0, and z_O points away from the camera that looks at them.

mod dot_grid;
mod four_dots;

pub use dot_grid::DotGrid;
pub use four_dots::{FourDots, TargetError};

use crate::messages::MAX_FEATURES;
use nalgebra::{Point3, Vector2};

/// One point of a target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TargetPoint {
    /// Its name in measurements and set-points: its index in the target's list.
    pub id: u32,
    /// Its place in the object frame, m.
    pub p_O: Point3<f64>,
}

/// A dark disc on the plate, drawn about a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mark {
    /// Centre in the object's plane, m.
    pub centre_m: Vector2<f64>,
    /// Radius, m.
    pub radius_m: f64,
}

/// The light plate: a rectangle along x_o and y_o.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plate {
    /// Least x_o and y_o, m.
    pub low_m: Vector2<f64>,
    /// Greatest x_o and y_o, m.
    pub high_m: Vector2<f64>,
}

/// The kinds of targets.
#[derive(Debug, Clone, PartialEq)]
pub enum Target {
    /// Four dots at the corners of a square, one of them larger (Fig. 10.6).
    FourDots(FourDots),
    /// Dots in rows and columns, told apart by the large ones among them; serves also where it is partly hidden.
    DotGrid(DotGrid),
}

impl Target {
    /// Its points, ids rising.
    #[must_use]
    pub fn points(&self) -> &[TargetPoint] {
        match self {
            Self::FourDots(target) => target.points(),
            Self::DotGrid(target) => target.points(),
        }
    }

    /// What is drawn, mark `i` about point `i`.
    #[must_use]
    pub fn marks(&self) -> &[Mark] {
        match self {
            Self::FourDots(target) => target.marks(),
            Self::DotGrid(target) => target.marks(),
        }
    }

    /// What it is drawn on.
    #[must_use]
    pub fn plate(&self) -> Plate {
        match self {
            Self::FourDots(target) => target.plate(),
            Self::DotGrid(target) => target.plate(),
        }
    }

    /// Fewest points by which it can be found in a whole frame.
    #[must_use]
    pub fn least_to_find(&self) -> usize {
        match self {
            Self::FourDots(_) => 4,
            Self::DotGrid(grid) => grid.window() * grid.window(),
        }
    }

    /// Which of its points serve as features, by their index: all of them, or of too many every second, third ... of each row
    /// and column, so that a measurement carries them.
    pub fn features(&self) -> impl Iterator<Item = &TargetPoint> + Clone {
        let (columns, stride) = match self {
            Self::FourDots(_) => (MAX_FEATURES, 1),
            Self::DotGrid(grid) => (grid.columns(), grid.feature_stride()),
        };
        let serves = move |(i, _): &(usize, &TargetPoint)| {
            (i / columns).is_multiple_of(stride) && (i % columns).is_multiple_of(stride)
        };
        self.points().iter().enumerate().filter(serves).map(|(_, point)| point)
    }
}

impl From<FourDots> for Target {
    fn from(target: FourDots) -> Self {
        Self::FourDots(target)
    }
}

impl From<DotGrid> for Target {
    fn from(target: DotGrid) -> Self {
        Self::DotGrid(target)
    }
}
