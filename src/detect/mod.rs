//! From a grey frame to the four dots of the target, each with its identity.
//!
//! ```text
//! whole frame:  threshold -> regions -> ellipses with contrast -> four that form the target, P1 the larger
//! tracking:     windows around the expected dots -> regions -> the same check
//! both:         grey-level centroids, with their standard deviation
//! ```
//! All positions are pixels of the distorted image. [`centre_offset`] tells how far the centroid of a dot's image
//! lies from the image of its centre.

mod blob;
mod detector;
mod dot;
mod identity;
mod offset;
mod sums;

pub use detector::{Detector, Expected};
pub use dot::Dot;
pub use offset::{centre_offset, dot_covariance_px2};
