//! Where the arm is within its limits in space, at start and goal.

use crate::config::Config;
use crate::motion::{Clearance, Workspace};
use crate::robot::Robot;
use nalgebra::SVector;
use serde::Serialize;

/// What is nearest to a limit in space.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SpaceAhead {
    /// At the start.
    pub start: Clearance,
    /// In the posture at the goal, where one is known.
    pub goal: Option<Clearance>,
    /// Distance that the arm keeps, m.
    pub margin_m: f64,
    /// Whether the arm has other postures with the same view.
    #[serde(skip)]
    is_redundant: bool,
}

impl SpaceAhead {
    /// Of the arm of `config` that starts in `q_start` and has its goal in `q_goal`, rad or m; `None` where no place is limited.
    pub(super) fn of<const N: usize>(
        config: &Config,
        robot: &Robot<N>,
        q_start: &SVector<f64, N>,
        q_goal: Option<&SVector<f64, N>>,
    ) -> Option<Self> {
        let settings = config.workspace.clone()?;
        let margin_m = settings.margin_m;
        let space = Workspace::new(robot.clone(), settings);
        let goal = q_goal.and_then(|q| space.nearest(q));
        // Chosen by what a camera has: six motions.
        Some(Self { start: space.nearest(q_start)?, goal, margin_m, is_redundant: N > 6 })
    }

    /// What keeps the arm off its goal, and whether nothing can be done about it.
    pub(super) fn held_off(&self) -> Option<(String, bool)> {
        let goal = self.goal.as_ref().filter(|goal| goal.room_m < self.margin_m)?;
        let (what, margin_m) = (goal.describe(), self.margin_m);
        let message = if goal.room_m < 0.0 {
            format!("at the goal {what}: the arm is held off it")
        } else {
            format!(
                "at the goal {what}, and the arm keeps {margin_m} m from it (workspace.margin_m): it is held off its goal"
            )
        };
        Some((message, !self.is_redundant))
    }

    /// Both in words.
    pub(super) fn line(&self) -> String {
        let goal =
            self.goal.as_ref().map_or_else(String::new, |goal| format!("; at the goal {}", goal.describe()));
        format!("at the start {}{goal}", self.start.describe())
    }
}
