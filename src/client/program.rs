//! Runs a program: one step after the other by requests of this client, with a look at the run in between.
//!
//! ```text
//! step ─► request ─► look every 100 ms ─► done ─► next step
//!                     ├─ fault, time over, exit code ─► on_fault, then the end: failed
//!                     └─ stopped or held by another client, interrupted ─► the arm holds, the end: stopped
//! ```

use super::{Client, RunAnswer, wait};
use crate::config::{FIRST_TARGET, Program, ProgramGoal, ProgramStep, StepAction, TargetGoal};
use crate::control::lifecycle::Refusal;
use crate::messages::ControlState;
use crate::process::{ProcessError, StopFlag};
use crate::rt::now;
use crate::time::{MonoNs, SpanNs};
use std::process::{Command, Stdio};

/// How a program ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ProgramOutcome {
    /// All steps were done.
    Done,
    /// A step failed.
    Failed,
    /// The arm has a fault.
    Fault,
    /// Somebody stopped or held the arm, or interrupted the program.
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

/// What the program has the arm do, so that a request of somebody else is seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Expected {
    Anything,
    Moving,
    Servoing,
    Standing,
}

struct Runner<'a> {
    client: &'a Client,
    tell: &'a mut dyn FnMut(&str),
    expected: Expected,
    /// The step that is done.
    at: String,
}

impl Client {
    /// Runs `program`; `tell` hears of each step.
    ///
    /// # Errors
    /// As for [`Self::status`]; a step that fails is an end.
    pub fn run_program(
        &self,
        program: &Program,
        tell: &mut dyn FnMut(&str),
    ) -> Result<ProgramEnd, ProcessError> {
        self.check_program(program)?;
        let mut runner = Runner { client: self, tell, expected: Expected::Anything, at: String::new() };
        let end = runner.all(&program.steps, None);
        let step = runner.at.clone();
        let end = match end {
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
        if let StepEnd::Ended(ProgramOutcome::Failed | ProgramOutcome::Fault, reason) = &end
            && !program.on_fault.is_empty()
        {
            (runner.tell)(&format!("{step}: failed: {reason}; on_fault"));
            runner.expected = Expected::Anything;
            holds = runner.all(&program.on_fault, None).is_err();
        }
        if holds {
            // What holds already, or has a fault, refuses it.
            let _ = self.clone().interrupted_by(StopFlag::default()).hold();
        }
        match end {
            StepEnd::Ended(outcome, reason) => Ok(ProgramEnd { outcome, step, reason }),
            StepEnd::Error(error) => Err(error),
        }
    }

    /// Refuses a program that this run cannot do, before anything moves: postures of another arm, goals of another target, a run that does not stay.
    fn check_program(&self, program: &Program) -> Result<(), ProcessError> {
        let (status, targets) = (self.status()?, self.targets());
        // A goal of no certain target is of the first one.
        let target_of = |of: &TargetGoal| {
            let name = of.target.as_deref().unwrap_or(FIRST_TARGET);
            targets.iter().find(|target| target.name == name)
        };
        let wrong =
            |step: &ProgramStep, why: String| Err(ProcessError::NoCommand(format!("{}: {why}", step.key)));
        if status.served != Some(true) {
            let why = "this run ends at its goal: a program needs one of `vservo serve`";
            return Err(ProcessError::NoCommand(why.into()));
        }
        for step in program.all_steps() {
            match &step.action {
                StepAction::Goto(name, q) if q.len() != status.q_rad_or_m.len() => {
                    let joints = status.q_rad_or_m.len();
                    return wrong(step, format!("`{name}` has {} joints, the arm {joints}", q.len()));
                }
                StepAction::Servo(name, of, _) => {
                    let ProgramGoal::Taught(goal) = &of.goal else { continue };
                    if let Some(target) = target_of(of).filter(|target| target.kind != goal.target) {
                        let (key, kind) = (target.key(), &target.kind);
                        let why = format!(
                            "`{name}` is of a target of kind \"{}\", {key}.kind is \"{kind}\"",
                            goal.target
                        );
                        return wrong(step, why);
                    }
                }
                _ => {}
            }
        }
        Ok(())
    }
}

impl Runner<'_> {
    fn all(&mut self, steps: &[ProgramStep], until: Option<MonoNs>) -> Result<(), StepEnd> {
        steps.iter().try_for_each(|step| self.one(step, until))
    }

    fn one(&mut self, step: &ProgramStep, until: Option<MonoNs>) -> Result<(), StepEnd> {
        self.at.clone_from(&step.key);
        let own = step.timeout_s.is_finite().then(|| now() + SpanNs::from_s(step.timeout_s));
        let until = own.into_iter().chain(until).min();
        (self.tell)(&format!("{}: {}", step.key, words(&step.action)));
        if step.action != StepAction::Reset {
            self.look()?;
        }
        match &step.action {
            StepAction::Goto(_, q) => {
                accepted(&self.client.goto(q)?)?;
                self.expected = Expected::Moving;
                self.until(until, |status| (status.state == ControlState::Held.as_str()).then_some(Ok(())))?;
                self.expected = Expected::Standing;
            }
            StepAction::Servo(_, goal, for_s) => self.servo(goal, *for_s, until)?,
            StepAction::Wait(what) => self.until(until, |status| wait::verdict(*what, status))?,
            StepAction::Pause(s) => self.pause(*s)?,
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
                    if answer.reason != Some(Refusal::StillMoving.describe()) {
                        accepted(&answer)?;
                        self.cleared(answer, until)?;
                        break;
                    }
                    self.rest(until)?;
                }
                self.expected = Expected::Anything;
            }
        }
        Ok(())
    }

    fn servo(&mut self, goal: &TargetGoal, for_s: f64, until: Option<MonoNs>) -> Result<(), StepEnd> {
        if goal.goal != ProgramGoal::Present || goal.target.is_some() {
            accepted(&self.client.goal_of_program(goal)?)?;
        }
        use ControlState::{Holding, Returning, Servoing, Waiting};
        let status = self.client.status()?;
        // An arm that was stopped since the last look is not started again.
        self.judge(&status)?;
        if ![Waiting, Servoing, Holding, Returning].iter().any(|going| going.as_str() == status.state) {
            accepted(&self.client.start()?)?;
        }
        self.expected = Expected::Servoing;
        self.until(until, |status| (status.at_goal == Some(true)).then_some(Ok(())))?;
        self.pause(for_s)
    }

    /// Waits until a robot whose error a reset has cleared obeys again.
    fn cleared(&mut self, answer: RunAnswer, until: Option<MonoNs>) -> Result<(), StepEnd> {
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

    fn pause(&mut self, s: f64) -> Result<(), StepEnd> {
        let end = now() + SpanNs::from_s(s);
        while now() < end {
            self.look()?;
            self.rest(None)?;
        }
        Ok(())
    }

    fn call(&mut self, command: &[String], until: Option<MonoNs>) -> Result<(), StepEnd> {
        let [program, arguments @ ..] = command else { return failed("no program") };
        let mut child = match Command::new(program).args(arguments).stdin(Stdio::null()).spawn() {
            Ok(child) => child,
            Err(cause) => return failed(format!("cannot start `{program}`: {cause}")),
        };
        let end = loop {
            match child.try_wait() {
                Ok(Some(status)) if status.success() => return Ok(()),
                Ok(Some(status)) => return failed(format!("`{program}` ended with {status}")),
                Ok(None) => {}
                Err(cause) => break failed(format!("`{program}`: {cause}")),
            }
            if let Err(end) = self.look().and_then(|_| self.rest(until)) {
                break Err(end);
            }
        };
        let _ = child.kill(); // it may have ended meanwhile
        let _ = child.wait();
        end
    }

    /// Looks at the run until `over` says so.
    fn until(
        &mut self,
        until: Option<MonoNs>,
        over: impl Fn(&RunAnswer) -> Option<Result<(), String>>,
    ) -> Result<(), StepEnd> {
        let mut told = String::new();
        loop {
            let status = self.client.status()?;
            if let Some(Ok(())) = over(&status) {
                return Ok(());
            }
            if told != status.state {
                status.state.clone_into(&mut told);
                (self.tell)(&format!("{}: {}", self.at, status.line().trim_end()));
            }
            self.judge(&status)?;
            if let Some(Err(why)) = over(&status) {
                return failed(why);
            }
            self.rest(until)?;
        }
    }

    /// The time between two looks, unless that is over.
    fn rest(&self, until: Option<MonoNs>) -> Result<(), StepEnd> {
        if until.is_some_and(|until| now() > until) {
            return failed("its time is over (timeout_s)");
        }
        if self.client.interrupted.is_requested_within(wait::LOOK_AGAIN) {
            return stopped("interrupted");
        }
        Ok(())
    }

    /// Looks whether the run is as the program expects it.
    fn look(&self) -> Result<(), StepEnd> {
        self.judge(&self.client.status()?)
    }

    fn judge(&self, status: &RunAnswer) -> Result<(), StepEnd> {
        use ControlState::{Fault, Held, Idle, Servoing, Stopped, Stopping};
        let is = |state: ControlState| status.state == state.as_str();
        let by_somebody =
            |what: &str| stopped(format!("the arm was {what} by somebody else: it is {}", status.state));
        match self.expected {
            _ if is(Fault) => Err(StepEnd::Ended(ProgramOutcome::Fault, status.state_in_words())),
            Expected::Moving | Expected::Servoing | Expected::Standing
                if is(Idle) || is(Stopping) || is(Stopped) =>
            {
                by_somebody("stopped")
            }
            Expected::Servoing if is(Held) => by_somebody("held"),
            Expected::Standing if is(Servoing) => by_somebody("started"),
            _ => Ok(()),
        }
    }
}

fn accepted(answer: &RunAnswer) -> Result<(), StepEnd> {
    answer.reason.map_or(Ok(()), |why| failed(format!("{} was refused: {why}", answer.request)))
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
