//! vservo: visual servoing in real time over shared memory.
//!
//! ARCHITECTURE.md tells how a frame travels through these modules.

#![allow(non_snake_case)] // monogram notation, see `geometry`

pub mod camera_model;
pub mod detect;
pub mod features;
pub mod geometry;
pub mod imaging;
pub mod messages;
pub mod pose;
pub mod robot;
pub mod scene;
pub mod time;
