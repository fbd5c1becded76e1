//! Image processing of Sect. 10.2 on 8-bit grey images.
mod view;
pub use view::{ImageSizeError, ImageView};
