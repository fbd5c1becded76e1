//! What a client has asked for last, so that it does not take another client's goal or motion for its own.

use super::{RunAnswer, WaitFor};
use crate::control::lifecycle::Request;
use crate::messages::ControlState;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// What a client has asked for last; its clones share it.
#[derive(Debug, Clone, Default)]
pub(super) struct OwnRequests(Arc<Mutex<LastAsked>>);

#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
struct LastAsked {
    /// Number of the goal that it has set, unless it has taught one since.
    goal: Option<u32>,
    /// Number of its last request, where that leads to a posture at which the arm holds by itself.
    posture: Option<u64>,
}

impl OwnRequests {
    fn last(&self) -> MutexGuard<'_, LastAsked> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes in the answer to a request of this client.
    pub(super) fn note(&self, request: Request, answer: &RunAnswer) {
        if !answer.accepted {
            return;
        }
        let mut last = self.last();
        match request {
            Request::Goal => last.goal = answer.goal,
            Request::Set => {}
            Request::Goto | Request::Jog => last.posture = answer.motion_request,
            // Its goal has a number when it is taught.
            Request::Teach => *last = LastAsked::default(),
            _ => last.posture = None,
        }
    }

    /// What a wait goes by that begins with the answer `first`. Of a client that has set no goal it is the present one.
    pub(super) fn awaited(&self, what: WaitFor, first: &RunAnswer) -> Awaited {
        let last = *self.last();
        match what {
            WaitFor::Converged => Awaited { goal: last.goal.or(first.goal), posture: None },
            WaitFor::State(ControlState::Held) => Awaited { goal: None, posture: last.posture },
            _ => Awaited::default(),
        }
    }

    /// Another client came in between, which is told once: the next wait goes by what there is then.
    pub(super) fn forget(&self) {
        *self.last() = LastAsked::default();
    }
}

/// What is to stay the same while something is waited for.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Awaited {
    goal: Option<u32>,
    posture: Option<u64>,
}

impl Awaited {
    /// Why what was waited for does not come any more, whatever the run comes to.
    pub(super) fn overtaken(self, status: &RunAnswer) -> Option<String> {
        if let Some((own, present)) = self.goal.zip(status.goal).filter(|(own, present)| own != present) {
            return Some(format!(
                "another goal was set meanwhile: number {present}, number {own} was waited for"
            ));
        }
        let is_other = self.posture.is_some() && self.posture != status.motion_request;
        is_other.then(|| {
            format!(
                "somebody else has moved or held the arm since this client sent it to a posture: it is {}",
                status.state
            )
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::client::answer::tests::answer;

    #[test]
    fn a_goal_of_another_client_is_not_waited_for() {
        let own = OwnRequests::default();
        let (own_goal, other_goal) =
            (RunAnswer { goal: Some(3), ..answer() }, RunAnswer { goal: Some(4), ..answer() });
        // Who has set none waits for the present one.
        let awaited = own.awaited(WaitFor::Converged, &own_goal);
        assert_eq!(awaited.overtaken(&own_goal), None);
        assert!(awaited.overtaken(&other_goal).unwrap().contains("another goal was set"));
        // The own one, also where another one came before the wait began.
        own.note(Request::Goal, &own_goal);
        assert!(own.awaited(WaitFor::Converged, &other_goal).overtaken(&other_goal).is_some());
        own.note(Request::Goal, &RunAnswer { accepted: false, ..other_goal.clone() });
        assert_eq!(
            own.awaited(WaitFor::Converged, &other_goal).goal,
            Some(3),
            "a refused one changes nothing"
        );
        own.forget();
        assert_eq!(own.awaited(WaitFor::Converged, &other_goal).overtaken(&other_goal), None);
        own.note(Request::Goal, &own_goal);
        own.note(Request::Teach, &own_goal);
        assert_eq!(own.awaited(WaitFor::Converged, &other_goal).goal, Some(4), "the one that was taught");
    }

    #[test]
    fn a_posture_that_somebody_else_ends_is_not_reached() {
        let own = OwnRequests::default();
        let at = |number| RunAnswer { motion_request: Some(number), ..answer() };
        let held = WaitFor::State(ControlState::Held);
        for request in [Request::Goto, Request::Jog] {
            own.note(request, &at(7));
            own.note(Request::Set, &at(7));
            assert_eq!(own.awaited(held, &at(7)).overtaken(&at(7)), None);
            assert!(own.awaited(held, &at(8)).overtaken(&at(8)).is_some());
            assert_eq!(own.awaited(WaitFor::Fault, &at(8)).overtaken(&at(8)), None);
        }
        // Whoever starts the arm may wait until somebody holds it.
        own.note(Request::Start, &at(9));
        assert_eq!(own.awaited(held, &at(9)).overtaken(&at(10)), None);
    }
}
