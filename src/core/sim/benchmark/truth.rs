//! What was true at each tick of a run, as a table from which every score can be computed anew by other programs (`contrib/benchmark/scores.py`).

use super::{BenchmarkError, BenchmarkScenario, BenchmarkSuite, BenchmarkTask};
use crate::config::Scene;
use crate::geometry::Pose;
use serde_json::{Map, Value, json};
use std::fmt::Write;

/// The table of one run.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RunTruth {
    head: String,
    rows: String,
}

impl RunTruth {
    /// A table of a run in `scene` to the goal `X_DO`, which `task` judges: its first line is a comment with all that is constant, as JSON.
    pub(super) fn begin(&mut self, task: &BenchmarkTask, scene: &Scene, X_DO: &Pose, joints: usize) {
        let i = scene.camera.intrinsics();
        let lens = scene.camera.lens();
        let distortion: Map<String, Value> =
            lens.coefficients().into_iter().map(|(name, value)| (name.to_owned(), value.into())).collect();
        let points: Vec<[f64; 3]> = scene.target.points().iter().map(|p| p.p_O.coords.into()).collect();
        let head = json!({
            "width_px": i.width_px, "height_px": i.height_px,
            "fx_px": i.fx_px, "fy_px": i.fy_px, "cx_px": i.cx_px, "cy_px": i.cy_px,
            "lens": lens.model().name(), "distortion": distortion,
            "points_m": points, "goal": numbers_of(X_DO),
            "tolerance_px": task.tolerance_px, "hold_s": task.hold_s,
        });
        self.head = format!("# {head}\ntime_s,x_m,y_m,z_m,qx,qy,qz,qw");
        for what in ["qd", "tau"] {
            for joint in 1..=joints {
                // a String takes everything
                let _ = write!(self.head, ",{what}{joint}");
            }
        }
        self.rows.clear();
    }

    /// A tick: the object before the camera, and the joints' true velocities and their torques.
    pub(super) fn note(&mut self, time_s: f64, X_CO: &Pose, qd: &[f64], tau: &[f64]) {
        let _ = write!(self.rows, "{time_s}");
        for number in numbers_of(X_CO).iter().chain(qd).chain(tau) {
            let _ = write!(self.rows, ",{number}");
        }
        self.rows.push('\n');
    }

    /// The table.
    #[must_use]
    pub fn to_csv(&self) -> String {
        format!("{}\n{}", self.head, self.rows)
    }
}

impl BenchmarkSuite {
    /// The name of the file of what was true in a scenario under the law or entrant `name`: task, number of its start among those of the task, name.
    ///
    /// # Errors
    /// [`BenchmarkError::Suite`] where the scenario is of another suite.
    pub fn truth_file(&self, scenario: &BenchmarkScenario, name: &str) -> Result<String, BenchmarkError> {
        let task = self.task_of(scenario)?;
        let number = scenario.place.case * task.count as usize + scenario.place.start as usize;
        Ok(format!("{}-{number}-{name}.csv", task.name))
    }
}

/// Position m and rotation x, y, z, w.
fn numbers_of(X: &Pose) -> [f64; 7] {
    let (p, c) = (X.translation.vector, X.rotation.coords);
    [p.x, p.y, p.z, c.x, c.y, c.z, c.w]
}
