//! What is counted during a run, from the trace of its ticks: latencies, settling, limits, events, and the hash over all joint
//! states.

use super::latency::LatencyTable;
use super::summary::{HeldBy, Latencies, LimitedTicks, SafetyEvent, SafetyReport};
use crate::control::safety::Fault;
use crate::control::trace::{Event, Trace};
use crate::messages::{CameraId, ControlState, JointState};
use crate::motion::{Limit, LimitWatch, SpaceLimit, WorkspaceSettings};
use crate::time::MonoNs;
use std::collections::VecDeque;
use xxhash_rust::xxh3::Xxh3;

/// Share of the first feature error below which the run counts as settled: the usual 2 % of textbooks on control.
const SETTLED_SHARE: f64 = 0.02;
/// Events that are kept from the beginning of a run, and from its end. Chosen by hand: a summary must stay readable.
const KEPT_EVENTS: usize = 32;

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
    /// Ticks in which each limit in space acted, by its number.
    held: [u64; SpaceLimit::COUNT],
    events: EventLog,
    joint_names: Vec<String>,
}

/// The first events and the last ones: a fault comes last, and what led to it may have come first.
#[derive(Debug, Clone, Default)]
struct EventLog {
    first: Vec<(MonoNs, String)>,
    last: VecDeque<(MonoNs, String)>,
    /// How many came between them.
    left_out: u64,
}

impl EventLog {
    fn push(&mut self, at: MonoNs, event: String) {
        if self.first.len() < KEPT_EVENTS {
            self.first.push((at, event));
            return;
        }
        if self.last.len() == KEPT_EVENTS {
            self.last.pop_front();
            self.left_out += 1;
        }
        self.last.push_back((at, event));
    }
}

impl RunStatistics {
    /// Before the first tick of an arm whose joints have these names.
    #[must_use]
    pub fn new(joint_names: Vec<String>) -> Self {
        Self {
            first: None,
            latencies: LatencyTable::default(),
            feature_error_px: f64::NAN,
            first_error_px: f64::NAN,
            last_unsettled: None,
            hash: Xxh3::new(),
            limits: LimitWatch::default(),
            held: [0; SpaceLimit::COUNT],
            events: EventLog::default(),
            joint_names,
        }
    }

    /// Takes a tick in.
    pub fn note(&mut self, trace: &Trace) {
        self.first.get_or_insert(trace.time);
        self.hash_state(&trace.joint_state);
        if let Some(latest) = &trace.measurement_record {
            // Of two cameras that control the arm the first one tells when it has settled.
            if latest.frame.camera == u32::from(CameraId::FIRST) {
                self.settle(trace.time, latest.error_px);
            }
            if let Some(latency) = &latest.latency {
                self.latencies.record(latency);
            }
        }
        for event in trace.events.iter() {
            self.event(trace.time, describe(event));
        }
        let (mut watch, names) = (self.limits, std::mem::take(&mut self.joint_names));
        watch.note(trace.time, &trace.limits, |long| self.event(trace.time, long.describe(&names)));
        (self.limits, self.joint_names) = (watch, names);
        if let Some(held) = trace.held_by.and_then(|limit| self.held.get_mut(limit.number())) {
            *held += 1;
        }
    }

    /// The limits in space that acted, by the names that `space` gives them; those of one name together.
    #[must_use]
    pub fn held_by(&self, space: &WorkspaceSettings) -> Vec<HeldBy> {
        let mut all: Vec<HeldBy> = Vec::new();
        for (number, ticks) in self.held.iter().enumerate().filter(|(_, ticks)| **ticks > 0) {
            let limit = space.name_of(number);
            match all.iter_mut().find(|one| one.limit == limit) {
                Some(one) => one.ticks += ticks,
                None => all.push(HeldBy { limit, ticks: *ticks }),
            }
        }
        all
    }

    /// Takes in what the trace does not tell: an event around the loop.
    pub fn note_event(&mut self, at: MonoNs, event: String) {
        self.event(at, event);
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
            events: self.events.first.iter().chain(&self.events.last).map(described).collect(),
            events_left_out: self.events.left_out,
            limited_ticks: LimitedTicks {
                position: ticks(Limit::Position),
                velocity: ticks(Limit::Velocity),
                acceleration: ticks(Limit::Acceleration),
                jerk: ticks(Limit::Jerk),
                effort: ticks(Limit::Effort),
                singularity: ticks(Limit::Singularity),
                view: ticks(Limit::View),
                stall: ticks(Limit::Stall),
                workspace: ticks(Limit::Workspace),
            },
            held_by: Vec::new(),
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
        self.events.push(at, event);
    }
}

/// An event, for people.
#[must_use]
pub fn describe(event: Event) -> String {
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
        Event::Arrived => "the posture that was asked for is reached",
        Event::VelocityEnded => "no velocity is asked for any more: the arm rests",
        Event::RobotReady => "the robot obeys commands again: the fault is reset",
        Event::RobotNotCleared => {
            "the robot has not cleared its error: see to it at the robot, then `vservo ctl reset` again"
        }
        Event::GoalLeft => "the goal that was reached is not met any more",
        Event::Returning => "the arm goes back to where it saw the whole target last",
        Event::Searching => "the arm looks around for its target, slowly",
        Event::LostAgain => {
            "the target is lost for the third time where it was lost before: the arm holds. Something stands in the way of the view or of the arm there, such as a plane of [workspace], a limit or an obstacle"
        }
        Event::AnotherWay => {
            "the law lost its target twice, or came no nearer: it goes another way, by the mean interaction matrix in place of servo.interaction, or by the current one in place of the mean, until another goal is set"
        }
        Event::MountTried => {
            "the image moved as before a camera whose mount is wrong, or askew: the arm moves the camera back a little, without a turn, to tell which"
        }
        Event::LensTried => {
            "the image moved as before a target or by a lens of another size than is told: the camera is turned by a third of a degree, and back, to tell which"
        }
        Event::FirstViewMissing => "the first camera does not see its target: the arm goes by the second one",
        Event::SecondViewMissing => {
            "the second camera does not see its target: the arm goes by the first one"
        }
        Event::BothViews => "both cameras see their targets: the arm goes by both",
        Event::StillMoves => Fault::NotAtRest.describe(),
        Event::NeverSeen => {
            "the target of the goal is not in view and was never seen whole in this run: bring the arm to where it is, by `vservo ctl goto`, `goto` of a program or [postures]"
        }
        Event::MotionOver => "the motion that was asked for is over",
        Event::GainReduced => "the arm moves about its goal and gets no nearer: gain and learning go down",
        Event::ImpossiblePose => {
            "a measurement was refused, its pose is none that an object before a camera has: see to the vision process"
        }
        Event::Inconsistent => {
            "a measurement was refused, its points do not fit one pose: shadow, glare, something in front?"
        }
    };
    text.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_late_event_is_told_however_much_happened_before() {
        let mut statistics = RunStatistics::new(Vec::new());
        for ms in 0..=1000 {
            statistics.event(MonoNs(ms * 1_000_000), format!("event {ms}"));
        }
        let report = statistics.safety_report(ControlState::Fault);
        let told: Vec<_> = report.events.iter().map(|e| e.event.clone()).collect();
        let wanted: Vec<_> = (0..32).chain(969..=1000).map(|ms| format!("event {ms}")).collect();
        assert_eq!(told, wanted);
        assert_eq!(report.gap(), Some((32, "937 events are left out here".to_owned())));
        assert_eq!(RunStatistics::new(Vec::new()).safety_report(ControlState::Waiting).gap(), None);
    }
}
