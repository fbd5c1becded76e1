//! From a grey frame to the points of the target, each with its identity.
//!
//! ```text
//! frame ─► Finder: search of the whole frame, or tracking where points are Expected ─► Found, by id
//!            ├ dots: four dots, grids of dots
//!            ├ chessboard: corners of squares, also of a part
//!            ├ tags: corners of tags
//!            └ shape: the outline of a polygon or an ellipse
//! ```
//! [`segments`] and [`ellipse`] find straight edges and ellipses by their rims, without a target.
//!
//! All positions are pixels of the distorted image.

pub mod chessboard;
mod dots;
pub mod ellipse;
mod finder;
mod found;
pub mod segments;
pub mod shape;
pub mod tags;

pub use dots::{DotFinder, centre_offset, dot_covariance_px2};
pub use finder::Finder;
pub use found::{Expected, Found};
