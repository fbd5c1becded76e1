//! The record of a tick as it is sent: a flat structure, in which enumerations are codes.

use super::{CommandTrace, Event, Events, FrameStamps, LatencyStages, MeasurementRecord, Trace};
use crate::control::lifecycle::Request;
use crate::control::safety::Fault;
use crate::messages::{ControlState, JointState, MAX_JOINTS, TRACE_LIMITS, TraceMsg, joint_flag, trace_flag};
use crate::motion::{ActingLimits, Limit};
use crate::servo::{MeasurementVerdict, NoTask};

impl Trace {
    /// The record of `control/trace`.
    #[must_use]
    pub fn record(&self) -> TraceMsg {
        let (js, command) = (&self.joint_state, &self.command);
        let mut limits = [0; TRACE_LIMITS];
        for limit in Limit::ALL {
            if let Some(joints) = limits.get_mut(limit as usize) {
                *joints = self.limits.joints(limit);
            }
        }
        let mut m = TraceMsg {
            tick: js.tick,
            sequence: js.sequence,
            lost: self.lost,
            stamp: self.time,
            commanded: self.commanded,
            feature_error_px: f64::NAN,
            arm: js.arm,
            joints: js.joints,
            state: self.state as u32,
            fault: self.fault.map_or(0, Fault::code),
            outcome: self.finish.map_or(0, |finish| finish.outcome.code()),
            events: self.events.iter().fold(0, |bits, event| bits | 1 << event_number(event)),
            orders: self.orders,
            flags: self.inputs | (self.robot.state as u32) << trace_flag::ROBOT_STATE,
            limits,
            q: js.q,
            qd: js.qd,
            q_true: js.q_true,
            qd_true: js.qd_true,
            requested_qd: command.requested_qd,
            tau: command.tau,
            q_r: command.q_r,
            qd_r: command.qd_r,
            external_torque: self.external_torque[0],
            external_torque_sd: self.external_torque[1],
            measured_torque: self.measured_torque.unwrap_or([f64::NAN; MAX_JOINTS]),
            ..TraceMsg::default()
        };
        if js.flags & joint_flag::TRUTH != 0 {
            m.flags |= trace_flag::TRUTH;
        }
        if self.contact.is_some() {
            m.flags |= trace_flag::CONTACT;
        }
        if self.gives_orders {
            m.flags |= trace_flag::ORDERS_GIVEN;
        }
        if self.finish.is_some() {
            m.flags |= trace_flag::LAST;
        }
        if let Some(s) = &self.measurement_record {
            m.flags |= trace_flag::MEASUREMENT;
            m.frame_id = s.frame.frame_id;
            m.camera = s.frame.camera;
            m.exposure = s.frame.exposure;
            m.frame_sent = s.frame.sent;
            m.vision_start = s.frame.vision_start;
            m.vision_end = s.frame.vision_end;
            m.feature_error_px = s.error_px;
            m.verdict = s.verdict.map_or(0, verdict_code);
        }
        m
    }
}

impl Trace {
    /// The trace of a record, as far as that tells: without what only the mission and the report of the same process know, and without the verdict on its measurement. The latency
    /// counts where `one_clock` says that all stamps are of the same clock.
    #[must_use]
    pub fn of_record(m: &TraceMsg, one_clock: bool) -> Self {
        let has = |flag: u32| m.flags & flag != 0;
        let mut limits = ActingLimits::default();
        for limit in Limit::ALL {
            limits.add(limit, m.limits.get(limit as usize).copied().unwrap_or(0));
        }
        let fault = Fault::from_code(m.fault);
        let mut events = Events::default();
        for event in events_of(m.events) {
            match event {
                Event::Fault(_) => fault.into_iter().for_each(|fault| events.push(Event::Fault(fault))),
                Event::Requested(_) => {} // the record of the request tells it
                other => events.push(other),
            }
        }
        let frame = FrameStamps::of_record(m);
        let measurement_record = has(trace_flag::MEASUREMENT).then(|| MeasurementRecord {
            frame,
            verdict: None,
            degraded: false,
            error_px: m.feature_error_px,
            latency: Some(LatencyStages::of(&frame, m.commanded, one_clock)),
        });
        Self {
            joint_state: JointState {
                sequence: m.sequence,
                tick: m.tick,
                stamp: m.stamp,
                arm: m.arm,
                joints: m.joints,
                q: m.q,
                qd: m.qd,
                q_true: m.q_true,
                qd_true: m.qd_true,
                flags: if has(trace_flag::TRUTH) { joint_flag::TRUTH } else { 0 },
                ..JointState::default()
            },
            command: CommandTrace { requested_qd: m.requested_qd, tau: m.tau, q_r: m.q_r, qd_r: m.qd_r },
            commanded: m.commanded,
            state: ControlState::from_code(m.state),
            fault,
            over: has(trace_flag::LAST),
            inputs: m.flags,
            orders: m.orders,
            gives_orders: has(trace_flag::ORDERS_GIVEN),
            lost: m.lost,
            measurement_record,
            limits,
            external_torque: [m.external_torque, m.external_torque_sd],
            measured_torque: m.measured_torque.iter().any(|tau| tau.is_finite()).then_some(m.measured_torque),
            events,
            ..Self::at(m.stamp)
        }
    }
}

fn verdict_code(verdict: MeasurementVerdict) -> u32 {
    match verdict {
        MeasurementVerdict::Used => 1,
        MeasurementVerdict::UsedFromFuture => 2,
        MeasurementVerdict::NoTarget => 3,
        MeasurementVerdict::OtherFeatures => 4,
        MeasurementVerdict::TooFewFeatures => 5,
        MeasurementVerdict::Inconsistent => 6,
        MeasurementVerdict::NotNewer => 7,
        MeasurementVerdict::RefusedFromFuture => 8,
        MeasurementVerdict::TooOld => 9,
        MeasurementVerdict::ImpossiblePose => 10,
        MeasurementVerdict::NoTask(NoTask::NoPose) => 11,
        MeasurementVerdict::NoTask(NoTask::TooFew) => 12,
        MeasurementVerdict::NoTask(NoTask::Singular) => 13,
        MeasurementVerdict::OtherTarget => 14,
    }
}

/// The words of the events in [`TraceMsg::events`], in the order of their bits.
pub fn event_words(events: u32) -> impl Iterator<Item = &'static str> {
    events_of(events).map(Event::as_str)
}

/// The events of a record, in the order of their bits; of faults and requests some one.
fn events_of(events: u32) -> impl Iterator<Item = Event> {
    let is_set = move |i: usize| events.checked_shr(i as u32).unwrap_or(0) & 1 == 1;
    EVENTS.into_iter().enumerate().filter(move |(i, _)| is_set(*i)).map(|(_, event)| event)
}

/// The events by [`event_number`], each fault and each request by one of them: which it was is not in its bit.
const EVENTS: [Event; 31] = [
    Event::Holding,
    Event::Resumed,
    Event::Stopping,
    Event::Fault(Fault::TrackingError),
    Event::StampFromFuture,
    Event::Inconsistent,
    Event::Degraded,
    Event::WholeAgain,
    Event::StartsElsewhere,
    Event::Taught,
    Event::Requested(Request::Start),
    Event::GoalReached,
    Event::ImpossiblePose,
    Event::GainReduced,
    Event::Returning,
    Event::MotionOver,
    Event::GoalLeft,
    Event::Arrived,
    Event::RobotReady,
    Event::RobotNotCleared,
    Event::VelocityEnded,
    Event::NeverSeen,
    Event::Searching,
    Event::LostAgain,
    Event::FirstViewMissing,
    Event::SecondViewMissing,
    Event::BothViews,
    Event::StillMoves,
    Event::AnotherWay,
    Event::MountTried,
    Event::LensTried,
];

fn event_number(event: Event) -> u32 {
    match event {
        Event::Holding => 0,
        Event::Resumed => 1,
        Event::Stopping => 2,
        Event::Fault(_) => 3,
        Event::StampFromFuture => 4,
        Event::Inconsistent => 5,
        Event::Degraded => 6,
        Event::WholeAgain => 7,
        Event::StartsElsewhere => 8,
        Event::Taught => 9,
        Event::Requested(_) => 10,
        Event::GoalReached => 11,
        Event::ImpossiblePose => 12,
        Event::GainReduced => 13,
        Event::Returning => 14,
        Event::MotionOver => 15,
        Event::GoalLeft => 16,
        Event::Arrived => 17,
        Event::RobotReady => 18,
        Event::RobotNotCleared => 19,
        Event::VelocityEnded => 20,
        Event::NeverSeen => 21,
        Event::Searching => 22,
        Event::LostAgain => 23,
        Event::FirstViewMissing => 24,
        Event::SecondViewMissing => 25,
        Event::BothViews => 26,
        Event::StillMoves => 27,
        Event::AnotherWay => 28,
        Event::MountTried => 29,
        Event::LensTried => 30,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::time::MonoNs;

    #[test]
    fn words_of_a_mask_are_those_of_its_events() {
        for (bit, event) in EVENTS.into_iter().enumerate() {
            assert_eq!(event_number(event), bit as u32, "{event:?}");
            assert_eq!(event_words(1 << bit).collect::<Vec<_>>(), [event.as_str()]);
        }
        assert_eq!(event_words(u32::MAX).count(), EVENTS.len());
        assert_eq!(event_words(0b101).collect::<Vec<_>>(), ["holding", "stopping"]);
    }

    /// What a record tells comes back from it.
    #[test]
    fn a_record_comes_back_from_its_trace() {
        let mut m = TraceMsg {
            tick: 7,
            sequence: 6,
            lost: 2,
            stamp: MonoNs(7_000_000),
            commanded: MonoNs(7_040_000),
            frame_id: 3,
            exposure: MonoNs(1_000_000),
            frame_sent: MonoNs(2_000_000),
            vision_start: MonoNs(3_000_000),
            vision_end: MonoNs(4_000_000),
            feature_error_px: 1.25,
            joints: 4,
            state: ControlState::Fault as u32,
            fault: super::Fault::TrackingError.code(),
            orders: 5,
            flags: trace_flag::MEASUREMENT | trace_flag::TRUTH | trace_flag::ORDERS_GIVEN,
            tau: std::array::from_fn(|i| i as f64 - 0.5),
            ..Trace::at(MonoNs(0)).record()
        };
        for (i, joints) in m.limits.iter_mut().enumerate().take(Limit::ALL.len()) {
            *joints = 1 << (i % 7);
        }
        m.events = 0b1111_1100; // of one tick as many as have room, a fault among them
        let again = Trace::of_record(&m, true).record();
        assert_eq!(format!("{again:?}"), format!("{m:?}"));
        let latency = Trace::of_record(&m, true).measurement_record.unwrap().latency.unwrap();
        assert_eq!(latency.exposure_to_command.unwrap().0, 6_040_000);
    }
}
