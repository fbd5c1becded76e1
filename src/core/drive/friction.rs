//! Joint friction over a time step, implicit: Coulomb friction changes its sign within 1 mm/s or 1 mrad/s, and light
//! wrists with heavy gears come to the speed that friction allows within microseconds; both far too stiff for an
//! explicit step.
//!
//! ```text
//! B v' + h F(v') = p
//! ```
//! with the momentum `p` that the step leads to without the friction at its end: that of the velocity `smooth` plus an
//! `impulse`. The left side is the gradient of
//! a convex function of `v'`, so Newton's method with a line search finds the one solution from anywhere.

use crate::linalg::Ldlt;
use crate::robot::Robot;
use nalgebra::SVector;

/// Most Newton steps. Chosen by hand: two or three are usual, and with the halvings each step reduces the residual.
const MAX_STEPS: usize = 40;
/// Halvings of a step that goes too far.
const HALVINGS: usize = 12;
/// A step that changes speeds (rad/s or m/s) by less ends the iteration. Chosen by hand, above the rounding of a speed of 10 rad/s (2e-15).
const GOOD_ENOUGH: f64 = 1e-12;

/// The joint velocities `v'` at the end of a step of `h` seconds in posture `q`, sought from `v` on.
pub(super) fn after_friction<const N: usize>(
    robot: &Robot<N>,
    q: &SVector<f64, N>,
    mut v: SVector<f64, N>,
    (smooth, impulse): (&SVector<f64, N>, &SVector<f64, N>),
    h: f64,
) -> SVector<f64, N> {
    let B = robot.mass_matrix(q);
    let p = B * smooth + impulse;
    let gradient = |v: &SVector<f64, N>| B * v + robot.friction_torque(v) * h - p;
    for _ in 0..MAX_STEPS {
        let slope = robot.friction_slope(&v);
        // Positive definite, as the mass matrix is.
        let Some(factors) = Ldlt::new(&B.data.0, &(slope * h).into()) else { return v };
        let step = -SVector::from(factors.solve(&gradient(&v).into()));
        let downhill = |t: f64| gradient(&(v + step * t)).dot(&step) <= 0.0;
        let t = if downhill(1.0) {
            1.0
        } else {
            let (mut near, mut far) = (0.0, 1.0);
            for _ in 0..HALVINGS {
                let middle = 0.5 * (near + far);
                *(if downhill(middle) { &mut near } else { &mut far }) = middle;
            }
            0.5 * (near + far)
        };
        v += step * t;
        if step.amax() * t < GOOD_ENOUGH {
            break;
        }
    }
    v
}

/// Whether any joint has friction.
pub(super) fn has_friction<const N: usize>(robot: &Robot<N>) -> bool {
    robot.friction().iter().any(|f| f.viscous != 0.0 || f.coulomb != 0.0)
}
