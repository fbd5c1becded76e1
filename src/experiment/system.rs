//! The whole system in one process and in simulated time: renderer, vision and control as `vservo run --clock lockstep`
//! runs them, to the last bit, without processes and shared memory.
//!
//! ```text
//! sense ─► joint state ─► source ─► pixels ─► Vision ─► Measurement ─ one latency later ─► act ─► drive
//! ```

use super::ExperimentError;
use crate::config::Config;
use crate::control_loop::{ControlLoop, Finish};
use crate::imaging::ImageView;
use crate::messages::{FrameHeader, Measurement};
use crate::schedule::TICK;
use crate::source::{self, Exposure, Source};
use crate::summary::FinalErrors;
use crate::time::MonoNs;
use crate::vision::{Frame, Prior, Vision};
use std::collections::VecDeque;

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
    /// A tick is over: its time from the first one in s, and the errors against truth.
    Tick(f64, &'a FinalErrors),
}

/// Runs `config` in simulated time, whatever its clock, and tells `watch` what happens.
///
/// # Errors
/// [`ExperimentError::Cell`] when a part of the configuration cannot be built, or the source of frames fails.
pub fn simulate_system(
    config: &Config,
    watch: &mut dyn FnMut(&Moment<'_>),
) -> Result<SystemRun, ExperimentError> {
    let mut vision = crate::assemble::vision(config);
    let mut source = source::open(config).map_err(broken)?;
    crate::dispatch_robot!(config.robot, |robot| {
        let mut control = crate::assemble::control_loop(config, robot).map_err(broken)?;
        let finish = run(config, &mut control, &mut vision, source.as_mut(), watch)?;
        let statistics = control.statistics();
        Ok(SystemRun {
            finish,
            errors: control.final_errors(),
            settling_time_s: control.settling_time_s(),
            target_lost: statistics.last_measurement().map_or(0, |m| m.target_lost),
            state_hash: statistics.state_hash(),
        })
    })
    .map_err(broken)?
}

fn broken(cause: impl ToString) -> ExperimentError {
    ExperimentError::Cell { cause: cause.to_string() }
}

fn run<const N: usize>(
    config: &Config,
    control: &mut ControlLoop<N>,
    vision: &mut Vision,
    source: &mut dyn Source,
    watch: &mut dyn FnMut(&Moment<'_>),
) -> Result<Finish, ExperimentError> {
    let schedule = &config.camera.schedule;
    let i = *config.camera.model.intrinsics();
    let mut pixels = vec![0; i.width_px as usize * i.height_px as usize];
    let mut on_their_way: VecDeque<(u64, Measurement)> = VecDeque::new();
    let mut tick = 0;
    loop {
        let now = MonoNs(TICK.0 * tick as i64);
        source.arm(&control.sense(tick, now));
        if let Some(frame_id) = schedule.frame_at(tick).filter(|id| !schedule.is_lost(*id)) {
            let exposure = Exposure { frame_id, mid: now, span: config.camera.exposure };
            source.expose(&exposure, &mut pixels).map_err(broken)?;
            let image = ImageView::new(&pixels, i.width_px as usize, i.height_px as usize).map_err(broken)?;
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
        let (_, finish) = control.act(tick, now, measurement.as_ref());
        watch(&Moment::Tick((now - MonoNs::ZERO).as_s(), &control.final_errors()));
        if let Some(finish) = finish {
            return Ok(finish);
        }
        tick += 1;
    }
}
