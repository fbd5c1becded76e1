//! The loop of a source that exposes by its own clock: frames go out as they come, numbered by the source's own count.
//!
//! ```text
//! sequence of the source   7   8       10  11     2   3        (9 was lost; then it was started anew)
//! frame_id                 0   1        3   4     5   6
//! lost                     0   0        1   1     1   1        and what the source itself says it lost
//! ```
//! A source that falls silent is reported, and later ends the process. One that knows that its camera is away, and looks for it, is
//! waited for longer (`camera.v4l2.give_up_s`). What it says of itself goes out at each change, and five times a second.

use super::{Outlet, Shot};
use crate::messages::{CameraHealth, CameraState, health_flag};
use crate::process::silence::Silence;
use crate::process::{LONGEST_WAIT, ProcessError, StopFlag};
use crate::source::{Captured, Filled, FreeRunningSource, SourceHealth};
use crate::time::{MonoNs, SpanNs};
use tracing::{debug_span, info, warn};

/// How long a source may be silent.
#[derive(Debug, Clone, Copy)]
pub(super) struct SilenceLimits {
    /// A silence that is reported.
    tell: SpanNs,
    /// A silence that ends the run.
    end: SpanNs,
    /// A silence that ends the run while the source reports its camera as disconnected.
    away: SpanNs,
}

impl SilenceLimits {
    /// For a source that is to give so many frames a second, and whose camera may be away for so long.
    pub(super) fn with(rate_hz: f64, away: SpanNs) -> Self {
        let period_s = 1.0 / rate_hz;
        let end = SpanNs::from_s(6.0 + 3.0 * period_s);
        Self { tell: SpanNs::from_s(2.0 + period_s), end, away }
    }

    /// How long a source in such a state is waited for.
    fn of(&self, state: CameraState) -> SpanNs {
        if state.is_away() { self.away } else { self.end }
    }
}

/// Hands over frames until a stop is requested.
pub(super) fn run(
    source: &mut dyn FreeRunningSource,
    outlet: &mut impl Outlet,
    patience: SilenceLimits,
    stop: &StopFlag,
) -> Result<(), ProcessError> {
    let mut numbers = Numbers::default();
    let mut silence = Silence::begin(outlet.now());
    let mut told = false;
    let mut bulletin = Bulletin::default();
    while !stop.is_requested() {
        outlet.beat();
        let waited = source.wait(LONGEST_WAIT)?;
        if let Some(health) = bulletin.due(&source.health(), &numbers, outlet.now()) {
            outlet.tell(&health)?;
        }
        let Some(captured) = waited else {
            let (lasted, state) = (silence.look(outlet.now()), source.health().state);
            if lasted > patience.of(state) {
                return Err(match state.is_away() {
                    true => ProcessError::CameraAway { state: state.as_str(), lasted_s: lasted.as_s() },
                    false => ProcessError::SourceSilent(lasted.as_s()),
                });
            }
            if lasted > patience.tell && !told && !state.is_away() {
                warn!("no frame for {:.1} s: is the camera connected, and does it run?", lasted.as_s());
                told = true;
            }
            continue;
        };
        if told {
            info!("frames are back");
        }
        (silence, told) = (Silence::begin(outlet.now()), false);
        let shot = numbers.shot(&captured);
        let _span = debug_span!("frame", frame = shot.frame_id).entered();
        match outlet.publish(&shot, &mut |out| source.fill(out))? {
            Filled::Image => numbers.published += 1,
            Filled::Damaged => numbers.gaps += 1,
        }
    }
    Ok(())
}

/// From the source's count to ours.
#[derive(Debug, Default, Clone, Copy)]
struct Numbers {
    /// Of the frame before: the source's number and ours.
    before: Option<(u64, u64)>,
    gaps: u64,
    lost: u64,
    published: u64,
}

impl Numbers {
    fn shot(&mut self, captured: &Captured) -> Shot {
        let frame_id = match self.before {
            None => 0,
            // A count that does not go on was begun anew: what was lost meanwhile nobody knows.
            Some((sequence, id)) => id + captured.sequence.checked_sub(sequence).unwrap_or(1).max(1),
        };
        self.gaps += frame_id - self.before.map_or(frame_id, |(_, id)| id + 1);
        self.before = Some((captured.sequence, frame_id));
        let lost = self.gaps + captured.lost;
        self.lost = captured.lost;
        let Captured { mid, span, sequence, .. } = *captured;
        Shot { frame_id, sequence, mid, span, lost, last: false }
    }
}

/// When what a source says of itself goes out.
#[derive(Debug, Default, Clone, Copy)]
struct Bulletin {
    state: CameraState,
    next: MonoNs,
    sent: u64,
}

impl Bulletin {
    /// Period of the records. Chosen by hand: it must be well below the time after which a silent camera is reported, 2 s.
    const PERIOD: SpanNs = SpanNs(200_000_000);

    /// The record that is to be sent at `now`, if one is. A source that says nothing of itself has none.
    fn due(&mut self, health: &SourceHealth, numbers: &Numbers, now: MonoNs) -> Option<CameraHealth> {
        let is_new = std::mem::replace(&mut self.state, health.state) != health.state;
        if health.state == CameraState::Unknown || !(is_new || now >= self.next) {
            return None;
        }
        self.next = now + Self::PERIOD;
        let mut flags = 0;
        for (is_set, flag) in [
            (health.stamps_are_doubted, health_flag::STAMPS_DOUBTED),
            (health.rate_is_missed, health_flag::RATE_MISSED),
        ] {
            flags |= if is_set { flag } else { 0 };
        }
        let record = CameraHealth {
            sequence: self.sent,
            stamp: now,
            since: health.since,
            frames: numbers.published,
            lost: numbers.gaps + numbers.lost,
            corrupt: health.corrupt,
            superseded: health.superseded,
            undated: health.undated,
            reopened: health.reopened,
            restarted: health.restarted,
            stamps_clamped: health.stamps_clamped,
            rate_hz: health.rate_hz.unwrap_or(f64::NAN),
            state: health.state as u32,
            camera: 0,
            flags,
            reserved: 0,
        };
        self.sent += 1;
        Some(record)
    }
}

#[cfg(test)]
mod tests;
