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
//! ```
//! The arm moves in `Servoing`, under the servo law, and in `Returning`, to the posture from which the target was seen last. In all
//! other states it is at rest, or brakes until it is.

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
    /// Held on request: the arm brakes and rests until the request `start`.
    Held,
    /// The arm brakes, and is idle once it is at rest.
    Stopping,
    /// A fault: the arm brakes.
    Failing,
    /// A fault: the arm is at rest until the request `reset`.
    Fault,
}

/// A request of a client.
#[repr(u32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Request {
    /// Servo to the goal.
    Start = 1,
    /// Brake and hold, until the next start.
    Hold = 2,
    /// Take the features in view as the goal.
    Teach = 3,
    /// Clear the fault.
    Reset = 4,
    /// Brake, and be idle.
    Stop = 5,
    /// Brake, and end the run.
    Shutdown = 6,
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
    /// The measured arm stands.
    AtRest,
    /// Something failed.
    Failed,
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

/// The reason why a request is refused.
#[repr(u32)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Refusal {
    /// There is a fault.
    InFault = 1,
    /// There is no fault that could be reset.
    NoFault = 2,
    /// The arm still moves.
    StillMoving = 3,
    /// It was started before.
    AlreadyStarted = 4,
    /// Nothing was started that could be held.
    NotStarted = 5,
    /// The goal is being taught.
    Teaching = 6,
    /// The run ends.
    Ending = 7,
    /// No request has this code.
    UnknownRequest = 8,
    /// There is no such arm.
    UnknownArm = 9,
    /// The run still waits for what it needs.
    NotReady = 10,
}

impl Request {
    /// All requests.
    pub const ALL: [Self; 6] =
        [Self::Start, Self::Hold, Self::Teach, Self::Reset, Self::Stop, Self::Shutdown];

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
        }
    }

    /// The request of a code in a message.
    #[must_use]
    pub fn from_code(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|request| *request as u32 == code)
    }
}

impl Refusal {
    /// All reasons.
    pub const ALL: [Self; 10] = [
        Self::InFault,
        Self::NoFault,
        Self::StillMoving,
        Self::AlreadyStarted,
        Self::NotStarted,
        Self::Teaching,
        Self::Ending,
        Self::UnknownRequest,
        Self::UnknownArm,
        Self::NotReady,
    ];

    /// The reason and the remedy, for people.
    #[must_use]
    pub fn describe(self) -> &'static str {
        match self {
            Self::InFault => "there is a fault: see to its cause, then `reset`",
            Self::NoFault => "there is no fault",
            Self::StillMoving => "the arm still moves: wait until it stands",
            Self::AlreadyStarted => "it was started already: `hold` or `stop` first",
            Self::NotStarted => "nothing was started that could be held",
            Self::Teaching => "the goal is being taught: wait, or `hold` to give that up",
            Self::Ending => "the run is ending",
            Self::UnknownRequest => {
                "this run knows no such request: does whoever asks run the same version of vservo?"
            }
            Self::UnknownArm => "this run has one arm, number 0",
            Self::NotReady => "the run is still starting: it waits for its external drive",
        }
    }

    /// The reason of a code in a message.
    #[must_use]
    pub fn from_code(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|refusal| *refusal as u32 == code)
    }
}

impl State {
    /// All states.
    pub const ALL: [Self; 10] = [
        Self::Idle,
        Self::Waiting,
        Self::Teaching,
        Self::Servoing,
        Self::Holding,
        Self::Returning,
        Self::Held,
        Self::Stopping,
        Self::Failing,
        Self::Fault,
    ];

    /// Whether the arm moves by itself.
    #[must_use]
    pub fn moves(self) -> bool {
        matches!(self, Self::Servoing | Self::Returning)
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
            Self::Held => ControlState::Held,
            Self::Stopping => ControlState::Stopping,
            Self::Failing | Self::Fault => ControlState::Fault,
        }
    }

    /// The table.
    #[must_use]
    pub fn next(self, cue: Cue) -> Step {
        use Refusal::{AlreadyStarted, InFault, NoFault, NotStarted, StillMoving};
        use State::{Failing, Fault, Held, Holding, Idle, Returning, Servoing, Stopping, Teaching, Waiting};
        use Step::{Refuse, Stay, To};
        match cue {
            Cue::Request(request) => match (self, request) {
                (Fault, Request::Reset) => To(Idle),
                (Failing, Request::Reset) => Refuse(StillMoving),
                // The arm stands or slows down already, and stays in fault.
                (Fault | Failing, Request::Stop | Request::Shutdown) => Stay,
                (Fault | Failing, _) => Refuse(InFault),
                (_, Request::Reset) => Refuse(NoFault),
                (Idle | Stopping, Request::Stop) | (Stopping, Request::Shutdown) => Stay,
                (_, Request::Stop | Request::Shutdown) => To(Stopping),
                (Stopping, _) => Refuse(StillMoving),
                (Idle | Held, Request::Start) => To(Waiting),
                (Teaching, Request::Start) => Refuse(Refusal::Teaching),
                (Waiting | Servoing | Holding | Returning, Request::Start | Request::Teach) => {
                    Refuse(AlreadyStarted)
                }
                (Idle | Held, Request::Teach) => To(Teaching),
                (Teaching, Request::Teach) => Stay,
                (Idle, Request::Hold) => Refuse(NotStarted),
                (Held, Request::Hold) => Stay,
                (Waiting | Teaching | Servoing | Holding | Returning, Request::Hold) => To(Held),
            },
            Cue::Failed => match self {
                Failing | Fault => Stay,
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
                Holding => To(Returning),
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
            Cue::AtRest => match self {
                Stopping => To(Idle),
                Failing => To(Fault),
                _ => Stay,
            },
        }
    }
}

#[cfg(test)]
mod tests;
