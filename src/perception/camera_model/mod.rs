//! The camera: perspective (5.41)-(5.45) with a lens as ROS and OpenCV describe it.
//!
//! ```text
//! p_C (m) --/z--> s = (X, Y), normalized (10.3) --lens--> s' --Omega--> pixel (u, v)
//! u = fx X' + cx,  v = fy Y' + cy,  r = |s|
//!
//! plumb_bob            s' = s (1 + k1 r^2 + k2 r^4 + k3 r^6) + t,  t = [2 p1 X Y + p2 (r^2 + 2 X^2), p1 (r^2 + 2 Y^2) + 2 p2 X Y]
//! rational_polynomial  s' = s (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6) + t
//! equidistant          s' = s / r (a + k1 a^3 + k2 a^5 + k3 a^7 + k4 a^9),  a = atan r: up to 89 degrees from the axis
//! ```
//! Pixel centres lie on integer coordinates, so an image covers `-0.5 .. width - 0.5`.

pub mod camera_info;
mod distortion;
mod equidistant;
mod error;
mod lens;
mod model;
mod rational;
mod region;
mod response;
mod roots;

pub use distortion::Distortion;
pub use equidistant::Equidistant;
pub use error::CameraModelError;
pub use lens::{Lens, LensModel};
pub use model::{CameraModel, Intrinsics};
pub use rational::RationalPolynomial;
pub use region::Region;
pub use response::{LevelTable, Response};
