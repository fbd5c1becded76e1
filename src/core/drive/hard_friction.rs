//! Joint friction with a jump at standstill, over a time step: a joint that stands is held by up to its static friction, one that moves is
//! braked by the Stribeck curve. Nothing creeps, and a joint that is pushed from its place jerks: what the smooth friction of the model
//! hides from a controller.
//!
//! ```text
//! standing:  |f| <= ratio F_c         moving:  f = D v + sign(v) F_c (1 + (ratio - 1) exp(-(v / v_s)^2))
//! B v' + h F(v') = p                  over a step of h seconds, the momentum p as in `friction`
//! ```
//! With the level of the curve that of the step's beginning, the left side is the gradient of a strictly convex function with
//! corners at `v_i' = 0`. Descent along one joint after the other finds its one minimum; each has a closed form.

use crate::robot::Robot;
use nalgebra::SVector;

/// Most sweeps over the joints. Chosen by hand: where axes nearly coincide some dozens are needed.
const MAX_SWEEPS: usize = 400;
/// A sweep that changes speeds (rad/s or m/s) by less ends the iteration. Chosen by hand, above the rounding of a speed of 10 rad/s (2e-15).
const GOOD_ENOUGH: f64 = 1e-11;

/// Friction with a jump at standstill.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HardFriction {
    /// Static friction over the Coulomb friction of motion, at least 1.
    pub static_ratio: f64,
    /// Speed over which the one becomes the other, rad/s or m/s.
    pub stribeck_speed: f64,
}

impl HardFriction {
    /// Of Coulomb friction, the share that acts at the speed `v`, rad/s or m/s.
    pub(super) fn level(&self, v: f64) -> f64 {
        1.0 + (self.static_ratio - 1.0) * (-(v / self.stribeck_speed).powi(2)).exp()
    }

    /// The torque that opposes the motion `v`, N m or N; of joints that stand, none.
    pub(super) fn torque<const N: usize>(&self, robot: &Robot<N>, v: &SVector<f64, N>) -> SVector<f64, N> {
        SVector::from_fn(|i, _| {
            let friction = &robot.friction()[i];
            let sign = if v[i] == 0.0 { 0.0 } else { v[i].signum() };
            friction.viscous * v[i] + friction.coulomb * self.level(v[i]) * sign
        })
    }

    /// The joint velocities at the end of a step of `h` seconds in posture `q` that begins with `v`.
    pub(super) fn after<const N: usize>(
        &self,
        robot: &Robot<N>,
        q: &SVector<f64, N>,
        v: &SVector<f64, N>,
        (smooth, impulse): (&SVector<f64, N>, &SVector<f64, N>),
        h: f64,
    ) -> SVector<f64, N> {
        let B = robot.mass_matrix(q);
        let p = B * smooth + impulse;
        let mut after = *v;
        for _ in 0..MAX_SWEEPS {
            let mut change = 0.0_f64;
            for i in 0..N {
                let friction = &robot.friction()[i];
                let left = p[i] - (B.row(i) * after)[0] + B[(i, i)] * after[i];
                let hold = h * friction.coulomb * self.level(v[i]);
                let next = (left.abs() - hold).max(0.0).copysign(left) / (B[(i, i)] + h * friction.viscous);
                change = change.max((next - after[i]).abs());
                after[i] = next;
            }
            if change < GOOD_ENOUGH {
                break;
            }
        }
        after
    }
}
