//! Whether an external drive keeps to its contract (`drive/command`, `drive/state`), judged from a log of what was sent to it and what came back.
//!
//! ```text
//! DriveTrial ─► TrialPlan (phases, references) ─► who sends and receives ─► DriveLog ─► judge ─► a RuleFinding for each DriveRule
//! ```
//! A trial is one life of the drive's program: START, something gentle, LAST. Every rule is a function of one log, so that each can be broken in a
//! test. Lengths and speeds scale with a joint's *stroke*, the distance that a gentle motion takes it: hundredths of a radian, or millimetres.

mod arm;
mod ends;
mod log;
mod motion;
mod plan;
mod rule;
mod stream;

pub use arm::{ArmFacts, JointFacts};
pub use ends::ENDS_WITHIN;
pub use log::{DriveLog, LoggedPhase, ProgramExit, ReceivedState, ReceivedText, SentCommand};
pub use plan::{DriveTrial, PhaseKind, TrialPhase, TrialPlan, departs};
pub use rule::{DriveRule, RuleFinding, RuleVerdict};

use rule::TrialFindings;

/// Judges one trial by every rule that it can tell something about.
#[must_use]
pub fn judge(log: &DriveLog) -> Vec<RuleFinding> {
    let mut findings = TrialFindings::new(log.mode);
    stream::start(log, &mut findings);
    stream::joint_names(log, &mut findings);
    stream::properties(log, &mut findings);
    stream::contents(log, &mut findings);
    stream::counts(log, &mut findings);
    stream::stamps(log, &mut findings);
    motion::standing(log, &mut findings);
    motion::following(log, &mut findings);
    ends::course(log, &mut findings);
    ends::end(log, &mut findings);
    ends::silence(log, &mut findings);
    ends::refusal(log, &mut findings);
    findings.all
}

/// One finding for each rule and, where a rule is about motion, for each mode: the worst of all trials, in the order of the rules.
/// Rules that no trial told anything about are not tested, without a reason.
#[must_use]
pub fn merged(all: impl IntoIterator<Item = RuleFinding>) -> Vec<RuleFinding> {
    let mut merged: Vec<RuleFinding> = Vec::new();
    for finding in all {
        let same = |f: &&mut RuleFinding| f.rule == finding.rule && f.mode == finding.mode;
        match merged.iter_mut().find(same) {
            Some(known) if finding.verdict > known.verdict => *known = finding,
            Some(_) => {}
            None => merged.push(finding),
        }
    }
    for rule in DriveRule::ALL.iter().copied() {
        if !merged.iter().any(|f| f.rule == rule) {
            merged.push(RuleFinding::untested(rule, ""));
        }
    }
    merged.sort_by_key(|f| (f.rule, f.mode.map(|mode| mode as u32)));
    merged
}

#[cfg(test)]
mod tests;
