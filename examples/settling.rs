//! How long run files take to settle, against the least time that the arm's limits allow.
//!
//! ```text
//! cargo run --release --example settling -- config/ur5.toml config/panda.toml --set servo.gain_1_s=10
//! ```
//! The bound is [`vservo::motion::min_time_s`]: each joint by itself from rest at the start to rest where the run ended, within
//! its limits on speed, acceleration and jerk; the slowest joint counts. It does not know of the camera: the first frame alone
//! comes `camera.latency_ms` late. A run settles when its feature error is 2 % of the first one and stays below.

#![allow(clippy::print_stdout)] // that is what it is for

use nalgebra::SVector;
use std::error::Error;
use std::ops::ControlFlow::Continue;
use std::path::Path;
use vservo::config::{Config, assemble};
use vservo::motion::min_time_s;
use vservo::sim::{Moment, simulate_system};

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let (mut files, mut set) = (Vec::new(), vec!["run.clock=lockstep".to_string()]);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--set" => set.extend(arguments.next()),
            _ => files.push(argument),
        }
    }
    for file in files {
        let config = Config::load(Some(Path::new(&file)), &set)?;
        let mut q_end = [0.0; vservo::messages::MAX_JOINTS];
        let run = simulate_system(&config, &mut |moment| {
            if let Moment::Tick(trace, _) = moment {
                q_end = trace.joint_state.q;
            }
            Continue(())
        })?;
        let bound_s = vservo::dispatch_robot!(config.robot, |robot| {
            assemble::motion_limits(&config, &robot).map(|limits| {
                let end = SVector::from_fn(|i, _| q_end[i]);
                min_time_s(&limits, &SVector::from_column_slice(&config.start.q), &end)
            })
        })??;
        let settled_s = run.settling_time_s.unwrap_or(f64::NAN);
        let name = Path::new(&file).file_stem().map_or(String::new(), |stem| stem.to_string_lossy().into());
        println!(
            "{name:18} settles in {settled_s:6.3} s, bound {bound_s:6.3} s, ratio {:6.2}; {} ({}), target lost {}",
            settled_s / bound_s,
            run.finish.outcome.as_str(),
            run.finish.reason,
            run.target_lost
        );
    }
    Ok(())
}
