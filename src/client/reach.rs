//! How a client reaches control: over the command service, or, for a stop, through the stop word. Neither takes longer than it
//! may, whatever stands in its way.

use crate::ipc::{CommandClient, Halt, Instance, InstanceError, IpcError, Role, Services};
use crate::messages::{ControlAnswer, ControlCommand, ControlState};
use crate::process::{ProcessError, StopFlag};
use crate::rt::now;
use crate::time::{MonoNs, SpanNs};
use std::sync::Mutex;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::Duration;

/// Looks for an answer lie so far apart. Derived: half a tick, as an answer takes a tick and two looks of control.
const LOOK: Duration = Duration::from_micros(500);
/// Looks whether a run is still there lie so far apart. Chosen by hand: people notice nothing of it, and it costs a system call.
const LOOK_FOR_RUN: SpanNs = SpanNs(100_000_000);
/// Pause where all slots are taken. Chosen by hand: one of the clients is answered, and leaves, within some milliseconds.
const CROWDED: Duration = Duration::from_millis(20);
/// Time for leaving after the answer, or after the last look for it. Chosen by hand, some hundred times what it takes on an idle machine.
const LEAVING: SpanNs = SpanNs(500_000_000);

/// The time that is left, and whether the answer is still awaited.
#[derive(Debug, Clone)]
pub(super) struct AnswerTimeout {
    timeout_s: f64,
    until: MonoNs,
    interrupted: StopFlag,
}

impl AnswerTimeout {
    /// From now on. A signal that sets `interrupted` does not end this process in the middle of joining, which would leave to others what it
    /// has half made: it ends the wait.
    pub(super) fn begin(timeout_s: f64, interrupted: StopFlag) -> Self {
        Self { timeout_s, until: now() + SpanNs::from_s(timeout_s), interrupted }
    }

    fn left(&self) -> Duration {
        Duration::from_secs_f64((self.until - now()).as_s().max(0.0))
    }

    /// Fails when there is no patience left.
    fn check(&self, instance: &Instance) -> Result<(), ProcessError> {
        if self.interrupted.is_requested() {
            return Err(ProcessError::Interrupted);
        }
        if now() > self.until { Err(self.no_answer(instance)) } else { Ok(()) }
    }

    fn no_answer(&self, instance: &Instance) -> ProcessError {
        ProcessError::NoAnswer { instance: instance.to_string(), waited_s: self.timeout_s }
    }
}

/// Makes sure that there is a run to ask.
pub(super) fn find(instance: &Instance) -> Result<(), ProcessError> {
    match instance.find(Role::Control) {
        Ok(true) => Ok(()),
        Ok(false) => Err(ProcessError::NobodyThere(instance.to_string())),
        Err(InstanceError::NotOurs { path, what }) => {
            Err(ProcessError::NotYourRun { instance: instance.to_string(), path, what })
        }
        Err(error) => Err(error.into()),
    }
}

/// Stops the arm of `instance`; control's state right after that.
pub(super) fn halt(
    instance: &Instance,
    halt: Halt,
    patience: &AnswerTimeout,
) -> Result<ControlState, ProcessError> {
    let mut asked = None;
    loop {
        if asked.is_none() {
            // A control that has just begun makes it within a moment.
            asked = instance.open_stop_word()?.map(|word| (word.ask(halt), word));
        }
        // Looked for before: control may answer and end in between.
        let there = find(instance);
        if let Some(state) = asked.as_ref().and_then(|(number, word)| word.answer(halt, *number)) {
            return Ok(state);
        }
        there?;
        patience.check(instance)?;
        std::thread::sleep(LOOK);
    }
}

/// Latches a stop of `instance`; control's state right after that.
pub(super) fn latch(instance: &Instance, patience: &AnswerTimeout) -> Result<ControlState, ProcessError> {
    let mut word = None;
    loop {
        if word.is_none() {
            word = instance.open_stop_word()?;
            if let Some(word) = &word {
                let _ = word.ask(Halt::Latch);
            }
        }
        let there = find(instance);
        if let Some(state) = word.as_ref().and_then(|word| word.begun(Halt::Latch)) {
            return Ok(state);
        }
        there?;
        patience.check(instance)?;
        std::thread::sleep(LOOK);
    }
}

/// What is wrong where a place was asked for, which may have been the last.
pub(super) fn crowded(instance: &Instance, error: IpcError) -> ProcessError {
    if error.is_crowded() {
        ProcessError::Crowded { instance: instance.to_string(), cause: error.to_string() }
    } else {
        error.into()
    }
}

/// Asks control of `instance`. What the transport does cannot be told to hurry, so that it is done beside.
pub(super) fn ask(
    instance: &Instance,
    command: ControlCommand,
    patience: &AnswerTimeout,
) -> Result<ControlAnswer, ProcessError> {
    // Whoever ends after the answer does not end in the middle of leaving.
    AskingThread::begin(instance)?.ask(command, patience)
}

/// A question on its way to the thread that asks it, with who waits for its answer.
type Question = (ControlCommand, AnswerTimeout, Sender<Result<ControlAnswer, ProcessError>>);

/// A thread that joins an instance, asks control what it is given, and leaves when this is dropped.
#[derive(Debug)]
pub(super) struct AskingThread {
    instance: Instance,
    /// `None` once this is dropped.
    questions: Option<Sender<Question>>,
    /// Nothing comes through it; it is closed when the thread has left.
    leaving: Mutex<Receiver<()>>,
}

impl Drop for AskingThread {
    /// A process that ends while it leaves would leave to others what it has half given back.
    fn drop(&mut self) {
        self.questions = None;
        if let Ok(leaving) = self.leaving.get_mut() {
            let _ = leaving.recv_timeout(Duration::from_secs_f64(LEAVING.as_s()));
        }
    }
}

impl AskingThread {
    /// A thread that joins `instance` with its first question.
    pub(super) fn begin(instance: &Instance) -> Result<Self, ProcessError> {
        let (questions, received) = channel();
        let (left, leaving) = channel();
        let place = instance.clone();
        std::thread::Builder::new()
            .name("ask".into())
            .spawn(move || {
                ask_all(&place, &received);
                drop(left);
            })
            .map_err(|cause| ProcessError::Start { what: "the thread that asks", cause })?;
        Ok(Self { instance: instance.clone(), questions: Some(questions), leaving: Mutex::new(leaving) })
    }

    /// The answer to `command`.
    pub(super) fn ask(
        &self,
        command: ControlCommand,
        patience: &AnswerTimeout,
    ) -> Result<ControlAnswer, ProcessError> {
        let gone = || ProcessError::Panicked("asking");
        let (tell, told) = channel();
        let questions = self.questions.as_ref().ok_or_else(gone)?;
        questions.send((command, patience.clone(), tell)).map_err(|_| gone())?;
        match told.recv_timeout(patience.left() + Duration::from_secs_f64(LEAVING.as_s())) {
            Ok(answer) => answer,
            Err(RecvTimeoutError::Timeout) => Err(patience.no_answer(&self.instance)),
            Err(RecvTimeoutError::Disconnected) => Err(gone()),
        }
    }
}

/// Joins `instance` with the first question, and asks until nobody asks any more. A place in a run that has ended is given back, so that nothing of it stays.
fn ask_all(instance: &Instance, questions: &Receiver<Question>) {
    let (mut joined, mut has_joined) = (None, false);
    loop {
        match questions.recv_timeout(Duration::from_secs_f64(LOOK_FOR_RUN.as_s())) {
            Ok((command, patience, tell)) => {
                // Who comes when the run has just ended makes a place in what is gone, and finds nobody there.
                has_joined = true;
                let place = match joined.take() {
                    Some(place) => Ok(place),
                    None => join(instance, &patience),
                };
                let answer = place.and_then(|place| {
                    let (client, _) = joined.insert(place);
                    ask_here(instance, client, command, &patience)
                });
                // A run that is another one meanwhile is joined anew.
                if answer.is_err() {
                    joined = None;
                }
                // Who asked may have given up.
                let _ = tell.send(answer);
            }
            // Over and over: the run's own processes, which could remove nothing while this was there, may be there themselves the first time.
            Err(RecvTimeoutError::Timeout) if has_joined && find(instance).is_err() => {
                joined = None;
                instance.remove_leftovers(None);
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break,
        }
    }
    drop(joined);
    if has_joined && find(instance).is_err() {
        instance.remove_leftovers(None);
    }
}

/// A place among the clients of `instance`.
fn join(instance: &Instance, patience: &AnswerTimeout) -> Result<(CommandClient, Services), ProcessError> {
    let join = || -> Result<_, IpcError> {
        let services = Services::join(instance)?;
        Ok((services.command_client()?, services))
    };
    loop {
        // Looked for before: a run that ends in between is gone at the next look, and nobody waits for one that has ended.
        let there = find(instance);
        match join() {
            Ok(joined) => return Ok(joined),
            Err(error) if error.is_crowded() => match there.and_then(|()| patience.check(instance)) {
                Err(ProcessError::NoAnswer { .. }) => return Err(crowded(instance, error)),
                over => over?,
            },
            // control makes the service soon after it has begun
            Err(error) if error.is_too_early() => there.and_then(|()| patience.check(instance))?,
            Err(error) => return Err(error.into()),
        }
        std::thread::sleep(CROWDED);
    }
}

fn ask_here(
    instance: &Instance,
    client: &CommandClient,
    command: ControlCommand,
    patience: &AnswerTimeout,
) -> Result<ControlAnswer, ProcessError> {
    let pending = client.ask(command)?;
    let mut looked = now();
    loop {
        // Looked for before: control may answer and end in between.
        let there = if now() - looked > LOOK_FOR_RUN {
            looked = now();
            find(instance)
        } else {
            Ok(())
        };
        if let Some(answer) = pending.answer()? {
            return Ok(answer);
        }
        there?;
        patience.check(instance)?;
        std::thread::sleep(LOOK);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    /// Where the run ends between the look for it and joining it, nobody waits for what will not come.
    #[test]
    fn a_run_that_is_gone_before_it_is_joined_is_told_at_once() {
        let instance: Instance = format!("reach-gone-{}", std::process::id()).parse().unwrap();
        let patience = AnswerTimeout::begin(20.0, StopFlag::default());
        let answer = ask(&instance, ControlCommand::default(), &patience);
        assert!(matches!(answer, Err(ProcessError::NobodyThere(_))), "{answer:?}");
    }
}
