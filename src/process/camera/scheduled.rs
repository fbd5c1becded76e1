//! The loops of a source whose exposures are triggered: by the machine's clock, or by the ticks of a lockstep control.

use super::Shot;
use crate::config::Clock;
use crate::config::Config;
use crate::faults::{FaultyProcess, ProcessFaults};
use crate::ipc::{BorrowedFrame, FrameSender, Receiver, Spin, WakeListener};
use crate::messages::{FrameHeader, JointState, frame_flag};
use crate::process::{
    FILLED_AHEAD, LONGEST_SPIN, LONGEST_WAIT, Membership, ProcessError, StopFlag, WAKE_AHEAD, process_faults,
};
use crate::rt::{now, sleep_until};
use crate::source::{Exposed, Exposure, NextInstant, ScheduledSource};
use crate::time::{MonoNs, SpanNs};
use std::collections::VecDeque;
use std::time::Duration;
use tracing::{debug_span, info};

/// Time from the start to the first exposure. Chosen by hand: the other processes have joined by then, mostly; a frame that comes too early
/// is lost, not an error.
const LEAD: SpanNs = SpanNs(50_000_000);

/// A camera whose exposures are triggered.
pub(super) struct ScheduledCamera<'a> {
    config: &'a Config,
    membership: &'a Membership,
    source: Box<dyn ScheduledSource>,
    frames: FrameSender,
    arm: Receiver<JointState>,
    /// Frames that are filled already, and whether none follows them.
    ahead: VecDeque<BorrowedFrame>,
    is_at_end: bool,
    lost: u64,
    faults: ProcessFaults,
}

/// An exposed frame that is not due yet.
struct PendingFrame {
    due: MonoNs,
    frame: BorrowedFrame,
    header: FrameHeader,
}

impl<'a> ScheduledCamera<'a> {
    pub(super) fn new(
        config: &'a Config,
        membership: &'a Membership,
        source: Box<dyn ScheduledSource>,
        frames: FrameSender,
        arm: Receiver<JointState>,
    ) -> Self {
        let faults = process_faults::of(config, FaultyProcess::Camera);
        let (ahead, is_at_end, lost) = (VecDeque::new(), false, 0);
        Self { config, membership, source, frames, arm, ahead, is_at_end, lost, faults }
    }

    /// Runs until a stop is requested or the source ends; `wake_listener` is notified of the arm's states.
    pub(super) fn run(mut self, wake_listener: &WakeListener, stop: &StopFlag) -> Result<(), ProcessError> {
        match self.config.clock {
            Clock::Realtime => self.run_by_the_clock(stop),
            Clock::Lockstep => self.run_by_the_ticks(wake_listener, stop),
        }
    }

    /// Exposes by the machine's clock. Frames whose latency is longer than the period wait in a queue, as they do in the
    /// pipeline of a real camera.
    fn run_by_the_clock(&mut self, stop: &StopFlag) -> Result<(), ProcessError> {
        let schedule = &self.config.camera.schedule;
        let half = SpanNs(self.config.camera.exposure.0 / 2);
        let start = self.first_exposure();
        let (mut frame_id, mut last, mut due) = (0, false, MonoNs::ZERO);
        let mut pending: VecDeque<PendingFrame> = VecDeque::new();
        loop {
            if pending.front().is_none_or(|p| p.due > now()) {
                self.fill_ahead()?;
            }
            let (mid, is_dated) = match self.source.next_instant() {
                NextInstant::Any => (start + schedule.exposure(frame_id), false),
                NextInstant::At(mid) => (mid, true),
                NextInstant::Never => {
                    last = true;
                    (start, true)
                }
            };
            let exposed = mid + half;
            let next = pending.front().map(|p| p.due).into_iter().chain((!last).then_some(exposed)).min();
            let Some(next) = next else { return self.rest(stop) };
            if !self.wait_until(next, stop) {
                return Ok(());
            }
            while let Some(p) = pending.pop_front_if(|p| p.due <= now()) {
                self.frames.send(p.frame, FrameHeader { sent: now(), ..p.header })?;
            }
            if last || now() < exposed {
                continue;
            }
            if schedule.is_lost(frame_id) {
                self.lost += 1;
            } else {
                while let Some(state) = self.arm.receive()? {
                    self.source.arm(&state);
                }
                let (frame, header) = self.expose(frame_id, mid)?;
                last = header.flags & frame_flag::LAST != 0;
                // Frames do not overtake one another.
                due = due.max(mid + schedule.latency(frame_id));
                pending.push_back(PendingFrame { due, frame, header });
            }
            // A camera that cannot keep up drops whole exposures, it does not shift them.
            frame_id += 1;
            if is_dated {
                continue;
            }
            let behind = now() - SpanNs(schedule.exposure(1).0 / 2);
            while start + schedule.exposure(frame_id) + half < behind {
                frame_id += 1;
                self.lost += 1;
            }
        }
    }

    /// Cameras of a pair have one trigger: each begins at a whole number of periods of the machine's clock.
    fn first_exposure(&self) -> MonoNs {
        let (start, period) = (now() + LEAD, self.config.camera.schedule.exposure(1).0.max(1));
        if self.config.stereo.is_none() {
            return start;
        }
        start + SpanNs((-start.0).rem_euclid(period))
    }

    /// Exposes at the ticks of a lockstep control, and hands over at once: control knows when to use what.
    fn run_by_the_ticks(
        &mut self,
        wake_listener: &WakeListener,
        stop: &StopFlag,
    ) -> Result<(), ProcessError> {
        let schedule = &self.config.camera.schedule;
        let mut spin = Spin::new(LONGEST_SPIN);
        let mut newest = None;
        while !stop.is_requested() {
            self.membership.beat();
            self.fill_ahead()?;
            while let Some(state) = self.arm.receive()? {
                self.source.arm(&state);
                newest = Some(state.tick);
                let Some(frame_id) = schedule.frame_at(state.tick) else { continue };
                if schedule.is_lost(frame_id) {
                    self.lost += 1;
                    continue;
                }
                let (frame, header) = self.expose(frame_id, state.stamp)?;
                self.frames.send(frame, FrameHeader { sent: now(), ..header })?;
                if header.flags & frame_flag::LAST != 0 {
                    return self.rest(stop);
                }
            }
            // Right after a frame the core is vision's; shortly before the next one control is on its way to it.
            if newest.is_some_and(|tick| schedule.next_exposure_tick(tick) - tick <= WAKE_AHEAD) {
                wake_listener.wait_spinning(LONGEST_WAIT, &mut spin, || self.arm.is_waiting())?;
            } else {
                wake_listener.wait(LONGEST_WAIT)?;
            }
        }
        Ok(())
    }

    /// Fills frames that are not due yet, of a source that knows its images.
    fn fill_ahead(&mut self) -> Result<(), ProcessError> {
        while self.source.is_known_ahead() && !self.is_at_end && self.ahead.len() < FILLED_AHEAD {
            let (frame, exposed) = self.filled_frame(0, MonoNs::ZERO)?;
            self.is_at_end = exposed == Exposed::End;
            self.ahead.extend((!self.is_at_end).then_some(frame));
        }
        Ok(())
    }

    /// A frame in shared memory, as the source fills it.
    fn filled_frame(&mut self, frame_id: u64, mid: MonoNs) -> Result<(BorrowedFrame, Exposed), ProcessError> {
        self.membership.beat();
        let i = self.config.camera.model.intrinsics();
        let mut frame = self.frames.borrow(i.width_px as usize * i.height_px as usize)?;
        let exposure = Exposure { frame_id, mid, span: self.config.camera.exposure };
        let exposed = self.source.expose(&exposure, frame.pixels_mut())?;
        Ok((frame, exposed))
    }

    /// Exposes frame `frame_id` into shared memory.
    fn expose(&mut self, frame_id: u64, mid: MonoNs) -> Result<(BorrowedFrame, FrameHeader), ProcessError> {
        let _span = debug_span!("frame", frame = frame_id).entered();
        self.membership.beat();
        process_faults::suffer(&self.faults, frame_id);
        self.fill_ahead()?;
        let (frame, last) = match self.ahead.pop_front() {
            Some(frame) => (frame, self.ahead.is_empty() && self.is_at_end),
            None => {
                let (frame, exposed) = self.filled_frame(frame_id, mid)?;
                (frame, exposed == Exposed::End)
            }
        };
        let camera = &self.config.camera;
        let exposure = Exposure { frame_id, mid, span: camera.exposure };
        let mid = self.source.stamped(&exposure);
        let shot = Shot { frame_id, sequence: frame_id, mid, span: exposure.span, lost: self.lost, last };
        let header = shot.header(camera);
        Ok((frame, header))
    }

    /// After the last frame: stays, because frames vanish with their publisher.
    fn rest(&self, stop: &StopFlag) -> Result<(), ProcessError> {
        info!("last frame sent");
        while !stop.is_requested() {
            self.membership.beat();
            std::thread::sleep(Duration::from_millis(20));
        }
        Ok(())
    }

    /// Waits for `time`; false when a stop is requested meanwhile.
    fn wait_until(&self, time: MonoNs, stop: &StopFlag) -> bool {
        let slice = SpanNs(LONGEST_WAIT.as_nanos() as i64);
        while !stop.is_requested() {
            self.membership.beat();
            let left = time - now();
            if left <= slice {
                sleep_until(time);
                return true;
            }
            sleep_until(now() + slice);
        }
        false
    }
}
