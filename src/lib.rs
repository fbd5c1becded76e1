//! vservo: visual servoing in real time over shared memory.
//!
//! A frame travels through the folders in this order: `source` (camera process) fills shared memory, `detect` and
//! `pose` (vision process, assembled by [`vision`]) turn it into a measurement, `servo`, `motion` and [`control`] (control
//! process) turn that into a command, and `drive` takes it. ARCHITECTURE.md tells more.

#![allow(non_snake_case)] // monogram notation, see `geometry`

pub mod calibration;
pub mod camera_model;
pub mod config;
pub mod control;
pub mod detect;
pub mod drive;
pub mod features;
pub mod geometry;
pub mod imaging;
pub mod input;
pub mod linalg;
pub mod messages;
pub mod motion;
pub mod pose;
pub mod print;
pub mod report;
pub mod robot;
pub mod scene;
pub mod servo;
pub mod sim;
pub mod stereo;
pub mod target;
pub mod time;
pub mod vision;

// Above: pure. Below: the operating system.
pub mod cli;
pub mod experiment;
pub mod ipc;
pub mod process;
pub mod rt;
pub mod source;
