//! What a cell can find out about itself from the motion of its own arm.
//!
//! ```text
//! control: GentleMotion instead of the servo law ─► JointStates ──┐
//! vision:                                          Measurements ──┴─► Recording ─► stamp_offset
//! ```
//! `vservo calibrate latency`: the offset between the camera's stamps and the encoders'. `vservo calibrate hand-eye`: where the camera
//! sits, [`hand_eye`].

mod gentle_motion;
pub mod hand_eye;
mod joint_track;
mod latency;
mod recording;

pub use gentle_motion::{GentleMotion, image_reach};
pub use joint_track::JointTrack;
pub use latency::{KnownCell, LatencyError, StampOffset, stamp_offset};
pub use recording::{Recording, SeenTarget};
