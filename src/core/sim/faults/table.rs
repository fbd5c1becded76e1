//! The table of a campaign: what became of the runs of each case under each law.

use super::{FaultJob, FaultRun};
use crate::control::outcome::Outcome;
use serde::Serialize;
use std::collections::BTreeSet;
use std::fmt::Write;

/// Runs of one case under one law, over arms and seeds.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct FaultRow {
    case: &'static str,
    law: &'static str,
    runs: usize,
    converged: usize,
    held: usize,
    fault: usize,
    right: usize,
    speed_by_limit: f64,
    acceleration_by_limit: f64,
    jerk_by_limit: f64,
    at_rest: usize,
    reasons: BTreeSet<&'static str>,
}

/// A whole campaign.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FaultTable {
    /// Version of the program.
    pub program: &'static str,
    rows: Vec<FaultRow>,
    /// Each run.
    pub runs: Vec<FaultRun>,
    /// The commands of the runs whose end is not right.
    pub wrong: Vec<String>,
}

impl FaultTable {
    /// The table of `runs`, in the order of `jobs`.
    #[must_use]
    pub fn new(jobs: &[FaultJob], runs: Vec<FaultRun>) -> Self {
        let mut rows: Vec<FaultRow> = Vec::new();
        for run in &runs {
            match rows.iter_mut().find(|row| row.case == run.case && row.law == run.law) {
                Some(row) => row.add(run),
                None => {
                    let mut row = FaultRow::of(run);
                    row.add(run);
                    rows.push(row);
                }
            }
        }
        let wrong = jobs.iter().zip(&runs).filter(|(_, run)| !run.is_right);
        let wrong =
            wrong.map(|(job, run)| format!("{}: {} -- {}", run.case, run.told(), job.command())).collect();
        Self { program: concat!("vservo ", env!("CARGO_PKG_VERSION")), rows, runs, wrong }
    }

    /// In words.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut text = format!(
            "{}, {} runs; speed, acceleration and jerk of the true arm are the greatest of all runs, by the limits of joint and run file\n\n",
            self.program,
            self.runs.len()
        );
        let _ = writeln!(
            text,
            "{:<20} {:<7} {:>4} {:>9} {:>4} {:>5} {:>5} {:>5} {:>5} {:>6} {:>6}  reasons",
            "fault", "law", "runs", "converged", "held", "fault", "right", "rest", "speed", "accel", "jerk"
        );
        for r in &self.rows {
            let short = |reason: &&str| reason.split(':').next().unwrap_or_default().to_owned();
            let reasons: Vec<String> = r.reasons.iter().map(short).collect();
            let _ = writeln!(
                text,
                "{:<20} {:<7} {:>4} {:>9} {:>4} {:>5} {:>5} {:>5} {:>5.2} {:>6.2} {:>6.2}  {}",
                r.case,
                r.law,
                r.runs,
                r.converged,
                r.held,
                r.fault,
                r.right,
                r.at_rest,
                r.speed_by_limit,
                r.acceleration_by_limit,
                r.jerk_by_limit,
                reasons.join("; ")
            );
        }
        let right = self.runs.len() - self.wrong.len();
        let _ = writeln!(text, "\n{right} of {} runs end as they should", self.runs.len());
        self.wrong.iter().for_each(|line| text += &format!("  {line}\n"));
        text
    }

    /// All runs as CSV.
    #[must_use]
    pub fn to_csv(&self) -> String {
        let mut text = String::from(
            "case,law,arm,seed,outcome,right,time_s,held_s,speed_by_limit,acceleration_by_limit,jerk_by_limit,torque_by_limit,beyond_range,commanded_by_limit,finite,\
             last_speed,final_error_px,state_hash,reason\n",
        );
        for r in &self.runs {
            let error = r.final_error_px.map_or(String::new(), |px| format!("{px:.4}"));
            let _ = writeln!(
                text,
                "{},{},{},{},{},{},{:.3},{:.3},{:.4},{:.4},{:.4},{:.4},{:.6},{:.4},{},{:.5},{error},{},\"{}\"",
                r.case,
                r.law,
                r.arm,
                r.seed,
                r.outcome.as_str(),
                r.is_right,
                r.time_s,
                r.held_s,
                r.speed_by_limit,
                r.acceleration_by_limit,
                r.jerk_by_limit,
                r.torque_by_limit,
                r.beyond_range,
                r.commanded_by_limit,
                r.is_finite,
                r.last_speed,
                r.state_hash,
                r.reason.replace('"', "'")
            );
        }
        text
    }
}

impl FaultRun {
    /// How it ended, in short.
    fn told(&self) -> String {
        let error = self.final_error_px.map_or(String::new(), |px| format!(", {px:.2} px from the goal"));
        let rest = if self.is_at_rest { "" } else { ", not at rest" };
        format!("{} ({}){error}{rest}", self.outcome.as_str(), self.reason)
    }
}

impl FaultRow {
    fn of(run: &FaultRun) -> Self {
        Self {
            case: run.case,
            law: run.law,
            runs: 0,
            converged: 0,
            held: 0,
            fault: 0,
            right: 0,
            speed_by_limit: 0.0,
            acceleration_by_limit: 0.0,
            jerk_by_limit: 0.0,
            at_rest: 0,
            reasons: BTreeSet::new(),
        }
    }

    fn add(&mut self, run: &FaultRun) {
        self.runs += 1;
        self.converged += usize::from(run.outcome == Outcome::Converged);
        self.held += usize::from(run.outcome == Outcome::NotConverged);
        self.fault += usize::from(run.outcome == Outcome::Fault);
        self.right += usize::from(run.is_right);
        self.at_rest += usize::from(run.is_at_rest);
        self.speed_by_limit = self.speed_by_limit.max(run.speed_by_limit);
        self.acceleration_by_limit = self.acceleration_by_limit.max(run.acceleration_by_limit);
        self.jerk_by_limit = self.jerk_by_limit.max(run.jerk_by_limit);
        if run.outcome == Outcome::Fault {
            self.reasons.insert(run.reason);
        }
    }
}
