//! What a goal that moves asks of the arm: its speeds, and whether each pose is within reach.

use super::reach::{Reach, ReachProblem};
use super::words;
use crate::servo::GoalPath;
use nalgebra::SVector;
use serde::Serialize;

/// Places between two poses at which the speed is looked at. Chosen by hand: the speed of a cubic is a parabola, of which so many places miss 1 % at most.
const PLACES: u32 = 16;

/// Places between two poses at which the joints are looked for. Chosen by hand: the mean speed over a quarter of a cubic's way is within a tenth of its peak.
const JOINT_PLACES: u32 = 4;
/// Steps of the inverse kinematics from one of them to the next. Chosen by hand: as along the straight way, of which so many always arrived.
const STEPS: usize = 30;

/// A joint that would have to be faster than it can.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OverspeedJoint {
    /// Its name.
    pub joint: String,
    /// When, s since the arm began to follow.
    pub at_s: f64,
    /// The speed that the path needs, rad/s or m/s.
    pub needs: f64,
    /// The joint's velocity limit, rad/s or m/s.
    pub limit: f64,
}

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
    /// The joint that would have to exceed its velocity limit by the largest factor; `None` where none has to.
    pub overspeed: Option<OverspeedJoint>,
}

impl GoalPathAhead {
    /// The path `path` for the arm of `first`, which reaches the first pose; each pose is looked for from the posture of the one before.
    pub(super) fn of<const N: usize>(path: &GoalPath, first: &ReachProblem<'_, N>) -> Self {
        let (mut max_speed, mut max_angular_speed, mut before_s) = (0.0_f64, 0.0_f64, 0.0);
        let (mut beyond, mut q_start) = (None, first.q_start);
        let mut overspeed: Option<OverspeedJoint> = None;
        for (t_s, X_DO) in path.poses() {
            for k in 0..PLACES {
                let at_s = before_s + (t_s - before_s) * (f64::from(k) + 0.5) / f64::from(PLACES);
                let V = path.at(at_s).V_OD_D;
                max_angular_speed = max_angular_speed.max(V.fixed_rows::<3>(3).norm());
                max_speed = max_speed.max(V.fixed_rows::<3>(0).norm());
            }
            let leg = (before_s, t_s);
            before_s = t_s;
            let mut set_point = first.set_point.clone();
            if beyond.is_none() && set_point.move_to(X_DO) {
                let (reach, found) =
                    ReachProblem { set_point: &set_point, X_DO: *X_DO, q_start, ..*first }.reach();
                match found {
                    Some(q) => {
                        let needed = first.fastest_joint(path, leg, q_start);
                        let share = |one: &OverspeedJoint| one.needs / one.limit;
                        overspeed =
                            overspeed.into_iter().chain(needed).max_by(|a, b| share(a).total_cmp(&share(b)));
                        q_start = q;
                    }
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
            overspeed: overspeed.filter(|one| one.needs > one.limit),
        }
    }

    /// The message of a path that is too fast for the arm.
    pub(super) fn doubt(&self) -> Option<String> {
        let OverspeedJoint { joint, at_s, needs, limit } = self.overspeed.as_ref()?;
        Some(format!(
            "joint `{joint}` would have to move with {needs:.2} rad/s or m/s at {at_s:.2} s, and its velocity limit is {limit:.2}: the arm stays behind its goal; \
             give the path more time (t_s), or lead it elsewhere"
        ))
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

impl<const N: usize> ReachProblem<'_, N> {
    /// The joint that needs the largest share of its velocity limit between two times of `path`, s, for an arm that is at `q`, rad or m, at the first of them.
    fn fastest_joint(
        &self,
        path: &GoalPath,
        (from_s, until_s): (f64, f64),
        q: SVector<f64, N>,
    ) -> Option<OverspeedJoint> {
        let step_s = (until_s - from_s) / f64::from(JOINT_PLACES);
        if !(step_s > 0.0) {
            return None;
        }
        let (mut q, mut fastest) = (q, None::<OverspeedJoint>);
        for k in 1..=JOINT_PLACES {
            let at_s = from_s + step_s * f64::from(k);
            let X_WD = self.X_WO * path.at(at_s).X_DO.inverse();
            let next = self.search().towards_within(&q, &X_WD, STEPS);
            for (i, limit) in self.robot.limits().iter().enumerate() {
                let needs = (next[i] - q[i]).abs() / step_s;
                if fastest.as_ref().is_none_or(|one| needs / limit.velocity > one.needs / one.limit) {
                    let at_s = at_s - 0.5 * step_s;
                    fastest =
                        Some(OverspeedJoint { joint: self.name(i), at_s, needs, limit: limit.velocity });
                }
            }
            q = next;
        }
        fastest
    }
}
