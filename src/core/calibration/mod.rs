//! What a cell can find out about itself: from the motion of its own arm, and from images of a board.
//!
//! ```text
//! control: the excitation motion instead of the servo law ─► JointStates ──┐
//! vision:                                          Measurements ──┴─► Recording ─► stamp_offset
//! ```
//! `vservo calibrate latency`: the offset between the camera's stamps and the encoders'. `vservo calibrate hand-eye`: where the camera
//! sits, [`hand_eye`]. `vservo calibrate load`: what the flange carries, from torques, [`load`].
//! `vservo calibrate from`: lens, mount, stamps and size of the target from what a run has seen, [`from_run`].
//!
//! And what images of a board tell about cameras, Sect. 10.5:
//!
//! ```text
//! corners of a board ─► camera (one lens, how good it is)  ─► camera_info
//!                    └► stereo (two, and where they are to each other)        bundle: the joint least squares under both
//! ```

pub mod bundle;
pub mod camera;
pub mod from_run;
pub mod hand_eye;
mod image_reach;
mod joint_track;
mod latency;
mod lens_check;
pub mod load;
mod recording;
mod response;
pub mod stereo;

pub use image_reach::image_reach;
pub use joint_track::JointTrack;
pub use latency::{KnownCell, LatencyError, StampOffset, stamp_offset};
pub use lens_check::{LensDifference, LensView, lens_differences};
pub use recording::{Recording, TargetDetection};
pub use response::{GammaEstimate, ResponseEvidence};
