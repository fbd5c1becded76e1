//! Velocities for the arm of a running instance: a control law of the client's own, in place of the run's.
//!
//! ```no_run
//! use vservo::client::Client;
//!
//! let arm = Client::connect("cell")?.velocities(0.1)?;
//! arm.camera(&[0.0, 0.0, 0.02, 0.0, 0.0, 0.0])?; // 2 cm/s ahead, for 0.1 s unless another one comes
//! # Ok::<(), vservo::process::ProcessError>(())
//! ```

use super::reach::{self, AnswerTimeout, AskingThread};
use super::requests::with_numbers;
use super::{Client, RunAnswer};
use crate::control::lifecycle::Request;
use crate::messages::CommandForm;
use crate::process::{ProcessError, StopFlag};
use std::sync::Arc;

/// Commands velocities, each of which holds for the same time. It has one of the few places for clients until it is dropped; the arm rests then as after any
/// silence.
#[derive(Debug, Clone)]
pub struct VelocityStream {
    client: Client,
    asking: Arc<AskingThread>,
    hold_s: f64,
}

impl Client {
    /// Commands velocities from now on, each of which holds for `hold_s`, 0.01 to 1 s: an arm that is sent none for longer brakes and rests. The first one
    /// takes the arm over from what it does, as `goto` does, and nothing but a request gives it back.
    ///
    /// # Errors
    /// When the run cannot be reached.
    pub fn velocities(&self, hold_s: f64) -> Result<VelocityStream, ProcessError> {
        reach::find(&self.instance)?;
        let asking = Arc::new(AskingThread::begin(&self.instance)?);
        Ok(VelocityStream { client: self.clone(), asking, hold_s })
    }
}

impl VelocityStream {
    /// The same, whose waits for answers end when `interrupted` is requested.
    #[must_use]
    pub fn interrupted_by(self, interrupted: StopFlag) -> Self {
        Self { client: self.client.interrupted_by(interrupted), ..self }
    }

    /// Moves each joint by `qd`, rad/s or m/s, all of them slower in the same proportion where one would be faster than it may.
    ///
    /// # Errors
    /// When control does not answer in time; a refusal is an answer. So for all that follow.
    pub fn joints(&self, qd: &[f64]) -> Result<RunAnswer, ProcessError> {
        self.command(CommandForm::JointVelocity, qd)
    }

    /// Moves the camera by the twist `V_WC_C` in its own frame: x, y, z, m/s, and about x, y, z, rad/s. Of a camera that does not move it is that of the
    /// camera as the object sees it, which the arm carries.
    ///
    /// # Errors
    /// As for [`Self::joints`].
    pub fn camera(&self, V_C: &[f64; 6]) -> Result<RunAnswer, ProcessError> {
        self.command(CommandForm::CameraTwist, V_C)
    }

    fn command(&self, form: CommandForm, velocity: &[f64]) -> Result<RunAnswer, ProcessError> {
        let Client { instance, timeout_s, interrupted, .. } = &self.client;
        let numbers: Vec<f64> = velocity.iter().copied().chain([self.hold_s]).collect();
        let command = with_numbers(Request::Velocity, form, &numbers)?;
        reach::find(instance)?;
        let patience = AnswerTimeout::begin(*timeout_s, interrupted.clone());
        let answer = self.asking.ask(command, &patience)?;
        let answer = RunAnswer::of(instance, Some(Request::Velocity), &answer);
        self.client.own.note(Request::Velocity, &answer);
        Ok(answer)
    }
}
