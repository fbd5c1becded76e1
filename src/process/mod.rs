//! The processes: thin loops around the cores. Each joins an instance under its role, works until it is told to stop,
//! and takes its run files with it.

pub mod camera;
pub mod control;
pub mod drive_guard;
mod error;
mod membership;
mod priority;
mod report_folder;
mod report_images;
pub mod run_report;
mod signals;
mod silence;
pub mod stereo_vision;
mod stop;
pub mod supervisor;
pub mod vision;

pub use error::ProcessError;
pub use membership::Membership;
pub use report_folder::{NewReport, ReportFolder};
pub use signals::follow_parent;
use stop::STOP_REASON;
pub use stop::StopFlag;

use crate::config::Clock;
use crate::config::{Camera, Config};
use crate::ipc::{FrameShape, Role};
use crate::time::SpanNs;
use std::time::Duration;

/// Longest wait for a message: how late a request to stop may be noticed.
const LONGEST_WAIT: Duration = Duration::from_millis(50);

/// The processes beside control that see for it: vision first, then its cameras.
fn seeing_roles(config: &Config) -> Vec<Role> {
    let id = config.camera.id;
    let pair = config.further_cameras.iter().filter(|_| config.stereo.is_some());
    [Role::Vision(id), Role::Camera(id)]
        .into_iter()
        .chain(pair.map(|camera| Role::Camera(camera.id)))
        .collect()
}

/// How long a lockstep process spins before it waits for another one, where a core is free: about what a frame takes from its
/// exposure to its measurement.
const LONGEST_SPIN: SpanNs = SpanNs(250_000);

/// So many ticks before that of a frame a lockstep control wakes the camera: what it takes to wake up, the camera then has
/// behind it when the frame's state comes.
const WAKE_AHEAD: u64 = 16;

/// Size and number of the frames of a run: the newest alone in real time, all that are on their way in lockstep.
#[must_use]
pub fn frame_shape(config: &Config) -> FrameShape {
    shape_of(&config.camera, config.clock)
}

/// The same of one of several cameras.
fn shape_of(camera: &Camera, clock: Clock) -> FrameShape {
    let i = camera.model.intrinsics();
    let on_their_way = camera.schedule.in_flight();
    let (in_flight, held_back) = match clock {
        Clock::Realtime => (1, on_their_way),
        Clock::Lockstep => (on_their_way, 1),
    };
    FrameShape { bytes: i.width_px as usize * i.height_px as usize, in_flight, held_back }
}
