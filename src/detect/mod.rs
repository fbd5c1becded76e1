//! From a grey frame to the points of the target, each with its identity.
//!
//! ```text
//! whole frame:  threshold -> regions -> ellipses with contrast -> those that form the target: four_dots, dot_grid
//! tracking:     windows around the expected dots -> regions -> the same check
//! both:         grey-level centroids, with their standard deviation
//! ```
//! All positions are pixels of the distorted image. [`centre_offset`] tells how far the centroid of a dot's image
//! lies from the image of its centre.

mod blob;
mod dot;
mod dot_grid;
mod finder;
mod four_dots;
mod offset;
mod sums;

pub use dot::Found;
pub use finder::{Expected, Finder};
pub use offset::{centre_offset, dot_covariance_px2};
