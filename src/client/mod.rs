//! A client of a running instance: what `vservo ctl` does, for programs.
//!
//! ```no_run
//! use vservo::client::{Client, WaitFor};
//!
//! let cell = Client::connect("cell")?;
//! cell.start()?;
//! let end = cell.wait(WaitFor::Converged, 30.0)?;
//! println!("{}: {}", end.is_reached, end.reason);
//! # Ok::<(), vservo::process::ProcessError>(())
//! ```
//! Every call joins the instance and leaves it again, so that a program that does nothing holds none of the few places for clients; streams keep theirs. `stop` and
//! `shutdown` go by the stop word, which nothing can hold up.

mod answer;
#[cfg(test)]
mod fake_control;
mod own_requests;
mod program;
mod reach;
mod record_stream;
mod requests;
#[cfg(feature = "cli")]
mod run_watch;
mod targets;
mod velocity_stream;
mod wait;

pub use crate::config::WaitFor;
pub use answer::RunAnswer;
pub use program::{ProgramEnd, ProgramOutcome};
pub use record_stream::{RecordStream, Watched};
pub use requests::Setting;
#[cfg(feature = "cli")]
pub use run_watch::RunWatch;
pub use targets::RunTarget;
pub use velocity_stream::VelocityStream;
pub use wait::WaitEnd;

use crate::control::lifecycle::Request;
use crate::ipc::{Halt, Instance};
use crate::messages::ControlCommand;
use crate::process::{ProcessError, StopFlag};
use own_requests::OwnRequests;
use reach::AnswerTimeout;

/// The longest wait for an answer, s. Chosen by hand: longer than any calibration takes, and a slip of the unit is refused.
const LONGEST_S: f64 = 3600.0;
/// The wait for an answer where nothing else is said, s. Chosen by hand: an answer takes milliseconds, and a run some seconds to start.
const USUAL_TIMEOUT_S: f64 = 5.0;
/// The longest wait for a state or the goal where nothing else is said, s: as long as a run takes at most where its file says nothing (`run.duration_s`).
pub const USUAL_WAIT_S: f64 = 30.0;

/// A client of one instance.
#[derive(Debug, Clone)]
pub struct Client {
    instance: Instance,
    timeout_s: f64,
    interrupted: StopFlag,
    /// Of which target the goals are that it sets: as in [`ControlCommand::target`].
    target: u32,
    /// Whether what it asks for is examined, and not done.
    examines: bool,
    own: OwnRequests,
}

impl Client {
    /// A client of the run of this name, which must be there.
    ///
    /// # Errors
    /// When the name is none, or no run of it is there.
    pub fn connect(instance: &str) -> Result<Self, ProcessError> {
        let instance: Instance = instance.parse()?;
        reach::find(&instance)?;
        let (interrupted, own) = (StopFlag::default(), OwnRequests::default());
        Ok(Self { instance, timeout_s: USUAL_TIMEOUT_S, interrupted, target: 0, examines: false, own })
    }

    /// The same with another longest wait for each answer, s.
    ///
    /// # Errors
    /// When it is not more than 0, or longer than an hour.
    pub fn with_timeout_s(self, timeout_s: f64) -> Result<Self, ProcessError> {
        check_timeout(timeout_s)?;
        Ok(Self { timeout_s, ..self })
    }

    /// The same, whose waits end when `interrupted` is requested.
    #[must_use]
    pub fn interrupted_by(self, interrupted: StopFlag) -> Self {
        Self { interrupted, ..self }
    }

    /// Refuses a wait that nobody can mean.
    ///
    /// # Errors
    /// When it is not more than 0 s, or longer than an hour.
    pub fn check_timeout_s(timeout_s: f64) -> Result<(), ProcessError> {
        check_timeout(timeout_s)
    }

    /// The name of the instance.
    #[must_use]
    pub fn instance(&self) -> &Instance {
        &self.instance
    }

    /// The state of the run.
    ///
    /// # Errors
    /// When it cannot be reached, or does not answer in time; so for all that follow.
    pub fn status(&self) -> Result<RunAnswer, ProcessError> {
        self.ask(None)
    }

    /// Servo to the goal, and hold it.
    ///
    /// # Errors
    /// As for [`Self::status`]; a refusal is an answer. So for all that follow.
    pub fn start(&self) -> Result<RunAnswer, ProcessError> {
        self.ask(Some(Request::Start))
    }

    /// Come to rest until the next start.
    ///
    /// # Errors
    /// As for [`Self::status`].
    pub fn hold(&self) -> Result<RunAnswer, ProcessError> {
        self.ask(Some(Request::Hold))
    }

    /// Make the present view the goal.
    ///
    /// # Errors
    /// As for [`Self::status`].
    pub fn teach(&self) -> Result<RunAnswer, ProcessError> {
        self.ask(Some(Request::Teach))
    }

    /// Clear the fault.
    ///
    /// # Errors
    /// As for [`Self::status`].
    pub fn reset(&self) -> Result<RunAnswer, ProcessError> {
        self.ask(Some(Request::Reset))
    }

    /// Come to rest, and be idle; a run that is not served ends by it.
    ///
    /// # Errors
    /// As for [`Self::status`].
    pub fn stop(&self) -> Result<RunAnswer, ProcessError> {
        self.halt(Halt::Stop, Request::Stop)
    }

    /// Come to rest as by a fault, which is there until [`Self::reset`].
    ///
    /// # Errors
    /// As for [`Self::status`].
    pub fn latch_stop(&self) -> Result<RunAnswer, ProcessError> {
        let patience = AnswerTimeout::begin(self.timeout_s, self.interrupted.clone());
        let state = reach::latch(&self.instance, &patience)?;
        Ok(RunAnswer::of_halt(&self.instance, Request::Stop, state))
    }

    /// Come to rest, and end the run.
    ///
    /// # Errors
    /// As for [`Self::status`].
    pub fn shutdown(&self) -> Result<RunAnswer, ProcessError> {
        self.halt(Halt::Shutdown, Request::Shutdown)
    }

    /// Waits until the run is as `what` says, for `timeout_s` at most. `converged` is waited for at the goal that this client has set last, or else at the
    /// present one, and the state `held` after a motion to a posture at that one: what another client asks for meanwhile ends the wait in vain.
    ///
    /// # Errors
    /// As for [`Self::status`], and when `timeout_s` is not more than 0 or longer than an hour.
    pub fn wait(&self, what: WaitFor, timeout_s: f64) -> Result<WaitEnd, ProcessError> {
        check_timeout(timeout_s)?;
        wait::wait(self, what, timeout_s)
    }

    fn ask(&self, request: Option<Request>) -> Result<RunAnswer, ProcessError> {
        self.ask_with(request, ControlCommand::of(request.map_or(0, |request| request as u32)))
    }

    fn ask_with(&self, request: Option<Request>, command: ControlCommand) -> Result<RunAnswer, ProcessError> {
        let answer = self.answer(request, command)?;
        if let Some(request) = request {
            self.own.note(request, &answer);
        }
        Ok(answer)
    }

    /// The answer to `command`, in the words of `request`.
    fn answer(&self, request: Option<Request>, command: ControlCommand) -> Result<RunAnswer, ProcessError> {
        let patience = AnswerTimeout::begin(self.timeout_s, self.interrupted.clone());
        reach::find(&self.instance)?;
        let answer = reach::ask(&self.instance, command, &patience)?;
        Ok(RunAnswer::of(&self.instance, request, &answer))
    }

    fn halt(&self, halt: Halt, request: Request) -> Result<RunAnswer, ProcessError> {
        let patience = AnswerTimeout::begin(self.timeout_s, self.interrupted.clone());
        let state = reach::halt(&self.instance, halt, &patience)?;
        Ok(RunAnswer::of_halt(&self.instance, request, state))
    }
}

/// What a wait may take at most.
fn check_timeout(timeout_s: f64) -> Result<(), ProcessError> {
    let is_good = timeout_s > 0.0 && timeout_s <= LONGEST_S;
    if is_good { Ok(()) } else { Err(ProcessError::Timeout(timeout_s)) }
}
