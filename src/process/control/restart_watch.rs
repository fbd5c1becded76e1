//! What control knows of the processes that see for it: the supervisor says when it lost one and started it anew. The arm holds by itself, because measurements grow
//! old; with `safety.resume = "manual"` it is held until somebody asks for `start`.

use super::stops::Stops;
use crate::config::{Config, ResumePolicy};
use crate::ipc::RestartCounts;
use crate::messages::Status;

/// What has changed since the last look.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(super) struct RestartNews {
    /// Whether the arm is to be held until somebody asks for `start`.
    pub(super) holds: bool,
    /// What is to be told among the events of the run.
    pub(super) event: Option<String>,
}

/// The look-out.
pub(super) struct RestartWatch {
    stops: Stops,
    is_manual: bool,
    seen: RestartCounts,
}

impl RestartWatch {
    /// On the page of `stops`, with the reaction of `config`.
    pub(super) fn new(stops: Stops, config: &Config) -> Self {
        let is_manual = config.safety.resume == ResumePolicy::Manual;
        Self { seen: stops.restarts(), stops, is_manual }
    }

    /// What the supervisor has said since the last look. Three loads, where it is nothing.
    pub(super) fn look(&mut self) -> RestartNews {
        let counts = self.stops.restarts();
        let before = std::mem::replace(&mut self.seen, counts);
        news(before, counts, self.is_manual)
    }

    /// A status with the counts.
    pub(super) fn added_to(&self, status: &Status) -> Status {
        let RestartCounts { camera, vision, .. } = self.seen;
        Status { camera_restarts: camera, vision_restarts: vision, ..*status }
    }
}

fn news(before: RestartCounts, counts: RestartCounts, is_manual: bool) -> RestartNews {
    let mut events = Vec::new();
    for (name, old, new) in
        [("camera", before.camera, counts.camera), ("vision", before.vision, counts.vision)]
    {
        if new != old {
            events.push(format!("{name} process started anew, restart {new}"));
        }
    }
    RestartNews {
        holds: is_manual && counts.losses != before.losses,
        event: (!events.is_empty()).then(|| events.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_loss_holds_only_where_the_start_is_manual() {
        let before = RestartCounts { losses: 1, camera: 1, vision: 0 };
        let lost = RestartCounts { losses: 2, ..before };
        for is_manual in [false, true] {
            assert_eq!(news(before, before, is_manual), RestartNews::default());
            assert_eq!(news(before, lost, is_manual), RestartNews { holds: is_manual, event: None });
        }
    }

    #[test]
    fn restarts_are_events_with_their_number() {
        let counts = |camera, vision| RestartCounts { losses: 1, camera, vision };
        let told = |before, after| news(before, after, true).event;
        assert_eq!(told(counts(1, 0), counts(1, 1)).unwrap(), "vision process started anew, restart 1");
        assert_eq!(
            told(counts(1, 1), counts(2, 2)).unwrap(),
            "camera process started anew, restart 2, vision process started anew, restart 2"
        );
    }
}
