//! The servo laws of Sects. 10.6 to 10.8: from what the camera sees to what the joints shall do.
//!
//! ```text
//! Measurement ─► View ─► Law::task: e_s = s_d - s, normal equations ─► Law::wish: joint velocity ─► reference
//!                │ frame:   task and wish once for a measurement, held
//!                │ tick:    task once, wish at every tick with the newest J(q)
//!                └ predict: view carried to now by the arm's own motion, task and wish at every tick
//! ```

mod image_velocity;
mod law;
mod set_point;
mod view;
mod visual_servo;

pub use image_velocity::{DepthSource, ImageTask, joint_velocity};
pub use law::{Arm, Law, Task, Wish};
pub use set_point::SetPoint;
pub use view::View;
pub use visual_servo::{Intake, UpdatePolicy, VisualServo};
