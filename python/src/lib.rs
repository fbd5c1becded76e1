//! The Python module `vservo`: a law from image points, poses from images, closed loops in simulated time, and a client of running
//! instances, with numpy arrays in and out. Everything is computed by the cores of the Rust library; this is their other end.

#![allow(non_snake_case)] // frames are named as in the library
#![deny(unsafe_code)]

mod arrays;
mod beside;
mod calibrate;
mod camera;
mod client;
mod errors;
mod goal;
mod law;
mod measurement;
mod simulation;
mod status;
mod streams;
mod velocities;
mod vision;

use pyo3::prelude::*;

/// Visual servoing: servo laws, poses from images, closed loops, clients of running instances. Units are SI: m, rad, s; px where a name says so.
#[pymodule]
fn vservo(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_function(wrap_pyfunction!(law::camera_velocity, module)?)?;
    module.add_function(wrap_pyfunction!(law::planar_pose, module)?)?;
    module.add_function(wrap_pyfunction!(simulation::simulate, module)?)?;
    module.add_function(wrap_pyfunction!(simulation::run_files, module)?)?;
    module.add_function(wrap_pyfunction!(client::connect, module)?)?;
    module.add_function(wrap_pyfunction!(calibrate::calibrate, module)?)?;
    module.add_function(wrap_pyfunction!(calibrate::stereo, module)?)?;
    module.add_function(wrap_pyfunction!(calibrate::hand_eye, module)?)?;
    module.add_function(wrap_pyfunction!(vision::detect, module)?)?;
    errors::add(module)?;
    module.add_class::<calibrate::Calibration>()?;
    module.add_class::<calibrate::Pair>()?;
    module.add_class::<calibrate::HandEye>()?;
    module.add_class::<client::Client>()?;
    module.add_class::<goal::Goal>()?;
    module.add_class::<status::Status>()?;
    module.add_class::<streams::JointState>()?;
    module.add_class::<streams::JointStates>()?;
    module.add_class::<streams::Measurements>()?;
    module.add_class::<streams::Statuses>()?;
    module.add_class::<velocities::Velocities>()?;
    module.add_class::<camera::Camera>()?;
    module.add_class::<vision::Vision>()?;
    module.add_class::<measurement::Measurement>()?;
    module.add_class::<simulation::Run>()
}
