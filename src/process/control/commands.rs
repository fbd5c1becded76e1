//! What `vservo ctl` wants, on its way to the loop and back.
//!
//! ```text
//! control/command ──► Commands ──ring──► real-time thread: ControlLoop::request
//! control/command ◄── Commands ◄─ring─── its answer
//! ```
//! Questions for the state alone are answered here, and requests that mean nothing are refused here.
//!
//! Clients cannot disturb a run: requests that cannot be taken are counted and reported, and never end it.

use super::requests::{Answered, Numbered};
use super::stops::Stops;
use crate::control::lifecycle::{Refusal, Request};
use crate::control::trace::Trace;
use crate::ipc::{Asked, CommandServer};
use crate::messages::{ControlAnswer, ControlCommand, ControlState, MAX_JOINTS, Status, answer_flag};
use std::collections::VecDeque;
use tracing::{Span, debug_span, info, warn};

/// Commands that came, and those that wait for their answers.
pub(super) struct Commands {
    server: CommandServer,
    /// Each with its number and with a span from its coming to its answer.
    waiting: VecDeque<(u64, Asked, Span)>,
    next: u64,
    standing: ControlAnswer,
    /// Looks for a request that failed.
    failed: u64,
}

/// What a command asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum ParsedCommand {
    /// How things stand.
    State,
    /// Something of the loop.
    Request(Request),
    /// Something that no run can do.
    Nothing(Refusal),
}

impl ParsedCommand {
    fn of(command: &ControlCommand) -> Self {
        match (command.arm, command.request) {
            (0, 0) => Self::State,
            (0, code) => {
                Request::from_code(code).map_or(Self::Nothing(Refusal::UnknownRequest), Self::Request)
            }
            _ => Self::Nothing(Refusal::UnknownArm),
        }
    }
}

impl Commands {
    pub(super) fn new(server: CommandServer, served: bool) -> Self {
        let standing = ControlAnswer {
            feature_error_px: f64::NAN,
            position_error_m: f64::NAN,
            orientation_error_rad: f64::NAN,
            camera_state_s: f64::NAN,
            at_goal_s: f64::NAN,
            flags: if served { answer_flag::SERVED } else { 0 },
            ..ControlAnswer::default()
        };
        Self { server, waiting: VecDeque::new(), next: 0, standing, failed: 0 }
    }

    /// Takes in how things stand after a tick.
    pub(super) fn note(&mut self, trace: &Trace) {
        let (standing, js) = (&mut self.standing, &trace.joint_state);
        standing.state = trace.state as u32;
        standing.fault = trace.fault.map_or(0, crate::control::safety::Fault::code);
        standing.tick = js.tick;
        standing.joints = js.joints.min(MAX_JOINTS as u32);
        (standing.q, standing.qd) = (js.q, js.qd);
        if let Some(status) = &trace.status {
            standing.time_s = status.time_s;
            standing.target = status.target;
            standing.feature_error_px = status.feature_error_px;
            standing.position_error_m = status.position_error_m;
            standing.orientation_error_rad = status.orientation_error_rad;
            (standing.at_goal_s, standing.goal) = (status.at_goal_s, status.goal);
        }
    }

    /// Takes in how the camera stands.
    pub(super) fn note_camera(&mut self, status: &Status) {
        (self.standing.camera_state, self.standing.camera_state_s) =
            (status.camera_state, status.camera_state_s);
    }

    /// The next request for the loop; everything else that has come is answered.
    pub(super) fn next(&mut self) -> Option<Numbered> {
        while let Some(asked) = self.take() {
            let command = asked.command();
            let refusal = match ParsedCommand::of(&command) {
                ParsedCommand::State => 0,
                ParsedCommand::Nothing(refusal) => refusal as u32,
                ParsedCommand::Request(request) => {
                    self.next += 1;
                    self.waiting.push_back((
                        self.next,
                        asked,
                        debug_span!("request", request = request.as_str()),
                    ));
                    return Some(Numbered { number: self.next, request });
                }
            };
            let ControlCommand { request, arm } = command;
            asked.answer(&ControlAnswer { request, arm, refusal, ..self.standing });
        }
        None
    }

    /// Before the first tick: questions are answered, a stop and a shutdown are taken, everything else is refused.
    pub(super) fn attend(&mut self, stops: &Stops) {
        while let Some(Numbered { number, request }) = self.next() {
            let refusal = stops.early(request).err();
            self.answer(&Answered { number, refusal, state: ControlState::Idle });
        }
    }

    /// A command that has come. One that cannot be taken is not waited for: a client that asks again before it has heard the
    /// answer, or that has died, has itself to blame, and the arm nothing to do with it.
    fn take(&mut self) -> Option<Asked> {
        match self.server.receive() {
            Ok(asked) => asked,
            Err(error) => {
                self.failed += 1;
                // Each power of two: a client that goes on so would fill the log.
                if self.failed.is_power_of_two() {
                    warn!(count = self.failed, "a request was not taken, the run goes on: {error}");
                }
                None
            }
        }
    }

    /// Hands an answer of the loop to the client that waits for it.
    pub(super) fn answer(&mut self, answered: &Answered) {
        while let Some((_, asked, span)) =
            self.waiting.pop_front_if(|(number, ..)| *number <= answered.number)
        {
            let _span = span.entered();
            let request = asked.command().request;
            let refusal = answered.refusal.map_or(0, |refusal| refusal as u32);
            let word = Request::from_code(request).map_or("?", Request::as_str);
            // What is accepted is an event, and logged as such.
            if let Some(refusal) = answered.refusal {
                info!(request = word, refusal = refusal as u32, "{word} was refused: {}", refusal.describe());
            }
            // The trace of that tick may come later than the next question.
            self.standing.state = answered.state as u32;
            if Request::from_code(request) == Some(Request::Start) && answered.refusal.is_none() {
                self.standing.at_goal_s = f64::NAN;
            }
            asked.answer(&ControlAnswer { request, refusal, state: answered.state as u32, ..self.standing });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_means_nothing_is_refused() {
        let of = |request, arm| ParsedCommand::of(&ControlCommand { request, arm });
        assert_eq!(of(0, 0), ParsedCommand::State);
        for request in Request::ALL {
            assert_eq!(of(request as u32, 0), ParsedCommand::Request(request));
        }
        for code in [7, 99, u32::MAX] {
            assert_eq!(of(code, 0), ParsedCommand::Nothing(Refusal::UnknownRequest), "{code}");
        }
        for arm in [1, 7, u32::MAX] {
            for code in [0, Request::Stop as u32, 99] {
                assert_eq!(of(code, arm), ParsedCommand::Nothing(Refusal::UnknownArm), "{code} {arm}");
            }
        }
    }
}
