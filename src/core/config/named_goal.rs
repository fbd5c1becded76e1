//! Goals and postures with names, of run files and programs: `[goals.NAME]` and `[postures.NAME]`.

use super::check::{Validation, pose};
use super::raw::{RawNamedGoal, RawPosture};
use super::source::Document;
use super::{GoalFile, Problem, pose_forms};
use crate::geometry::Pose;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

/// Joint positions, rad or m, as in a run file. Chosen by hand, wider than any joint.
const POSITION: RangeInclusive<f64> = -100.0..=100.0;

/// A goal.
#[derive(Debug, Clone, PartialEq)]
pub enum ProgramGoal {
    /// That which the run has: `servo = "present"`.
    Present,
    /// A taught one.
    Taught(GoalFile),
    /// The pose of the target in the camera at the goal.
    Pose(Pose),
}

/// A goal with its target: that which the run file or the program names, or else that of which the file of the goal was taught.
#[derive(Debug, Clone, PartialEq)]
pub struct TargetGoal {
    /// The goal; [`ProgramGoal::Present`]: the last one of its target.
    pub goal: ProgramGoal,
    /// Name of the target; `None`: `[target]`, and of a goal that is present, that which the run has.
    pub target: Option<String>,
}

impl RawNamedGoal {
    /// Reads the file, whose path `locate` makes absolute, and puts what stands in it in its place; converts all ways to write a pose to roll, pitch, yaw.
    pub(super) fn resolve(
        &mut self,
        key: &str,
        document: &Document,
        locate: impl Fn(&Path) -> PathBuf,
        problems: &mut Vec<Problem>,
    ) {
        if self.file.is_some() && self.position_m.is_some() {
            let message = "has file and position_m: leave out one of them";
            problems.push(document.problem(key, message));
            *self = Self::default();
            return;
        }
        if let Some(file) = self.file.take() {
            match GoalFile::load(&locate(&file)) {
                Ok(goal) => {
                    self.target = self.target.take().or_else(|| goal.target_name.clone());
                    self.taught = Some(goal);
                }
                Err(why) => problems.push(document.problem(&format!("{key}.file"), why)),
            }
        } else if self.position_m.is_some() {
            pose_forms::resolve_one(key, self, document, problems);
        } else if self.taught.is_none() {
            let message = "needs file (of `vservo teach`), or position_m of the target in the camera";
            problems.push(document.problem(key, message));
        }
    }

    /// The goal, of a file that was checked; `None` where it is none.
    #[must_use]
    pub fn checked(self) -> Option<TargetGoal> {
        let rotation = self.rotation_rpy_rad.unwrap_or_default();
        let goal = match (self.taught, self.position_m) {
            (Some(goal), _) => ProgramGoal::Taught(goal),
            (None, Some(position_m)) => ProgramGoal::Pose(pose(position_m, rotation)),
            (None, None) => return None,
        };
        Some(TargetGoal { goal, target: self.target })
    }

    /// The goal; `None` where it is not there or wrong, which was told.
    pub(super) fn goal(&self, key: &str, check: &mut Validation<'_>) -> Option<TargetGoal> {
        let of = |goal| TargetGoal { goal, target: self.target.clone() };
        if let Some(goal) = &self.taught {
            return Some(of(ProgramGoal::Taught(goal.clone())));
        }
        let before = check.count_problems();
        let X_DO = check.pose(key, self.position_m?, self.rotation_rpy_rad.unwrap_or_default());
        (check.count_problems() == before).then(|| of(ProgramGoal::Pose(X_DO)))
    }
}

impl RawPosture {
    /// Reads the file, whose path `locate` makes absolute, and puts the posture in it in its place.
    pub(super) fn resolve(
        &mut self,
        key: &str,
        document: &Document,
        locate: impl Fn(&Path) -> PathBuf,
        problems: &mut Vec<Problem>,
    ) {
        let file = self.file.take();
        if file.is_some() != self.q_rad_or_m.is_empty() {
            let message = "needs either q_rad_or_m or file (of `vservo ctl teach --save`)";
            problems.push(document.problem(key, message));
            self.q_rad_or_m.clear();
            return;
        }
        let Some(file) = file else { return };
        let goal = GoalFile::load(&locate(&file)).and_then(|goal| {
            let missing = || "has no q_rad_or_m: `vservo ctl teach --save FILE` writes it".to_owned();
            if goal.q_rad_or_m.is_empty() { Err(missing()) } else { Ok(goal.q_rad_or_m) }
        });
        match goal {
            Ok(q) => self.q_rad_or_m = q,
            Err(why) => problems.push(document.problem(&format!("{key}.file"), why)),
        }
    }

    /// The posture; `None` where it is not there, which was told.
    pub(super) fn posture(&self, key: &str, check: &mut Validation<'_>) -> Option<Vec<f64>> {
        for (i, x) in self.q_rad_or_m.iter().enumerate() {
            check.range(&format!("{key}.q_rad_or_m[{i}]"), *x, POSITION);
        }
        (!self.q_rad_or_m.is_empty()).then(|| self.q_rad_or_m.clone())
    }
}

#[cfg(test)]
mod tests {
    use crate::config::Config;
    use std::path::Path;

    fn problems(set: &[&str]) -> String {
        let set: Vec<String> = set.iter().map(|set| (*set).to_owned()).collect();
        Config::load(Some(Path::new("ur5")), &set).map_or_else(|error| error.to_string(), |_| String::new())
    }

    #[test]
    fn names_of_a_run_file_are_checked_like_its_other_poses() {
        let good = [
            "goals.a={position_m=[0,0,0.5],rotation_rpy_deg=[0,0,90]}",
            "postures.p={q_rad_or_m=[0,0,0,0,0,0]}",
        ];
        assert_eq!(problems(&good), "");
        for (set, why) in [
            ("goals.a={position_m=[0,0,500]}", "goals.a.position_m[2]: 500 is out of range"),
            ("goals.a={}", "goals.a: needs file"),
            ("goals.a={file='absent.toml'}", "goals.a.file: "),
            ("goals.a={taught={target='tags',features=[]}}", "is of a target of kind \"tags\""),
            ("goals.a={position=[0,0,1]}", "goals.a.position: unknown field"),
            ("postures.p={q_rad_or_m=[0,0]}", "postures.p: has 2 joints, the arm 6"),
            ("postures.p={}", "postures.p: needs either"),
            ("postures.p={q_rad_or_m=[0,0,0,0,0,1e9]}", "postures.p.q_rad_or_m[5]: "),
        ] {
            let told = problems(&[set]);
            assert!(told.contains(why), "{set}: {told}");
        }
    }
}
