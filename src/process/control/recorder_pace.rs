//! In lockstep a recorder that cannot follow is waited for: simulated time is as slow as its slowest listener, so that a recording has no gap.

use crate::config::Config;
use crate::ipc::Role;
use crate::process::{Membership, shape_of};
use crate::rt::now;
use crate::time::SpanNs;
use std::time::Duration;
use tracing::warn;

/// Most ticks that a recorder may lag behind. Chosen by hand: a tenth of its buffer of 1024, whose rest covers what is sent between two looks.
const MAX_LAG: u64 = 96;
/// Longest wait for a recorder. Chosen by hand: its disk hangs, or it was stopped; then the run goes on, and it counts what it loses.
const PATIENCE: SpanNs = SpanNs(2_000_000_000);
/// Between two looks. Chosen by hand: a recorder takes what there is every half millisecond.
const LOOK_AGAIN: Duration = Duration::from_micros(100);

/// How far control is ahead of a recorder.
pub(super) struct RecorderPace {
    max_lag: u64,
    given_up: bool,
}

impl RecorderPace {
    /// For a run, whose frames are what a recorder has the smallest buffer for.
    pub(super) fn new(config: &Config) -> Self {
        let ticks_of_frames = |camera| {
            let waiting = shape_of(camera, config.clock).recorded.saturating_sub(1) as u64;
            camera.schedule.usable_tick(waiting).saturating_sub(2 * camera.schedule.usable_tick(0))
        };
        let max_lag = config.cameras().map(ticks_of_frames).min().unwrap_or(MAX_LAG);
        Self { max_lag: max_lag.clamp(1, MAX_LAG), given_up: false }
    }

    /// Waits, after a tick whose trace somebody listens to, until the recorder is near.
    pub(super) fn keep(&mut self, tick: u64, membership: &Membership) {
        if self.given_up || !tick.is_multiple_of(self.max_lag.div_ceil(4)) {
            return;
        }
        let start = now();
        // None: it is another program that listens
        while let Some(taken) = membership.services().instance().progress(Role::Recorder)
            && tick > taken.saturating_add(self.max_lag)
        {
            membership.beat();
            if !membership.services().instance().is_running(Role::Recorder) {
                return; // it has ended, and somebody else listens
            }
            if now() - start > PATIENCE {
                warn!("the recorder does not follow: the run goes on without waiting for it");
                self.given_up = true;
                return;
            }
            std::thread::sleep(LOOK_AGAIN);
        }
    }
}
