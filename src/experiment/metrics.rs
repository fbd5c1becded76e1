//! The figures of merit of a run: final errors, settling times, overshoot, straightness, largest control.
//!
//! All are taken against the goal, never against the last sample: a run that is still on its way when it ends must not be
//! judged by where it happened to be.

use super::{ExperimentError, Trajectory, TrajectoryEnd, TrajectoryRow};
use crate::features::wrap_rad;
use nalgebra::{SVector, Vector2, Vector3, Vector4};
use serde::Serialize;

/// Band about the goal, as a share of the first error, for the settling times: the usual 2 % of textbooks on control.
const SETTLED: f64 = 0.02;

/// The goal of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CellGoal {
    /// Desired camera pose in the base: m, m, m, rad.
    pub x_c: Vector4<f64>,
    /// What an ideal camera sees there, normalized.
    pub s: [Vector2<f64>; 4],
}

/// What is left at the end.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RemainingErrors {
    /// Distance of the camera from its goal.
    pub position_m: f64,
    /// Angle to its goal.
    pub orientation_rad: f64,
    /// Norm over the four points, normalized.
    pub features: f64,
}

/// From when on the error stays within 2 % of the first one; nothing where it does not, or where the run broke off.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SettlingTimes {
    /// Of the camera's position.
    pub position: Option<f64>,
    /// Of its orientation.
    pub orientation: Option<f64>,
    /// Of the four points in the image.
    pub features: Option<f64>,
}

/// Everything that `metrics.json` says of one run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Metrics {
    /// `finished`, or why the run broke off.
    pub end: String,
    /// Length of the run.
    pub duration_s: f64,
    /// Errors at its end.
    pub final_errors: RemainingErrors,
    /// 2 % settling times.
    pub settling_time_s: SettlingTimes,
    /// `100 (z_d - min z) / |z_d - z_start|`: how far the camera retreats beyond the goal's height. Negative where it never
    /// comes to that height.
    pub z_overshoot_percent: f64,
    /// Largest distance of the camera's path from the straight line from start to goal, over the distance of these.
    pub camera_path_deviation: f64,
    /// The same for the paths of P1 ... P4 in the image.
    pub image_path_deviation: [f64; 4],
    /// Largest magnitude of each joint's control.
    pub largest_control: [f64; 4],
}

impl Metrics {
    /// Measures `run` against `goal`.
    ///
    /// # Errors
    /// [`ExperimentError::Empty`] for a run without rows.
    pub fn of(run: &Trajectory, goal: &CellGoal) -> Result<Self, ExperimentError> {
        let (first, last) = run.ends()?;
        let position = |row: &TrajectoryRow| (row.x_c - goal.x_c).xyz().norm();
        let orientation = |row: &TrajectoryRow| wrap_rad(row.x_c.w - goal.x_c.w).abs();
        let features = |row: &TrajectoryRow| {
            row.s.iter().zip(&goal.s).map(|(s, s_d)| (s - s_d).norm_squared()).sum::<f64>().sqrt()
        };
        let z_min = run.rows.iter().map(|row| row.x_c.z).fold(f64::INFINITY, f64::min);
        let camera: Vec<Vector3<f64>> = run.rows.iter().map(|row| row.x_c.xyz()).collect();
        let image = |i: usize| {
            let path: Vec<_> = run.rows.iter().filter_map(|row| row.s.get(i).copied()).collect();
            goal.s.get(i).map_or(f64::NAN, |s_d| path_deviation(&path, s_d))
        };
        let control = |i: usize| run.rows.iter().map(|row| row.u[i].abs()).fold(0.0, f64::max);
        Ok(Self {
            end: match &run.end {
                TrajectoryEnd::Finished => "finished".into(),
                TrajectoryEnd::Stopped { time_s, reason } => format!("stopped at {time_s:.3} s: {reason}"),
            },
            duration_s: last.time_s - first.time_s,
            final_errors: RemainingErrors {
                position_m: position(last),
                orientation_rad: orientation(last),
                features: features(last),
            },
            settling_time_s: SettlingTimes {
                position: settling_time(run, position),
                orientation: settling_time(run, orientation),
                features: settling_time(run, features),
            },
            z_overshoot_percent: 100.0 * (goal.x_c.z - z_min) / (goal.x_c.z - first.x_c.z).abs(),
            camera_path_deviation: path_deviation(&camera, &goal.x_c.xyz()),
            image_path_deviation: std::array::from_fn(image),
            largest_control: std::array::from_fn(control),
        })
    }
}

/// The time from which on `error` stays within 2 % of its first value; `None` where it does not, or where `run` broke off.
#[must_use]
pub fn settling_time(run: &Trajectory, error: impl Fn(&TrajectoryRow) -> f64) -> Option<f64> {
    if run.end != TrajectoryEnd::Finished {
        return None;
    }
    let first = run.rows.first()?;
    let band = SETTLED * error(first);
    let inside = |row: &&TrajectoryRow| error(row) <= band; // false for NaN
    let settled = run.rows.iter().rev().take_while(inside).last()?;
    Some(settled.time_s - first.time_s)
}

/// Largest distance of `path` from the straight line through its start and `goal`, over the distance of these; NaN when they
/// coincide.
#[must_use]
pub fn path_deviation<const D: usize>(path: &[SVector<f64, D>], goal: &SVector<f64, D>) -> f64 {
    let Some(first) = path.first() else { return f64::NAN };
    let line = goal - first;
    let length = line.norm();
    let along = line / length;
    let away = |p: &SVector<f64, D>| {
        let d = p - first;
        (d - along * d.dot(&along)).norm()
    };
    if length > 0.0 { path.iter().map(away).fold(0.0, f64::max) / length } else { f64::NAN }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(z: &[f64]) -> Trajectory {
        let row = |(k, z): (usize, &f64)| TrajectoryRow {
            time_s: k as f64 * 1e-3,
            x_c: Vector4::new(0.0, 0.0, *z, 0.0),
            s: [Vector2::new(*z, 0.0); 4],
            q: Vector4::zeros(),
            u: Vector4::repeat(-z),
        };
        Trajectory {
            name: "t".into(),
            rows: z.iter().enumerate().map(row).collect(),
            end: TrajectoryEnd::Finished,
        }
    }

    fn goal() -> CellGoal {
        CellGoal { x_c: Vector4::zeros(), s: [Vector2::zeros(); 4] }
    }

    #[test]
    fn settling_is_the_last_entry_into_the_band() {
        let m = Metrics::of(&run(&[1.0, 0.01, 0.5, 0.02, 0.001]), &goal()).unwrap();
        assert_eq!(m.settling_time_s.position, Some(0.003));
        assert_eq!(m.settling_time_s.features, Some(0.003));
        assert_eq!(m.settling_time_s.orientation, Some(0.0), "no error, settled from the start");
        assert_eq!(Metrics::of(&run(&[1.0, 0.01, 0.5]), &goal()).unwrap().settling_time_s.position, None);
        assert_eq!(Metrics::of(&run(&[1.0, f64::NAN]), &goal()).unwrap().settling_time_s.position, None);
    }

    /// Goal at 0, start at 0.5, the last sample still at -0.1: what counts is how far the camera went beyond the goal.
    #[test]
    fn overshoot_is_taken_from_the_goal() {
        let m = Metrics::of(&run(&[0.5, -0.15, -0.1]), &goal()).unwrap();
        assert!((m.z_overshoot_percent - 30.0).abs() < 1e-9, "{}", m.z_overshoot_percent);
        let m = Metrics::of(&run(&[0.5, 0.35, 0.4]), &goal()).unwrap();
        assert!((m.z_overshoot_percent + 70.0).abs() < 1e-9, "{}", m.z_overshoot_percent);
        assert_eq!(m.largest_control, [0.5; 4]);
        assert!(matches!(Metrics::of(&run(&[]), &goal()), Err(ExperimentError::Empty { .. })));
    }

    #[test]
    fn a_run_that_broke_off_has_not_settled() {
        let mut broken = run(&[1.0, 0.01, 0.001]);
        assert!(Metrics::of(&broken, &goal()).unwrap().settling_time_s.position.is_some());
        broken.end = TrajectoryEnd::Stopped { time_s: 0.002, reason: "no target".into() };
        assert_eq!(Metrics::of(&broken, &goal()).unwrap().settling_time_s.position, None);
    }

    #[test]
    fn straight_and_bent_paths() {
        let v = |x, y| Vector2::new(x, y);
        let goal = v(2.0, 0.0);
        assert!(path_deviation(&[v(0.0, 0.0), v(0.5, 0.0), v(1.0, 0.0)], &goal) < 1e-15);
        assert!((path_deviation(&[v(0.0, 0.0), v(1.0, 0.5), v(2.0, 0.0)], &goal) - 0.25).abs() < 1e-15);
        // Straight, but elsewhere: the line that counts leads to the goal.
        assert!((path_deviation(&[v(0.0, 0.0), v(0.5, 0.5), v(1.0, 1.0)], &goal) - 0.5).abs() < 1e-15);
        assert!(path_deviation(&[v(2.0, 0.0), v(1.0, 0.5)], &goal).is_nan());
        assert!(path_deviation(&[], &goal).is_nan());
    }
}
