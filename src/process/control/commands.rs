//! What `vservo ctl` wants, on its way to the loop and back.
//!
//! ```text
//! control/command ──► Commands ──ring──► real-time thread: ControlLoop::request
//! control/command ◄── Commands ◄─ring─── its answer
//! ```
//! Questions for the state alone are answered here.

use crate::control::lifecycle::{Refusal, Request};
use crate::control::trace::Trace;
use crate::ipc::{Asked, CommandServer, IpcError};
use crate::messages::{ControlAnswer, ControlState, MAX_JOINTS, Status, answer_flag};
use std::collections::VecDeque;
use tracing::info;

/// A request on its way to the loop.
#[derive(Debug, Clone, Copy)]
pub(super) struct Numbered {
    pub(super) number: u64,
    pub(super) request: Request,
}

/// What the loop says to it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Answered {
    pub(super) number: u64,
    pub(super) refusal: Option<Refusal>,
    pub(super) state: ControlState,
}

/// Commands that came, and those that wait for their answers.
pub(super) struct Commands {
    server: CommandServer,
    waiting: VecDeque<(u64, Asked)>,
    next: u64,
    standing: ControlAnswer,
}

impl Commands {
    pub(super) fn new(server: CommandServer, served: bool) -> Self {
        let standing = ControlAnswer {
            feature_error_px: f64::NAN,
            position_error_m: f64::NAN,
            orientation_error_rad: f64::NAN,
            camera_state_s: f64::NAN,
            flags: if served { answer_flag::SERVED } else { 0 },
            ..ControlAnswer::default()
        };
        Self { server, waiting: VecDeque::new(), next: 0, standing }
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
        }
    }

    /// Takes in how the camera stands.
    pub(super) fn note_camera(&mut self, status: &Status) {
        (self.standing.camera_state, self.standing.camera_state_s) =
            (status.camera_state, status.camera_state_s);
    }

    /// The next request for the loop; everything else that has come is answered.
    pub(super) fn next(&mut self) -> Result<Option<Numbered>, IpcError> {
        while let Some(asked) = self.server.receive()? {
            let code = asked.command().request;
            let Some(request) = Request::from_code(code) else {
                asked.answer(&ControlAnswer { request: code, ..self.standing });
                continue;
            };
            self.next += 1;
            self.waiting.push_back((self.next, asked));
            return Ok(Some(Numbered { number: self.next, request }));
        }
        Ok(None)
    }

    /// Hands an answer of the loop to whoever waits for it.
    pub(super) fn answer(&mut self, answered: &Answered) {
        while let Some((_, asked)) = self.waiting.pop_front_if(|(number, _)| *number <= answered.number) {
            let request = asked.command().request;
            let refusal = answered.refusal.map_or(0, |refusal| refusal as u32);
            let word = Request::from_code(request).map_or("?", Request::as_str);
            match answered.refusal {
                None => info!("{word}, on request"),
                Some(refusal) => info!("{word} was refused: {}", refusal.describe()),
            }
            asked.answer(&ControlAnswer { request, refusal, state: answered.state as u32, ..self.standing });
        }
    }
}
