//! Targets made of dots: four dots, grids.
//!
//! ```text
//! whole frame:  threshold -> regions -> ellipses with contrast -> those that form the target: four_dots, dot_grid
//! tracking:     windows around the expected dots -> regions -> the same check
//! both:         grey-level centroids, with their standard deviation
//! ```
//! [`centre_offset`] tells how far the centroid of a dot's image lies from the image of its centre.

mod blob;
mod dot;
mod dot_grid;
mod ellipse;
mod fill;
mod finder;
mod four_dots;
mod light;
mod noise;
mod offset;
mod rims;
mod ring;
mod search;
mod sums;
mod turns;
mod unit_square;

pub use finder::DotFinder;
pub use offset::{centre_offset, dot_covariance_px2};
