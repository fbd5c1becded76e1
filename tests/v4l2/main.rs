//! Cameras through real kernel drivers: in the virtual machine of `tests/vm`, with vivid and with an emulated USB camera.
//!
//! Outside it every test is ignored; where one is asked for there by `--ignored` it fails and says how to run it.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::indexing_slicing)] // helpers of tests are tests
#![allow(unreachable_pub, dead_code, non_snake_case, clippy::print_stdout)]

mod capture;
mod closed_loop;
#[path = "../common/mod.rs"]
mod common;
mod formats;
mod guest;
mod handles;
mod program;
mod rates;
mod regions;
mod rig;
mod usb_camera;
mod usb_faults;
mod vivid_faults;
mod whole_path;
