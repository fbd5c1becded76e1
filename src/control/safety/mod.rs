//! What can go wrong, and what the arm then does.
//!
//! | fault | reaction |
//! | --- | --- |
//! | the last good measurement grows old, from `slow_down_from` of `measurement_timeout` on | the wish fades: the arm slows down |
//! | no good measurement for `measurement_timeout`, or a moving object too uncertain | reference slows down within its limits, arm holds, run goes on; the next good measurement resumes it |
//! | drive reports NaN, infinity, or what no arm does (100 times the speed limit, 100 ranges away) | command of the previous tick without motion, run ends as fault |
//! | joint farther from its reference than `tracking_error` | reference slows down, arm holds, run ends as fault |
//! | any end of a run: goal, time, request, fault | the reference slows down within its limits, and the run ends when the measured arm is at rest (`run_end`) |
//! | `max_missed_deadlines_in_a_row` ticks missed in a row | protective stop: reference slows down, arm holds, run ends as fault |
//! | the measured arm still moves 2 s after its reference came to rest | the run ends as fault, with the last command |
//! | lockstep: a measurement does not come for 10 s | reference slows down, arm holds, run ends as fault |
//! | external drive: states stop, drive leaves, hangs or answers out of step | as for NaN: nothing can be computed any more |

use crate::drive::DriveFault;
use crate::time::{MonoNs, SpanNs};

/// Why a run ended in a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// The drive reported a joint state that is not finite.
    DriveStateNotFinite,
    /// The drive reported a joint state that no arm has.
    DriveStateImplausible,
    /// A joint is too far from its reference.
    TrackingError,
    /// Too many deadlines in a row were missed.
    DeadlinesMissed,
    /// The drive's states cannot be used any more.
    Drive(DriveFault),
    /// The measured arm did not come to rest although its reference did.
    NotAtRest,
    /// In lockstep: camera and vision owe a measurement and do not answer.
    PeersSilent,
}

impl Fault {
    /// Whether there is no joint state any more to compute with.
    #[must_use]
    pub fn blinds(self) -> bool {
        !matches!(self, Self::TrackingError | Self::DeadlinesMissed | Self::NotAtRest | Self::PeersSilent)
    }

    /// What happened, for people.
    #[must_use]
    pub fn describe(self) -> &'static str {
        match self {
            Self::DriveStateNotFinite => "the drive reported a joint state that is not finite",
            Self::DriveStateImplausible => {
                "the drive reported a joint state that no arm has: a speed of more than 100 times the joint's limit, or a \
                 position more than 100 ranges away from its range"
            }
            Self::TrackingError => {
                "a joint is farther from its reference than safety.max_tracking_error_rad_or_m"
            }
            Self::DeadlinesMissed => {
                "more deadlines in a row were missed than safety.max_missed_deadlines_in_a_row"
            }
            Self::Drive(fault) => fault.describe(),
            Self::NotAtRest => "the arm still moves although it was brought to rest: see to its drive",
            Self::PeersSilent => {
                "a measurement did not come although the loop waited for it: the camera or the vision process hangs"
            }
        }
    }
}

/// Watches that good measurements keep coming.
#[derive(Debug, Clone, Copy)]
pub struct MeasurementWatch {
    timeout: SpanNs,
    slow_down_from: f64,
    last: Option<MonoNs>,
}

/// How old the last good measurement is, as the watch says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Freshness {
    /// There has been no good measurement yet.
    Never,
    /// The last good one is young enough.
    Fresh,
    /// The last good one is too old.
    Stale,
}

impl MeasurementWatch {
    /// A watch that calls measurements stale when `timeout` has passed since their exposure, and trusts them less and
    /// less from the share `slow_down_from` of that time on (0 to 1; 1: not before).
    #[must_use]
    pub fn new(timeout: SpanNs, slow_down_from: f64) -> Self {
        Self { timeout, slow_down_from, last: None }
    }

    /// A good measurement with this exposure stamp was used.
    pub fn good(&mut self, exposure: MonoNs) {
        self.last = Some(self.last.map_or(exposure, |last| last.max(exposure)));
    }

    /// Share of the wished velocity that the age of the last good measurement still justifies at `now`: 1 for a young
    /// one, falling evenly to 0 at the timeout.
    #[must_use]
    pub fn confidence(&self, now: MonoNs) -> f64 {
        let Some(last) = self.last else { return 0.0 };
        let age = (now - last).as_s() / self.timeout.as_s();
        if age <= self.slow_down_from {
            return 1.0;
        }
        ((1.0 - age) / (1.0 - self.slow_down_from)).clamp(0.0, 1.0)
    }

    /// How things stand at `now`.
    #[must_use]
    pub fn check(&self, now: MonoNs) -> Freshness {
        match self.last {
            None => Freshness::Never,
            Some(last) if now - last <= self.timeout => Freshness::Fresh,
            Some(_) => Freshness::Stale,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn measurements_grow_stale_and_recover() {
        let mut w = MeasurementWatch::new(SpanNs(100), 0.75);
        assert_eq!(w.check(MonoNs(1_000)), Freshness::Never);
        w.good(MonoNs(950));
        assert_eq!(w.check(MonoNs(1_050)), Freshness::Fresh);
        assert_eq!(w.check(MonoNs(1_051)), Freshness::Stale);
        w.good(MonoNs(900));
        assert_eq!(w.check(MonoNs(1_051)), Freshness::Stale, "an older measurement does not refresh");
        w.good(MonoNs(1_040));
        assert_eq!(w.check(MonoNs(1_051)), Freshness::Fresh);
    }

    #[test]
    fn trust_fades_ahead_of_the_timeout() {
        let mut w = MeasurementWatch::new(SpanNs(100), 0.75);
        assert_eq!(w.confidence(MonoNs(0)), 0.0);
        w.good(MonoNs(1_000));
        let at = |age: i64| w.confidence(MonoNs(1_000 + age));
        assert_eq!((at(-5), at(0), at(75)), (1.0, 1.0, 1.0));
        assert!((at(80) - 0.8).abs() < 1e-12 && (at(95) - 0.2).abs() < 1e-12);
        assert_eq!((at(100), at(200)), (0.0, 0.0));
        let mut all = MeasurementWatch::new(SpanNs(100), 1.0);
        all.good(MonoNs(0));
        assert_eq!((all.confidence(MonoNs(100)), all.confidence(MonoNs(101))), (1.0, 0.0));
    }
}
