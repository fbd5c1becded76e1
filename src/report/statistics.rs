//! What is counted during a run, from the trace of its ticks: latencies, settling, limits, events, and the hash over all joint
//! states.

use super::latency::LatencyTable;
use super::summary::{Latencies, LimitedTicks, SafetyEvent, SafetyReport};
use crate::control::trace::{Event, Trace};
use crate::messages::{ControlState, JointState};
use crate::motion::{Limit, LimitWatch};
use crate::time::MonoNs;
use xxhash_rust::xxh3::Xxh3;

/// Share of the first feature error below which the run counts as settled.
const SETTLED_SHARE: f64 = 0.02;
/// Events that are kept.
const MAX_EVENTS: usize = 64;

/// What was counted during a run.
#[derive(Clone)]
pub struct RunStatistics {
    first: Option<MonoNs>,
    latencies: LatencyTable,
    feature_error_px: f64,
    first_error_px: f64,
    last_unsettled: Option<MonoNs>,
    hash: Xxh3,
    limits: LimitWatch,
    events: Vec<(MonoNs, String)>,
}

impl Default for RunStatistics {
    fn default() -> Self {
        Self::new()
    }
}

impl RunStatistics {
    /// Before the first tick.
    #[must_use]
    pub fn new() -> Self {
        Self {
            first: None,
            latencies: LatencyTable::default(),
            feature_error_px: f64::NAN,
            first_error_px: f64::NAN,
            last_unsettled: None,
            hash: Xxh3::new(),
            limits: LimitWatch::default(),
            events: Vec::new(),
        }
    }

    /// Takes a tick in.
    pub fn note(&mut self, trace: &Trace) {
        self.first.get_or_insert(trace.time);
        self.hash_state(&trace.joint_state);
        if let Some(sighting) = &trace.sighting {
            self.settle(trace.time, sighting.error_px);
            if let Some(latency) = &sighting.latency {
                self.latencies.record(latency);
            }
        }
        for event in trace.events.iter() {
            self.event(trace.time, describe(event));
        }
        let mut watch = self.limits;
        watch.note(trace.time, &trace.limits, |long| self.event(trace.time, long.describe()));
        self.limits = watch;
    }

    /// The latencies, us.
    #[must_use]
    pub fn latencies(&self) -> Latencies {
        self.latencies.quantiles_us()
    }

    /// When the feature error came below 2 % of its first value for good, s.
    #[must_use]
    pub fn settling_time_s(&self) -> Option<f64> {
        let first = self.first?;
        let settled = self.feature_error_px <= SETTLED_SHARE * self.first_error_px;
        settled.then(|| self.last_unsettled.map_or(0.0, |last| (last - first).as_s()))
    }

    /// What safety saw, of a run whose loop is in `state`.
    #[must_use]
    pub fn safety_report(&self, state: ControlState) -> SafetyReport {
        let first = self.first.unwrap_or(MonoNs::ZERO);
        let described = |(at, event): &(MonoNs, String)| SafetyEvent {
            time_s: (*at - first).as_s(),
            event: event.clone(),
        };
        let ticks = |limit| self.limits.ticks(limit);
        SafetyReport {
            state: state.as_str().into(),
            events: self.events.iter().map(described).collect(),
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

    /// Hash over every joint state so far, hexadecimal.
    #[must_use]
    pub fn state_hash(&self) -> String {
        format!("{:032x}", self.hash.digest128())
    }

    fn hash_state(&mut self, state: &JointState) {
        let joints = state.joints as usize;
        for x in state.q.iter().take(joints).chain(state.qd.iter().take(joints)) {
            self.hash.update(&x.to_bits().to_le_bytes());
        }
    }

    fn settle(&mut self, time: MonoNs, error_px: f64) {
        if error_px.is_nan() {
            return;
        }
        self.feature_error_px = error_px;
        if self.first_error_px.is_nan() {
            self.first_error_px = error_px;
        }
        if error_px > SETTLED_SHARE * self.first_error_px {
            self.last_unsettled = Some(time);
        }
    }

    fn event(&mut self, at: MonoNs, event: String) {
        if self.events.len() < MAX_EVENTS {
            self.events.push((at, event));
        }
    }
}

/// For people.
fn describe(event: Event) -> String {
    let text = match event {
        Event::Holding => "measurements stopped or are too uncertain: the arm slows down and holds",
        Event::Resumed => "measurements are back: the arm goes on",
        Event::Stopping => "stop requested: the arm slows down",
        Event::Fault(fault) => fault.describe(),
        Event::StampFromFuture => {
            "an exposure stamp lies in the future: `vservo calibrate latency` finds camera.stamp_offset_ms"
        }
        Event::Degraded => "a part of the target is hidden: degraded, the law goes on with the rest",
        Event::WholeAgain => "the whole target is seen again",
        Event::StartsElsewhere => "the arm does not start where robot.q_start_rad_or_m says",
        Event::Taught => "the goal is taught",
        Event::Requested(request) => return format!("{} on request", request.as_str()),
        Event::GoalReached => "the goal was reached and held",
        Event::ImpossiblePose => {
            "a measurement was refused, its pose is none that an object before a camera has: see to the vision process"
        }
        Event::Inconsistent => {
            "a measurement was refused, its dots do not fit one pose: shadow, glare, something in front?"
        }
    };
    text.into()
}
