//! What the processes have in common: who sees for control, how large their frames are, how long they wait for each other.

use super::guardian;
use crate::config::{Camera, Clock, Config, Source};
use crate::ipc::{FrameShape, Role};
use crate::messages::CameraId;
use crate::time::SpanNs;
use std::time::Duration;

/// Longest wait for a message, and so the delay with which a request to stop is noticed at most. Chosen by hand: below what people perceive as
/// a delay, and 20 wake-ups a second.
pub(super) const LONGEST_WAIT: Duration = Duration::from_millis(50);

/// The processes beside control that see for it: vision first, then its cameras.
pub(super) fn seeing_roles(config: &Config) -> Vec<Role> {
    let cameras = seeing_cameras(config).map(|camera| Role::Camera(camera.id));
    std::iter::once(config.camera.id).chain(second_vision(config)).map(Role::Vision).chain(cameras).collect()
}

/// The processes beside control that a supervisor watches and starts anew: those that see for it, and the guardian.
pub(super) fn watched_roles(config: &Config) -> Vec<Role> {
    let guardian = guardian::is_wanted(config).then_some(Role::Guardian);
    seeing_roles(config).into_iter().chain(guardian).collect()
}

/// The cameras that a run uses: one, a pair, or two that control together.
pub(super) fn seeing_cameras(config: &Config) -> impl Iterator<Item = &Camera> + Clone {
    let is_used = config.stereo.is_some() || config.second_view.is_some();
    std::iter::once(&config.camera).chain(config.further_cameras.iter().filter(move |_| is_used))
}

/// The camera whose measurements control takes beside those of the first one.
pub(super) fn second_vision(config: &Config) -> Option<CameraId> {
    config.second_view.as_ref().map(|second| second.cell.camera.id)
}

/// Longest spin of a lockstep process before it sleeps, where a core is free. Chosen by hand: about the time of a frame from its
/// exposure to its measurement.
pub(super) const LONGEST_SPIN: SpanNs = SpanNs(250_000);

/// Ticks before that of a frame at which lockstep control wakes the camera, so that the camera has woken up
/// when the state of the frame's tick arrives. Chosen by hand: sixteen ticks of lockstep take longer than a wake-up.
pub(super) const WAKE_AHEAD: u64 = 16;

/// Frames of a replay that are filled before they are due. Derived: the one that is next, so that it leaves on time however long its decoding takes, and the one
/// after it, so that the last good one is known to be the last.
pub(super) const FILLED_AHEAD: usize = 2;

/// Time that a recorder may lag behind a camera without missing a frame. Chosen by hand: it has no real-time priority, and on a loaded machine
/// waits some tens of milliseconds for its core; each frame more takes four of shared memory, one for every reader.
const RECORDER_LAG: SpanNs = SpanNs(150_000_000);
/// Most frames that wait for a recorder, whatever the rate. Chosen by hand: what 100 Hz needs.
const MAX_RECORDER_FRAMES: usize = 16;

/// Size and number of the frames of a run: the newest alone in real time, all that are on their way in lockstep.
#[must_use]
pub fn frame_shape(config: &Config) -> FrameShape {
    shape_of(&config.camera, config.clock)
}

/// The same of one of several cameras.
pub(super) fn shape_of(camera: &Camera, clock: Clock) -> FrameShape {
    let i = camera.model.intrinsics();
    let on_their_way = camera.schedule.in_flight();
    let (in_flight, held_back) = match clock {
        Clock::Realtime => (1, on_their_way),
        Clock::Lockstep => (on_their_way, 1),
    };
    let period = camera.schedule.exposure(1);
    let recorded = RECORDER_LAG.0.div_euclid(period.0.max(1)).unsigned_abs() as usize + 1;
    let bytes = i.width_px as usize * i.height_px as usize;
    let ahead = if matches!(camera.source, Source::Replay { .. }) { FILLED_AHEAD } else { 0 };
    let held_back = held_back + ahead;
    FrameShape { bytes, in_flight, recorded: recorded.min(MAX_RECORDER_FRAMES), held_back }
}
