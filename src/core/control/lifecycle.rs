//! The states of a run and their transitions: one table, a pure and total function.
//!
//! ```text
//!                     start                in view                 out of view
//!            Idle ───────────► Waiting ──────────► Servoing ◄──────────────────► Holding ◄──────► Returning
//!             │ ▲                 ▲                   │ ▲            in view        │  a way back, returned  │ in view
//!             │ │                 │                   │ └───────────────────────────┼────────────────────────┘
//!       teach │ │ at rest         │ start             │ hold                        │ hold, of both
//!             ▼ │                 │                   ▼                             ▼
//!      Teaching │ Stopping       Held ◄─────────────────────────────────────────────┘
//!             └─┼─────────────────▲
//!               │ taught, hold    stop: from everywhere to Stopping; failed: from everywhere to Failing
//!               └──── reset ──── Fault ◄── at rest ── Failing
//!               └─ robot ready ─ Clearing ◄─ reset, where the robot has an error of its own that it can clear ─ Fault
//!
//!   Moving: from everywhere but Teaching, Stopping, Failing, Fault and Clearing by the requests goto, jog and velocity ─► Held, when the posture is
//!           reached, or no velocity holds any more
//! ```
//! From `Waiting` a way back leads to `Returning` too, for a goal of another target than the one before.
//!
//! The arm moves in `Servoing`, under the servo law, in `Returning`, to the posture from which the target was seen last, and in `Moving`, to a posture
//! or by a velocity that was asked for. In all other states it is at rest, or brakes until it is.

use crate::messages::ControlState;

/// The state of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum State {
    /// The arm is at rest until the request `start`.
    Idle,
    /// Started, without a usable view yet: the arm is at rest.
    Waiting,
    /// The arm is at rest, and the features in view become the goal.
    Teaching,
    /// The law moves the arm.
    Servoing,
    /// The view was lost: the arm brakes and rests, and resumes by itself when the view is back.
    Holding,
    /// The view was lost: the arm returns to where it saw the whole target last, and resumes by itself when the view is back.
    Returning,
    /// On the way to a posture, or moving by a velocity, that was asked for.
    Moving,
    /// Held on request: the arm brakes and rests until the request `start`.
    Held,
    /// The arm brakes, and is idle once it is at rest.
    Stopping,
    /// A fault: the arm brakes.
    Failing,
    /// A fault: the arm is at rest until the request `reset`.
    Fault,
    /// A fault that is to be reset: the arm is at rest until the robot has cleared its own error.
    Clearing,
}

/// A request of a client.
#[repr(u32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Request {
    /// Servo to the goal.
    Start = 1,
    /// Brake and hold, until the next start.
    Hold = 2,
    /// Take the features in view as the goal, once the arm is at rest.
    Teach = 3,
    /// Clear the fault.
    Reset = 4,
    /// Brake, and be idle.
    Stop = 5,
    /// Brake, and end the run.
    Shutdown = 6,
    /// Another goal.
    Goal = 7,
    /// Move to a posture, and hold.
    Goto = 8,
    /// Move by a little, and hold.
    Jog = 9,
    /// Change what may change in a running loop.
    Set = 10,
    /// Move by a velocity for a time, and hold once no other has come.
    Velocity = 11,
}

/// The events that cause transitions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Cue {
    /// A request of a client.
    Request(Request),
    /// There is a usable view.
    InView,
    /// There is none, or none any more.
    OutOfView,
    /// There is a posture to return to, from which the target was seen last.
    WayBack,
    /// There is none, or none any more.
    Returned,
    /// The goal is taught.
    Taught,
    /// The posture that was asked for is reached.
    Arrived,
    /// The last velocity that was asked for has held as long as it may, and the arm rests.
    Silent,
    /// The measured arm stands.
    AtRest,
    /// Something failed.
    Failed,
    /// A reset was asked for, and the robot has to clear its error first.
    RobotClears,
    /// The robot obeys commands again.
    RobotReady,
    /// The robot does not clear its error.
    RobotStays,
}

/// The result of a cue.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Step {
    /// The state stays.
    Stay,
    /// The next state.
    To(State),
    /// The request is refused.
    Refuse(Refusal),
}

impl Request {
    /// All requests.
    pub const ALL: [Self; 11] = [
        Self::Start,
        Self::Hold,
        Self::Teach,
        Self::Reset,
        Self::Stop,
        Self::Shutdown,
        Self::Goal,
        Self::Goto,
        Self::Jog,
        Self::Set,
        Self::Velocity,
    ];

    /// The word of `vservo ctl`.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Start => "start",
            Self::Hold => "hold",
            Self::Teach => "teach",
            Self::Reset => "reset",
            Self::Stop => "stop",
            Self::Shutdown => "shutdown",
            Self::Goal => "goal",
            Self::Goto => "goto",
            Self::Jog => "jog",
            Self::Set => "set",
            Self::Velocity => "velocity",
        }
    }

    /// The request of a code in a message.
    #[must_use]
    pub fn from_code(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|request| *request as u32 == code)
    }
}

impl State {
    /// All states.
    pub const ALL: [Self; 12] = [
        Self::Idle,
        Self::Waiting,
        Self::Teaching,
        Self::Servoing,
        Self::Holding,
        Self::Returning,
        Self::Moving,
        Self::Held,
        Self::Stopping,
        Self::Failing,
        Self::Fault,
        Self::Clearing,
    ];

    /// Whether the arm moves by itself.
    #[must_use]
    pub fn moves(self) -> bool {
        matches!(self, Self::Servoing | Self::Returning | Self::Moving)
    }

    /// Its code in a message.
    #[must_use]
    pub fn told(self) -> ControlState {
        match self {
            Self::Idle => ControlState::Idle,
            Self::Waiting => ControlState::Waiting,
            Self::Teaching => ControlState::Teaching,
            Self::Servoing => ControlState::Servoing,
            Self::Holding => ControlState::Holding,
            Self::Returning => ControlState::Returning,
            Self::Moving => ControlState::Moving,
            Self::Held => ControlState::Held,
            Self::Stopping => ControlState::Stopping,
            Self::Failing | Self::Fault | Self::Clearing => ControlState::Fault,
        }
    }

    /// The table.
    #[must_use]
    pub fn next(self, cue: Cue) -> Step {
        use Refusal::{AlreadyStarted, InFault, NoFault, NotStarted, StillMoving};
        use State::{
            Clearing, Failing, Fault, Held, Holding, Idle, Moving, Returning, Servoing, Stopping, Teaching,
            Waiting,
        };
        use Step::{Refuse, Stay, To};
        match cue {
            Cue::Request(request) => match (self, request) {
                (Fault, Request::Reset) => To(Idle),
                (Failing, Request::Reset) => Refuse(StillMoving),
                // The arm stands or slows down already, and stays in fault.
                (Fault | Failing, Request::Stop | Request::Shutdown | Request::Set) => Stay,
                (Clearing, Request::Reset | Request::Set) => Stay,
                (Clearing, Request::Stop | Request::Shutdown) => To(Fault),
                (Fault | Failing | Clearing, _) => Refuse(InFault),
                (_, Request::Reset) => Refuse(NoFault),
                (Idle | Stopping, Request::Stop) | (Stopping, Request::Shutdown) => Stay,
                (_, Request::Stop | Request::Shutdown) => To(Stopping),
                (_, Request::Set) => Stay,
                (
                    Teaching,
                    Request::Start | Request::Goal | Request::Goto | Request::Jog | Request::Velocity,
                ) => Refuse(Refusal::Teaching),
                (_, Request::Goal) => Stay,
                (Stopping, _) | (Moving, Request::Start | Request::Teach) => Refuse(StillMoving),
                (Idle | Held, Request::Start) => To(Waiting),
                (Waiting | Servoing | Holding | Returning, Request::Start) => Refuse(AlreadyStarted),
                (Teaching, Request::Teach) => Stay,
                (_, Request::Teach) => To(Teaching),
                (Moving, Request::Goto | Request::Jog | Request::Velocity) => Stay,
                (_, Request::Goto | Request::Jog | Request::Velocity) => To(Moving),
                (Idle, Request::Hold) => Refuse(NotStarted),
                (Held, Request::Hold) => Stay,
                (Waiting | Teaching | Servoing | Holding | Returning | Moving, Request::Hold) => To(Held),
            },
            Cue::Failed => match self {
                Failing | Fault => Stay,
                Clearing => To(Fault),
                _ => To(Failing),
            },
            Cue::InView => match self {
                Waiting | Holding | Returning => To(Servoing),
                _ => Stay,
            },
            Cue::OutOfView => match self {
                Servoing => To(Holding),
                _ => Stay,
            },
            Cue::WayBack => match self {
                Waiting | Holding => To(Returning),
                _ => Stay,
            },
            Cue::Returned => match self {
                Returning => To(Holding),
                _ => Stay,
            },
            Cue::Taught => match self {
                Teaching => To(Held),
                _ => Stay,
            },
            Cue::Arrived | Cue::Silent => match self {
                Moving => To(Held),
                _ => Stay,
            },
            Cue::AtRest => match self {
                Stopping => To(Idle),
                Failing => To(Fault),
                _ => Stay,
            },
            Cue::RobotClears => match self {
                Fault => To(Clearing),
                _ => Stay,
            },
            Cue::RobotReady => match self {
                Clearing => To(Idle),
                _ => Stay,
            },
            Cue::RobotStays => match self {
                Clearing => To(Fault),
                _ => Stay,
            },
        }
    }
}

mod refusal;
#[cfg(test)]
mod tests;
mod wrong_numbers;

pub use refusal::Refusal;
