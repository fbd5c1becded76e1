//! Control: from a measurement and the arm's state to the command of a tick. What the real-time thread runs, and nothing else.
//!
//! ```text
//! [`control_loop`] drive and controller, and the way to an arm at rest
//! [`controller`]   one tick: watch ─► lifecycle ─► behaviour ─► reference ─► joint control ─► gate
//! [`lifecycle`]    what the run is doing: a table                         [`behaviour`] why the arm moves
//! [`order`]        what the mission wants                                 [`gate`] the last thing before the drive
//! [`trace`]        the record of a tick: mission and report read it; control depends on neither
//! [`safety`]       faults and reactions, the watches over measurements and measured arm
//! ```
//!
//! # Terms
//!
//! | term | meaning |
//! | --- | --- |
//! | tick | One period of the control loop, 1 ms. |
//! | motion command | What the active behaviour gives in a tick: a joint velocity, a joint torque, or rest. |
//! | reference, `q_r` | The joint positions that the joint controller follows; they never leave the limits, and can always brake within them. |
//! | cue | What makes the lifecycle change its state: a request, a view, a lost view, rest, a fault ([`lifecycle::Cue`]). |
//! | goal | The set-point that the servo law is to reach, with its tolerance and the time for which it must be held. |
//! | rest | No joint of the measured arm moves, over a window of ticks ([`safety`]). |
//! | hold | The arm is at rest because a view is missing or somebody asked for it, and the run goes on. |
//! | fault | A condition that ends all motion until it is reset ([`safety::Fault`]). |
//! | gate | The last check of a command before the drive: finite, and within all limits. |
//!
//! # Example
//!
//! ```
//! # use vservo_core as vservo;
//! use vservo::control::lifecycle::{Cue, Refusal, Request, State, Step};
//!
//! // The target comes into view: the law moves the arm. After a fault the arm moves only when the fault was reset.
//! assert_eq!(State::Waiting.next(Cue::InView), Step::To(State::Servoing));
//! assert_eq!(State::Fault.next(Cue::Request(Request::Start)), Step::Refuse(Refusal::InFault));
//! assert_eq!(State::Fault.next(Cue::Request(Request::Reset)), Step::To(State::Idle));
//! ```

pub mod behaviour;
pub mod control_loop;
pub mod controller;
pub mod gate;
pub mod lifecycle;
pub mod order;
pub mod outcome;
mod records;
pub mod safety;
pub mod trace;
