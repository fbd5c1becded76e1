//! Targets made of dots: the square of four dots, grids, and bodies with dots on their faces.
//!
//! Data flow:
//!
//! ```text
//! whole frame:  threshold -> regions -> ellipses with contrast -> those that form the target: four_dots, dot_grid, body
//! tracking:     windows around the expected dots -> regions -> the same check
//! both:         grey-level centroids, with their standard deviation
//! ```
//! [`centre_offset`] computes the bias of a centroid: the offset of the centroid of a dot's image from the projection of its centre.
//!
//! Terms: a *region* is a connected set of dark pixels; a *blob* is its ellipse by second moments; the *plate* is the light ground around the dots; the
//! *ring* of a dot is a set of sample points on the plate around it; the *rim* is its border; the *light* is the level of the plate as a smooth
//! function of position.

mod blob;
mod body;
mod clipped;
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
