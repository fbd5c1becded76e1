//! Waiting for a state of a run, or for its goal. The run is asked again and again, and in between the place of the client is free.

use super::{Client, RunAnswer};
use crate::messages::ControlState;
use crate::process::ProcessError;
use crate::rt::now;
use crate::time::SpanNs;
use serde::Serialize;
use std::fmt;
use std::str::FromStr;
use std::time::Duration;

/// Pause between two questions. Chosen by hand: a program notices nothing of it, and ten questions a second take a part of a per cent of a core.
const LOOK_AGAIN: Duration = Duration::from_millis(100);

/// What is waited for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WaitFor {
    /// The goal is reached and held.
    Converged,
    /// The view is lost: the arm holds, or returns to where it saw the target last.
    Holding,
    /// There is a fault.
    Fault,
    /// Control is in this state.
    State(ControlState),
}

impl FromStr for WaitFor {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let state = |word: &str| ControlState::ALL.into_iter().find(|state| state.as_str() == word);
        match (text, text.strip_prefix("state=")) {
            ("converged", _) => Ok(Self::Converged),
            ("holding", _) => Ok(Self::Holding),
            ("fault", _) => Ok(Self::Fault),
            (_, Some(word)) => state(word).map(Self::State).ok_or_else(|| {
                let words: Vec<_> = ControlState::ALL.iter().map(|state| state.as_str()).collect();
                format!("`{word}` is no state; there are {}", words.join(", "))
            }),
            _ => Err(format!("`{text}` is nothing to wait for; there are converged, holding, fault and state=NAME")),
        }
    }
}

impl fmt::Display for WaitFor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Converged => f.write_str("converged"),
            Self::Holding => f.write_str("holding"),
            Self::Fault => f.write_str("fault"),
            Self::State(state) => write!(f, "state={}", state.as_str()),
        }
    }
}

impl WaitFor {
    /// Whether the wait is over: that it is met, or that it cannot be any more without another request.
    fn verdict(self, a: &RunAnswer) -> Option<Result<(), String>> {
        let is = |state: ControlState| a.state == state.as_str();
        let met = match self {
            Self::Converged => a.at_goal == Some(true),
            Self::Holding => is(ControlState::Holding) || is(ControlState::Returning),
            Self::Fault => is(ControlState::Fault),
            Self::State(state) => is(state),
        };
        if met {
            return Some(Ok(()));
        }
        if is(ControlState::Fault) {
            return Some(Err(a.state_in_words()));
        }
        use ControlState::{Held, Idle, Stopped, Stopping};
        let stands = [Held, Idle, Stopped, Stopping].into_iter().any(is);
        let needs_motion = matches!(self, Self::Converged | Self::Holding);
        (needs_motion && stands).then(|| Err(format!("the run is {}: nothing moves it to the goal", a.state)))
    }
}

/// How a wait ended.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WaitEnd {
    /// Whether what was waited for is there.
    pub is_reached: bool,
    /// What is there instead, or how it stands.
    pub reason: String,
    /// The last answer; `None` where there was none.
    pub status: Option<RunAnswer>,
}

pub(super) fn wait(client: &Client, what: WaitFor, timeout_s: f64) -> Result<WaitEnd, ProcessError> {
    let until = now() + SpanNs::from_s(timeout_s);
    let mut last: Option<RunAnswer> = None;
    loop {
        let status = match client.status() {
            Ok(status) => status,
            // A run that was there has ended meanwhile.
            Err(ProcessError::NobodyThere(_)) if last.is_some() => {
                return Ok(WaitEnd { is_reached: false, reason: "the run has ended".into(), status: last });
            }
            Err(error) => return Err(error),
        };
        let ended = |is_reached, reason, status| Ok(WaitEnd { is_reached, reason, status: Some(status) });
        match what.verdict(&status) {
            Some(Ok(())) => return ended(true, status.state.to_owned(), status),
            Some(Err(why)) => return ended(false, why, status),
            None if now() > until => {
                let error = status.feature_error_px.map_or(String::new(), |px| format!(", feature error {px:.3} px"));
                let reason = format!("still {} after {timeout_s} s{error}", status.state);
                return ended(false, reason, status);
            }
            None => last = Some(status),
        }
        if client.interrupted.is_requested_within(LOOK_AGAIN) {
            return Err(ProcessError::Interrupted);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_of_waits_are_understood_and_others_are_told() {
        assert_eq!("converged".parse(), Ok(WaitFor::Converged));
        assert_eq!("state=held".parse(), Ok(WaitFor::State(ControlState::Held)));
        let told = "state=dancing".parse::<WaitFor>().unwrap_err();
        assert!(told.contains("servoing") && told.contains("dancing"), "{told}");
        assert!("done".parse::<WaitFor>().unwrap_err().contains("state=NAME"));
    }
}
