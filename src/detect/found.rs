//! Points of a target in a frame: as they are found, and as they are expected.

use nalgebra::Vector2;

/// One point of the target, found and measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Found {
    /// Which point.
    pub id: u32,
    /// Centroid of its dot in the distorted image, px.
    pub px: Vector2<f64>,
    /// One standard deviation of each coordinate of `px`, px.
    pub sd_px: f64,
    /// Area, px^2.
    pub area_px2: f64,
    /// Covariance `[xx, xy, yy]` of a point uniform in the dot's image, px^2.
    pub covariance_px2: [f64; 3],
    /// Grey level of the dot.
    pub dark_level: f64,
    /// Grey level of the plate around it.
    pub plate_level: f64,
    /// How far what is dark on the plate around it, on one side more than on the other, may have moved `px`: a shadow's
    /// edge, a neighbour; px.
    pub disturbance_px: f64,
}

/// Where a point of the target should be, and how its dot should look.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expected {
    /// Which point.
    pub id: u32,
    /// Centroid, px.
    pub px: Vector2<f64>,
    /// Covariance `[xx, xy, yy]` of a point uniform in its image, px^2.
    pub covariance_px2: [f64; 3],
    /// Area, px^2.
    pub area_px2: f64,
    /// How far off the prediction may be, px.
    pub slack_px: f64,
    /// Greatest level that counts as dark.
    pub threshold: u8,
}
