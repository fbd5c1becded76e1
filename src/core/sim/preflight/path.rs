//! What a goal that moves asks of the arm: its speeds, and whether each pose is within reach.

use super::reach::{Reach, ReachProblem};
use super::words;
use crate::servo::GoalPath;
use serde::Serialize;

/// Places between two poses at which the speed is looked at. Chosen by hand: the speed of a cubic is a parabola, of which so many places miss 1 % at most.
const PLACES: u32 = 16;

/// The path of a goal before the run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GoalPathAhead {
    /// Poses, the first one included.
    pub poses: usize,
    /// Length, s.
    pub end_s: f64,
    /// Largest speed of the desired camera relative to the object, m/s.
    pub max_speed_m_s: f64,
    /// Its largest angular speed, rad/s.
    pub max_angular_speed_rad_s: f64,
    /// The first pose that the arm does not reach: its time, s, and how near it gets; `None` where it reaches all.
    pub beyond: Option<(f64, Reach)>,
}

impl GoalPathAhead {
    /// The path `path` for the arm of `first`, which reaches the first pose; each pose is looked for from the posture of the one before.
    pub(super) fn of<const N: usize>(path: &GoalPath, first: &ReachProblem<'_, N>) -> Self {
        let (mut max_speed, mut max_angular_speed, mut before_s) = (0.0_f64, 0.0_f64, 0.0);
        let (mut beyond, mut q_start) = (None, first.q_start);
        for (t_s, X_DO) in path.poses() {
            for k in 0..PLACES {
                let at_s = before_s + (t_s - before_s) * (f64::from(k) + 0.5) / f64::from(PLACES);
                let V = path.at(at_s).V_OD_D;
                max_angular_speed = max_angular_speed.max(V.fixed_rows::<3>(3).norm());
                max_speed = max_speed.max(V.fixed_rows::<3>(0).norm());
            }
            before_s = t_s;
            let mut set_point = first.set_point.clone();
            if beyond.is_none() && set_point.move_to(X_DO) {
                let (reach, found) =
                    ReachProblem { set_point: &set_point, X_DO: *X_DO, q_start, ..*first }.reach();
                match found {
                    Some(q) => q_start = q,
                    None => beyond = Some((t_s, reach)),
                }
            }
        }
        Self {
            poses: path.poses().count(),
            end_s: path.end_s(),
            max_speed_m_s: max_speed,
            max_angular_speed_rad_s: max_angular_speed,
            beyond,
        }
    }

    /// The message of a pose out of reach.
    pub(super) fn fault(&self) -> Option<String> {
        let (t_s, reach) = self.beyond.as_ref()?;
        Some(format!("the arm cannot bring the camera to the pose at {t_s} s: {}", words::nearest(reach)))
    }

    /// In words.
    pub(super) fn line(&self) -> String {
        let reached = self.fault().unwrap_or_else(|| "the arm reaches each".into());
        format!(
            "{} poses in {} s, with up to {:.3} m/s and {:.2} rad/s; {reached}",
            self.poses, self.end_s, self.max_speed_m_s, self.max_angular_speed_rad_s
        )
    }
}
