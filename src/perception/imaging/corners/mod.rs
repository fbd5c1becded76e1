//! Feature points: where four squares meet (ring response), where edges of any kind meet (structure tensor), and where exactly.
//!
//! ```text
//! image --ring--> response --ring_corners--> RingCorner, some tenths of a pixel --corner_fit--> CornerFit, hundredths, with covariance
//! ```

mod corner_fit;
mod corner_model;
mod half;
mod lane;
mod ring;
mod ring_corners;
mod structure;

pub use corner_fit::{CornerFit, CornerFitter, CornerGuess};
pub(crate) use half::halve;
pub use ring::{RING, RING_RADIUS_PX, RingResponse};
pub use ring_corners::{RingCorner, RingDetector};
pub use structure::{StructureCorner, StructureDetector};
