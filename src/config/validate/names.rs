//! Goals and postures of a run file that requests may name.

use super::Validation;
use crate::config::goal_file::word;
use crate::config::named_goal::ProgramGoal;
use crate::config::raw::RawConfig;

/// Goals that requests may name are of the run's target, postures of its arm with so many joints.
pub(super) fn named_goals(raw: &RawConfig, joints: Option<usize>, check: &mut Validation<'_>) {
    for (name, goal) in &raw.goals {
        let (key, kind) = (format!("goals.{name}"), word(raw.target.kind));
        if let Some(ProgramGoal::Taught(goal)) = goal.goal(&key, check)
            && goal.target != kind
        {
            check.wrong(
                &key,
                format!("is of a target of kind \"{}\", target.kind is \"{kind}\"", goal.target),
            );
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
