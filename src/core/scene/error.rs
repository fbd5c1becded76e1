//! Why a scene is refused.

use std::ops::RangeInclusive;
use thiserror::Error;

/// A look or sensor that cannot be rendered.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum SceneError {
    /// A parameter lies outside its range, or is not a number.
    #[error("scene: {name} is {value}; it must lie in {low}..={high}")]
    Range {
        /// Which parameter.
        name: &'static str,
        /// Its value.
        value: f64,
        /// Least value allowed.
        low: f64,
        /// Greatest value allowed.
        high: f64,
    },
    /// The camera's image is larger than the renderer handles.
    #[error("scene: the image is {width_px}x{height_px} px; at most 4096x4096 can be rendered")]
    ImageSize {
        /// Columns.
        width_px: u32,
        /// Rows.
        height_px: u32,
    },
}

/// Checks that `value` is one of the `allowed` ones.
pub(super) fn in_range(
    name: &'static str,
    value: f64,
    allowed: &RangeInclusive<f64>,
) -> Result<(), SceneError> {
    let (low, high) = (*allowed.start(), *allowed.end());
    if allowed.contains(&value) { Ok(()) } else { Err(SceneError::Range { name, value, low, high }) }
}
