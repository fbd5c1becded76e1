//! The loop of a source that exposes by its own clock: frames go out as they come, numbered by the source's own count.
//!
//! ```text
//! sequence of the source   7   8       10  11     2   3        (9 was lost; then it was started anew)
//! frame_id                 0   1        3   4     5   6
//! lost                     0   0        1   1     1   1        and what the source itself says it lost
//! ```
//! A source that falls silent is told of, and then ends the process: nobody waits for a camera that was unplugged.

use super::{Outlet, Shot};
use crate::process::silence::Silence;
use crate::process::{LONGEST_WAIT, ProcessError, StopFlag};
use crate::source::{Captured, FreeRunningSource};
use crate::time::SpanNs;
use tracing::{info, warn};

/// How long a source may be silent.
#[derive(Debug, Clone, Copy)]
pub(super) struct Patience {
    /// A silence that is worth a line.
    tell: SpanNs,
    /// One that is the end.
    end: SpanNs,
}

impl Patience {
    /// For a source that is to give so many frames a second.
    pub(super) fn with(rate_hz: f64) -> Self {
        let period_s = 1.0 / rate_hz;
        Self { tell: SpanNs::from_s(2.0 + period_s), end: SpanNs::from_s(6.0 + 3.0 * period_s) }
    }
}

/// Hands over frames until a stop is requested.
pub(super) fn run(
    source: &mut dyn FreeRunningSource,
    outlet: &mut impl Outlet,
    patience: Patience,
    stop: &StopFlag,
) -> Result<(), ProcessError> {
    let mut numbers = Numbers::default();
    let mut silence = Silence::begin(outlet.now());
    let mut told = false;
    while !stop.is_requested() {
        outlet.beat();
        let Some(captured) = source.wait(LONGEST_WAIT)? else {
            let lasted = silence.look(outlet.now());
            if lasted > patience.end {
                return Err(ProcessError::SourceSilent(lasted.as_s()));
            }
            if lasted > patience.tell && !told {
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
        outlet.publish(&shot, &mut |out| source.fill(out))?;
    }
    Ok(())
}

/// From the source's count to ours.
#[derive(Debug, Default, Clone, Copy)]
struct Numbers {
    /// Of the frame before: the source's number and ours.
    before: Option<(u64, u64)>,
    gaps: u64,
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
        let Captured { mid, span, sequence, .. } = *captured;
        Shot { frame_id, sequence, mid, span, lost, last: false }
    }
}

#[cfg(test)]
mod tests;
