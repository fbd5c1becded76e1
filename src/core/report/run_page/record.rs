//! What the page of a run is made of: plain data, as it stands in the files beside the page.

use crate::config::FIRST_TARGET;
use crate::report::csv_table::CsvTable;
use crate::robot::{JointDescription, JointKind};
use std::collections::BTreeSet;

/// A run.
#[derive(Debug, Clone, Default)]
pub struct RunRecord {
    /// What was run, in a few words.
    pub title: String,
    /// How it ended, in a sentence.
    pub verdict: String,
    /// Whether it ended as it should.
    pub is_good: bool,
    /// What was found out about it: what happened, from what that is concluded, what to change.
    pub findings: Vec<[String; 3]>,
    /// What limited its speed.
    pub speed: String,
    /// What there is to tell beside the figures: names and values.
    pub facts: Vec<(String, String)>,
    /// The run file with all its values.
    pub config: String,
    /// The version of the program.
    pub version: String,
    /// Seed of every random number.
    pub seed: u64,
    /// What repeats the run, line by line.
    pub commands: Vec<String>,
    /// Whether time was simulated: ticks then have no deadline.
    pub simulated_time: bool,
    /// Whether an arm moved the camera or the target.
    pub has_arm: bool,
    /// Whether the camera is on the arm.
    pub eye_in_hand: bool,
    /// Gravity in B, m/s^2: what is drawn as down.
    pub gravity_B: [f64; 3],
    /// The axes of the arm, from the base.
    pub joints: Vec<JointSummary>,
    /// Columns and rows of the image.
    pub image_px: [f64; 2],
    /// The feature error below which the goal is reached, px.
    pub goal_error_px: f64,
    /// Corners of the target's plate in its own plane, least and greatest x and y, m.
    pub plate_m: [[f64; 2]; 2],
    /// The further targets, by their numbers: their names, and the corners of their plates as [`Self::plate_m`].
    pub further_targets: Vec<(String, [[f64; 2]; 2])>,
    /// A row a tick.
    pub trace: CsvTable,
    /// A row a measurement.
    pub measurements: CsvTable,
    /// Where the points are to be.
    pub goal: CsvTable,
    /// Frames of the cell.
    pub poses: CsvTable,
    /// What is in the kept images.
    pub frames: CsvTable,
    /// When something happened, s, and what.
    pub events: Vec<(f64, String)>,
    /// How many more events happened between them.
    pub events_left_out: u64,
    /// Deadline to command: upper edges of buckets, us, and counts.
    pub tick_times: Vec<(f64, u64)>,
    /// Ticks that missed their deadline.
    pub missed_deadlines: u64,
    /// Kept images by the name of their file, as `data:` addresses.
    pub images: Vec<ImageData>,
    /// Files beside the page, and what is in them.
    pub files: Vec<(String, String)>,
}

/// A joint, and its limits: rad, rad/s, N m for a turning one; m, m/s, N for a sliding one.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct JointSummary {
    /// Its name.
    pub name: String,
    /// Whether it slides.
    pub slides: bool,
    /// Least position; minus infinity where there is none.
    pub lower: f64,
    /// Greatest position; infinity where there is none.
    pub upper: f64,
    /// Greatest speed.
    pub velocity: f64,
    /// Greatest torque or force.
    pub effort: f64,
}

/// A time in which one target was looked for: its number, from when to when, s, and the first row of the measurements and that after the last.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct TargetSpell {
    pub(super) target: usize,
    pub(super) from_s: f64,
    pub(super) to_s: f64,
    pub(super) rows: (usize, usize),
}

impl RunRecord {
    /// Number of the target that a row of the measurements is of.
    pub(super) fn target_at(&self, row: usize) -> usize {
        // A page of a file without the column is of the first target; numbers are small and whole.
        self.measurements.number("target_number", row).max(0.0) as usize
    }

    /// The same of a row of the goals.
    pub(super) fn goal_target_at(&self, row: usize) -> usize {
        self.goal.number("target_number", row).max(0.0) as usize
    }

    /// Name of a target.
    pub(super) fn target_name(&self, number: usize) -> &str {
        let further = number.checked_sub(1).and_then(|i| self.further_targets.get(i));
        further.map_or(FIRST_TARGET, |(name, _)| name.as_str())
    }

    /// When which target was looked for, in the order of time.
    pub(super) fn spells(&self) -> Vec<TargetSpell> {
        let mut spells: Vec<TargetSpell> = Vec::new();
        for row in 0..self.measurements.rows() {
            let (target, time_s) = (self.target_at(row), self.measurements.number("exposure_s", row));
            match spells.last_mut() {
                Some(last) if last.target == target => (last.to_s, last.rows.1) = (time_s, row + 1),
                _ => spells.push(TargetSpell { target, from_s: time_s, to_s: time_s, rows: (row, row + 1) }),
            }
        }
        spells
    }

    /// Numbers of the targets that were looked for, rising.
    pub(super) fn targets_looked_for(&self) -> Vec<usize> {
        let all: BTreeSet<usize> = (0..self.measurements.rows()).map(|row| self.target_at(row)).collect();
        all.into_iter().collect()
    }
}

impl JointSummary {
    /// That of a joint of a robot file.
    #[must_use]
    pub fn of(joint: &JointDescription) -> Self {
        Self {
            name: joint.name.clone(),
            slides: joint.kind == JointKind::Prismatic,
            lower: joint.limits.lower,
            upper: joint.limits.upper,
            velocity: joint.limits.velocity,
            effort: joint.limits.effort,
        }
    }
}

/// An image in the page.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ImageData {
    /// The name of its file.
    pub file: String,
    /// The image itself, smaller where it is large.
    pub data: String,
}
