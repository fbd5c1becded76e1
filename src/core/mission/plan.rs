//! What a run is to do: who begins it, its goal, and when it ends.

use crate::servo::{GoalPath, Law, SetPoint};
use crate::target::PointKind;
use crate::time::SpanNs;
use nalgebra::Vector2;

/// Who begins and ends a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Service {
    /// It starts by itself, after teaching where the goal is taught, and ends when its task is done.
    OneShot {
        /// Whether the goal is taught first.
        teaches: bool,
    },
    /// It waits for requests, and ends on request.
    Served,
}

/// A goal of the run.
#[derive(Debug, Clone, PartialEq)]
pub struct Goal {
    /// Its number in the run: 0 is that of the run file, and each taught goal has the next number.
    pub id: u32,
    /// The features.
    pub set_point: SetPoint,
    /// Largest root mean square feature error at which it counts as reached, px.
    pub tolerance_px: f64,
    /// Time for which it must be held.
    pub hold: SpanNs,
}

/// The conditions under which a run begins and ends.
#[derive(Debug, Clone)]
pub struct RunPlan {
    /// Whether the run serves requests, or executes its file.
    pub service: Service,
    /// Measurements of which a taught goal is the mean.
    pub teaching_measurements: u32,
    /// When the arm is brought to rest at the latest; `None` ends with the last frame only.
    pub duration: Option<SpanNs>,
    /// Age from which on an exposure is no measurement of now any more.
    pub measurement_timeout: SpanNs,
    /// Whether the loop is closed: without it there is no goal to reach.
    pub closed_loop: bool,
    /// Focal lengths that turn normalized errors into pixels.
    pub f_px: Vector2<f64>,
    /// The path of the goal; `None` for a goal at rest.
    pub path: Option<GoalPath>,
    /// The law, by which an error that stays is judged.
    pub law: Law,
    /// Whether the law follows the object's own motion.
    pub follows: bool,
    /// What the points of each target are, for words, by the targets' numbers.
    pub points: Vec<PointKind>,
    /// What a status tells as [`Status::stability`](crate::messages::Status::stability).
    pub stability: f64,
}
