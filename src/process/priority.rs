//! Real-time priorities of the processes beside control: what they do late, control misses. The guardian alone is above it.
//!
//! | thread | SCHED_FIFO priority |
//! | --- | --- |
//! | control's real-time thread | `realtime.priority` |
//! | guardian: some microseconds each millisecond | 1 above: it must see a control that spins |
//! | control's companion, where it carries an external drive's messages | 1 below |
//! | camera: exposes at its time | 9 below |
//! | vision: measures what was exposed | 10 below |
//! | recorder | none, but before others that have none |

use super::ProcessError;
use crate::config::{Clock, RealtimePolicy};
use crate::config::{Config, RealtimeRequest};
use crate::rt;
use tracing::info;

/// Where the others are, seen from control.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Rank {
    /// The guardian.
    Guardian,
    /// Control's companion.
    Companion,
    /// A camera.
    Camera,
    /// Vision.
    Vision,
}

impl Rank {
    /// Its priority where control's is `control`, which is 98 at most.
    fn beside(self, control: u32) -> u32 {
        let below = match self {
            Self::Guardian => return control.saturating_add(1),
            Self::Companion => 1,
            Self::Camera => 9,
            Self::Vision => 10,
        };
        control.saturating_sub(below).max(1)
    }

    /// What a thread of this rank asks for where control asks for `control`.
    pub(super) fn request(self, control: &RealtimeRequest) -> RealtimeRequest {
        RealtimeRequest { priority: self.beside(control.priority), cpu: None, lock_memory: false }
    }
}

/// Asks for the priority of `rank` for this thread, in real time and as `realtime.policy` says; the result is reported.
///
/// # Errors
/// Under policy `enforce`, when it is refused.
pub(super) fn take(config: &Config, rank: Rank) -> Result<(), ProcessError> {
    if config.clock != Clock::Realtime || config.realtime.policy == RealtimePolicy::Off {
        return Ok(());
    }
    let obtained = rt::prepare_thread(&rank.request(&config.realtime.request));
    if config.realtime.policy == RealtimePolicy::Enforce {
        obtained.require_all()?;
    }
    match obtained.fifo {
        Some(Ok(priority)) => info!("real-time scheduling: SCHED_FIFO {priority}"),
        Some(Err(refusal)) => info!("real-time scheduling: normal priority (SCHED_FIFO: {refusal})"),
        None => {}
    }
    Ok(())
}

/// Puts the recorder, without real-time priority, before programs that have nothing to do with the run, in real time and unless `realtime.policy` is off.
pub(super) fn prefer(config: &Config) {
    if config.clock == Clock::Realtime && config.realtime.policy != RealtimePolicy::Off {
        rt::prefer_thread();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_but_the_guardian_are_below_control_and_above_nothing() {
        for control in [1, 5, 80, 98] {
            let request = RealtimeRequest { priority: control, cpu: Some(1), lock_memory: true };
            let of = |rank: Rank| rank.request(&request).priority;
            let (companion, camera, vision) = (of(Rank::Companion), of(Rank::Camera), of(Rank::Vision));
            assert!(companion >= camera && camera >= vision && vision >= 1, "{control}");
            assert!(companion < control || control == 1);
            assert_eq!(Rank::Vision.request(&request).cpu, None, "the core is control's");
        }
        let usual = RealtimeRequest { priority: 80, cpu: None, lock_memory: false };
        assert_eq!(
            [Rank::Guardian, Rank::Companion, Rank::Camera, Rank::Vision].map(|r| r.request(&usual).priority),
            [81, 79, 71, 70]
        );
    }
}
