//! A whole closed loop in one process: the same cores as `vservo run --clock lockstep`, without processes and shared
//! memory. The joint states are the same to the last bit, and so is the state hash. How the cores are put together stands
//! in `src/core/sim/system.rs`.
//!
//! ```text
//! cargo run --release --example in_process                # runs the default configuration
//! cargo run --release --example in_process -- FOLDER      # and writes every frame to FOLDER as PNG
//! ```

#![allow(clippy::print_stdout)] // this is a program for a terminal

use std::ops::ControlFlow;
use std::path::PathBuf;
use vservo::config::Config;
use vservo::sim::{Moment, simulate_system};

type AnyError = Box<dyn std::error::Error>;

/// Reads the configuration, runs it, and prints how it went.
fn main() -> Result<(), AnyError> {
    let config = Config::load(None, &[])?;
    let folder = std::env::args().nth(1).map(PathBuf::from);
    if let Some(folder) = &folder {
        std::fs::create_dir_all(folder)?;
    }
    let i = *config.camera.model.intrinsics();
    let mut written = Ok(());
    let run = simulate_system(&config, &mut |moment| {
        let (Moment::Frame(id, image), Some(folder)) = (moment, &folder) else {
            return ControlFlow::Continue(());
        };
        let file = folder.join(format!("{id:05}.png"));
        written = image::save_buffer(file, image.pixels(), i.width_px, i.height_px, image::ColorType::L8);
        if written.is_ok() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    })?;
    written?;
    let mm = run.errors.position_error_m.map_or(f64::NAN, |m| m * 1e3);
    let (outcome, reason) = (run.finish.outcome.as_str(), run.finish.reason);
    println!("{outcome} ({reason}), {mm:.4} mm from the goal, state hash {}", run.state_hash);
    Ok(())
}
