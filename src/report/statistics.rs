//! What is counted during a run: measurements, latencies, errors, safety events, and the hash over all joint states.
//! Nothing here allocates until the summary is made.

use crate::control::safety::Fault;
use crate::drive::DriveState;
use crate::messages::{ControlState, Measurement};
use crate::motion::{ActingLimits, Limit, LimitWatch, LongActing};
use crate::report::latency::{LatencyStages, LatencyTable};
use crate::report::summary::{IntakeCounts, Latencies, LimitedTicks, SafetyEvent, SafetyReport};
use crate::servo::Intake;
use crate::time::MonoNs;
use xxhash_rust::xxh3::Xxh3;

/// Share of the first feature error below which the run counts as settled.
const SETTLED_SHARE: f64 = 0.02;
/// Events that are kept; later ones are only counted.
const MAX_EVENTS: usize = 64;

/// Kinds of safety events.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Event {
    /// Measurements stopped.
    Holding,
    /// Measurements are back.
    Resumed,
    /// A stop was requested.
    Stopping,
    /// A fault.
    Fault(Fault),
    /// A limit that has acted for long.
    Limit(LongActing),
    /// The first stamp that lay in the future.
    StampFromFuture,
    /// The first measurement whose dots did not fit one pose.
    Inconsistent,
}

/// What was counted during a run.
#[derive(Clone)]
pub struct RunStatistics {
    ticks: u64,
    measurements: u64,
    intake: IntakeCounts,
    latencies: LatencyTable,
    last_measurement: Option<Measurement>,
    last_found: Option<Measurement>,
    feature_error_px: f64,
    first_error_px: f64,
    last_unsettled: Option<MonoNs>,
    hash: Xxh3,
    limits: LimitWatch,
    events: [(MonoNs, Option<Event>); MAX_EVENTS],
    event_count: usize,
}

impl RunStatistics {
    pub(crate) fn new() -> Self {
        Self {
            ticks: 0,
            measurements: 0,
            intake: IntakeCounts::default(),
            latencies: LatencyTable::default(),
            last_measurement: None,
            last_found: None,
            feature_error_px: f64::NAN,
            first_error_px: f64::NAN,
            last_unsettled: None,
            hash: Xxh3::new(),
            limits: LimitWatch::default(),
            events: [(MonoNs::ZERO, None); MAX_EVENTS],
            event_count: 0,
        }
    }

    /// The latencies, us.
    #[must_use]
    pub fn latencies(&self) -> Latencies {
        self.latencies.quantiles_us()
    }

    /// Ticks done.
    #[must_use]
    pub fn ticks(&self) -> u64 {
        self.ticks
    }

    /// Good and bad measurements that reached the controller.
    #[must_use]
    pub fn measurements(&self) -> u64 {
        self.measurements
    }

    /// Root mean square feature error of the newest good measurement, px; NaN before the first.
    #[must_use]
    pub fn feature_error_px(&self) -> f64 {
        self.feature_error_px
    }

    pub(crate) fn ticked(&mut self) {
        self.ticks += 1;
    }

    /// The command that used the newest measurement was written.
    pub(crate) fn commanded(&mut self, at: MonoNs, one_clock: bool) {
        if let Some(m) = &self.last_measurement {
            self.latencies.record(&LatencyStages::of(m, at, one_clock));
        }
    }

    /// The stages of the newest measurement that was commanded.
    #[must_use]
    pub fn newest_latency(&self) -> &LatencyStages {
        self.latencies.newest()
    }

    /// Counts a measurement; `error_px` is NaN for a bad one.
    pub(crate) fn count(&mut self, now: MonoNs, m: &Measurement, error_px: f64) {
        self.measurements += 1;
        self.last_measurement = Some(*m);
        if error_px.is_nan() {
            return;
        }
        self.last_found = Some(*m);
        self.feature_error_px = error_px;
        if self.first_error_px.is_nan() {
            self.first_error_px = error_px;
        }
        if error_px > SETTLED_SHARE * self.first_error_px {
            self.last_unsettled = Some(now);
        }
    }

    /// Counts what became of a measurement.
    pub(crate) fn taken(&mut self, now: MonoNs, intake: Intake) {
        let counts = &mut self.intake;
        let first_from_future = counts.used_from_future + counts.refused_from_future == 0;
        let first_inconsistent = counts.refused_inconsistent == 0;
        *match intake {
            Intake::Used => &mut counts.used,
            Intake::UsedFromFuture => &mut counts.used_from_future,
            Intake::NoTarget => &mut counts.no_target,
            Intake::OtherFeatures => &mut counts.refused_features,
            Intake::Inconsistent => &mut counts.refused_inconsistent,
            Intake::NotNewer => &mut counts.refused_not_newer,
            Intake::RefusedFromFuture => &mut counts.refused_from_future,
            Intake::TooOld => &mut counts.refused_too_old,
        } += 1;
        if first_from_future && matches!(intake, Intake::UsedFromFuture | Intake::RefusedFromFuture) {
            self.event(now, Event::StampFromFuture);
        }
        if first_inconsistent && intake == Intake::Inconsistent {
            self.event(now, Event::Inconsistent);
        }
    }

    /// What became of the measurements.
    #[must_use]
    pub fn intake(&self) -> &IntakeCounts {
        &self.intake
    }

    /// The newest good measurement.
    #[must_use]
    pub fn last_found(&self) -> Option<&Measurement> {
        self.last_found.as_ref()
    }

    pub(crate) fn settling_time_s(&self, first: MonoNs) -> Option<f64> {
        let settled = self.feature_error_px <= SETTLED_SHARE * self.first_error_px;
        settled.then(|| self.last_unsettled.map_or(0.0, |last| (last - first).as_s()))
    }

    pub(crate) fn safety_report(&self, state: ControlState, first: MonoNs) -> SafetyReport {
        let kept = self.events.iter().take(self.event_count);
        let described = |(at, event): &(MonoNs, Option<Event>)| {
            Some(SafetyEvent { time_s: (*at - first).as_s(), event: (*event)?.describe() })
        };
        let ticks = |limit| self.limits.ticks(limit);
        SafetyReport {
            state: state.as_str().into(),
            events: kept.filter_map(described).collect(),
            limited_ticks: LimitedTicks {
                position: ticks(Limit::Position),
                velocity: ticks(Limit::Velocity),
                acceleration: ticks(Limit::Acceleration),
                jerk: ticks(Limit::Jerk),
                effort: ticks(Limit::Effort),
                singularity: ticks(Limit::Singularity),
                view: ticks(Limit::View),
            },
        }
    }

    /// The newest measurement.
    #[must_use]
    pub fn last_measurement(&self) -> Option<&Measurement> {
        self.last_measurement.as_ref()
    }

    /// Hash over every joint state so far, hexadecimal.
    #[must_use]
    pub fn state_hash(&self) -> String {
        format!("{:032x}", self.hash.digest128())
    }

    /// Takes a joint state into the hash.
    pub(crate) fn hash_state<const N: usize>(&mut self, state: &DriveState<N>) {
        for x in state.q.iter().chain(state.qd.iter()) {
            self.hash.update(&x.to_bits().to_le_bytes());
        }
    }

    /// Counts the limits that acted; one that has acted for long is an event.
    pub(crate) fn limited(&mut self, now: MonoNs, acting: &ActingLimits) {
        let mut watch = self.limits;
        watch.note(now, acting, |long| self.event(now, Event::Limit(long)));
        self.limits = watch;
    }

    /// Notes a safety event.
    pub(crate) fn event(&mut self, at: MonoNs, event: Event) {
        if let Some(place) = self.events.get_mut(self.event_count) {
            *place = (at, Some(event));
        }
        self.event_count += 1;
    }
}

impl Event {
    fn describe(self) -> String {
        let text = match self {
            Self::Holding => "measurements stopped or are too uncertain: the arm slows down and holds",
            Self::Resumed => "measurements are back: the arm goes on",
            Self::Stopping => "stop requested: the arm slows down",
            Self::Fault(fault) => fault.describe(),
            Self::StampFromFuture => {
                "an exposure stamp lies in the future: `vservo calibrate latency` finds camera.stamp_offset_ms"
            }
            Self::Inconsistent => {
                "a measurement was refused, its dots do not fit one pose: shadow, glare, something in front?"
            }
            Self::Limit(long) => return long.describe(),
        };
        text.into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refused_measurements_are_counted_and_told_once() {
        let mut statistics = RunStatistics::new();
        for ms in 1..=3 {
            statistics.taken(MonoNs(ms * 1_000_000), Intake::Inconsistent);
        }
        statistics.taken(MonoNs(4_000_000), Intake::NoTarget);
        let counts = IntakeCounts { no_target: 1, refused_inconsistent: 3, ..IntakeCounts::default() };
        assert_eq!(*statistics.intake(), counts);
        let report = statistics.safety_report(ControlState::Servoing, MonoNs(0));
        assert_eq!(report.events.len(), 1, "{:?}", report.events);
        assert!(report.events[0].event.contains("do not fit one pose"), "{:?}", report.events);
    }
}
