//! From an image to what it says: the crate `vservo-perception`, whose modules `vservo` shows under its own name.
//!
//! Image processing (`imaging`), what is looked for (`target`) and what finds it (`detect`), features with their interaction
//! matrices, poses, stereo vision, and what all of it stands on: geometry, camera models, messages, linear algebra.

#![allow(non_snake_case)] // monogram notation, see `geometry`

pub use nalgebra;

pub mod camera_model;
pub mod detect;
pub mod features;
pub mod geometry;
pub mod imaging;
pub mod input;
pub mod linalg;
pub mod messages;
pub mod pipeline;
pub mod pose;
pub mod stereo;
pub mod target;
pub mod time;
