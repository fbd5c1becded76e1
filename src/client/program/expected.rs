//! What a program has the arm do, so that a request of somebody else is seen.

use super::{RunAnswer, StepEnd, failed, stopped};
use crate::client::ProgramOutcome;
use crate::messages::ControlState;
use crate::process::ProcessError;

/// What a program has the arm do, with the numbers of the goal and of the request that it goes by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Expected {
    Anything,
    Moving { request: Option<u64> },
    Standing { request: Option<u64> },
    Servoing { request: Option<u64>, goal: Option<u32> },
}

impl Expected {
    /// The same with another goal, which the program has set itself.
    pub(super) fn with_goal(self, goal: Option<u32>) -> Self {
        match self {
            Self::Servoing { request, .. } => Self::Servoing { request, goal },
            other => other,
        }
    }

    /// The goal that the arm is at or on its way to.
    pub(super) fn goal(self) -> Option<u32> {
        if let Self::Servoing { goal, .. } = self { goal } else { None }
    }

    /// Whether the run is so.
    pub(super) fn judge(self, status: &RunAnswer) -> Result<(), StepEnd> {
        use ControlState::{Fault, Held, Idle, Servoing, Stopped, Stopping};
        let is = |state: ControlState| status.state == state.as_str();
        let by_somebody =
            |what: &str| stopped(format!("the arm was {what} by somebody else: it is {}", status.state));
        let request = match self {
            _ if is(Fault) => return Err(StepEnd::Ended(ProgramOutcome::Fault, status.state_in_words())),
            Self::Anything => return Ok(()),
            Self::Moving { request } | Self::Standing { request } | Self::Servoing { request, .. } => request,
        };
        match self {
            _ if is(Idle) || is(Stopping) || is(Stopped) => by_somebody("stopped"),
            Self::Servoing { .. } if is(Held) => match status.held_for {
                Some(why) => failed(format!("control holds the arm: {why}")),
                None => by_somebody("held"),
            },
            Self::Standing { .. } if is(Servoing) => by_somebody("started"),
            Self::Servoing { goal, .. } if goal != status.goal => another_goal(status),
            _ if request != status.motion_request => by_somebody("taken over"),
            _ => Ok(()),
        }
    }
}

/// What led to `[[on_fault]]`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum KnownEnd {
    /// A fault, by its words; they may come a moment after the state.
    Fault(Option<&'static str>),
    RunEnded,
}

impl KnownEnd {
    /// What an answer of the run tells of it; `None` where the run goes on without a fault.
    pub(super) fn of(answer: &Result<RunAnswer, ProcessError>) -> Option<Self> {
        match answer {
            Ok(status) => (status.state == ControlState::Fault.as_str()).then_some(Self::Fault(status.fault)),
            Err(ProcessError::NobodyThere(_)) => Some(Self::RunEnded),
            Err(_) => None,
        }
    }

    /// The same, where `now` is no other one.
    pub(super) fn still(self, now: Self) -> Option<Self> {
        match (self, now) {
            (Self::Fault(known), Self::Fault(told)) if known.is_none() || told.is_none() || known == told => {
                Some(Self::Fault(told.or(known)))
            }
            _ => (self == now).then_some(self),
        }
    }
}

/// The end of a program whose goal is none any more.
pub(super) fn another_goal(status: &RunAnswer) -> Result<(), StepEnd> {
    let number = status.goal.unwrap_or_default();
    stopped(format!("another goal was set by somebody else: number {number}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::client::answer::tests::answer;

    fn told(expected: Expected, status: &RunAnswer) -> Option<String> {
        match expected.judge(status) {
            Ok(()) => None,
            Err(StepEnd::Ended(ProgramOutcome::Stopped, why)) => Some(why),
            Err(_) => Some("no stop".into()),
        }
    }

    #[test]
    fn goals_and_motions_of_other_clients_stop_a_program() {
        let (request, goal) = (Some(5), Some(2));
        let run = |state: ControlState, number, of| RunAnswer {
            state: state.as_str(),
            motion_request: Some(number),
            goal: Some(of),
            ..answer()
        };
        use ControlState::{Held, Moving, Servoing, Waiting};
        for (expected, good, bad, word) in [
            (
                Expected::Servoing { request, goal },
                run(Servoing, 5, 2),
                run(Servoing, 5, 3),
                "another goal was set by somebody else: number 3",
            ),
            (
                Expected::Servoing { request, goal },
                run(Waiting, 5, 2),
                run(Moving, 6, 2),
                "taken over by somebody else: it is moving",
            ),
            (Expected::Servoing { request, goal }, run(Servoing, 5, 2), run(Servoing, 7, 2), "taken over"),
            (
                Expected::Moving { request },
                run(Held, 5, 2),
                run(Held, 6, 2),
                "taken over by somebody else: it is held",
            ),
            (Expected::Standing { request }, run(Held, 5, 3), run(Held, 6, 2), "taken over"),
            (
                Expected::Standing { request },
                run(Held, 5, 2),
                run(Servoing, 6, 2),
                "started by somebody else",
            ),
        ] {
            assert_eq!(told(expected, &good), None, "{expected:?}");
            let why = told(expected, &bad).unwrap();
            assert!(why.contains(word), "{expected:?}: {why}");
            assert_eq!(told(Expected::Anything, &bad), None);
        }
    }

    #[test]
    fn a_hold_of_control_itself_is_nobody_elses() {
        let expected = Expected::Servoing { request: Some(5), goal: Some(2) };
        let held = RunAnswer { state: ControlState::Held.as_str(), motion_request: Some(6), ..answer() };
        assert!(told(expected, &held).unwrap().contains("held by somebody else"));
        let lost = RunAnswer { held_for: Some("vision was lost"), ..held };
        let Err(StepEnd::Ended(ProgramOutcome::Failed, why)) = expected.judge(&lost) else {
            panic!("{lost:?}")
        };
        assert_eq!(why, "control holds the arm: vision was lost");
    }
}
