//! What computes a run: the crate `vservo-core`, whose modules `vservo` shows under its own name.
//!
//! From a measurement to what an arm is commanded (`vision`, `servo`, `motion`, `control`, `mission`, `drive`), the scene and the closed
//! loop that are simulated, calibration, the run file, and what is told of a run. Like the crate below it, it is pure: the operating system begins in `vservo`.

#![allow(non_snake_case)] // monogram notation, see `geometry`

pub use nalgebra;
#[doc(inline)]
pub use vservo_perception::{
    camera_model, detect, features, geometry, imaging, input, linalg, messages, pipeline, pose, stereo,
    target, time,
};

pub mod calibration;
pub mod config;
pub mod control;
pub mod drive;
pub mod explain;
pub mod faults;
pub mod guardian;
pub mod mission;
pub mod motion;
pub mod report;
pub mod robot;
pub mod scene;
pub mod servo;
pub mod sim;
pub mod vision;
