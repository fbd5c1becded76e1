//! The log of a running control process: a line for each event of a tick, with its facts as fields, so that programs need not read words.

use crate::control::trace::{Event, Trace};
use crate::mission::Mission;
use crate::report::statistics::describe;
use tracing::{error, info, warn};

/// Logs the events of a tick that the mission has seen.
pub(super) fn log<const N: usize>(trace: &Trace, mission: &Mission<N>) {
    for event in trace.events.iter() {
        let (word, time_s, tick) = (event.as_str(), mission.duration_s(), trace.joint_state.tick);
        let (state, goal, error_px) = (trace.state.as_str(), mission.goal().id, mission.feature_error_px());
        let what = describe(event);
        match event {
            Event::Fault(fault) => {
                error!(event = word, fault = fault.code(), state, time_s, tick, "{what}");
            }
            Event::StillMoves => error!(event = word, state, time_s, tick, "{what}"),
            Event::Holding
            | Event::Returning
            | Event::Searching
            | Event::LostAgain
            | Event::AnotherWay
            | Event::GoalLeft
            | Event::FirstViewMissing
            | Event::SecondViewMissing
            | Event::StartsElsewhere => {
                warn!(event = word, state, goal, feature_error_px = error_px, time_s, tick, "{what}");
            }
            Event::Requested(request) => {
                info!(event = word, request = request.as_str(), state, goal, time_s, tick, "{what}");
            }
            _ => info!(event = word, state, goal, feature_error_px = error_px, time_s, tick, "{what}"),
        }
    }
}
