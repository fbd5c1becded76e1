//! What one tick leaves behind: what goes out, and everything that the report counts. The report reads it; control does not
//! know the report.

mod record;

use super::lifecycle::Request;
use super::outcome::Finish;
use super::safety::Fault;
use crate::messages::{ControlState, JointState, MAX_JOINTS, Measurement, Status};
use crate::motion::ActingLimits;
use crate::servo::MeasurementVerdict;
use crate::time::{MonoNs, SpanNs};

/// Most events of one tick.
const MAX_EVENTS: usize = 4;

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
    /// What control does.
    pub state: ControlState,
    /// Why it does nothing more.
    pub fault: Option<Fault>,
    /// Traces before this one that were dropped because nobody took them in time.
    pub lost: u64,
    /// The run after the tick, every 20 ms.
    pub status: Option<Status>,
    /// The measurement that came, and what became of it.
    pub measurement_record: Option<MeasurementRecord>,
    /// The limits that acted.
    pub limits: ActingLimits,
    /// What happened.
    pub events: Events,
    /// Set at the tick that ends the run.
    pub finish: Option<Finish>,
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

/// Where a measurement came from, and when.
#[derive(Debug, Clone, Copy)]
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
}

/// A measurement that reached control.
#[derive(Debug, Clone, Copy)]
pub struct MeasurementRecord {
    /// Which one.
    pub frame: FrameStamps,
    /// What became of it; `None` where the controller could not look at it.
    pub verdict: Option<MeasurementVerdict>,
    /// Root mean square feature error, px; NaN where it says nothing about the goal.
    pub error_px: f64,
    /// Where its time went, once its command was written.
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
    /// A part of the target is hidden: the law goes on with the rest.
    Degraded,
    /// The whole target is seen again.
    WholeAgain,
    /// The arm does not start where the run file says.
    StartsElsewhere,
    /// The goal is taught.
    Taught,
    /// Somebody wanted something, and it is so.
    Requested(Request),
    /// The goal was reached and held, and the run goes on.
    GoalReached,
    /// The first measurement with a pose that no object before a camera has.
    ImpossiblePose,
    /// The arm swings about its goal: from now on it goes there, and learns, more slowly.
    GainReduced,
    /// The arm goes back to where it saw the whole target last.
    Returning,
}

/// The events of one tick, in their order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Events {
    list: [Option<Event>; MAX_EVENTS],
    count: usize,
}

impl Events {
    /// Notes an event; past [`MAX_EVENTS`] of one tick nothing new can have happened.
    pub(super) fn push(&mut self, event: Event) {
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

/// Stamps that lie further apart are of different clocks, or of none: a process that was stopped for an hour is let go before.
const LONGEST_STAGE: SpanNs = SpanNs(3_600_000_000_000);

impl LatencyStages {
    /// The stages of `m`, whose command was written at `command`. `one_clock`: all stamps are of the same clock.
    #[must_use]
    pub fn of(m: &Measurement, command: MonoNs, one_clock: bool) -> Self {
        let span = |from: MonoNs, to: MonoNs| {
            let span = SpanNs(to.0.saturating_sub(from.0));
            (span.0.unsigned_abs() <= LONGEST_STAGE.0.unsigned_abs()).then_some(span)
        };
        let if_one_clock = |span: Option<SpanNs>| span.filter(|_| one_clock);
        Self {
            exposure_to_frame: if_one_clock(span(m.exposure, m.frame_sent)),
            frame_to_vision: span(m.frame_sent, m.vision_start),
            vision: span(m.vision_start, m.vision_end),
            measurement_to_command: if_one_clock(span(m.vision_end, command)),
            exposure_to_command: span(m.exposure, command),
        }
    }
}
