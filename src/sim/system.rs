//! The whole system in one process and in simulated time: renderer, vision and control as `vservo run --clock lockstep`
//! runs them, to the last bit, without processes and shared memory.
//!
//! ```text
//! sense ─► joint state ─► source ─► pixels ─► Vision ─► Measurement ─ one latency later ─► act ─► drive
//! ```

use crate::config::Config;
use crate::config::assemble::{self, AssembleError};
use crate::control::control_loop::{ControlLoop, Finish};
use crate::control::outcome::FinalErrors;
use crate::control::trace::Trace;
use crate::imaging::{ImageSizeError, ImageView};
use crate::messages::{FrameHeader, Measurement};
use crate::report::statistics::RunStatistics;
use crate::robot::RobotError;
use crate::scene::{Exposure, SyntheticCamera};
use crate::time::MonoNs;
use crate::time::TICK;
use crate::vision::{Frame, Prior, Vision};
use std::collections::VecDeque;
use thiserror::Error;

/// Why a run cannot be simulated.
#[derive(Debug, Error)]
pub enum SimError {
    /// A part of it cannot be built.
    #[error(transparent)]
    Assemble(#[from] AssembleError),
    /// The arm cannot.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// The camera has no pixels.
    #[error(transparent)]
    Image(#[from] ImageSizeError),
}

/// A simulated run that has come to its end.
#[derive(Debug, Clone, PartialEq)]
pub struct SystemRun {
    /// How it ended.
    pub finish: Finish,
    /// Errors at the end, against truth.
    pub errors: FinalErrors,
    /// To 2 % of the first feature error, s.
    pub settling_time_s: Option<f64>,
    /// How often the target was lost.
    pub target_lost: u64,
    /// Over every joint state, hexadecimal; that of the three processes.
    pub state_hash: String,
}

/// What can be watched of a run.
#[derive(Debug, Clone, Copy)]
pub enum Moment<'a> {
    /// A frame was exposed: its number and its pixels.
    Frame(u64, &'a ImageView<'a>),
    /// A tick is over: what it left, and the errors against truth.
    Tick(&'a Trace, &'a FinalErrors),
}

/// Runs `config` in simulated time, whatever its clock, and tells `watch` what happens.
///
/// # Errors
/// [`SimError`] when a part of the configuration cannot be built.
pub fn simulate_system(config: &Config, watch: &mut dyn FnMut(&Moment<'_>)) -> Result<SystemRun, SimError> {
    let mut vision = assemble::vision(config);
    crate::dispatch_robot!(config.robot, |robot| {
        let mut camera = assemble::synthetic_camera(config)?;
        let mut control = assemble::control_loop(config, robot)?;
        let mut statistics = RunStatistics::new();
        let finish = run(config, &mut control, &mut vision, &mut camera, &mut |moment| {
            if let Moment::Tick(trace, _) = moment {
                statistics.note(trace);
            }
            watch(moment);
        })?;
        Ok(SystemRun {
            finish,
            errors: control.final_errors(),
            settling_time_s: statistics.settling_time_s(),
            target_lost: control.sightings().last().map_or(0, |m| m.target_lost),
            state_hash: statistics.state_hash(),
        })
    })?
}

fn run<const N: usize>(
    config: &Config,
    control: &mut ControlLoop<N>,
    vision: &mut Vision,
    camera: &mut SyntheticCamera<N>,
    watch: &mut dyn FnMut(&Moment<'_>),
) -> Result<Finish, SimError> {
    let schedule = &config.camera.schedule;
    let i = *config.camera.model.intrinsics();
    let mut pixels = vec![0; i.width_px as usize * i.height_px as usize];
    let mut on_their_way: VecDeque<(u64, Measurement)> = VecDeque::new();
    let mut tick = 0;
    loop {
        let now = MonoNs(TICK.0 * tick as i64);
        camera.arm(&control.sense(tick, now));
        if let Some(frame_id) = schedule.frame_at(tick).filter(|id| !schedule.is_lost(*id)) {
            let exposure = Exposure { frame_id, mid: now, span: config.camera.exposure };
            camera.expose(&exposure, &mut pixels);
            let image = ImageView::new(&pixels, i.width_px as usize, i.height_px as usize)?;
            watch(&Moment::Frame(frame_id, &image));
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
        let trace = control.act(tick, now, measurement.as_ref());
        watch(&Moment::Tick(&trace, &control.final_errors()));
        if let Some(finish) = trace.finish {
            return Ok(finish);
        }
        tick += 1;
    }
}
