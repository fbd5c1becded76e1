//! The programs that take part in a benchmark: what the command line says of them, and one process a run that answers line by line.
//!
//! A process lives for one run, so that nothing of a run is left in the next one, whoever runs it on which thread.

use crate::input::printable;
use crate::rt::{kill_with_group, now};
use crate::sim::benchmark::{
    BenchmarkError, BenchmarkScenario, BenchmarkSuite, EntrantCard, EntrantLink, begin_message, checked_names,
};
use crate::time::{MonoNs, SpanNs};
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::process::CommandExt;
use std::process::{Child, ChildStdin, ChildStdout, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::Duration;

/// Longest answer, bytes. Chosen by hand: a thousand times what six numbers take.
const MAX_ANSWER: u64 = 100_000;
/// How long an entrant that was told the end of its run may take to end. Chosen by hand: interpreters take a tenth of it on a loaded machine.
const LEAVES_WITHIN: SpanNs = SpanNs(2_000_000_000);
/// Between two looks whether it has ended. Chosen by hand: what starting the next one takes many times over.
const LOOK_EVERY: Duration = Duration::from_millis(1);

/// An entrant of the command line, and what it says of itself.
#[derive(Debug, Clone)]
pub(super) struct EntrantProgram {
    pub(super) card: EntrantCard,
    timeout: Duration,
}

/// `NAME=COMMAND`, or a command alone.
fn split(text: &str) -> (Option<&str>, &str) {
    let is_name = |name: &str| checked_names([name.to_owned()].iter()).is_ok();
    match text.split_once('=') {
        Some((name, command)) if is_name(name) => (Some(name), command),
        _ => (None, text),
    }
}

/// The entrants of the command line, each asked for its words and settings with the task of `first`.
///
/// # Errors
/// When one cannot be started or does not answer, and when names stand there twice.
pub(super) fn enrolled(
    suite: &BenchmarkSuite,
    first: &BenchmarkScenario,
    all: &[String],
    timeout: Duration,
) -> Result<Vec<EntrantProgram>, BenchmarkError> {
    let wrong = |cause: String| BenchmarkError::Entrant { cause };
    let mut entrants = Vec::with_capacity(all.len());
    for (number, text) in all.iter().enumerate() {
        let (name, command) = split(text);
        let task = suite.task_of(first)?;
        let begin = begin_message(&suite.run_file(first, None)?, task).map_err(wrong)?;
        let mut process = EntrantProcess::start(command, timeout).map_err(|e| {
            wrong(format!("entrant `{command}` cannot be started: {e}; give a command of the shell, as in --entrant 'mine=python3 mine.py'"))
        })?;
        let card = process.exchange(&begin).and_then(|line| EntrantCard::parse(&line));
        let mut card = card.map_err(|why| {
            wrong(format!(
                "entrant `{}` {}; docs/benchmark.md has the protocol",
                printable(command),
                printable(&why)
            ))
        })?;
        drop(process);
        card.name = match (name, card.name.as_str()) {
            (Some(name), _) => name.to_owned(),
            (None, "") => format!("entrant-{}", number + 1),
            (None, own) => own.to_owned(),
        };
        card.command = command.to_owned();
        entrants.push(EntrantProgram { card, timeout });
    }
    let laws = suite.laws.iter().map(|law| &law.name);
    checked_names(laws.chain(entrants.iter().map(|entrant| &entrant.card.name)))
        .map_err(|cause| wrong(format!("{cause}; name it, as in --entrant 'NAME=COMMAND'")))?;
    Ok(entrants)
}

impl EntrantProgram {
    /// A process for one run. One that cannot be started has its reason to tell instead.
    pub(super) fn start(&self) -> EntrantRun {
        EntrantRun { process: EntrantProcess::start(&self.card.command, self.timeout), spans_ns: Vec::new() }
    }
}

/// The process of one run, and how long its answers took.
pub(super) struct EntrantRun {
    process: Result<EntrantProcess, std::io::Error>,
    spans_ns: Vec<i64>,
}

impl EntrantRun {
    /// From a question to its answer, in the middle; the answer to the task is none.
    pub(super) fn median_ns(&self) -> Option<f64> {
        let mut spans = self.spans_ns.get(1..)?.to_vec();
        spans.sort_unstable();
        spans.get(spans.len() / 2).map(|ns| *ns as f64)
    }
}

impl EntrantLink for EntrantRun {
    fn exchange(&mut self, line: &str) -> Result<String, String> {
        let process = self.process.as_mut().map_err(|e| format!("cannot be started: {e}"))?;
        let asked = now();
        let answer = process.exchange(line)?;
        self.spans_ns.push((now() - asked).0);
        Ok(answer)
    }

    fn end(&mut self, line: &str) {
        if let Ok(process) = &mut self.process {
            process.leave(line);
        }
    }
}

/// A process that answers lines.
struct EntrantProcess {
    child: Child,
    timeout: Duration,
    /// To the thread that writes and reads, which ends when this does; and back.
    questions: Option<Sender<LineTo>>,
    answers: Receiver<Result<String, NoAnswer>>,
}

/// A line to an entrant.
enum LineTo {
    /// That it answers.
    Question(String),
    /// That nobody answers: its input ends behind it.
    Farewell(String),
}

/// Why a line has no answer.
enum NoAnswer {
    /// Its output is over.
    Over,
    /// Its answer has no end.
    TooLong,
    /// Its answer is no text.
    NoText,
}

impl EntrantProcess {
    fn start(command: &str, timeout: Duration) -> Result<Self, std::io::Error> {
        let mut child = Command::new("sh")
            .args(["-c", command])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            // A group of its own, so that what the shell has started ends with it.
            .process_group(0)
            .spawn()?;
        let (questions, asked) = channel();
        let (answer, answers) = channel();
        if let (Some(to), Some(from)) = (child.stdin.take(), child.stdout.take()) {
            let carry = move || carried(&asked, to, from, &answer);
            std::thread::Builder::new().name("entrant".into()).spawn(carry)?;
        }
        Ok(Self { child, timeout, questions: Some(questions), answers })
    }

    fn exchange(&mut self, line: &str) -> Result<String, String> {
        let is_sent = self
            .questions
            .as_ref()
            .is_some_and(|questions| questions.send(LineTo::Question(line.to_owned())).is_ok());
        let answer = if is_sent {
            self.answers.recv_timeout(self.timeout)
        } else {
            Err(RecvTimeoutError::Disconnected)
        };
        match answer {
            Ok(Ok(answer)) => Ok(answer),
            Ok(Err(NoAnswer::TooLong)) => Err(format!("answers with more than {MAX_ANSWER} bytes in a line")),
            Ok(Err(NoAnswer::NoText)) => Err("answers with bytes that are no text in UTF-8".into()),
            Ok(Err(NoAnswer::Over)) | Err(RecvTimeoutError::Disconnected) => Err(self.death()),
            Err(RecvTimeoutError::Timeout) => {
                Err(format!("did not answer within {} s (--entrant-timeout)", self.timeout.as_secs_f64()))
            }
        }
    }

    /// How a process ended that says no more.
    fn death(&mut self) -> String {
        self.questions = None;
        match self.ended_within(LEAVES_WITHIN) {
            Some(status) => format!("ended before its run was over ({status})"),
            None => "closed its output before its run was over".into(),
        }
    }

    fn ended_within(&mut self, span: SpanNs) -> Option<ExitStatus> {
        let until: MonoNs = now() + span;
        loop {
            match self.child.try_wait() {
                Ok(Some(status)) => return Some(status),
                Ok(None) if now() < until => std::thread::sleep(LOOK_EVERY),
                _ => return None,
            }
        }
    }

    /// The last line, after which it may end by itself.
    fn leave(&mut self, line: &str) {
        if let Some(questions) = self.questions.take() {
            // one that has ended before needs no farewell
            let _ = questions.send(LineTo::Farewell(line.to_owned()));
        }
        let _ = self.ended_within(LEAVES_WITHIN);
    }
}

impl Drop for EntrantProcess {
    fn drop(&mut self) {
        self.questions = None;
        kill_with_group(&mut self.child);
    }
}

/// Carries lines to the process and its answers back, until nobody asks any more or there is no answer.
fn carried(
    asked: &Receiver<LineTo>,
    mut to: ChildStdin,
    from: ChildStdout,
    answer: &Sender<Result<String, NoAnswer>>,
) {
    let mut from = BufReader::new(from);
    for line in asked {
        let (LineTo::Question(text) | LineTo::Farewell(text)) = &line;
        // a process that reads no more may still have answered
        let _ = to.write_all(format!("{text}\n").as_bytes());
        if let LineTo::Farewell(_) = line {
            return;
        }
        let read = read_line(&mut from);
        let is_last = read.is_err();
        if answer.send(read).is_err() || is_last {
            return;
        }
    }
}

fn read_line(from: &mut BufReader<ChildStdout>) -> Result<String, NoAnswer> {
    let mut bytes = Vec::new();
    match from.take(MAX_ANSWER).read_until(b'\n', &mut bytes) {
        Ok(_) if bytes.last() == Some(&b'\n') => String::from_utf8(bytes).map_err(|_| NoAnswer::NoText),
        Ok(_) if bytes.len() as u64 >= MAX_ANSWER => Err(NoAnswer::TooLong),
        _ => Err(NoAnswer::Over),
    }
}
