//! What a simulated run leaves: one row per millisecond, and its CSV file.

use super::ExperimentError;
use nalgebra::{Vector2, Vector4};
use std::fmt::Write as _;

/// First line of every trajectory file.
pub const HEADER: &str = "time_s,x_m,y_m,z_m,alpha_rad,X1,Y1,X2,Y2,X3,Y3,X4,Y4,q1,q2,q3,q4,u1,u2,u3,u4";

/// The state at one millisecond.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrajectoryRow {
    /// Since the start.
    pub time_s: f64,
    /// Camera in the base: x, y, z in m and the angle about z in rad, not wrapped.
    pub x_c: Vector4<f64>,
    /// What an ideal camera sees of P1 ... P4, normalized.
    pub s: [Vector2<f64>; 4],
    /// Joint positions, rad and m.
    pub q: Vector4<f64>,
    /// Control: N m and N for torque laws, joint reference rates in rad/s and m/s for the others.
    pub u: Vector4<f64>,
}

/// How a run ended.
#[derive(Debug, Clone, PartialEq)]
pub enum TrajectoryEnd {
    /// It lasted as long as asked.
    Finished,
    /// It broke off.
    Stopped {
        /// When.
        time_s: f64,
        /// Why, for people.
        reason: String,
    },
}

/// A run on the 1 ms grid.
#[derive(Debug, Clone, PartialEq)]
pub struct Trajectory {
    /// Name of the scheme; also of its file.
    pub name: String,
    /// At least one row.
    pub rows: Vec<TrajectoryRow>,
    /// How it ended.
    pub end: TrajectoryEnd,
}

impl Trajectory {
    /// The CSV text, with ten digits after the point.
    #[must_use]
    pub fn to_csv(&self) -> String {
        let mut text = String::with_capacity(self.rows.len() * 300);
        text.push_str(HEADER);
        text.push('\n');
        for row in &self.rows {
            let _ = write!(text, "{:.3}", row.time_s);
            let s = row.s.iter().flat_map(|s| [s.x, s.y]);
            for value in row.x_c.iter().copied().chain(s).chain(row.q.iter().chain(row.u.iter()).copied()) {
                let _ = write!(text, ",{value:.10}");
            }
            text.push('\n');
        }
        text
    }

    /// A quantity of every row over time.
    pub fn series<'a>(
        &'a self,
        of: impl Fn(&TrajectoryRow) -> f64 + 'a,
    ) -> impl Iterator<Item = (f64, f64)> + 'a {
        self.rows.iter().map(move |row| (row.time_s, of(row)))
    }

    /// First and last row.
    ///
    /// # Errors
    /// [`ExperimentError::Empty`] without rows.
    pub fn ends(&self) -> Result<(&TrajectoryRow, &TrajectoryRow), ExperimentError> {
        match (self.rows.first(), self.rows.last()) {
            (Some(first), Some(last)) => Ok((first, last)),
            _ => Err(ExperimentError::Empty { scheme: self.name.clone() }),
        }
    }
}
