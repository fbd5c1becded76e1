//! A whole closed loop in one process: the same cores as `vservo run --clock lockstep`, without processes and shared
//! memory, in about sixty lines. The joint states are the same to the last bit, and so is the state hash.
//!
//! ```text
//! cargo run --release --example in_process                # runs the default configuration
//! cargo run --release --example in_process -- FOLDER      # and writes every frame to FOLDER as PNG
//! ```

#![allow(clippy::print_stdout)] // this is a program for a terminal

use std::collections::VecDeque;
use std::path::Path;
use vservo::config::Config;
use vservo::control_loop::{ControlLoop, Finish};
use vservo::imaging::ImageView;
use vservo::messages::{FrameHeader, Measurement};
use vservo::schedule::TICK;
use vservo::source::{Exposure, Source};
use vservo::time::MonoNs;
use vservo::vision::{Frame, Prior, Vision};

type AnyError = Box<dyn std::error::Error>;

/// Reads the configuration, runs it, and prints how it went.
fn main() -> Result<(), AnyError> {
    let config = Config::load(None, &[])?;
    let folder = std::env::args().nth(1);
    if let Some(folder) = &folder {
        std::fs::create_dir_all(folder)?;
    }
    let (finish, errors, hash) = simulate(&config, folder.as_deref().map(Path::new))?;
    let mm = errors.map_or(f64::NAN, |m| m * 1e3);
    println!("{} ({}), {mm:.4} mm from the goal, state hash {hash}", finish.outcome.as_str(), finish.reason);
    Ok(())
}

/// Runs `config` in simulated time: how it ended, the distance of the camera from its goal in m, the state hash.
///
/// # Errors
/// When a part of the configuration cannot be built, or a frame not be written to `folder`.
pub(crate) fn simulate(
    config: &Config,
    folder: Option<&Path>,
) -> Result<(Finish, Option<f64>, String), AnyError> {
    let mut vision = vservo::assemble::vision(config);
    let mut source = vservo::source::open(config)?;
    vservo::dispatch_robot!(config.robot, |robot| {
        let mut control = vservo::assemble::control_loop(config, robot)?;
        let finish = run(config, &mut control, &mut vision, source.as_mut(), folder)?;
        Ok((finish, control.final_errors().position_error_m, control.statistics().state_hash()))
    })?
}

fn run<const N: usize>(
    config: &Config,
    control: &mut ControlLoop<N>,
    vision: &mut Vision,
    source: &mut dyn Source,
    folder: Option<&Path>,
) -> Result<Finish, AnyError> {
    let schedule = &config.camera.schedule;
    let i = *config.camera.model.intrinsics();
    let mut pixels = vec![0; i.width_px as usize * i.height_px as usize];
    let mut on_their_way: VecDeque<(u64, Measurement)> = VecDeque::new();
    for tick in 0.. {
        let now = MonoNs(TICK.0 * i64::try_from(tick)?);
        source.arm(&control.sense(tick, now));
        if let Some(frame_id) = schedule.frame_at(tick).filter(|id| !schedule.is_lost(*id)) {
            source.expose(&Exposure { frame_id, mid: now, span: config.camera.exposure }, &mut pixels)?;
            let image = ImageView::new(&pixels, i.width_px as usize, i.height_px as usize)?;
            if let Some(folder) = folder {
                let file = folder.join(format!("{frame_id:05}.png"));
                image::save_buffer(file, &pixels, i.width_px, i.height_px, image::ColorType::L8)?;
            }
            let header = FrameHeader {
                frame_id,
                exposure: config.camera.stamp(now),
                width_px: i.width_px,
                height_px: i.height_px,
                ..FrameHeader::default()
            };
            let measurement = vision.process(&Frame { header, image }, &Prior::default());
            on_their_way.push_back((schedule.usable_tick(frame_id), measurement));
        }
        // A measurement reaches control one latency after the middle of its exposure.
        let mut measurement = None;
        while let Some((_, m)) = on_their_way.pop_front_if(|(usable, _)| *usable <= tick) {
            measurement = Some(m);
        }
        if let (_, Some(finish)) = control.act(tick, now, measurement.as_ref()) {
            return Ok(finish);
        }
    }
    Err("the ticks are used up".into())
}
