//! Points of a target in a frame: detections ([`Detection`]) and predictions ([`PredictedPoint`]). Pixels of the distorted image.

use nalgebra::Vector2;

/// Detection of one point of the target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Detection {
    /// Which point.
    pub id: u32,
    /// Position in the distorted image, px: the centroid of its dot, or the corner.
    pub px: Vector2<f64>,
    /// One standard deviation of each coordinate of `px`, px.
    pub sd_px: f64,
    /// Area of its dot, square, tag or shape in the image, px^2.
    pub area_px2: f64,
    /// Second moments `[xx, xy, yy]` of the image of its dot, square or shape about the centroid, px^2; of a tag's corner the covariance of its position.
    pub covariance_px2: [f64; 3],
    /// Grey level of the dot.
    pub dark_level: f64,
    /// Grey level of the plate around it.
    pub plate_level: f64,
    /// Bound on the shift of `px` by something dark beside the dot (the edge of a shadow, a neighbour), px.
    pub disturbance_px: f64,
}

/// Prediction of a point of the target: its position, and the ellipse of its dot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PredictedPoint {
    /// Which point.
    pub id: u32,
    /// Centroid, px.
    pub px: Vector2<f64>,
    /// Second moments `[xx, xy, yy]` of its dot's image about the centroid, px^2.
    pub covariance_px2: [f64; 3],
    /// Area, px^2.
    pub area_px2: f64,
    /// Largest error of the prediction for which the window allows, px.
    pub slack_px: f64,
    /// Greatest grey level that counts as dark.
    pub threshold: u8,
}
