//! Image processing of Sect. 10.2 on 8-bit grey images, and the way to grey from what cameras deliver.
//!
//! ```text
//! a camera's buffer --grey, jpeg--> ImageView
//! ImageView --> Histogram --> Otsu threshold --> dark runs of each row --> components with moments
//! ```
mod components;
pub mod grey;
mod histogram;
pub mod jpeg;
mod mask;
mod runs;
mod view;

pub use components::{Component, Components, Connectivity, PrincipalAxes};
pub use histogram::{Histogram, Otsu, PairCounter};
pub use runs::{LocalThreshold, Run, Runs, Window};
pub use view::{ImageSizeError, ImageView};
