//! What the goals and postures that a run file has names for have before them.

use super::{Preflight, Reach, SpaceAhead, words};
use crate::config::{Config, FIRST_TARGET};
use crate::robot::{Robot, RobotError};
use nalgebra::SVector;
use serde::Serialize;

/// A goal of `[goals]`, of whichever target, from the start of the run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NamedGoalAhead {
    /// Its name.
    pub name: String,
    /// The name of its target.
    pub target: String,
    /// Whether the arm gets there.
    pub reach: Reach,
    /// What speaks against it.
    pub doubts: Vec<String>,
}

impl NamedGoalAhead {
    /// All of them.
    pub(super) fn all<const N: usize>(config: &Config, robot: &Robot<N>) -> Result<Vec<Self>, RobotError> {
        let mut all = Vec::new();
        for (name, goal) in config.named_goals() {
            let target = goal.target.clone().unwrap_or_else(|| FIRST_TARGET.to_owned());
            let Some(of_goal) = config.with_goal(&goal) else {
                let doubts = vec!["the target would lie behind the camera there".to_owned()];
                let reach = Reach::Unasked { why: "the goal is no view of its target" };
                all.push(Self { name: name.to_owned(), target, reach, doubts });
                continue;
            };
            let ahead = Preflight::of_goal(&of_goal, robot)?;
            let cut = ahead.cut_at_the_goal().map(|(message, _)| message);
            let beyond = matches!(ahead.reach, Reach::Beyond { .. });
            let beyond = beyond
                .then(|| format!("the arm cannot bring the camera there: {}", words::nearest(&ahead.reach)));
            let held_off = ahead.space.iter().filter_map(SpaceAhead::held_off).map(|(message, _)| message);
            let doubts = cut.into_iter().chain(beyond).chain(held_off).collect();
            all.push(Self { name: name.to_owned(), target, reach: ahead.reach, doubts });
        }
        Ok(all)
    }

    /// It in words.
    pub(super) fn line(&self) -> String {
        let of = if self.target == FIRST_TARGET { String::new() } else { format!(" of `{}`", self.target) };
        format!("`{}`{of}: {}", self.name, words::reach(&self.reach))
    }
}

/// The postures of `[postures]` at which a joint would be outside its range: name, and which joint.
pub(super) fn postures_outside<const N: usize>(config: &Config, robot: &Robot<N>) -> Vec<(String, String)> {
    let outside = |(name, posture): (&String, &crate::config::RawPosture)| {
        let q = SVector::<f64, N>::from_fn(|i, _| posture.q_rad_or_m.get(i).copied().unwrap_or_default());
        let joint = robot.joint_names().get(robot.outside_limits(&q)?)?;
        Some((
            name.clone(),
            format!("the joint `{joint}` would be outside its range there, and `goto` is refused"),
        ))
    };
    config.effective.postures.iter().filter_map(outside).collect()
}
