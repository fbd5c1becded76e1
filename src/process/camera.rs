//! The camera process: exposes on schedule, straight into shared memory.

use super::{LONGEST_WAIT, Membership, ProcessError, StopFlag, frame_shape};
use crate::config::Config;
use crate::config::raw::Clock;
use crate::ipc::{FrameSender, Instance, Receiver, Role, Waker};
use crate::messages::{FrameHeader, JointState, frame_flag};
use crate::rt::{now, sleep_until};
use crate::schedule::FrameSchedule;
use crate::source::{self, Exposure, Position, Source, SourceError};
use crate::time::{MonoNs, SpanNs};
use std::time::Duration;
use tracing::info;

/// From the start to the first exposure: the other processes have joined by then.
const LEAD: SpanNs = SpanNs(50_000_000);

/// Runs the camera until a stop is requested or the source ends.
///
/// # Errors
/// When the source, shared memory or the instance fails.
pub fn run(config: &Config, instance: &Instance, stop: &StopFlag) -> Result<(), ProcessError> {
    let source = source::open(config)?;
    let membership = Membership::join(instance, Role::Camera)?;
    let services = membership.services();
    let (arm, waker) = services.joint_state_receiver()?;
    let frames = services.frame_sender(frame_shape(config))?;
    let mut camera = Camera { config, source, frames, arm, lost: 0 };
    info!(rate_hz = config.camera.rate_hz, "camera runs");
    match config.clock {
        Clock::Realtime => camera.run_by_the_clock(stop),
        Clock::Lockstep => camera.run_by_the_ticks(&waker, stop),
    }
}

struct Camera<'a> {
    config: &'a Config,
    source: Box<dyn Source>,
    frames: FrameSender,
    arm: Receiver<JointState>,
    lost: u64,
}

impl Camera<'_> {
    fn run_by_the_clock(&mut self, stop: &StopFlag) -> Result<(), ProcessError> {
        let schedule = FrameSchedule::new(self.config.camera.rate_hz);
        let half = SpanNs(self.config.camera.exposure.0 / 2);
        let start = now() + LEAD;
        let mut frame_id = 0;
        loop {
            let mid = start + schedule.exposure(frame_id);
            if !wait_until(mid + half, stop) {
                return Ok(());
            }
            while let Some(state) = self.arm.receive()? {
                self.source.arm(&state);
            }
            if self.send(frame_id, mid, Some(mid + self.config.camera.latency))? == Position::Last {
                return self.rest(stop);
            }
            // A camera that cannot keep up drops whole exposures, it does not shift them.
            frame_id += 1;
            while start + schedule.exposure(frame_id) + half
                < now() - SpanNs(self.config.camera.latency.0 / 2)
            {
                frame_id += 1;
                self.lost += 1;
            }
        }
    }

    fn run_by_the_ticks(&mut self, waker: &Waker, stop: &StopFlag) -> Result<(), ProcessError> {
        let schedule = FrameSchedule::new(self.config.camera.rate_hz);
        while !stop.is_requested() {
            while let Some(state) = self.arm.receive()? {
                self.source.arm(&state);
                if let Some(frame_id) = schedule.frame_at(state.tick)
                    && self.send(frame_id, state.stamp, None)? == Position::Last
                {
                    return self.rest(stop);
                }
            }
            waker.wait(LONGEST_WAIT)?;
        }
        Ok(())
    }

    /// Exposes frame `frame_id` into shared memory and hands it over, not before `due`.
    fn send(&mut self, frame_id: u64, mid: MonoNs, due: Option<MonoNs>) -> Result<Position, ProcessError> {
        let Self { config, source, frames, lost, .. } = self;
        let i = config.camera.model.intrinsics();
        let exposure = Exposure { frame_id, mid, span: config.camera.exposure };
        let mut position = Position::Running;
        let bytes = i.width_px as usize * i.height_px as usize;
        let filled = frames.send_filled(bytes, |pixels| {
            position = source.expose(&exposure, pixels)?;
            if let Some(due) = due {
                sleep_until(due);
            }
            Ok::<_, SourceError>(FrameHeader {
                frame_id,
                exposure: mid,
                sent: now(),
                exposure_span_ns: exposure.span.0.max(0).unsigned_abs(),
                lost: *lost,
                camera: 0,
                width_px: i.width_px,
                height_px: i.height_px,
                flags: if position == Position::Last { frame_flag::LAST } else { 0 },
            })
        })?;
        filled?;
        Ok(position)
    }

    /// After the last frame: stays, because frames vanish with their publisher.
    fn rest(&self, stop: &StopFlag) -> Result<(), ProcessError> {
        info!("last frame sent");
        while !stop.is_requested() {
            std::thread::sleep(Duration::from_millis(20));
        }
        Ok(())
    }
}

/// Waits for `time`; false when a stop is requested meanwhile.
fn wait_until(time: MonoNs, stop: &StopFlag) -> bool {
    let slice = SpanNs(LONGEST_WAIT.as_nanos() as i64);
    while !stop.is_requested() {
        let left = time - now();
        if left <= slice {
            sleep_until(time);
            return true;
        }
        sleep_until(now() + slice);
    }
    false
}
