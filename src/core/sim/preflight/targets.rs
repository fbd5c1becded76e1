//! What a run has before it of its further targets.

use super::{Preflight, Reach, Viewpoint, words};
use crate::config::{Config, ProgramGoal, TargetGoal};
use crate::robot::{Robot, RobotError};
use serde::Serialize;

/// A target of `[targets]`, from the start of the run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FurtherTargetAhead {
    /// Its name.
    pub name: String,
    /// What the camera sees of it at the start; `None` where no scene says where it is.
    pub start: Option<Viewpoint>,
    /// What it sees at the goal that the target has until it is given another.
    pub goal: Option<Viewpoint>,
    /// Whether the arm gets there.
    pub reach: Reach,
}

impl FurtherTargetAhead {
    /// All of them, by their numbers.
    pub(super) fn all<const N: usize>(config: &Config, robot: &Robot<N>) -> Result<Vec<Self>, RobotError> {
        let mut all = Vec::new();
        for further in &config.further_targets {
            let name = further.name.clone();
            let Some(led) =
                config.with_goal(&TargetGoal { goal: ProgramGoal::Present, target: Some(name.clone()) })
            else {
                continue;
            };
            let Preflight { start, goal, reach, .. } = Preflight::of_goal(&led, robot)?;
            all.push(Self { name, start, goal, reach });
        }
        Ok(all)
    }

    /// It in words. A target that is not seen at the start is no fault: the arm may have been sent to it by then.
    pub(super) fn lines(&self) -> Vec<String> {
        let seen = |view: &Option<Viewpoint>| {
            view.as_ref().map_or_else(
                || "not known".to_owned(),
                |view| {
                    format!("{}; {}", words::points(&view.visibility), words::visibility(&view.visibility))
                },
            )
        };
        let name = &self.name;
        vec![
            format!("  target `{name}`: at the start: {}", seen(&self.start)),
            format!("         at its goal: {}", seen(&self.goal)),
            format!("         {}", words::reach(&self.reach)),
        ]
    }
}
