//! An occluder: a sheet that is in front of the target for some time.

use crate::time::SpanNs;
use nalgebra::Vector2;

/// A sheet parallel to the object's plane: it covers what lies behind it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Occluder {
    /// Its middle along x_o and y_o, m.
    pub centre_m: Vector2<f64>,
    /// Its sides along x_o and y_o, m.
    pub size_m: Vector2<f64>,
    /// How far it lies in front of the object's plane, on the side that shows the dots, m.
    pub height_m: f64,
    /// Its grey level, 0..=255.
    pub level: f64,
    /// When it comes, since the first tick.
    pub from: SpanNs,
    /// When it goes.
    pub until: SpanNs,
}

impl Occluder {
    /// Whether it is there at a time since the first tick.
    #[must_use]
    pub fn is_there(&self, since: SpanNs) -> bool {
        since >= self.from && since < self.until
    }

    /// Least and greatest x_o and y_o, m.
    pub(super) fn corners_m(&self) -> (Vector2<f64>, Vector2<f64>) {
        (self.centre_m - self.size_m * 0.5, self.centre_m + self.size_m * 0.5)
    }
}
