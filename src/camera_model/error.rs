//! Why a set of camera parameters is refused.

use thiserror::Error;

/// Camera parameters that describe no usable camera.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum CameraModelError {
    /// A parameter is NaN or infinite.
    #[error("camera: {name} is {value}; give a finite number")]
    NotFinite {
        /// Which parameter.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// A focal length is zero or negative.
    #[error("camera: {name} is {value_px} px; a focal length must be greater than zero")]
    FocalLength {
        /// Which parameter.
        name: &'static str,
        /// Its value.
        value_px: f64,
    },
    /// The image is empty, or larger than 65536 px a side.
    #[error("camera: the image is {width_px}x{height_px} px; each side must be 1..=65536")]
    ImageSize {
        /// Columns.
        width_px: u32,
        /// Rows.
        height_px: u32,
    },
    /// The distortion folds inside the image: two directions share one pixel, and no inverse exists.
    #[error(
        "camera: the lens distortion cannot be inverted at pixel ({u_px:.1}, {v_px:.1}): it folds at the distorted \
         normalized radius {fold_radius:.4}, the pixel lies at {radius:.4}; check the signs and the order k1 k2 p1 p2 k3"
    )]
    Folded {
        /// Column of the first pixel found without an inverse.
        u_px: f64,
        /// Row of that pixel.
        v_px: f64,
        /// Distorted normalized radius of that pixel.
        radius: f64,
        /// Distorted normalized radius at which the radial part turns back; infinite when only the
        /// tangential part folds.
        fold_radius: f64,
    },
}
