//! What the page of a run is made of: plain data, as it stands in the files beside the page.

use crate::report::csv_table::CsvTable;
use crate::robot::{JointDescription, JointKind};

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
    /// The points of the target, m.
    pub points_m: Vec<[f64; 3]>,
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
