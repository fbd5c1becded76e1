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
    /// There is no such camera, or there are two with a goal each.
    UnknownCamera = 11,
    /// The numbers of the request are none that it takes.
    WrongNumbers = 12,
    /// A goal of other points than those of the target.
    OtherPoints = 13,
    /// A goal in which the target is not in the image.
    OutOfView = 14,
    /// A posture outside the joints' ranges.
    OutOfRange = 15,
    /// No posture of this arm has the camera there.
    OutOfReach = 16,
    /// Farther than one jog goes.
    TooFar = 17,
    /// The law has no single gain.
    NoGain = 18,
    /// The run has no arm that it moves.
    NoArm = 19,
    /// A posture beyond a limit in space, or a way there through one.
    OutOfWorkspace = 20,
    /// The robot is in an emergency stop.
    RobotEmergencyStop = 21,
    /// The robot has no power, or its brakes are closed.
    RobotOff = 22,
    /// The robot has a fault of its own.
    RobotFault = 23,
    /// There is no such target.
    UnknownTarget = 24,
    /// A goal so far away that the target could not be found in the image.
    TooSmall = 25,
    /// A goal from which the camera looks at the back of the target.
    FromBehind = 26,
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

impl Refusal {
    /// All reasons.
    pub const ALL: [Self; 26] = [
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
        Self::UnknownCamera,
        Self::WrongNumbers,
        Self::OtherPoints,
        Self::OutOfView,
        Self::OutOfRange,
        Self::OutOfReach,
        Self::TooFar,
        Self::NoGain,
        Self::NoArm,
        Self::OutOfWorkspace,
        Self::RobotEmergencyStop,
        Self::RobotOff,
        Self::RobotFault,
        Self::UnknownTarget,
        Self::TooSmall,
        Self::FromBehind,
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
            Self::UnknownRequest => "this run knows no such request: do both run the same version of vservo?",
            Self::UnknownArm => "this run has one arm, number 0",
            Self::NotReady => "the run is still starting: it waits for its external drive",
            Self::UnknownCamera => "a goal is for camera 0 of a run with one; two keep those of the run file",
            Self::WrongNumbers => "its numbers are none that this run takes",
            Self::TooSmall => "the target would be smaller than 8 px at that goal: is it given in m?",
            Self::FromBehind => {
                "the camera would see the back of the target: its z must point away from the camera"
            }
            Self::OtherPoints => {
                "the goal is of other points than the target of this run: teach it with the same run file, or give a pose"
            }
            Self::OutOfView => {
                "the target would not be in the image at that goal: a goal is the pose of the target in the camera, x to the right, y down, z \
                 ahead"
            }
            Self::OutOfRange => "a joint would leave its range there",
            Self::OutOfReach => "no posture of this arm near the present one has the camera there",
            Self::TooFar => {
                "one jog moves a joint by 0.2 rad or 0.05 m at most, and the camera by 0.05 m and 0.2 rad: `goto` goes farther"
            }
            Self::NoGain => {
                "this law has no single gain: that of schemes B, D and hybrid can be set where servo.gain_1_s is one number and \
                 servo.adaptive_gain is left out"
            }
            Self::NoArm => "this run has no arm that it could move",
            Self::OutOfWorkspace => {
                "the arm would be beyond a limit of [workspace] there, or on the straight way of its joints: go round it by another posture"
            }
            Self::RobotEmergencyStop => {
                "the robot is in an emergency stop, which is not cleared from here: release its button, power the robot and open its brakes at the \
                 robot, then `reset` again"
            }
            Self::RobotOff => {
                "the robot has no power or its brakes are closed, and it is not powered from here: do that at the robot, then `reset` again"
            }
            Self::UnknownTarget => {
                "the run has no such target: `[target]` of its run file is number 0, and `[targets.NAME]` follow in the order of their names"
            }
            Self::RobotFault => {
                "the robot has a fault of its own, which is not cleared from here: see to it at the robot, then `reset` again"
            }
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

#[cfg(test)]
mod tests;
mod wrong_numbers;
