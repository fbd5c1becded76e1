//! Goals and postures of a run file that requests may name.

use super::Validation;
use crate::config::goal_file::word;
use crate::config::named_goal::{ProgramGoal, TargetGoal};
use crate::config::raw::RawConfig;
use crate::config::targets::{FIRST_TARGET, unknown};

/// Goals that requests may name are of the run's target, postures of its arm with so many joints.
pub(super) fn named_goals(raw: &RawConfig, joints: Option<usize>, check: &mut Validation<'_>) {
    for (name, goal) in &raw.goals {
        let key = format!("goals.{name}");
        let of = goal.target.as_deref().unwrap_or(FIRST_TARGET);
        if let Some(why) = unknown(of, raw.targets.keys().map(String::as_str)) {
            check.wrong(&format!("{key}.target"), why);
            continue;
        }
        let (table, kind) = match raw.targets.get(of) {
            Some(further) => (format!("targets.{of}"), further.kind),
            None => (FIRST_TARGET.to_owned(), raw.target.kind),
        };
        let kind = word(kind);
        if let Some(TargetGoal { goal: ProgramGoal::Taught(goal), .. }) = goal.goal(&key, check)
            && goal.target != kind
        {
            let message = format!("is of a target of kind \"{}\", {table}.kind is \"{kind}\"", goal.target);
            check.wrong(&key, message);
        }
    }
    for (name, posture) in &raw.postures {
        let key = format!("postures.{name}");
        if let (Some(q), Some(joints)) = (posture.posture(&key, check), joints)
            && q.len() != joints
        {
            check.wrong(&key, format!("has {} joints, the arm {joints}", q.len()));
        }
    }
}
