//! The camera: perspective (5.41)-(5.45) with the lens distortion that ROS and OpenCV call `plumb_bob`.
//!
//! ```text
//! p_C (m) --/z--> s = (X, Y), normalized (10.3) --distortion--> s' --Omega--> pixel (u, v)
//! s' = s (1 + k1 r^2 + k2 r^4 + k3 r^6) + [2 p1 X Y + p2 (r^2 + 2 X^2), p1 (r^2 + 2 Y^2) + 2 p2 X Y]
//! u = fx X' + cx,  v = fy Y' + cy,  r = |s|
//! ```
//! Pixel centres lie on integer coordinates, so an image covers `-0.5 .. width - 0.5`.

mod distortion;
mod error;
mod model;

pub use distortion::Distortion;
pub use error::CameraModelError;
pub use model::{CameraModel, Intrinsics};
