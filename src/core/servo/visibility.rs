//! Keeps features in the image: modifies a requested camera twist that would move them out of it.
//!
//! The outward speed of each visible feature at the pixel u is limited in proportion to its distance d from a margin before the
//! border: a velocity damper, `n . u_dot <= k max(d, 0)` with n the outward normal of a side and
//! `u_dot = (du/ds) L_s V`. The camera twist V of the law output is replaced by the nearest one that fulfils this for every
//! feature and side,
//!
//! ```text
//! V' = argmin |V' - V|^2_W   subject to   a_j V' <= b_j,        b_j >= 0
//! ```
//!
//! among the twists of which the arm is capable. V is not the output of a velocity law itself, which may be many times faster than the arm: it is what the
//! acceleration limits leave of it in the next HORIZON_S. Zero fulfils all constraints, so a solution always exists; it is computed
//! by Gauss-Seidel on the multipliers (Hildreth), with a bounded number of sweeps from zero. Law outputs that fulfil
//! all constraints are returned unchanged, to the last bit.
//!
//! A torque law `u = g + J^T (h - D J qd) - K_D qd` has the terminal velocity `qd*` with
//! `(J^T D J + K_D) qd* = J^T h`. The constraints apply to it, and an arm that is already too fast is braked.

use super::{Arm, LawOutput, SetPoint, Task, TwistTask, View, WrenchTask, joint_velocity};
use crate::camera_model::CameraModel;
use crate::features::point_rows;
use crate::linalg::Ldlt;
use crate::messages::{MAX_FEATURES, MAX_JOINTS};
use crate::robot::CameraJacobian;
use nalgebra::{Matrix2x6, Matrix6, RowVector6, SMatrix, SVector, Vector2, Vector6};

/// Share of the distance between a desired feature and the border that the margin leaves free, so that a goal near the border
/// can be reached. Chosen by hand: half of it changes no unit test; twice would leave goals no margin at all, and two of them fail.
const GOAL_SHARE: f64 = 0.5;
/// Most sweeps over all features and sides, so that the time of a tick is bounded. Chosen by hand: twice as many come within 0.2 % of what
/// ten times as many find for a SCARA with four points at a border, and go 0.1 % beyond the bound of the unit test for it.
const SWEEPS: usize = 60;
/// Tolerance of the constraints on the outward speed, px/s. No detection resolves a thousandth of a pixel in a second, so that
/// further sweeps would change nothing but the time of the tick.
const SLACK_PX_S: f64 = 1e-3;
/// Weight of rotation against translation in W, m per rad: the distance of a target whose image both move alike. Chosen for targets at half a metre;
/// it changes which twist is nearest, not the constraints.
const TURN_M: f64 = 0.5;
/// Factor on the law's own damping with which an arm under a torque law is braked when it is too fast towards a border. Chosen by hand: half and twice
/// of it change no unit test.
const BRAKING: f64 = 4.0;
/// Damping in the solution for a torque law's velocity, as share of the largest diagonal entry: so that a law which leaves a motion free
/// has a solution too. A thousand times the rank tolerance of the factors; it affects only motions that are damped 3e-5 times as
/// strongly as others.
const DAMPING: f64 = 1e-9;

/// How far ahead the arm's motion is looked at, s. A reference that is asked for so much more than it does accelerates at its limit (`A / (1.6 J)`
/// is 0.0125 s with the default limits), and what comes later is looked at again in the next tick. Measured: of 540 starts of UR5, Panda and xArm7 up to 1 rad
/// from the goal (schemes D and hybrid) 147 lost their target for a while with the whole law output, 122 with 0.2 s, 62 with 0.1 s, 25 with 0.05 s; of 600 others 29 with 0.05 s and 13 with this.
const HORIZON_S: f64 = 0.025;

/// Settings: camera, margin and rate of the velocity damper.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VisibilityGuard {
    /// The camera that sees the features.
    pub camera: CameraModel,
    /// Distance from the border that the target's marks keep, px.
    pub margin_px: f64,
    /// Radius of the largest mark of the target, m, which extends beyond a feature's centre.
    pub mark_radius_m: f64,
    /// Share of the distance to the margin that a feature may cover in a second, 1/s.
    pub rate_1_s: f64,
    /// Acceleration limits of the joints, rad/s^2 or m/s^2; infinite for an arm without.
    pub acceleration: [f64; MAX_JOINTS],
}

/// Constraints on the motion of one feature: `rows V` is its velocity in the image, `growth V` the rate of the radius of its mark,
/// px/s.
#[derive(Clone, Copy)]
struct Bound {
    rows: Matrix2x6<f64>,
    growth: RowVector6<f64>,
    /// Distance to the margins, px: at the left and right, above and below; infinite where there is no bound.
    left_px: [[f64; 2]; 2],
    /// Multipliers of the four sides.
    multiplier: [[f64; 2]; 2],
}

impl VisibilityGuard {
    /// `law_output` for `task`, modified so that no feature of `view` leaves the image.
    #[must_use]
    pub fn hold<const N: usize>(
        &self,
        set_point: &SetPoint,
        view: &View,
        (task, joint_damping): (&Task, &SVector<f64, N>),
        arm: &Arm<N>,
        law_output: LawOutput<N>,
    ) -> LawOutput<N> {
        let held = match (law_output, task) {
            (LawOutput::Velocity(qd), _) => self
                .held_back(|| self.bounds(set_point, view), arm, &self.within_reach(&qd, arm), 0.0)
                .map(LawOutput::Velocity),
            (LawOutput::Torque(tau), Task::Wrench(task)) => {
                self.held_torque(set_point, view, task, joint_damping, arm, &tau).map(LawOutput::Torque)
            }
            (LawOutput::Torque(_), Task::Twist(_)) => None,
        };
        held.filter(LawOutput::is_finite).unwrap_or(law_output)
    }

    fn held_torque<const N: usize>(
        &self,
        set_point: &SetPoint,
        view: &View,
        task: &WrenchTask,
        joint_damping: &SVector<f64, N>,
        arm: &Arm<N>,
        tau: &SVector<f64, N>,
    ) -> Option<SVector<f64, N>> {
        let J = arm.J.matrix();
        let damping = task.joint_damping(&arm.J, joint_damping);
        let largest = damping.diagonal().max();
        let factors = Ldlt::new(&damping.data.0, &[DAMPING * largest; N])?;
        let qd = SVector::from(factors.solve(&J.tr_mul(&task.wrench).into()));
        let reached = self.within_reach(&qd, arm);
        let held = self.held_back(|| self.bounds(set_point, view), arm, &reached, BRAKING)?;
        Some(tau + damping * (held - qd))
    }

    /// The joint velocity nearest to `qd` with which no point leaves the image whose derivative by the camera's twist is learnt: its `rows` in normalized
    /// coordinates, by its index.
    #[must_use]
    pub(super) fn hold_learnt<'a, const N: usize>(
        &'a self,
        (set_point, view): (&'a SetPoint, &'a View),
        rows: impl Fn(usize) -> Option<Matrix2x6<f64>> + Copy + 'a,
        arm: &Arm<N>,
        qd: SVector<f64, N>,
    ) -> SVector<f64, N> {
        let bounds = move || {
            self.bounds(set_point, view).zip(view.seen()).filter_map(move |(bound, (i, s))| {
                let rows = self.camera.pixel_jacobian(&s) * rows(i)?;
                Some(Bound { rows, growth: RowVector6::zeros(), ..bound })
            })
        };
        let held = self.held_back(bounds, arm, &self.within_reach(&qd, arm), 0.0);
        held.filter(|qd| qd.iter().all(|x| x.is_finite())).unwrap_or(qd)
    }

    /// The joint velocity nearest to `qd` that fulfils all constraints; `None` where `qd` does. `braking`: by how much below its limit the speed
    /// of a feature is set for each px/s by which it exceeds the limit now.
    fn held_back<const N: usize, Bounds: Iterator<Item = Bound>>(
        &self,
        bounds: impl Fn() -> Bounds,
        arm: &Arm<N>,
        qd: &SVector<f64, N>,
        braking: f64,
    ) -> Option<SVector<f64, N>> {
        let wanted = arm.J.matrix() * qd;
        let now = arm.J.matrix() * arm.qd;
        if bounds().all(|bound| bound.admits(&wanted, self, &now, braking)) {
            return None;
        }
        let none = Bound {
            rows: Matrix2x6::zeros(),
            growth: RowVector6::zeros(),
            left_px: [[f64::INFINITY; 2]; 2],
            multiplier: [[0.0; 2]; 2],
        };
        let mut list = [none; MAX_FEATURES];
        let mut count = 0;
        for (place, bound) in list.iter_mut().zip(bounds()) {
            *place = bound;
            count += 1;
        }
        let list = list.get_mut(..count)?;
        let mobility = mobility(&arm.J)?;
        let mut V = wanted;
        for _ in 0..SWEEPS {
            let mut worst = 0.0_f64;
            for bound in list.iter_mut() {
                worst = worst.max(bound.project(&mut V, &mobility, self, &now, braking));
            }
            if worst <= SLACK_PX_S {
                break;
            }
        }
        let change = V - wanted;
        let task = TwistTask { matrix: Matrix6::identity(), vector: change, error: change.norm() };
        Some(qd + joint_velocity(&task, 1.0, &arm.J)?)
    }

    /// The velocity of an arm on its way to `qd` after [`HORIZON_S`]: all joints change alike, as the reference lets them.
    fn within_reach<const N: usize>(&self, qd: &SVector<f64, N>, arm: &Arm<N>) -> SVector<f64, N> {
        let change = qd - arm.qd;
        let mut share = 1.0_f64;
        for (change, limit) in change.iter().zip(self.acceleration) {
            share = share.min(limit * HORIZON_S / change.abs());
        }
        if share < 1.0 { arm.qd + change * share } else { *qd }
    }

    /// The constraints of the visible features.
    fn bounds<'a>(&'a self, set_point: &'a SetPoint, view: &'a View) -> impl Iterator<Item = Bound> + 'a {
        view.seen().filter_map(move |(i, s)| {
            let (s_d, z_d_m) = (set_point.features().get(i)?, *set_point.depths_m().get(i)?);
            let z_m = view.depth_m(set_point.points().get(i)?, z_d_m);
            let rows = self.camera.pixel_jacobian(&s) * point_rows(&s, z_m);
            let (now, goal) = (self.distances_px(&s, z_m), self.distances_px(s_d, z_d_m));
            let mut left_px = [[f64::INFINITY; 2]; 2];
            for ((left, now), goal) in
                left_px.iter_mut().flatten().zip(now.iter().flatten()).zip(goal.iter().flatten())
            {
                // (to the border, the margin)
                let margin = now.1.min((1.0 - GOAL_SHARE) * goal.0);
                if goal.0 > 0.0 {
                    *left = (now.0 - margin).max(0.0);
                }
            }
            // r f / z with z_dot = -(v_z + z (y w_x - x w_y)).
            let growth = RowVector6::new(0.0, 0.0, 1.0 / z_m, s.y, -s.x, 0.0)
                * (self.mark_radius_m * self.camera.intrinsics().fx_px / z_m);
            Some(Bound { rows, growth, left_px, multiplier: [[0.0; 2]; 2] })
        })
    }

    /// How far a feature is from each border, and how far it should be, px.
    fn distances_px(&self, s: &Vector2<f64>, z_m: f64) -> [[(f64, f64); 2]; 2] {
        let i = self.camera.intrinsics();
        let px = self.camera.pixel_of(s);
        let of = |x: f64, size: u32, f_px: f64| {
            let margin = self.margin_px + self.mark_radius_m * f_px / z_m;
            [(x + 0.5, margin), (f64::from(size) - 0.5 - x, margin)]
        };
        [of(px.x, i.width_px, i.fx_px), of(px.y, i.height_px, i.fy_px)]
    }

    /// Largest outward speed, px/s, of a feature at the distance `left_px` from the margin that moves outward with `now_px_s`.
    fn largest_px_s(&self, left_px: f64, now_px_s: f64, braking: f64) -> f64 {
        let allowed = self.rate_1_s * left_px;
        allowed - braking * (now_px_s - allowed).max(0.0)
    }
}

/// Left and right, above and below.
const SIDES: [f64; 2] = [-1.0, 1.0];

impl Bound {
    /// `row V` is the speed of a mark towards the border at one `side` of an `axis`, px/s.
    fn outward(&self, axis: usize, side: f64) -> RowVector6<f64> {
        self.rows.row(axis) * side + self.growth
    }

    fn admits(&self, V: &Vector6<f64>, guard: &VisibilityGuard, now: &Vector6<f64>, braking: f64) -> bool {
        let (wanted, growing) = (self.rows * V, (self.growth * V).x);
        let (moving, grows) = (self.rows * now, (self.growth * now).x);
        self.left_px.iter().enumerate().all(|(axis, sides)| {
            sides.iter().zip(SIDES).all(|(left, side)| {
                let largest = guard.largest_px_s(*left, side * moving[axis] + grows, braking);
                side * wanted[axis] + growing <= largest
            })
        })
    }

    /// One Hildreth step for this constraint: corrects V and the multiplier. Returns by how much the constraint was violated, px/s.
    fn project(
        &mut self,
        V: &mut Vector6<f64>,
        mobility: &Matrix6<f64>,
        guard: &VisibilityGuard,
        now: &Vector6<f64>,
        braking: f64,
    ) -> f64 {
        let mut worst = 0.0_f64;
        for axis in 0..2 {
            for (k, side) in SIDES.into_iter().enumerate() {
                let row = self.outward(axis, side);
                let (left, multiplier) = (self.left_px[axis][k], &mut self.multiplier[axis][k]);
                let over = (row * *V).x - guard.largest_px_s(left, (row * now).x, braking);
                if !left.is_finite() || (over <= 0.0 && *multiplier == 0.0) {
                    continue;
                }
                let direction = mobility * row.transpose();
                let change = (over / (row * direction).x).max(-*multiplier);
                if change.is_finite() && change != 0.0 {
                    *multiplier += change;
                    *V -= direction * change;
                    worst = worst.max(over.abs());
                }
            }
        }
        worst
    }
}

/// Inverse of the weights W on the range of the camera's Jacobian, 6 x 6: the twists of which the arm is capable.
fn mobility<const N: usize>(J: &CameraJacobian<N>) -> Option<Matrix6<f64>> {
    let turn = 1.0 / (TURN_M * TURN_M);
    let all = Vector6::new(1.0, 1.0, 1.0, turn, turn, turn);
    if J.moving_joints() >= 6 {
        return Some(Matrix6::from_diagonal(&all));
    }
    let J = J.matrix();
    let weighted = SMatrix::<f64, 6, N>::from_fn(|i, j| J[(i, j)] / all[i]);
    let normal = J.tr_mul(&weighted);
    let factors = Ldlt::new(&normal.data.0, &[DAMPING * normal.diagonal().max(); N])?;
    let mut out = Matrix6::zeros();
    for i in 0..6 {
        let row: [f64; N] = std::array::from_fn(|j| J[(i, j)]);
        out.set_column(i, &(J * SVector::from(factors.solve(&row))));
    }
    Some(out)
}

#[cfg(test)]
mod tests;
