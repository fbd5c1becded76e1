//! Runs a program: one step after the other by requests of this client, with a look at the run in between.
//!
//! ```text
//! step ─► request ─► look every 100 ms ─► done ─► next step
//!                     ├─ fault, time over, exit code ─► on_fault, then the end: failed
//!                     └─ stopped, held, moved or given another goal by another client, interrupted ─► the end: stopped
//! ```
//! Where it ends early the arm holds, if what it does then is the program's own: of somebody else's motion it keeps its hands off.

mod command;
mod examination;
mod expected;
#[cfg(test)]
mod on_fault_tests;

use super::{Client, RunAnswer, WaitFor, wait};
use crate::config::{Program, ProgramGoal, ProgramStep, StepAction, TargetGoal};
use crate::control::lifecycle::Refusal;
use crate::messages::ControlState;
use crate::process::{ProcessError, StopFlag};
use crate::rt::now;
use crate::time::{MonoNs, SpanNs};
use command::RunningCommand;
use expected::{Expected, KnownEnd, another_goal};

/// How a program ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ProgramOutcome {
    /// All steps were done.
    Done,
    /// A step failed.
    Failed,
    /// The arm has a fault.
    Fault,
    /// Somebody stopped, held or moved the arm, set another goal, or interrupted the program.
    Stopped,
}

/// The end of a program.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ProgramEnd {
    /// How it ended.
    pub outcome: ProgramOutcome,
    /// At which step, by its place in the file.
    pub step: String,
    /// Why.
    pub reason: String,
}

/// Why a step ended early.
enum StepEnd {
    Ended(ProgramOutcome, String),
    Error(ProcessError),
}

impl std::fmt::Display for StepEnd {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Ended(_, reason) => f.write_str(reason),
            Self::Error(error) => error.fmt(f),
        }
    }
}

impl From<ProcessError> for StepEnd {
    fn from(error: ProcessError) -> Self {
        match error {
            ProcessError::Interrupted => Self::Ended(ProgramOutcome::Stopped, "interrupted".into()),
            ProcessError::NobodyThere(_) => Self::Ended(ProgramOutcome::Failed, "the run has ended".into()),
            other => Self::Error(other),
        }
    }
}

fn failed<T>(reason: impl Into<String>) -> Result<T, StepEnd> {
    Err(StepEnd::Ended(ProgramOutcome::Failed, reason.into()))
}

fn stopped<T>(reason: impl Into<String>) -> Result<T, StepEnd> {
    Err(StepEnd::Ended(ProgramOutcome::Stopped, reason.into()))
}

/// When the time of a step is over, and which step's.
#[derive(Debug, Clone, Copy)]
struct Deadline<'p> {
    at: MonoNs,
    of: &'p str,
}

/// The motion that the program has asked for last.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct ProgramMotion {
    /// Number of the request, or of that of another client where the program has found the arm on its way to the goal, and gone on with that.
    request: Option<u64>,
    /// Whether an answer is missing, so that its number is not known.
    is_unanswered: bool,
}

impl ProgramMotion {
    /// Whether the arm does it still, by an answer of the run.
    fn is_that_of(self, status: &RunAnswer) -> bool {
        self.is_unanswered || (self.request.is_some() && self.request == status.motion_request)
    }
}

struct Runner<'a> {
    client: &'a Client,
    tell: &'a mut dyn FnMut(&str),
    expected: Expected,
    own: ProgramMotion,
    /// What led to `[[on_fault]]`, while it lasts: the steps there that move nothing are done in spite of it.
    known: Option<KnownEnd>,
    /// The step that is done.
    at: String,
}

impl Client {
    /// Runs `program`; `tell` hears of each step.
    ///
    /// # Errors
    /// As for [`Self::status`], and, before anything moves, where the run would refuse a step; a step that fails is an end.
    pub fn run_program(
        &self,
        program: &Program,
        tell: &mut dyn FnMut(&str),
    ) -> Result<ProgramEnd, ProcessError> {
        examination::examine(self, program)?;
        let (expected, own) = (Expected::Anything, ProgramMotion::default());
        let mut runner = Runner { client: self, tell, expected, own, known: None, at: String::new() };
        let end = runner.all(&program.steps, None);
        let step = runner.at.clone();
        let mut end = match end {
            Ok(()) => {
                return Ok(ProgramEnd {
                    outcome: ProgramOutcome::Done,
                    step,
                    reason: "all steps are done".into(),
                });
            }
            Err(end) => end,
        };
        let mut holds = true;
        if let StepEnd::Ended(ProgramOutcome::Failed | ProgramOutcome::Fault, reason) = &mut end
            && !program.on_fault.is_empty()
        {
            (runner.tell)(&format!("{step}: failed: {reason}; on_fault"));
            let failure = runner.on_fault(&program.on_fault);
            holds = failure.is_err();
            if let Err(why) = failure {
                *reason = format!("{reason}; on_fault failed at {}: {why}", runner.at);
            }
        }
        if holds {
            runner.hold_own();
        }
        match end {
            StepEnd::Ended(outcome, reason) => Ok(ProgramEnd { outcome, step, reason }),
            StepEnd::Error(error) => Err(error),
        }
    }
}

impl Runner<'_> {
    fn all<'p>(&mut self, steps: &'p [ProgramStep], until: Option<Deadline<'p>>) -> Result<(), StepEnd> {
        steps.iter().try_for_each(|step| self.one(step, until))
    }

    /// Does the steps of `[[on_fault]]`, with the arm at rest unless they move it themselves.
    fn on_fault(&mut self, steps: &[ProgramStep]) -> Result<(), StepEnd> {
        self.hold_own();
        self.expected = Expected::Anything;
        self.known = KnownEnd::of(&self.client.status());
        self.all(steps, None)
    }

    /// Holds the arm, if what it does is the program's own.
    fn hold_own(&mut self) {
        let client = self.client.clone().interrupted_by(StopFlag::default());
        let in_fault = |status: &RunAnswer| status.state == ControlState::Fault.as_str();
        if !client.status().is_ok_and(|status| self.own.is_that_of(&status) && !in_fault(&status)) {
            return;
        }
        // An arm that was never started refuses it, and stands.
        if let Ok(answer) = client.hold()
            && answer.accepted
        {
            self.own = ProgramMotion { request: answer.motion_request, is_unanswered: false };
        }
    }

    fn one<'p>(&mut self, step: &'p ProgramStep, outer: Option<Deadline<'p>>) -> Result<(), StepEnd> {
        self.at.clone_from(&step.key);
        in_time(outer)?;
        let own = step
            .timeout_s
            .is_finite()
            .then(|| Deadline { at: now() + SpanNs::from_s(step.timeout_s), of: &step.key });
        let until = outer.into_iter().chain(own).min_by_key(|deadline| deadline.at);
        (self.tell)(&format!("{}: {}", step.key, words(&step.action)));
        if matches!(step.action, StepAction::Goto(..) | StepAction::Servo(..)) {
            self.known = None;
        }
        if step.action != StepAction::Reset {
            self.look()?;
        }
        match &step.action {
            StepAction::Goto(_, q) => {
                let request = self.move_by(|client| client.goto(q))?.motion_request;
                self.expected = Expected::Moving { request };
                let stands = |status: &RunAnswer| status.state == ControlState::Held.as_str();
                self.until(until, false, |status| stands(status).then_some(Ok(())))?;
                self.expected = Expected::Standing { request };
            }
            StepAction::Servo(_, goal, for_s) => {
                self.servo(goal, until)?;
                // The time of the step is for the way to the goal.
                self.pause(*for_s, outer)?;
            }
            StepAction::Wait(what) => {
                // A state may be waited for that somebody else brings about.
                let by_anybody = matches!(what, WaitFor::Fault | WaitFor::State(_));
                self.until(until, by_anybody, |status| wait::verdict(*what, status))?;
            }
            StepAction::Pause(s) => self.pause(*s, outer)?,
            StepAction::Call(command) => self.call(command, until)?,
            StepAction::Repeat(count, steps) => {
                for round in 1..=*count {
                    (self.tell)(&format!("{}: round {round} of {count}", step.key));
                    self.all(steps, until)?;
                }
            }
            StepAction::Reset => {
                // It is refused until the arm stands.
                loop {
                    let answer = self.client.reset()?;
                    if answer.reason.as_deref() != Some(Refusal::StillMoving.describe()) {
                        accepted(&answer)?;
                        self.cleared(answer, until)?;
                        break;
                    }
                    self.rest(until)?;
                }
                (self.expected, self.known) = (Expected::Anything, None);
            }
        }
        Ok(())
    }

    /// A request that moves the arm.
    fn move_by(
        &mut self,
        ask: impl FnOnce(&Client) -> Result<RunAnswer, ProcessError>,
    ) -> Result<RunAnswer, StepEnd> {
        self.own.is_unanswered = true;
        let answer = ask(self.client)?;
        self.own.is_unanswered = false;
        accepted(&answer)?;
        self.own.request = answer.motion_request;
        Ok(answer)
    }

    fn servo(&mut self, goal: &TargetGoal, until: Option<Deadline<'_>>) -> Result<(), StepEnd> {
        let mut own = self.expected.goal();
        if goal.goal != ProgramGoal::Present || goal.target.is_some() {
            let answer = self.client.goal_of_program(goal)?;
            accepted(&answer)?;
            own = answer.goal;
            self.expected = self.expected.with_goal(own);
        }
        use ControlState::{Holding, Returning, Servoing, Waiting};
        let status = self.client.status()?;
        // An arm that was stopped since the last look is not started again, nor for a goal of somebody else.
        self.expected.judge(&status)?;
        let goal = own.or(status.goal);
        if goal != status.goal {
            return another_goal(&status);
        }
        let mut request = status.motion_request;
        if ![Waiting, Servoing, Holding, Returning].iter().any(|going| going.as_str() == status.state) {
            request = self.move_by(Client::start)?.motion_request;
        }
        self.own.request = request;
        self.expected = Expected::Servoing { request, goal };
        self.until(until, false, |status| (status.at_goal == Some(true)).then_some(Ok(())))
    }

    /// Waits until a robot whose error a reset has cleared obeys again.
    fn cleared(&mut self, answer: RunAnswer, until: Option<Deadline<'_>>) -> Result<(), StepEnd> {
        let mut newest = answer;
        if newest.waits_for.is_none() {
            return Ok(());
        }
        while newest.waits_for.is_some() {
            self.rest(until)?;
            newest = self.client.status()?;
        }
        newest.fault.map_or(Ok(()), |fault| failed(format!("the robot has not cleared its error: {fault}")))
    }

    fn pause(&mut self, s: f64, until: Option<Deadline<'_>>) -> Result<(), StepEnd> {
        let end = now() + SpanNs::from_s(s);
        while now() < end {
            self.look()?;
            self.rest(until)?;
        }
        Ok(())
    }

    fn call(&mut self, command: &[String], until: Option<Deadline<'_>>) -> Result<(), StepEnd> {
        let [program, arguments @ ..] = command else { return failed("no program") };
        let mut running = match RunningCommand::start(program, arguments) {
            Ok(running) => running,
            Err(cause) => return failed(format!("cannot start `{program}`: {cause}")),
        };
        loop {
            match running.ended() {
                Ok(Some(status)) if status.success() => return Ok(()),
                Ok(Some(status)) => return failed(format!("`{program}` ended with {status}")),
                Ok(None) => {}
                Err(cause) => return failed(format!("`{program}`: {cause}")),
            }
            self.look()?;
            self.rest(until)?;
        }
    }

    /// Looks at the run until `over` says so; `by_anybody`: also where somebody else has brought that about.
    fn until(
        &mut self,
        until: Option<Deadline<'_>>,
        by_anybody: bool,
        over: impl Fn(&RunAnswer) -> Option<Result<(), String>>,
    ) -> Result<(), StepEnd> {
        let mut told = String::new();
        loop {
            let answer = self.client.status();
            let judged = self.judge(&answer);
            let status = answer?;
            let over = over(&status);
            if let Some(Ok(())) = over
                && (by_anybody || judged.is_ok())
            {
                return Ok(());
            }
            if told != status.state {
                status.state.clone_into(&mut told);
                (self.tell)(&format!("{}: {}", self.at, status.line().trim_end()));
            }
            judged?;
            if let Some(Err(why)) = over {
                return failed(why);
            }
            self.rest(until)?;
        }
    }

    /// The time between two looks, unless that is over.
    fn rest(&self, until: Option<Deadline<'_>>) -> Result<(), StepEnd> {
        in_time(until)?;
        if self.client.interrupted.is_requested_within(wait::LOOK_AGAIN) {
            return stopped("interrupted");
        }
        Ok(())
    }

    /// Looks whether the run is as the program expects it.
    fn look(&mut self) -> Result<(), StepEnd> {
        let answer = self.client.status();
        let judged = self.judge(&answer);
        match answer {
            Err(error) if self.known.is_none() => Err(error.into()),
            _ => judged,
        }
    }

    /// Judges an answer of the run, unless it tells what is known already.
    fn judge(&mut self, answer: &Result<RunAnswer, ProcessError>) -> Result<(), StepEnd> {
        self.known = self.known.and_then(|known| known.still(KnownEnd::of(answer)?));
        match answer {
            Ok(status) if self.known.is_none() => self.expected.judge(status),
            _ => Ok(()),
        }
    }
}

fn in_time(until: Option<Deadline<'_>>) -> Result<(), StepEnd> {
    match until {
        Some(Deadline { at, of }) if now() > at => failed(format!("its time is over (timeout_s of {of})")),
        _ => Ok(()),
    }
}

fn accepted(answer: &RunAnswer) -> Result<(), StepEnd> {
    match &answer.reason {
        None => Ok(()),
        Some(why) => failed(format!("{} was refused: {why}", answer.request)),
    }
}

/// A step in words.
fn words(action: &StepAction) -> String {
    match action {
        StepAction::Goto(name, _) => format!("goto {name}"),
        StepAction::Servo(name, TargetGoal { target: Some(target), .. }, _) => {
            format!("servo {name} of {target}")
        }
        StepAction::Servo(name, ..) => format!("servo {name}"),
        StepAction::Wait(what) => format!("wait {what}"),
        StepAction::Pause(s) => format!("wait {s} s"),
        StepAction::Call(command) => format!("call {}", command.join(" ")),
        StepAction::Repeat(count, _) => format!("repeat {count}"),
        StepAction::Reset => "reset".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::client::answer::tests::answer;

    #[test]
    fn a_program_holds_no_motion_of_somebody_else() {
        let runs = |number| RunAnswer { motion_request: Some(number), ..answer() };
        let own = ProgramMotion { request: Some(5), is_unanswered: false };
        assert!(own.is_that_of(&runs(5)));
        assert!(!own.is_that_of(&runs(6)), "taken over");
        assert!(!ProgramMotion::default().is_that_of(&runs(6)), "it has moved nothing");
        // Nobody knows whose it is: the arm is to stand.
        assert!(ProgramMotion { is_unanswered: true, ..own }.is_that_of(&runs(6)));
    }
}
