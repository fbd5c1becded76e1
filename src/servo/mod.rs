//! The servo laws of Sects. 10.6 to 10.8: from what the camera sees to joint velocities.
//!
//! ```text
//! Measurement ─► e_s = s_d - s ─► normal equations of (10.91) ─┬─► qd_r, held           (update = frame)
//!                                                             └─► held, qd_r from J(q) (update = tick)
//! ```

mod image_velocity;
mod set_point;

pub use image_velocity::{ImageTask, joint_velocity};
pub use set_point::SetPoint;
