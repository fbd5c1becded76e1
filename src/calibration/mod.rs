//! What a cell can find out about itself from the motion of its own arm.
//!
//! ```text
//! control: GentleMotion instead of the servo law ─► JointStates ──┐
//! vision:                                          Measurements ──┴─► Recording ─► stamp_offset
//! ```
//! `vservo calibrate latency`: the offset between the camera's stamps and the encoders'.

mod gentle_motion;
mod joint_track;
mod latency;
mod recording;

pub use gentle_motion::{GentleMotion, image_reach};
pub use joint_track::JointTrack;
pub use latency::{KnownCell, LatencyError, StampOffset, stamp_offset};
pub use recording::{Recording, SeenTarget};
