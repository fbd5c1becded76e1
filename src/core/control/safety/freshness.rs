//! Whether good measurements keep arriving.

use crate::time::{MonoNs, SpanNs};

/// Watches that good measurements keep arriving.
#[derive(Debug, Clone, Copy)]
pub struct MeasurementWatch {
    timeout: SpanNs,
    slow_down_from: f64,
    last: Option<MonoNs>,
    /// When the last measurement of any kind came.
    any: Option<MonoNs>,
}

/// The age of the last good measurement.
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
        Self { timeout, slow_down_from, last: None, any: None }
    }

    /// The age from which on measurements are stale.
    #[must_use]
    pub fn timeout(&self) -> SpanNs {
        self.timeout
    }

    /// A measurement came at `now`, whatever it says. Its stamp is not asked, because it may be absurd.
    pub fn came(&mut self, now: MonoNs) {
        self.any = Some(now);
    }

    /// Whether measurements keep coming at `now`, good or not: camera and vision are at work.
    #[must_use]
    pub fn sees(&self, now: MonoNs) -> bool {
        self.any.is_some_and(|any| now - any <= self.timeout)
    }

    /// No measurement was good so far: those that were are of another target.
    pub fn forget(&mut self) {
        self.last = None;
    }

    /// A good measurement with this exposure stamp was used.
    pub fn good(&mut self, exposure: MonoNs) {
        self.last = Some(self.last.map_or(exposure, |last| last.max(exposure)));
    }

    /// Share of the requested velocity that the age of the last good measurement still justifies at `now`: 1 for a young
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

    /// The freshness at `now`.
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
    fn a_camera_that_sees_no_target_is_at_work() {
        let mut w = MeasurementWatch::new(SpanNs(100), 1.0);
        assert!(!w.sees(MonoNs(0)));
        w.came(MonoNs(1_000));
        assert!(w.sees(MonoNs(1_100)) && !w.sees(MonoNs(1_101)));
        assert_eq!(w.check(MonoNs(1_000)), Freshness::Never, "it was not good");
    }

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

    /// What was good of one target is not of another; that measurements come is true of both.
    #[test]
    fn another_target_was_not_seen_yet() {
        let mut w = MeasurementWatch::new(SpanNs(100), 0.75);
        assert_eq!(w.timeout(), SpanNs(100));
        w.came(MonoNs(1_000));
        w.good(MonoNs(1_000));
        w.forget();
        assert_eq!((w.check(MonoNs(1_000)), w.confidence(MonoNs(1_000))), (Freshness::Never, 0.0));
        assert!(w.sees(MonoNs(1_000)));
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
