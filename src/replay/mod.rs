//! What happened, once more: recorded drive states and measurements through control and mission, and every record compared with the recorded one.
//!
//! ```text
//! RUN.mcap ─► run file, robot files ─► config/assemble ─► ControlLoop, Mission
//!         └─► [`RecordedRun`]: tick by tick what came from outside ─► both, in the order in which it came ─► Trace ─► the same bits? ([`Difference`])
//!         └─► frames ─► vision ─► Measurement ─► the same bits? ([`measure_again`])
//! ```
//! What comes to control from outside is in the records: the drive's state of each tick, which measurement was taken at it, requests, stops, faults of
//! the process, and how many orders of the mission had been obeyed by then, which in real time come one or two ticks late ([`crate::messages::TraceMsg`]).

mod difference;
mod recorded_arm;
mod recorded_run;
mod run_again;
mod vision_again;

pub use difference::{Difference, difference};
pub use recorded_run::{RecordedRun, RecordedTick, recorded_config};
pub use run_again::{CommandDeviation, ControlAgain, How, Replayed, replay};
pub use vision_again::{MeasuredAgain, measure_again};

use crate::config::ConfigError;
use crate::config::assemble::AssembleError;
use crate::record::RecordingError;
use crate::robot::RobotError;
use thiserror::Error;

/// A recording cannot be replayed.
#[derive(Debug, Error)]
pub enum ReplayError {
    /// It cannot be read.
    #[error(transparent)]
    Recording(#[from] RecordingError),
    /// Its run file is not one of this version.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The run file does not make a working whole.
    #[error(transparent)]
    Assemble(#[from] AssembleError),
    /// The robot cannot be built.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// There is no run file in it.
    #[error("has no run file: `vservo record` and `--record` of this version write one")]
    NoRunFile,
    /// It begins after the run.
    #[error(
        "begins at tick {0} of its run: what control knew by then is not in it; record from the begin, by `vservo run|serve --record`"
    )]
    NoBegin(u64),
    /// No tick is in it.
    #[error("has no tick of control")]
    NoTicks,
    /// What it was made of does not give it.
    #[error("does not replay, by which alone a report can be made of it: {0}")]
    Differs(Difference),
    /// Two cameras.
    #[error(
        "--from frames: two cameras, a pair ([stereo]) or with a view each ([second_view]), are replayed --from measurements alone"
    )]
    PairOfCameras,
}
