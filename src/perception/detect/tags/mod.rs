//! Tags of the AprilTag families in a frame: id, sub-pixel corners and their covariance.
//!
//! Data flow; the second row names the modules:
//!
//! ```text
//! frame -> dark pixels by tiles -> regions -> outlines -> quadrilaterals -> bits -> tag -> sub-pixel corners
//!          imaging's LocalThreshold, Runs, Components, Outlines
//!                                             finder      quad              decode, codebook  edges
//!          cells narrower than six blurs: a model of the whole tag is fitted instead of its sides      whole, whole_model
//!          wider ones: the common shift of all edges, by the camera's response or the print            edge_growth
//!          where levels are alike as noise does not make them (likeness): a model of the whole tag, and what its parts pull   pulls
//!          the choice between these: best_corners
//! tracking: the same in windows about the expected tags
//! ```
//! All positions are pixels of the distorted image.
//!
//! # Terms
//!
//! | term | meaning |
//! | --- | --- |
//! | cell | One square of a tag's grid, black or white; a bit of its code, or a part of the border. |
//! | border, margin | The ring of black cells around the bits; the white ring, one cell wide, around the border. |
//! | ink, paper | The levels of black and of white cells, grey levels. |
//! | ground | What lies beyond the margin. |
//! | side | One of the four outer edges of the black border, from which the corners are computed. |
//! | blur | Standard deviation of the point spread, the pixel's own square included, px; "six blurs" is six times as much. |
//! | growth | The distance, px, by which light areas appear too large on each of their edges (gamma, spread of light, print). |
//! | clipped | Paper at the last grey level, whose true lightness is unknown. |
//! | stated | The covariance that is reported with a corner. |

mod best_corners;
mod clipped;
mod codebook;
mod decode;
mod edge_growth;
mod edges;
mod finder;
mod level_curve;
mod level_sums;
mod likeness;
mod pattern;
mod plane_map;
mod plate;
mod points;
mod pulls;
mod quad;
mod shine;
mod side;
mod whole;
mod whole_model;

pub use finder::{MAX_TAGS, PredictedTag, TagDetection, TagFinder, TagMiss};
pub use plate::TagPlateFinder;
pub use points::TagPoints;
