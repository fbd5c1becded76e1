//! The record of a tick as it is sent: a flat structure, in which enumerations are codes.

use super::{Event, Trace};
use crate::control::safety::Fault;
use crate::messages::{MAX_JOINTS, TRACE_LIMITS, TraceMsg, joint_flag, trace_flag};
use crate::motion::Limit;
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
    let is_set = move |i: usize| events.checked_shr(i as u32).unwrap_or(0) & 1 == 1;
    EVENT_WORDS.into_iter().enumerate().filter(move |(i, _)| is_set(*i)).map(|(_, word)| word)
}

/// [`Event::as_str`] by [`event_number`].
const EVENT_WORDS: [&str; 27] = [
    "holding",
    "resumed",
    "stopping",
    "fault",
    "stamp_from_future",
    "inconsistent",
    "degraded",
    "whole_again",
    "starts_elsewhere",
    "taught",
    "requested",
    "goal_reached",
    "impossible_pose",
    "gain_reduced",
    "returning",
    "motion_over",
    "goal_left",
    "arrived",
    "robot_ready",
    "robot_not_cleared",
    "velocity_ended",
    "never_seen",
    "searching",
    "lost_again",
    "first_view_missing",
    "second_view_missing",
    "both_views",
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
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::lifecycle::Request;

    #[test]
    fn words_of_a_mask_are_those_of_its_events() {
        use Event::*;
        let all = [
            Holding,
            Resumed,
            Stopping,
            Fault(super::Fault::TrackingError),
            StampFromFuture,
            Inconsistent,
            Degraded,
            WholeAgain,
            StartsElsewhere,
            Taught,
            Requested(Request::Start),
            GoalReached,
            ImpossiblePose,
            GainReduced,
            Returning,
            MotionOver,
            GoalLeft,
            Arrived,
            RobotReady,
            RobotNotCleared,
            VelocityEnded,
            NeverSeen,
            Searching,
            LostAgain,
            FirstViewMissing,
            SecondViewMissing,
            BothViews,
        ];
        for event in all {
            let words: Vec<_> = event_words(1 << event_number(event)).collect();
            assert_eq!(words, [event.as_str()]);
        }
        assert_eq!(event_words(u32::MAX).count(), all.len());
        assert_eq!(event_words(0b101).collect::<Vec<_>>(), ["holding", "stopping"]);
    }
}
