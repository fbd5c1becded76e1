//! The whole system in one process and in simulated time: renderer, vision and control as `vservo run --clock lockstep`
//! runs them, to the last bit, without processes and shared memory.
//!
//! ```text
//! sense ─► joint state ─► source ─► pixels ─► Vision ─► Measurement ─ one latency later ─► act ─► drive
//! ```

use super::closed_loop::{self, ClosedLoop};
use crate::config::Config;
use crate::config::assemble::{self, AssembleError};
use crate::control::control_loop::ControlLoop;
use crate::control::outcome::{FinalErrors, Finish, Outcome};
use crate::control::trace::Trace;
use crate::imaging::{ImageSizeError, ImageView};
use crate::messages::{FrameHeader, Measurement};
use crate::report::statistics::RunStatistics;
use crate::robot::RobotError;
use crate::scene::{Exposure, SyntheticCamera};
use crate::time::MonoNs;
use crate::time::TICK;
use crate::vision::{Carrier, Frame, Prior, Vision};
use std::ops::ControlFlow::{self, Break, Continue};
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

/// Runs `config` in simulated time, whatever its clock, and tells `watch` what happens; a break of `watch` ends the run as
/// [`Outcome::Stopped`], wherever the arm is then.
///
/// # Errors
/// [`SimError`] when a part of the configuration cannot be built.
pub fn simulate_system(
    config: &Config,
    watch: &mut dyn FnMut(&Moment<'_>) -> ControlFlow<()>,
) -> Result<SystemRun, SimError> {
    let vision = assemble::vision(config);
    let carrier = assemble::carrier(config)?;
    crate::dispatch_robot!(config.robot, |robot| {
        let camera = assemble::synthetic_camera(config)?;
        let control = assemble::control_loop(config, robot)?;
        let i = config.camera.model.intrinsics();
        let pixels = vec![0; i.width_px as usize * i.height_px as usize];
        let mut system = System {
            config,
            control,
            vision,
            carrier,
            camera,
            pixels,
            statistics: RunStatistics::new(),
            watch,
        };
        let finish = closed_loop::run(&config.camera.schedule, &mut system)?;
        Ok(SystemRun {
            finish,
            errors: system.control.final_errors(),
            settling_time_s: system.statistics.settling_time_s(),
            target_lost: system.control.sightings().last().map_or(0, |m| m.target_lost),
            state_hash: system.statistics.state_hash(),
        })
    })?
}

/// The cores of the three processes.
struct System<'a, const N: usize> {
    config: &'a Config,
    control: ControlLoop<N>,
    vision: Vision,
    carrier: Box<dyn Carrier>,
    camera: SyntheticCamera<N>,
    pixels: Vec<u8>,
    statistics: RunStatistics,
    watch: &'a mut dyn FnMut(&Moment<'_>) -> ControlFlow<()>,
}

const WATCHED_ENOUGH: Finish = Finish { outcome: Outcome::Stopped, reason: "who watched has seen enough" };

fn time(tick: u64) -> MonoNs {
    MonoNs(TICK.0 * tick as i64)
}

impl<const N: usize> ClosedLoop for System<'_, N> {
    type Seen = Measurement;
    type End = Result<Finish, SimError>;

    fn sense(&mut self, tick: u64) -> ControlFlow<Self::End> {
        let state = self.control.sense(tick, time(tick));
        self.camera.arm(&state);
        self.carrier.note(&state);
        Continue(())
    }

    fn see(&mut self, tick: u64, frame_id: u64) -> ControlFlow<Self::End, Measurement> {
        let camera = &self.config.camera;
        let i = camera.model.intrinsics();
        let exposure = Exposure { frame_id, mid: time(tick), span: camera.exposure };
        self.camera.expose(&exposure, &mut self.pixels);
        let image = match ImageView::new(&self.pixels, i.width_px as usize, i.height_px as usize) {
            Ok(image) => image,
            Err(e) => return Break(Err(e.into())),
        };
        if (self.watch)(&Moment::Frame(frame_id, &image)).is_break() {
            return Break(Ok(WATCHED_ENOUGH));
        }
        let header = FrameHeader {
            frame_id,
            exposure: camera.stamp(exposure.mid),
            width_px: i.width_px,
            height_px: i.height_px,
            ..FrameHeader::default()
        };
        let X_WC = self.carrier.X_WC(exposure.mid.min(header.exposure));
        Continue(self.vision.process(&Frame { header, image }, &Prior { X_WC, ..Prior::default() }))
    }

    fn act(&mut self, tick: u64, seen: Option<Measurement>) -> ControlFlow<Self::End> {
        let trace = self.control.act(tick, time(tick), seen.as_ref());
        self.statistics.note(&trace);
        let watched = (self.watch)(&Moment::Tick(&trace, &self.control.final_errors()));
        match trace.finish.or(watched.is_break().then_some(WATCHED_ENOUGH)) {
            Some(finish) => Break(Ok(finish)),
            None => Continue(()),
        }
    }
}
