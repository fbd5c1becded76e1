//! An occluder: a sheet that is in front of the target for some time.

use crate::time::SpanNs;
use nalgebra::{Point3, Vector2};

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

    /// Whether it hides the point `p_O` from a camera at `camera_O`, both in O, m.
    #[must_use]
    pub fn hides(&self, camera_O: &Point3<f64>, p_O: &Point3<f64>) -> bool {
        // Where the ray from the camera to the point meets the sheet, as a share of it.
        let share = (-self.height_m - camera_O.z) / (p_O.z - camera_O.z);
        let foot = (camera_O + (p_O - camera_O) * share).coords.xy() - self.centre_m;
        let is_between = share > 0.0 && share <= 1.0;
        is_between && foot.x.abs() <= 0.5 * self.size_m.x && foot.y.abs() <= 0.5 * self.size_m.y
    }

    /// Least and greatest x_o and y_o, m.
    pub(super) fn corners_m(&self) -> (Vector2<f64>, Vector2<f64>) {
        (self.centre_m - self.size_m * 0.5, self.centre_m + self.size_m * 0.5)
    }
}
