//! Waiting for a state of a run, or for its goal. The run is asked again and again, and in between the place of the client is free.

use super::own_requests::Awaited;
use super::{Client, RecordStream, RunAnswer, WaitFor};
use crate::messages::{ControlState, Status};
use crate::process::ProcessError;
use crate::rt::now;
use crate::time::SpanNs;
use serde::Serialize;
use std::time::Duration;

/// Pause between two questions. Chosen by hand: a program notices nothing of it; joining and leaving ten times a second took 4 % of a core where it was measured.
pub(super) const LOOK_AGAIN: Duration = Duration::from_millis(100);

/// Longest wait for what a run has told last, s. Chosen by hand: a stream notices the end of its run within a tenth of a second.
const LAST_WORDS_S: f64 = 0.5;

/// Whether the wait for `what` is over: that it is met, or that it cannot be any more without another request.
pub(super) fn verdict(what: WaitFor, a: &RunAnswer) -> Option<Result<(), String>> {
    let is = |state: ControlState| a.state == state.as_str();
    let met = match what {
        WaitFor::Converged => a.at_goal == Some(true) || is(ControlState::Converged),
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
    // A run that is not served stops to end, and says then whether it came to its goal.
    let ends = a.served == Some(false) && (is(Stopping) || is(Stopped));
    let needs_motion = matches!(what, WaitFor::Converged | WaitFor::Holding);
    (needs_motion && stands && !ends)
        .then(|| Err(format!("the run is {}: nothing moves it to the goal", a.state)))
}

/// How a wait ended.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WaitEnd {
    /// Whether what was waited for is there.
    pub is_reached: bool,
    /// Whether that is known: a run that ends by itself may have come to it since it was asked last.
    pub is_known: bool,
    /// What is there instead, or how it stands.
    pub reason: String,
    /// The last answer; `None` where there was none.
    pub status: Option<RunAnswer>,
}

impl WaitEnd {
    /// What is to be told of a wait for `what` that did not reach it.
    #[must_use]
    pub fn in_vain(&self, what: WaitFor) -> String {
        if self.is_known {
            format!("{what} was not reached: {}", self.reason)
        } else {
            format!("whether {what} was reached is not known: {}", self.reason)
        }
    }
}

pub(super) fn wait(client: &Client, what: WaitFor, timeout_s: f64) -> Result<WaitEnd, ProcessError> {
    let until = now() + SpanNs::from_s(timeout_s);
    let (mut last, mut awaited): (Option<RunAnswer>, _) = (None, None);
    // What a run that ends by itself tells last: no question comes in time for that.
    let mut statuses = None;
    loop {
        let status = match (client.status(), last) {
            (Ok(status), _) => status,
            // A run that was there has ended meanwhile.
            (Err(ProcessError::NobodyThere(_)), Some(last)) => {
                return Ok(after_the_run(what, awaited.unwrap_or_default(), last, statuses.as_ref()));
            }
            (Err(error), _) => return Err(error),
        };
        let ended = |is_reached, reason, status| {
            Ok(WaitEnd { is_reached, is_known: true, reason, status: Some(status) })
        };
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
            None => {}
        }
        if statuses.is_none() && status.served == Some(false) {
            // Without a place among those who read it the end stays unknown.
            statuses = client.statuses().ok();
        }
        last = Some(status);
        if client.interrupted.is_requested_within(LOOK_AGAIN) {
            return Err(ProcessError::Interrupted);
        }
    }
}

/// The end of a wait whose run has ended, by what that has told last.
fn after_the_run(
    what: WaitFor,
    awaited: Awaited,
    last: RunAnswer,
    statuses: Option<&RecordStream<Status>>,
) -> WaitEnd {
    let mut status = last;
    let until = now() + SpanNs::from_s(LAST_WORDS_S);
    let next = || statuses?.next((until - now()).as_s().max(0.0)).ok()?;
    let mut before = 0;
    // Ticks that begin anew are those of another run in the same place.
    while let Some(told) = next().filter(|told| now() < until && told.tick >= before) {
        before = told.tick;
        if Some(told.tick) >= status.tick {
            status = status.with(&told);
        }
    }
    use ControlState::{Converged, Fault, Stopped};
    let is_over = [Converged, Fault, Stopped].iter().any(|state| state.as_str() == status.state);
    let is_reached = verdict(what, &status) == Some(Ok(())) && awaited.overtaken(&status).is_none();
    // A run that is served stays at its goal.
    let is_known = is_reached || is_over || status.served == Some(true);
    let reason = match (is_reached, is_over) {
        (true, _) => status.state.to_owned(),
        (false, true) => format!("the run has ended in the state {}", status.state),
        (false, false) if is_known => "the run has ended".into(),
        (false, false) => "the run has ended before it could be asked again".into(),
    };
    WaitEnd { is_reached, is_known, reason, status: Some(status) }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::client::answer::tests::answer;
    use crate::client::fake_control::FakeControl;

    /// One that is not served stops before it ends; of one that is served a stop is the end of what moves it.
    #[test]
    fn a_run_that_stops_to_end_is_waited_for() {
        let of = |served| {
            let state = ControlState::Stopping.as_str();
            verdict(WaitFor::Converged, &RunAnswer { state, served: Some(served), ..answer() })
        };
        assert_eq!(of(false), None);
        assert!(of(true).unwrap().unwrap_err().contains("stopping"));
    }

    /// A run that is not served ends in the tick that converges.
    #[test]
    fn what_a_run_has_told_last_is_the_end_of_a_wait() {
        let ended = |state: Option<ControlState>| {
            let control = FakeControl::start("wait-end", 0);
            control.standing().state = ControlState::Servoing as u32;
            let client = control.client();
            let status = |state| Status { state: state as u32, ..Status::default() };
            let ends = control.end_with(state.map(status));
            let end = client.wait(WaitFor::Converged, 20.0).unwrap();
            ends.join().unwrap();
            (end.is_reached, end.in_vain(WaitFor::Converged))
        };
        assert!(ended(Some(ControlState::Converged)).0);
        let (is_reached, told) = ended(Some(ControlState::Stopped));
        assert!(!is_reached && told.starts_with("converged was not reached: the run has ended"), "{told}");
        let (is_reached, told) = ended(None);
        assert!(!is_reached && told.starts_with("whether converged was reached is not known"), "{told}");
    }
}
