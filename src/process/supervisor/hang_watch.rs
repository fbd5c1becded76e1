//! Watchdog of the processes of a run: a process that hangs neither ends nor reports anything.
//!
//! The numbers here were chosen by hand, so that a process that is kept from its core by load is reported before it ends the run.
//!
//! | sign of life | of | by |
//! | --- | --- | --- |
//! | its heartbeat, in the file of its role's lock | camera, vision, control | its main loop |
//! | `control/status` goes on | control's real-time thread | its ticks, once they have begun |

use crate::config::Clock;
use crate::ipc::{Instance, Role};
use crate::messages::Status;
use crate::process::silence::Silence;
use crate::time::{MonoNs, SpanNs};
use tracing::warn;

/// Period of the checks.
const PERIOD: SpanNs = SpanNs(100_000_000);
/// A silence that is reported.
const REPORT_AFTER: SpanNs = SpanNs(2_000_000_000);
/// A silence that ends the run.
const GIVE_UP_AFTER: SpanNs = SpanNs(6_000_000_000);
/// From the start of a process to its first sign: a busy machine may take its time.
const START_UP: SpanNs = SpanNs(20_000_000_000);

/// The signs of life of a run's processes.
pub(super) struct HangWatch {
    instance: Instance,
    clock: Clock,
    next_look: MonoNs,
    heartbeats: Vec<(Role, Sign)>,
    ticks: Sign,
}

impl HangWatch {
    /// Over control and those that see for it.
    pub(super) fn new(instance: &Instance, clock: Clock, seeing: Vec<Role>, now: MonoNs) -> Self {
        let sign = Sign::new(now);
        let heartbeats = std::iter::once(Role::Control).chain(seeing).map(|role| (role, sign)).collect();
        Self { instance: instance.clone(), clock, next_look: now, heartbeats, ticks: sign }
    }

    /// Control said where the run stands.
    pub(super) fn note(&mut self, status: &Status, now: MonoNs) {
        self.ticks.seen(status.tick as i64, now);
    }

    /// Whether control has ticked at all.
    pub(super) fn has_ticked(&self) -> bool {
        self.ticks.last.is_some()
    }

    /// Checks at `now`; returns the process that has been silent for too long, and for how long.
    pub(super) fn look(&mut self, now: MonoNs) -> Option<(Role, SpanNs)> {
        if now < self.next_look {
            return None;
        }
        self.next_look = now + PERIOD;
        let mut hangs = None;
        for (role, sign) in &mut self.heartbeats {
            if let Some(heartbeat) = self.instance.last_heartbeat(*role) {
                sign.seen(heartbeat.0, now);
            }
            hangs = sign.judge(*role, "shows no sign of life", now).or(hangs);
        }
        // In lockstep control's ticks wait for camera and vision; then its heartbeat alone is a sign.
        if self.clock == Clock::Realtime && self.ticks.last.is_some() {
            hangs = self.ticks.judge(Role::Control, "does not tick", now).or(hangs);
        }
        hangs
    }
}

/// A value that changes while its process lives.
#[derive(Debug, Clone, Copy)]
struct Sign {
    last: Option<i64>,
    silence: Silence,
    told: bool,
}

impl Sign {
    fn new(now: MonoNs) -> Self {
        Self { last: None, silence: Silence::begin(now), told: false }
    }

    fn seen(&mut self, value: i64, now: MonoNs) {
        if self.last != Some(value) {
            *self = Self { last: Some(value), ..Self::new(now) };
        }
    }

    fn judge(&mut self, role: Role, what: &str, now: MonoNs) -> Option<(Role, SpanNs)> {
        let silent = self.silence.look(now);
        let patience = if self.last.is_some() { GIVE_UP_AFTER } else { START_UP };
        if silent > REPORT_AFTER && !std::mem::replace(&mut self.told, true) {
            warn!(
                "the {role} process {what} for {:.0} s; the run ends after {:.0} s",
                silent.as_s(),
                patience.as_s()
            );
        }
        (silent > patience).then_some((role, silent))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::CameraId;

    #[test]
    fn a_sign_that_does_not_change_is_told_then_given_up() {
        let at = |ms: i64| MonoNs(ms * 1_000_000);
        let mut sign = Sign::new(at(0));
        let mut given_up = None;
        for ms in (0..40_000).step_by(100) {
            if ms < 3_000 {
                sign.seen(ms, at(ms));
            }
            if sign.judge(Role::Vision(CameraId::FIRST), "is silent", at(ms)).is_some() {
                given_up.get_or_insert(ms);
            } else {
                assert_eq!(given_up, None);
            }
            assert_eq!(sign.told, ms > 2_900 + 2_000, "{ms}");
        }
        assert_eq!(given_up, Some(2_900 + 6_100));
    }

    #[test]
    fn a_start_may_take_longer() {
        let mut sign = Sign::new(MonoNs(0));
        let first = (0..400).map(|k| k * 100).find(|ms| {
            sign.judge(Role::Camera(CameraId::FIRST), "is silent", MonoNs(ms * 1_000_000)).is_some()
        });
        assert_eq!(first, Some(20_100));
    }
}
