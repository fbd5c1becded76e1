//! What was sent to a drive in one trial, and what came back.

use super::arm::ArmFacts;
use super::plan::{DriveTrial, PhaseKind};
use crate::drive::{CommandMode, DriveProperties};
use crate::messages::{DriveCommandMsg, DriveStateMsg, DriveTextMsg, MAX_JOINTS, drive_flag, text_kind};
use crate::time::{MonoNs, SpanNs};

/// As many states may wait for their reader, as the services have it: where so many were taken at once, some before them may have been
/// overwritten, and the reader is to blame for the gap.
const FULL: u32 = 64;
/// A stamp that is farther from its arrival is of another clock. Chosen by hand: a thousand periods, and far below the difference of any two clocks.
pub(super) const OTHER_CLOCK: SpanNs = SpanNs(1_000_000_000);

/// A command, and when it was sent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SentCommand {
    /// When, by the clock of this machine.
    pub at: MonoNs,
    /// What.
    pub command: DriveCommandMsg,
}

/// A state, and when it was taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReceivedState {
    /// When, by the clock of this machine.
    pub at: MonoNs,
    /// Which of those that were taken at once, from 1.
    pub of_batch: u32,
    /// How many were taken at once.
    pub batch: u32,
    /// What.
    pub state: DriveStateMsg,
}

/// A text, and when it was there at the latest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReceivedText {
    /// When the look for states began in which it was found: it is no later than a state of that look unless it was sent after that.
    pub at: MonoNs,
    /// What.
    pub text: DriveTextMsg,
}

/// A phase of the trial as it took place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LoggedPhase {
    /// What it was for.
    pub kind: PhaseKind,
    /// Its begin, on the scale of the stamps.
    pub from: MonoNs,
    /// Its end.
    pub to: MonoNs,
}

/// What became of the drive's program.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ProgramExit {
    /// It was started by somebody else: nobody knows.
    Unknown,
    /// It still ran when the trial was over, and was ended.
    Ran,
    /// It ended.
    Ended {
        /// When that was seen.
        at: MonoNs,
        /// The exit code; `None` for a signal.
        code: Option<u8>,
        /// The reason that it left.
        words: Option<String>,
    },
}

/// All of one trial.
#[derive(Debug, Clone, PartialEq)]
pub struct DriveLog {
    /// What was tried.
    pub trial: DriveTrial,
    /// In which mode.
    pub mode: CommandMode,
    /// The arm and the run file.
    pub arm: ArmFacts,
    /// What was sent, oldest first.
    pub sent: Vec<SentCommand>,
    /// What came, oldest first.
    pub received: Vec<ReceivedState>,
    /// What it said, oldest first.
    pub texts: Vec<ReceivedText>,
    /// The phases that were begun.
    pub phases: Vec<LoggedPhase>,
    /// When the last look for states was.
    pub until: MonoNs,
    /// Why the trial was given up before its end.
    pub given_up: Option<String>,
    /// What became of the program.
    pub exit: ProgramExit,
}

impl DriveLog {
    pub(super) fn joints(&self) -> usize {
        self.arm.joints.len().min(MAX_JOINTS)
    }

    /// States that are no answers to START.
    pub(super) fn ordinary(&self) -> impl Iterator<Item = &ReceivedState> {
        self.received.iter().filter(|r| r.state.flags & drive_flag::INITIAL == 0)
    }

    /// The first answer to START.
    pub(super) fn initial(&self) -> Option<&ReceivedState> {
        self.received.iter().find(|r| r.state.flags & drive_flag::INITIAL != 0)
    }

    /// What the drive tells of itself; nothing where that is not to be read, which another rule tells.
    pub(super) fn told(&self) -> DriveProperties {
        let told = self.texts.iter().find(|t| t.text.kind == text_kind::PROPERTIES);
        told.and_then(|told| DriveProperties::parse(&told.text.text()).ok()).unwrap_or_default()
    }

    /// The first command with this flag.
    pub(super) fn flagged(&self, flag: u32) -> Option<&SentCommand> {
        self.sent.iter().find(|s| s.command.flags & flag != 0)
    }

    pub(super) fn phases_of(&self, wanted: impl Fn(PhaseKind) -> bool) -> impl Iterator<Item = &LoggedPhase> {
        self.phases.iter().filter(move |p| wanted(p.kind))
    }

    /// Whether stamps are of another clock than this machine's.
    pub(super) fn has_other_clock(&self) -> bool {
        let far = |r: &&ReceivedState| (r.at - r.state.stamp).0.unsigned_abs() > OTHER_CLOCK.0.unsigned_abs();
        !self.arm.lockstep && self.received.iter().filter(far).count() * 2 > self.received.len()
    }

    /// The ordinary states of a span of time, with their times, oldest first: those are their stamps, or their arrivals where stamps are of another clock.
    pub(super) fn states_within(&self, from: MonoNs, to: MonoNs) -> Vec<(MonoNs, DriveStateMsg)> {
        let other_clock = self.has_other_clock();
        let time = |r: &ReceivedState| if other_clock { r.at } else { r.state.stamp };
        let timed = self.ordinary().map(|r| (time(r), r.state));
        let mut states: Vec<_> = timed.filter(|(t, _)| *t >= from && *t <= to).collect();
        states.sort_by_key(|(t, _)| *t);
        states
    }

    /// The longest pause of commands or of states between two moments of real time; none in lockstep.
    pub(super) fn pause(&self, from: MonoNs, to: MonoNs) -> SpanNs {
        let longest = |times: &mut dyn Iterator<Item = MonoNs>| {
            let within = times.filter(|at| *at > from && *at < to).chain([to]);
            let (_, longest) =
                within.fold((from, SpanNs::ZERO), |(before, longest), at| (at, longest.max(at - before)));
            longest
        };
        if self.arm.lockstep {
            return SpanNs::ZERO;
        }
        let sent = longest(&mut self.sent.iter().map(|s| s.at));
        sent.max(longest(&mut self.received.iter().map(|r| r.at)))
    }

    /// When the drive stopped to be commanded as in a run: the begin of a silence or of commands that are to be refused, LAST, or the program's end.
    pub(super) fn ordinary_end(&self) -> MonoNs {
        let odd = self.phases_of(|kind| kind.is_odd()).map(|p| p.from);
        let last = self.flagged(drive_flag::LAST).map(|s| s.at);
        let ended = match &self.exit {
            ProgramExit::Ended { at, .. } => Some(*at),
            ProgramExit::Unknown | ProgramExit::Ran => None,
        };
        odd.chain(last).chain(ended).min().unwrap_or(self.until)
    }

    /// Whether states before this one may have been lost by their reader.
    pub(super) fn reader_may_have_lost(r: &ReceivedState) -> bool {
        r.batch >= FULL
    }
}
