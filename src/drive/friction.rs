//! Joint friction over a time step, implicit: Coulomb friction changes its sign within 1 mm/s or 1 mrad/s, far too
//! stiff for an explicit step.
//!
//! ```text
//! B (v' - v) = -h F(v'),   F(v) = D(v) v   solved by (B + h D(v_k)) v_{k+1} = B v
//! ```
//! `D` is the secant of the friction torque, which is never negative: the step takes energy off whatever its length.

use crate::robot::Robot;
use nalgebra::SVector;

/// Sweeps of the fixed point; each at least halves the error here.
const MOST_SWEEPS: usize = 12;
/// A sweep that changes speeds (rad/s or m/s) by less ends it.
const GOOD_ENOUGH: f64 = 1e-10;
/// Below this speed the secant is taken at this speed.
const SMALLEST_SPEED: f64 = 1e-9;

/// Joint velocities after friction has acted on `v` for `h` seconds in posture `q`.
pub(super) fn after_friction<const N: usize>(
    robot: &Robot<N>,
    q: &SVector<f64, N>,
    v: &SVector<f64, N>,
    h: f64,
) -> SVector<f64, N> {
    let B = robot.mass_matrix(q);
    let momentum = B * v;
    let mut next = *v;
    for _ in 0..MOST_SWEEPS {
        let at = next.map(|v| if v.abs() < SMALLEST_SPEED { SMALLEST_SPEED } else { v });
        let force = robot.friction_torque(&at);
        let mut A = B;
        for i in 0..N {
            A[(i, i)] += h * force[i] / at[i];
        }
        // Positive definite, as the mass matrix is; without an answer friction waits for the next step.
        let Some(factor) = nalgebra::Cholesky::new(A) else { return next };
        let better = factor.solve(&momentum);
        let change = (better - next).amax();
        next = better;
        if change < GOOD_ENOUGH {
            break;
        }
    }
    next
}

/// Whether any joint has friction.
pub(super) fn has_friction<const N: usize>(robot: &Robot<N>) -> bool {
    robot.friction().iter().any(|f| f.viscous != 0.0 || f.coulomb != 0.0)
}
