//! Why a set of camera parameters is refused.

use super::Region;
use thiserror::Error;

/// The longest telephoto lens, 5 m, before the smallest pixels, 0.5 um: what is larger must be a slip.
pub(super) const LONGEST_FOCAL_PX: f64 = 1e7;
/// Principal points and coefficients that are further from zero than this belong to no lens, and to no finite computation: chosen
/// to be the largest focal length.
pub(super) const MAX_NUMBER: f64 = 1e7;

/// Camera parameters that describe no usable camera.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum CameraModelError {
    /// A parameter is NaN, infinite, or larger than that of any camera.
    #[error("camera: {name} is {value:?}; give a number between -{MAX_NUMBER:e} and {MAX_NUMBER:e}")]
    NotFinite {
        /// Which parameter.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// A focal length is zero, negative, or longer than any.
    #[error(
        "camera: {name} is {value_px:?} px; a focal length must be greater than zero and at most {LONGEST_FOCAL_PX:e} px"
    )]
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
         normalized radius {fold_radius:.4}, the pixel lies at {radius:.4}; check the signs, the model and the order of the coefficients"
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
    /// A region that is no part of the image.
    #[error(
        "camera: the region {region} is not inside the image of {width_px}x{height_px} px; give it at least one pixel, and none \
         outside"
    )]
    Region {
        /// The region.
        region: Region,
        /// Columns of the image.
        width_px: u32,
        /// Rows of the image.
        height_px: u32,
    },
}
