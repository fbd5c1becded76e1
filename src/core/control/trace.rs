//! The record of one tick: everything that is published, that the mission uses, and that the report counts. Mission and report read it;
//! control depends on neither.
//!
//! The mission adds the feature error, its events, the status and the end of the run.

mod record;

pub use record::event_words;

use super::lifecycle::Request;
use super::outcome::Finish;
use super::safety::{Contact, Fault};
use crate::drive::RobotReport;
use crate::messages::{ControlState, JointState, MAX_JOINTS, Measurement, Status, TraceMsg};
use crate::motion::{ActingLimits, SpaceLimit};
use crate::servo::MeasurementVerdict;
use crate::time::{MonoNs, SpanNs};

/// Most events of one tick, of control and mission together. Chosen by hand, above the transitions and reports that one tick can make.
const MAX_EVENTS: usize = 8;

/// One tick.
#[derive(Debug, Clone, Copy)]
pub struct Trace {
    /// The tick's time.
    pub time: MonoNs,
    /// The arm at that time, and the command of the tick before.
    pub joint_state: JointState,
    /// What this tick commanded.
    pub command: CommandTrace,
    /// When that command was written.
    pub commanded: MonoNs,
    /// Deadlines missed so far.
    pub missed_deadlines: u64,
    /// The law output for a camera without an arm, `V_WC_C`, m/s and rad/s; `None` where an arm moves the camera.
    pub V_C: Option<[f64; 6]>,
    /// The state of control; in the last record, the outcome of the run.
    pub state: ControlState,
    /// The fault.
    pub fault: Option<Fault>,
    /// The reason for bringing the arm to rest and ending the run, where control itself decided it; from that tick on.
    pub stopped: Option<&'static str>,
    /// Whether no tick follows.
    pub over: bool,
    /// What came from outside at this tick: bits of [`crate::messages::trace_flag`].
    pub inputs: u32,
    /// What the drive told of its robot.
    pub robot: RobotReport,
    /// Whether a reset waits until the robot has cleared its error.
    pub clears: bool,
    /// Orders of the mission that were obeyed so far.
    pub orders: u32,
    /// Whether the mission gave out its orders when it had seen this trace, which is not so where the next one had come already.
    pub gives_orders: bool,
    /// Earlier traces that were dropped because they were not read in time.
    pub lost: u64,
    /// The measurement of this tick, and the verdict on it.
    pub measurement_record: Option<MeasurementRecord>,
    /// When the path of the goal began; `None` for a goal at rest.
    pub path_began: Option<MonoNs>,
    /// The limits that acted.
    pub limits: ActingLimits,
    /// The limit in space that acted.
    pub held_by: Option<SpaceLimit>,
    /// The torque of each joint that comes from outside, N m or N, and its standard deviation; NaN where torques are not known.
    pub external_torque: [[f64; MAX_JOINTS]; 2],
    /// What touches the arm, or stopped it where that fault stands.
    pub contact: Option<Contact>,
    /// The joint torques that the drive's state carries, N m or N; `None` where it measures none.
    pub measured_torque: Option<[f64; MAX_JOINTS]>,
    /// The events of the tick; the mission adds its own.
    pub events: Events,
    /// The run after the tick, every 20 ms: the mission's.
    pub status: Option<Status>,
    /// How the run ended, with the last record: the mission's.
    pub finish: Option<Finish>,
}

impl Trace {
    /// An empty trace of the tick at `time`.
    #[must_use]
    pub fn at(time: MonoNs) -> Self {
        let zero = [0.0; MAX_JOINTS];
        Self {
            time,
            joint_state: JointState::default(),
            command: CommandTrace { requested_qd: zero, tau: zero, q_r: zero, qd_r: zero },
            commanded: time,
            missed_deadlines: 0,
            V_C: None,
            state: ControlState::Waiting,
            fault: None,
            stopped: None,
            over: false,
            inputs: 0,
            robot: RobotReport::default(),
            clears: false,
            orders: 0,
            gives_orders: true,
            lost: 0,
            measurement_record: None,
            path_began: None,
            limits: ActingLimits::default(),
            held_by: None,
            external_torque: [[f64::NAN; MAX_JOINTS]; 2],
            contact: None,
            measured_torque: None,
            events: Events::default(),
            status: None,
            finish: None,
        }
    }
}

/// The command of a tick; entries beyond the arm's joints are zero.
#[derive(Debug, Clone, Copy)]
pub struct CommandTrace {
    /// What the servo law requested, before limits, rad/s or m/s.
    pub requested_qd: [f64; MAX_JOINTS],
    /// Torques or forces, N m or N.
    pub tau: [f64; MAX_JOINTS],
    /// Reference positions, rad or m.
    pub q_r: [f64; MAX_JOINTS],
    /// Reference velocities.
    pub qd_r: [f64; MAX_JOINTS],
}

/// The origin and the stamps of a measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameStamps {
    /// Which frame.
    pub frame_id: u64,
    /// Of which camera.
    pub camera: u32,
    /// Middle of its exposure.
    pub exposure: MonoNs,
    /// When the camera handed it over.
    pub sent: MonoNs,
    /// When vision began to work on it.
    pub vision_start: MonoNs,
    /// When vision was done.
    pub vision_end: MonoNs,
}

impl FrameStamps {
    /// Those of `m`.
    #[must_use]
    pub fn of(m: &Measurement) -> Self {
        Self {
            frame_id: m.frame_id,
            camera: m.camera,
            exposure: m.exposure,
            sent: m.frame_sent,
            vision_start: m.vision_start,
            vision_end: m.vision_end,
        }
    }

    /// Those of the measurement that a tick took.
    #[must_use]
    pub fn of_record(m: &TraceMsg) -> Self {
        Self {
            frame_id: m.frame_id,
            camera: m.camera,
            exposure: m.exposure,
            sent: m.frame_sent,
            vision_start: m.vision_start,
            vision_end: m.vision_end,
        }
    }
}

/// A measurement that arrived at control.
#[derive(Debug, Clone, Copy)]
pub struct MeasurementRecord {
    /// Which one.
    pub frame: FrameStamps,
    /// The verdict on it; `None` where the controller had no joint state to judge it.
    pub verdict: Option<MeasurementVerdict>,
    /// Whether some features are hidden, so that the law uses the others.
    pub degraded: bool,
    /// Root mean square feature error, px, computed by the mission; NaN where the measurement has none.
    pub error_px: f64,
    /// Its latency by stages, once its command was written.
    pub latency: Option<LatencyStages>,
}

/// Kinds of events.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Event {
    /// Measurements stopped.
    Holding,
    /// Measurements are back.
    Resumed,
    /// A stop was requested.
    Stopping,
    /// A fault.
    Fault(Fault),
    /// The first stamp that lay in the future.
    StampFromFuture,
    /// The first measurement whose dots fit no pose.
    Inconsistent,
    /// A part of the target is occluded: the law continues with the rest.
    Degraded,
    /// The whole target is in view again.
    WholeAgain,
    /// The arm does not start where the run file says.
    StartsElsewhere,
    /// The goal is taught.
    Taught,
    /// A request took effect.
    Requested(Request),
    /// The goal was reached and held, and the run goes on.
    GoalReached,
    /// The first measurement with an impossible pose: no object in front of a camera can have it.
    ImpossiblePose,
    /// The arm oscillates about its goal: gain and estimation rate were reduced.
    GainReduced,
    /// The arm returns to where it saw the whole target last.
    Returning,
    /// The requested motion is complete.
    MotionOver,
    /// The goal that was reached and held is not met any more, and the run goes on.
    GoalLeft,
    /// The posture that was asked for is reached.
    Arrived,
    /// No velocity that a client asked for holds any more, and the arm rests.
    VelocityEnded,
    /// The robot has cleared its error, and the fault is reset.
    RobotReady,
    /// The robot has not cleared its error although a reset was asked for.
    RobotNotCleared,
    /// A goal of another target was set, which is not in view and was never seen whole: nobody knows where it is.
    NeverSeen,
    /// The arm looks around for its target.
    Searching,
    /// The view was lost where it was lost before, again and again: the arm holds.
    LostAgain,
    /// The law goes another way to its goal, by another interaction matrix.
    AnotherWay,
    /// The camera is moved a little to tell a wrong mount from one that is askew.
    MountTried,
    /// The camera is turned a little, and back, to tell a lens that is not as told from a target that is.
    LensTried,
    /// Of two cameras that control the arm the first one does not see its target: the arm goes by the second.
    FirstViewMissing,
    /// The same of the second one.
    SecondViewMissing,
    /// Both see their targets again.
    BothViews,
    /// An arm in a fault should be at rest, and moves on.
    StillMoves,
}

impl Event {
    /// Its word in a log.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Holding => "holding",
            Self::Resumed => "resumed",
            Self::Stopping => "stopping",
            Self::Fault(_) => "fault",
            Self::StampFromFuture => "stamp_from_future",
            Self::Inconsistent => "inconsistent",
            Self::Degraded => "degraded",
            Self::WholeAgain => "whole_again",
            Self::StartsElsewhere => "starts_elsewhere",
            Self::Taught => "taught",
            Self::Requested(_) => "requested",
            Self::GoalReached => "goal_reached",
            Self::ImpossiblePose => "impossible_pose",
            Self::GainReduced => "gain_reduced",
            Self::Returning => "returning",
            Self::MotionOver => "motion_over",
            Self::GoalLeft => "goal_left",
            Self::Arrived => "arrived",
            Self::VelocityEnded => "velocity_ended",
            Self::RobotReady => "robot_ready",
            Self::RobotNotCleared => "robot_not_cleared",
            Self::NeverSeen => "never_seen",
            Self::Searching => "searching",
            Self::LostAgain => "lost_again",
            Self::AnotherWay => "another_way",
            Self::MountTried => "mount_tried",
            Self::LensTried => "lens_tried",
            Self::FirstViewMissing => "first_view_missing",
            Self::SecondViewMissing => "second_view_missing",
            Self::BothViews => "both_views",
            Self::StillMoves => "still_moves",
        }
    }
}

/// The events of one tick, in their order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Events {
    list: [Option<Event>; MAX_EVENTS],
    count: usize,
}

impl Events {
    /// Notes an event; more than [`MAX_EVENTS`] in one tick are dropped.
    pub(crate) fn push(&mut self, event: Event) {
        if let Some(place) = self.list.get_mut(self.count) {
            *place = Some(event);
            self.count += 1;
        }
    }

    /// The events.
    pub fn iter(&self) -> impl Iterator<Item = Event> {
        self.list.into_iter().flatten()
    }
}

/// Spans of a measurement from light to command; `None` where its stamps belong to two clocks.
///
/// ```text
/// exposure ──► frame sent ──► vision starts ──► measurement ──► command
///    exposure_to_frame   frame_to_vision     vision     measurement_to_command
///    └───────────────────────── exposure_to_command ─────────────────────────┘
/// ```
/// In lockstep exposure and command have stamps of the simulated clock, the stages between of the machine's: only spans
/// within one clock are known.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LatencyStages {
    /// Middle of the exposure to hand-over.
    pub exposure_to_frame: Option<SpanNs>,
    /// Hand-over to the start of vision's work.
    pub frame_to_vision: Option<SpanNs>,
    /// Vision's work.
    pub vision: Option<SpanNs>,
    /// Finished measurement to the command that used it.
    pub measurement_to_command: Option<SpanNs>,
    /// Middle of the exposure to that command.
    pub exposure_to_command: Option<SpanNs>,
}

/// Stamps that lie further apart are of different clocks, or invalid. Chosen by hand: a process that is suspended for an hour is given up
/// long before.
const LONGEST_STAGE: SpanNs = SpanNs(3_600_000_000_000);

impl LatencyStages {
    /// The stages of the frame `m`, whose command was written at `command`. `one_clock`: all stamps are of the same clock.
    #[must_use]
    pub fn of(m: &FrameStamps, command: MonoNs, one_clock: bool) -> Self {
        let span = |from: MonoNs, to: MonoNs| {
            let span = SpanNs(to.0.saturating_sub(from.0));
            (span.0.unsigned_abs() <= LONGEST_STAGE.0.unsigned_abs()).then_some(span)
        };
        let if_one_clock = |span: Option<SpanNs>| span.filter(|_| one_clock);
        Self {
            exposure_to_frame: if_one_clock(span(m.exposure, m.sent)),
            frame_to_vision: span(m.sent, m.vision_start),
            vision: span(m.vision_start, m.vision_end),
            measurement_to_command: if_one_clock(span(m.vision_end, command)),
            exposure_to_command: span(m.exposure, command),
        }
    }
}
