//! Tags of the AprilTag families in a frame: which, where, and how sure.
//!
//! ```text
//! frame -> dark pixels by tiles -> regions -> outlines -> quadrilaterals -> bits -> tag -> sub-pixel corners
//!          imaging's LocalThreshold, Runs, Components, Outlines
//!                                             finder      quad              decode, codebook  edges
//!          cells narrower than six blurs: the whole tag at once instead of its sides                  whole, whole_model
//!          wider ones: what all edges show that light areas have grown by                             edge_growth
//! tracking: the same in windows about the expected tags
//! ```
//! All positions are pixels of the distorted image.

mod codebook;
mod decode;
mod edge_growth;
mod edges;
mod finder;
mod level_curve;
mod pattern;
mod plane_map;
mod plate;
mod points;
mod quad;
mod shine;
mod side;
mod whole;
mod whole_model;

pub use finder::{MAX_TAGS, TagExpected, TagFinder, TagFound, TagMiss};
pub use plate::TagPlateFinder;
pub use points::TagPoints;
