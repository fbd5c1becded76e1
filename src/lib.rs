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

pub mod calibration;
pub mod camera_model;
pub mod config;
pub mod control;
pub mod detect;
pub mod drive;
pub mod explain;
pub mod faults;
pub mod features;
pub mod geometry;
pub mod guardian;
pub mod imaging;
pub mod input;
pub mod linalg;
pub mod messages;
pub mod mission;
pub mod motion;
pub mod pipeline;
pub mod pose;
pub mod prelude;
pub mod report;
pub mod robot;
pub mod scene;
pub mod servo;
pub mod sim;
pub mod stereo;
pub mod target;
pub mod time;
pub mod vision;

// Above: pure. Below: the operating system, and what programs alone need.
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
