//! A finished run in words: what happened when, what limited its speed, what made it fail, and which key to change, each with its evidence.
//!
//! ```text
//! summary, run file, trace.csv, measurements.csv ─► view    what became of the target in the image, and of the frames
//!                                                  ├► intake  were the measurements used?
//!                                                  ├► cell    does the target rest where lens, mount, stamps and sizes say?
//!                                                  ├► joints  do the joints do what they are told?
//!                                                  ├► dynamics  does the arm answer its torques as its model says?
//!                                                  └► pace    how the error fell, and what held the arm back
//!                                                       └► [`RunFinding`]s, the gravest first ─► [`Explanation`]
//! ```
//! A run's own reason comes first, and what contradicts it is not named. Nothing here knows the truth of a simulated cell: a finding rests on what the run measured.

mod cell;
mod dynamics;
mod intake;
mod joints;
mod pace;
mod view;

use crate::config::Config;
use crate::control::outcome::Outcome;
use crate::report::csv_table::CsvTable;
use crate::report::run_page::run_verdict;
use crate::report::summary::Summary;
use serde::Serialize;
use std::fmt::Write as _;

/// Causes of trouble, the gravest of a kind first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// Ticks of control were not served in time.
    Deadlines,
    /// The drive obeys late.
    DriveDelay,
    /// The encoders are coarser than the run file says.
    CoarseEncoders,
    /// The base of the arm shakes.
    ShakingBase,
    /// The motors' rotors have inertia that the robot file does not tell.
    UntoldRotors,
    /// The joints yield.
    ElasticJoints,
    /// A joint was stopped from one tick to the next, and stands.
    Jammed,
    /// The reading of a joint that had moved stays the same to the last digit: a frozen encoder, or a joint that is held.
    StuckReading,
    /// A joint does not follow from its start: friction, a brake, a drive that is off.
    Friction,
    /// Something touched the arm.
    Contact,
    /// Another fault: the summary has it.
    OtherFault,
    /// A limit in space held the arm back.
    HeldBySpace,
    /// A joint is at the end of its range, or the arm is stretched out.
    AtItsEnd,
    /// The goal's tolerance is below what the measurements scatter by.
    FineTolerance,
    /// The lens is not as described.
    WrongLens,
    /// The depth that the law takes is not that of the target.
    WrongDepth,
    /// The exposure stamps are wrong.
    WrongStamps,
    /// The camera does not sit where the run file says.
    WrongMount,
    /// The target has another size, or the lens another focal length.
    WrongScale,
    /// The object moves by itself.
    ObjectMoves,
    /// Images or measurements came again, in place of new ones.
    RepeatedViews,
    /// Frames came no more.
    FramesStopped,
    /// Frames were lost.
    FramesLost,
    /// The target went out of the image.
    LeftTheImage,
    /// Something hides the target.
    Hidden,
    /// The target was never found.
    NeverSeen,
    /// The loop swings.
    GainTooHigh,
    /// The limits of motion are low.
    Limits,
    /// The error was still falling slowly by the law.
    GainTooLow,
    /// The arm carries what nobody told.
    Load,
    /// A fault stopped the arm, and the run went on.
    EarlierFault,
}

/// Something that was found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RunFinding {
    /// What it is.
    pub cause: Cause,
    /// What happened, in a sentence.
    pub what: String,
    /// What it is concluded from, with figures.
    pub evidence: String,
    /// Which key to change, or what to see to.
    pub change: String,
}

/// What a run left.
#[derive(Debug, Clone)]
pub struct RunEvidence {
    /// How it went.
    pub summary: Summary,
    /// What was believed of the cell.
    pub config: Config,
    /// `trace.csv` of a report: a row a tick.
    pub trace: CsvTable,
    /// `measurements.csv` of a report: a row a measurement.
    pub measurements: CsvTable,
}

impl RunEvidence {
    /// Whether the run came to another end than it was to.
    fn has_failed(&self) -> bool {
        matches!(self.summary.outcome, Outcome::Fault | Outcome::NotConverged)
    }
}

/// A run in words.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Explanation {
    /// How it ended.
    pub verdict: String,
    /// Whether it failed: the first finding then is what made it fail.
    pub has_failed: bool,
    /// What was found, the likeliest cause first.
    pub findings: Vec<RunFinding>,
    /// What limited its speed.
    pub speed: String,
    /// What happened when: s since the first tick.
    pub events: Vec<(f64, String)>,
}

/// Explains a run.
#[must_use]
pub fn explain(evidence: &RunEvidence) -> Explanation {
    let mut findings = joints::findings(evidence);
    findings.extend(dynamics::findings(evidence));
    findings.extend(view::findings(evidence));
    // Where things were seen, and how far away, is compared with the description of one target.
    let of_first = (!evidence.config.further_targets.is_empty()).then(|| RunEvidence {
        measurements: evidence.measurements.rows_of("target_number", 0.0),
        ..evidence.clone()
    });
    findings.extend(cell::findings(of_first.as_ref().unwrap_or(evidence)));
    // Where nothing that came was used the pace of the error is no matter.
    let refused = intake::finding(evidence);
    if refused.is_none() {
        findings.extend(pace::findings(evidence, !findings.is_empty()));
    }
    findings.sort_by_key(|finding| finding.cause as u8);
    findings.splice(0..0, refused);
    let events = evidence.summary.safety.events.iter().map(|e| (e.time_s, e.event.clone()));
    Explanation {
        verdict: run_verdict(&evidence.summary),
        has_failed: evidence.has_failed(),
        findings,
        speed: pace::speed(evidence),
        events: events.collect(),
    }
}

impl Explanation {
    /// For people.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text = format!("{}\n", self.verdict);
        let heads = match (self.has_failed, self.findings.len()) {
            (true, 0) => "nothing in the run tells why",
            (true, _) => "most likely because:",
            (false, 0) => "nothing out of the ordinary was found",
            (false, _) => "worth knowing:",
        };
        // a String takes everything
        let _ = writeln!(text, "\n{heads}");
        for (i, RunFinding { what, evidence, change, .. }) in self.findings.iter().enumerate() {
            let _ = writeln!(text, "{}. {what}\n   evidence: {evidence}\n   change:   {change}", i + 1);
        }
        let _ = writeln!(text, "\nspeed: {}", self.speed);
        if !self.events.is_empty() {
            let _ = writeln!(text, "\nwhat happened:");
        }
        for (time_s, event) in &self.events {
            let _ = writeln!(text, "  {time_s:8.3} s  {event}");
        }
        text
    }
}

/// The middle one of some numbers; NaN of none. Those that are none do not count.
fn median(numbers: impl IntoIterator<Item = f64>) -> f64 {
    let mut numbers: Vec<f64> = numbers.into_iter().filter(|x| x.is_finite()).collect();
    numbers.sort_by(f64::total_cmp);
    numbers.get(numbers.len() / 2).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::summary::SafetyEvent;

    /// What a run of a cell left that converged, with these tables.
    pub(super) fn evidence(cell: &str, trace: &str, measurements: &str) -> RunEvidence {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../config/{cell}.toml"));
        let config = Config::load(Some(&path), &[]).unwrap();
        let summary = Summary {
            outcome: Outcome::Converged,
            duration_s: 8.0,
            ..Summary::without_control(&config, crate::time::SpanNs(0))
        };
        let [trace, measurements] = [trace, measurements].map(CsvTable::parse);
        RunEvidence { summary, config, trace, measurements }
    }

    /// The same of a run that did not converge, for a reason.
    pub(super) fn failed(mut evidence: RunEvidence, reason: &str) -> RunEvidence {
        (evidence.summary.outcome, evidence.summary.reason) = (Outcome::NotConverged, reason.into());
        evidence
    }

    #[test]
    fn a_head_ends_with_a_colon_where_something_follows() {
        let fine = explain(&evidence("default", "", ""));
        assert!(fine.to_text().contains("\nnothing out of the ordinary was found\n"), "{}", fine.to_text());
    }

    #[test]
    fn a_fault_that_was_reset_is_worth_knowing() {
        let mut evidence = evidence("default", "", "");
        evidence.summary.outcome = Outcome::Stopped;
        let fault = crate::control::safety::Fault::TrackingError.describe();
        let events = [(1.5, "start on request"), (3.0, fault), (5.0, "reset on request")];
        evidence.summary.safety.events =
            events.map(|(time_s, event)| SafetyEvent { time_s, event: event.into() }).into();
        let told = explain(&evidence);
        assert_eq!(told.findings.iter().map(|f| f.cause).collect::<Vec<_>>(), [Cause::EarlierFault]);
        assert!(told.findings[0].evidence.contains("3.000 s") && told.to_text().contains("worth knowing:"));
        // A run that ended by it tells it once.
        (evidence.summary.outcome, evidence.summary.reason) = (Outcome::Fault, fault.into());
        assert!(explain(&evidence).findings.iter().all(|f| f.cause != Cause::EarlierFault));
    }
}
