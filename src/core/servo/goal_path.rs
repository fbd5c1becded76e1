//! A goal that moves: the desired pose `X_DO` as a smooth function of time through given poses, and the twist of the desired camera that follows
//! from it.
//!
//! Between two poses, which are `h` seconds apart, the position is the cubic Hermite polynomial, and the orientation its counterpart on the
//! rotations, `R(u) = R_a exp(b1 w1) exp(b2 w2) exp(b3 w3)` with the cumulative Bernstein polynomials `b1 = 1 - (1 - u)^3`, `b2 = 3 u^2 - 2 u^3`, `b3 = u^3`
//! of `u` in 0..=1 (Kim, Kim and Shin, A general construction scheme for unit quaternion curves, 1995). Both have given velocities at their ends, so that
//! the velocity is continuous everywhere. The path begins and ends at rest.
//!
//! With `s_d(t)` the error of a law changes by the motion of D too. That part vanishes where the camera has the twist of D beside that of the law:
//! `V_OC_C = Ad(X_CD) V_OD_D`, the feed-forward, keeps the camera's pose in D.

use crate::geometry::{Pose, Twist};
use nalgebra::{UnitQuaternion, Vector3};

/// Largest speed at a pose, as a multiple of the smaller mean speed beside it. Chosen: below the 3 up to which a cubic stays between its ends (Fritsch and
/// Carlson, 1980), so that the path does not overshoot where a long leg meets a short one, and 0 beside a leg in which nothing moves.
const MAX_SPEED_RATIO: f64 = 1.5;

/// A pose of the path.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Knot {
    t_s: f64,
    X_DO: Pose,
    /// Velocity of O in D, m/s.
    v: Vector3<f64>,
    /// Angular velocity of O in D, expressed in O, rad/s.
    w: Vector3<f64>,
}

/// The desired pose `X_DO` over time.
#[derive(Debug, Clone, PartialEq)]
pub struct GoalPath {
    knots: Vec<Knot>,
    /// Whether the arm is moved along with the desired pose; without it the law alone follows.
    pub feed_forward: bool,
}

/// The goal at one time of its path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MovingGoal {
    /// The desired pose of the object in the camera.
    pub X_DO: Pose,
    /// Twist of the desired camera D relative to the object, expressed in D, m/s and rad/s.
    pub V_OD_D: Twist,
}

impl GoalPath {
    /// The path through `poses`, each with its time, s. `None` for fewer than two poses, times that do not rise, or numbers that are not finite.
    #[must_use]
    pub fn new(poses: &[(f64, Pose)], feed_forward: bool) -> Option<Self> {
        let is_finite = |(t_s, X): &(f64, Pose)| {
            t_s.is_finite() && X.to_homogeneous().iter().all(|entry| entry.is_finite())
        };
        let rises = poses.is_sorted_by(|(a, _), (b, _)| a < b);
        if poses.len() < 2 || !rises || !poses.iter().all(is_finite) {
            return None;
        }
        let zero = Vector3::zeros();
        let mut knots: Vec<_> =
            poses.iter().map(|&(t_s, X_DO)| Knot { t_s, X_DO, v: zero, w: zero }).collect();
        for (i, window) in poses.windows(3).enumerate() {
            let [(t0, X0), (t1, X1), (t2, X2)] = window else { continue };
            let (before_s, after_s) = (t1 - t0, t2 - t1);
            let through = |before: Vector3<f64>, after: Vector3<f64>| {
                let (before, after) = (before / before_s, after / after_s);
                let mean = (before * after_s + after * before_s) / (before_s + after_s);
                let largest = MAX_SPEED_RATIO * before.norm().min(after.norm());
                mean * (largest / mean.norm().max(largest).max(f64::MIN_POSITIVE))
            };
            let place = |X: &Pose| X.translation.vector;
            let turn = |from: &Pose, to: &Pose| from.rotation.rotation_to(&to.rotation);
            // From one orientation to the next about one axis: in both frames it has the same numbers.
            let body = |from: &Pose, to: &Pose| {
                (from.rotation.inverse() * turn(from, to) * from.rotation).scaled_axis()
            };
            if let Some(knot) = knots.get_mut(i + 1) {
                knot.v = through(place(X1) - place(X0), place(X2) - place(X1));
                knot.w = through(body(X0, X1), body(X1, X2));
            }
        }
        Some(Self { knots, feed_forward })
    }

    /// The times of the poses, s, and the poses.
    pub fn poses(&self) -> impl Iterator<Item = (f64, &Pose)> {
        self.knots.iter().map(|knot| (knot.t_s, &knot.X_DO))
    }

    /// The time of the last pose, s.
    #[must_use]
    pub fn end_s(&self) -> f64 {
        self.knots.last().map_or(0.0, |knot| knot.t_s)
    }

    /// The goal at `t_s`: before the first pose that one at rest, after the last one that at rest.
    #[must_use]
    pub fn at(&self, t_s: f64) -> MovingGoal {
        let next = self.knots.partition_point(|knot| knot.t_s <= t_s);
        let leg = next.checked_sub(1).and_then(|i| self.knots.get(i)).zip(self.knots.get(next));
        match (leg, self.knots.first(), self.knots.last()) {
            (Some((a, b)), ..) => between(a, b, t_s),
            (None, Some(first), _) if next == 0 => MovingGoal::at_rest(first.X_DO),
            (None, _, last) => MovingGoal::at_rest(last.map_or_else(Pose::identity, |knot| knot.X_DO)),
        }
    }
}

impl MovingGoal {
    fn at_rest(X_DO: Pose) -> Self {
        Self { X_DO, V_OD_D: Twist::zeros() }
    }

    /// The twist `V_OC_C`, m/s and rad/s, with which a camera that sees the object at `X_CO` keeps its pose in D.
    #[must_use]
    pub fn twist_of_camera(&self, X_CO: &Pose) -> Twist {
        let X_DC = self.X_DO * X_CO.inverse();
        let (v_D, w_D) = (self.V_OD_D.fixed_rows::<3>(0), self.V_OD_D.fixed_rows::<3>(3).into_owned());
        let R_CD = X_DC.rotation.inverse();
        let v_C = R_CD * (v_D + w_D.cross(&X_DC.translation.vector));
        let w_C = R_CD * w_D;
        Twist::new(v_C.x, v_C.y, v_C.z, w_C.x, w_C.y, w_C.z)
    }
}

/// The goal at `t_s` between two poses.
fn between(a: &Knot, b: &Knot, t_s: f64) -> MovingGoal {
    let h_s = b.t_s - a.t_s;
    let u = (t_s - a.t_s) / h_s;
    let (p_a, p_b) = (a.X_DO.translation.vector, b.X_DO.translation.vector);
    let (from_a, from_b) = (u * (1.0 - u) * (1.0 - u) * h_s, -u * u * (1.0 - u) * h_s);
    let share = u * u * (3.0 - 2.0 * u);
    let p = p_a + (p_b - p_a) * share + a.v * from_a + b.v * from_b;
    let v = (p_b - p_a) * (6.0 * u * (1.0 - u) / h_s)
        + a.v * ((1.0 - u) * (1.0 - 3.0 * u))
        + b.v * (u * (3.0 * u - 2.0));

    let (w1, w3) = (a.w * (h_s / 3.0), b.w * (h_s / 3.0));
    let exp = UnitQuaternion::from_scaled_axis;
    let w2 = (exp(-w1) * a.X_DO.rotation.inverse() * b.X_DO.rotation * exp(-w3)).scaled_axis();
    let [b1, b2, b3] = [1.0 - (1.0 - u).powi(3), share, u.powi(3)];
    let rates = [3.0 * (1.0 - u) * (1.0 - u), 6.0 * u * (1.0 - u), 3.0 * u * u].map(|rate| rate / h_s);
    let (second, third) = (exp(w2 * b2), exp(w3 * b3));
    let R_DO = a.X_DO.rotation * exp(w1 * b1) * second * third;
    let w_O = third.inverse() * (second.inverse() * (w1 * rates[0]) + w2 * rates[1]) + w3 * rates[2];

    // A point of the object moves in D by `v + w x (p - p_DO)` and, with D's own twist, by `-v_D - w_D x p`.
    let w = R_DO * w_O;
    let v_D = w.cross(&p) - v;
    MovingGoal {
        X_DO: Pose::from_parts(p.into(), R_DO),
        V_OD_D: Twist::new(v_D.x, v_D.y, v_D.z, -w.x, -w.y, -w.z),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::servo::SetPoint;
    use nalgebra::{Point3, Vector2};
    use proptest::prelude::*;

    fn poses() -> impl Strategy<Value = Vec<(f64, Pose)>> {
        let pose = prop::array::uniform6(-1.0..1.0f64).prop_map(|x| {
            Pose::new([0.2 * x[0], 0.2 * x[1], 1.0 + 0.4 * x[2]].into(), [x[3], x[4], x[5]].into())
        });
        prop::collection::vec((0.2..3.0f64, pose), 2..6).prop_map(|legs| {
            let mut t_s = 0.0;
            legs.into_iter()
                .map(|(leg_s, X)| {
                    t_s += leg_s;
                    (t_s, X)
                })
                .collect()
        })
    }

    /// Features of points of a target that lies at `X_CO`, by division.
    fn seen(X_CO: &Pose, points: &[Point3<f64>]) -> Vec<Vector2<f64>> {
        points.iter().map(|p| X_CO * p).map(|p| Vector2::new(p.x / p.z, p.y / p.z)).collect()
    }

    proptest! {
        /// The twist against differences of poses: a frame that moves by it for a moment is where the path then is; and it is continuous.
        #[test]
        fn the_twist_is_that_of_the_path(poses in poses(), share in 0.0..1.0f64) {
            let path = GoalPath::new(&poses, true).unwrap();
            let (begin_s, end_s) = (poses[0].0, path.end_s());
            let t_s = begin_s + share * (end_s - begin_s);
            let h = 1e-5;
            let (X_OD, V) = (path.at(t_s).X_DO.inverse(), path.at(t_s).V_OD_D);
            let (before, after) = (path.at(t_s - h).X_DO.inverse(), path.at(t_s + h).X_DO.inverse());
            let v = X_OD.rotation.inverse() * (after.translation.vector - before.translation.vector) / (2.0 * h);
            let w = (before.rotation.inverse() * after.rotation).scaled_axis() / (2.0 * h);
            let found = Twist::new(v.x, v.y, v.z, w.x, w.y, w.z);
            // Where a leg ends within the difference, its second derivative jumps: by less than 1e3 per s^2.
            let near_a_pose = poses.iter().any(|(t, _)| (t - t_s).abs() < h);
            prop_assert!((found - V).norm() < if near_a_pose { 1e-1 } else { 1e-5 * (1.0 + V.norm()) }, "{found} {V}");
        }

        /// Each pose is met at its time, with one velocity from both sides; both ends are at rest.
        #[test]
        fn each_pose_is_met(poses in poses()) {
            let path = GoalPath::new(&poses, true).unwrap();
            for (t_s, X_DO) in &poses {
                prop_assert!((path.at(*t_s).X_DO.to_homogeneous() - X_DO.to_homogeneous()).norm() < 1e-9);
                let (left, right) = (path.at(t_s - 1e-9).V_OD_D, path.at(t_s + 1e-9).V_OD_D);
                prop_assert!((left - right).norm() < 1e-5, "{left} {right}");
            }
            for (t_s, (_, X_DO)) in [(-1.0, poses[0]), (path.end_s() + 1.0, poses[poses.len() - 1])] {
                prop_assert_eq!(path.at(t_s).X_DO, X_DO);
            }
            prop_assert!(path.at(poses[0].0).V_OD_D.norm() < 1e-12 && path.at(path.end_s()).V_OD_D.norm() == 0.0);
        }

        /// A camera that is not at the goal keeps its pose in D when it moves by the feed-forward, and features at the goal move by it as `s_d` does.
        #[test]
        fn the_feed_forward_keeps_the_error(poses in poses(), share in 0.05..0.95f64, off in prop::array::uniform6(-0.2..0.2f64)) {
            let path = GoalPath::new(&poses, true).unwrap();
            let t_s = poses[0].0 + share * (path.end_s() - poses[0].0);
            let goal = path.at(t_s);
            let X_DC = Pose::new([off[0], off[1], off[2]].into(), [off[3], off[4], off[5]].into());
            let X_CO = X_DC.inverse() * goal.X_DO;
            let V = goal.twist_of_camera(&X_CO) * 1e-6;
            let moved = Pose::new(V.fixed_rows::<3>(0).into(), V.fixed_rows::<3>(3).into());
            let then = path.at(t_s + 1e-6).X_DO * (moved.inverse() * X_CO).inverse();
            prop_assert!((then.to_homogeneous() - X_DC.to_homogeneous()).norm() < 1e-9);

            let points = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]].map(|[x, y]| Point3::new(x, y, 0.0));
            let mut set_point = SetPoint::from_pose(&poses[0].1, &points).unwrap();
            prop_assert!(set_point.move_to(&goal.X_DO));
            for (s, s_d) in seen(&goal.X_DO, &points).iter().zip(set_point.features()) {
                prop_assert!((s - s_d).norm() < 1e-12);
            }
        }
    }

    #[test]
    fn a_pose_that_is_held_is_left_and_reached_at_rest() {
        let at = |x: f64| Pose::translation(x, 0.0, 0.5);
        let poses = [(0.0, at(0.0)), (1.0, at(0.1)), (2.0, at(0.1)), (3.0, at(0.0))];
        let path = GoalPath::new(&poses, true).unwrap();
        for t_s in [1.0, 1.3, 2.0] {
            assert_eq!(path.at(t_s).V_OD_D, Twist::zeros());
            assert_eq!(path.at(t_s).X_DO.translation.x, 0.1);
        }
        assert!(path.at(0.5).V_OD_D.x < -0.1, "D moves against O");
    }

    #[test]
    fn what_is_no_path_is_refused() {
        let at = |x: f64| Pose::translation(x, 0.0, 0.5);
        assert!(GoalPath::new(&[(0.0, at(0.0))], true).is_none());
        assert!(GoalPath::new(&[(1.0, at(0.0)), (1.0, at(0.1))], true).is_none());
        assert!(GoalPath::new(&[(0.0, at(0.0)), (1.0, at(f64::NAN))], true).is_none());
    }
}
