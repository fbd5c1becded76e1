//! What is known besides of a camera before a plane: it tells which of the two readings of a homography is true.

use super::Refused;
use crate::cli::StereoMotionArguments;
use crate::cli::pose_tool::numbers_of;
use crate::pose::{HomographySolution, HomographySolutions};
use nalgebra::Vector3;

/// How much nearer to a hint the true reading must be than the other, rad. Chosen by hand: a plane's normal is seldom known better than to two degrees.
const TIE: f64 = 0.035;

fn vector_of(text: &str) -> Result<Vector3<f64>, String> {
    let numbers: [f64; 3] =
        numbers_of(text).ok_or_else(|| format!("`{text}`: three numbers are expected"))?;
    Ok(Vector3::from(numbers))
}

/// The direction of a hint.
fn direction_of(option: &str, text: &str) -> Result<Vector3<f64>, Refused> {
    let direction = vector_of(text).map_err(|e| (format!("{option}: {e}"), 2))?;
    let usable = direction.iter().all(|x| x.is_finite()) && direction.norm() > 0.0;
    usable.then_some(direction).ok_or_else(|| (format!("{option}: `{text}` has no direction"), 2))
}

/// Whether both readings are as far from a hint, rad, so that it does not tell which is true.
fn is_tie(solutions: &HomographySolutions, apart: impl Fn(&HomographySolution) -> f64) -> bool {
    solutions.second.is_some_and(|second| (apart(&second) - apart(&solutions.first)).abs() < TIE)
}

/// What is known of a plane's displacement besides: tells which reading is true.
pub(super) enum Hint {
    /// The plane's normal in camera 2.
    Normal(Vector3<f64>),
    /// The way of the camera in frame 1.
    Way(Vector3<f64>),
}

pub(super) fn hints(a: &StereoMotionArguments) -> Result<Vec<Hint>, Refused> {
    let normal = a.normal.as_deref().map(|text| direction_of("--normal", text).map(Hint::Normal));
    let way = a.direction.as_deref().map(|text| direction_of("--direction", text).map(Hint::Way));
    normal.into_iter().chain(way).collect()
}

/// Both readings, or the one that the first hint tells that tells any.
pub(super) fn chosen(hints: &[Hint], solutions: HomographySolutions) -> HomographySolutions {
    let one = |first: HomographySolution| HomographySolutions { first, second: None };
    for hint in hints {
        let apart = |s: &HomographySolution| match hint {
            Hint::Normal(n_2) => s.n_2.angle(n_2),
            Hint::Way(way) => s.p_12_1_over_d2.angle(way),
        };
        if !is_tie(&solutions, apart) {
            return one(match hint {
                Hint::Normal(n_2) => solutions.nearest_normal(n_2),
                Hint::Way(way) => solutions.nearest_direction(way),
            });
        }
    }
    solutions
}
