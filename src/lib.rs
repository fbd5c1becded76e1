//! vservo: visual servoing in real time over shared memory.
//!
//! A frame travels through the folders in this order: `source` (camera process) fills shared memory, `detect` and
//! `pose` (vision process, assembled by [`vision`]) turn it into a measurement, `servo`, `motion` and [`control`] (control
//! process) turn that into a command, and `drive` takes it. ARCHITECTURE.md tells more.

//!
//! The cores are there without the programs: with `default-features = false` the crate has no transport, no command
//! line and no plots; with the feature `client` it has the client of a running instance too. [`prelude`] has what most uses need.

#![allow(non_snake_case)] // monogram notation, see `geometry`

pub use nalgebra;
#[doc(inline)]
pub use vservo_core::{
    calibration, camera_model, config, control, detect, dispatch_robot, drive, explain, faults, features,
    geometry, guardian, imaging, input, linalg, messages, mission, motion, pipeline, pose, report, robot,
    scene, servo, sim, stereo, target, time, vision,
};

pub mod prelude;

// Above: pure, in crates of their own. Below: the operating system, and what programs alone need.
#[cfg(feature = "cli")]
pub mod cli;
#[cfg(feature = "client")]
pub mod client;
#[cfg(feature = "cli")]
pub mod experiment;
#[cfg(feature = "cli")]
pub mod export;
#[cfg(feature = "client")]
pub mod ipc;
#[cfg(feature = "cli")]
pub mod monitor;
#[cfg(feature = "cli")]
pub mod print;
#[cfg(feature = "client")]
pub mod process;
#[cfg(feature = "cli")]
pub mod record;
#[cfg(feature = "cli")]
pub mod replay;
#[cfg(feature = "client")]
pub mod rt;
#[cfg(feature = "cli")]
pub mod source;
