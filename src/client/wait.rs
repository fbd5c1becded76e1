//! Waiting for a state of a run, or for its goal. The run is asked again and again, and in between the place of the client is free.

use super::{Client, RunAnswer, WaitFor};
use crate::messages::ControlState;
use crate::process::ProcessError;
use crate::rt::now;
use crate::time::SpanNs;
use serde::Serialize;
use std::time::Duration;

/// Pause between two questions. Chosen by hand: a program notices nothing of it; joining and leaving ten times a second took 4 % of a core where it was measured.
pub(super) const LOOK_AGAIN: Duration = Duration::from_millis(100);

/// Whether the wait for `what` is over: that it is met, or that it cannot be any more without another request.
pub(super) fn verdict(what: WaitFor, a: &RunAnswer) -> Option<Result<(), String>> {
    let is = |state: ControlState| a.state == state.as_str();
    let met = match what {
        WaitFor::Converged => a.at_goal == Some(true),
        WaitFor::Holding => is(ControlState::Holding) || is(ControlState::Returning),
        WaitFor::Fault => is(ControlState::Fault),
        WaitFor::State(state) => is(state),
    };
    if met {
        return Some(Ok(()));
    }
    if is(ControlState::Fault) {
        // A reset that waits for the robot may still end it.
        return a.waits_for.is_none().then(|| Err(a.state_in_words()));
    }
    use ControlState::{Held, Idle, Stopped, Stopping};
    let stands = [Held, Idle, Stopped, Stopping].into_iter().any(is);
    let needs_motion = matches!(what, WaitFor::Converged | WaitFor::Holding);
    (needs_motion && stands).then(|| Err(format!("the run is {}: nothing moves it to the goal", a.state)))
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
    let (mut last, mut awaited): (Option<RunAnswer>, _) = (None, None);
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
        let awaited = *awaited.get_or_insert_with(|| client.own.awaited(what, &status));
        let verdict = verdict(what, &status);
        if !matches!(verdict, Some(Err(_)))
            && let Some(why) = awaited.overtaken(&status)
        {
            client.own.forget();
            return ended(false, why, status);
        }
        match verdict {
            Some(Ok(())) => return ended(true, status.state.to_owned(), status),
            Some(Err(why)) => return ended(false, why, status),
            None if now() > until => {
                let reason = format!("still {} after {timeout_s} s{}", status.state, status.view_in_words());
                return ended(false, reason, status);
            }
            None => last = Some(status),
        }
        if client.interrupted.is_requested_within(LOOK_AGAIN) {
            return Err(ProcessError::Interrupted);
        }
    }
}
