//! Joint friction with a memory (LuGre): teeth and grease of a gear yield like bristles before they slip, so that a joint that sticks moves by a little, and springs back.
//!
//! ```text
//! z' = v - |v| z / z_s(v)      f = s z + c z' + D v      z_s = w level(v), the bristles' way; s = F_c / w; c = sqrt(s B_ii), half of what damps critically
//! ```
//! The bristles are far too stiff for an explicit step. With `|v|` that of the step's beginning, all is linear in the velocity at its end:
//!
//! ```text
//! z+ = a (z + h v+), a = 1 / (1 + h |v| / z_s)      (B + h diag(k)) v+ = p - h f_0
//! ```

use super::HardFriction;
use crate::linalg::Ldlt;
use crate::robot::Robot;
use nalgebra::SVector;

/// The bristles of the joints of an arm.
#[derive(Debug, Clone)]
pub(super) struct Bristles<const N: usize> {
    /// By how much each joint's bend, rad or m.
    bend: SVector<f64, N>,
    /// By how much they bend before they slip under the Coulomb friction of motion, rad or m.
    way: f64,
    hard: HardFriction,
}

impl<const N: usize> Bristles<N> {
    /// Bristles that are straight.
    pub(super) fn new(hard: HardFriction, way: f64) -> Self {
        Self { bend: SVector::zeros(), way, hard }
    }

    /// The torque that opposes the motion `v`, N m or N, bending of the bristles left out.
    pub(super) fn torque(&self, robot: &Robot<N>, v: &SVector<f64, N>) -> SVector<f64, N> {
        SVector::from_fn(|i, _| {
            let friction = &robot.friction()[i];
            friction.coulomb / self.way * self.bend[i] + friction.viscous * v[i]
        })
    }

    /// The joint velocities at the end of a step of `h` seconds in posture `q` that begins with `v`; the momentum as in `friction`.
    pub(super) fn after(
        &mut self,
        robot: &Robot<N>,
        q: &SVector<f64, N>,
        v: &SVector<f64, N>,
        (smooth, impulse): (&SVector<f64, N>, &SVector<f64, N>),
        h: f64,
    ) -> SVector<f64, N> {
        let B = robot.mass_matrix(q);
        let most = v.map(|v| self.way * self.hard.level(v));
        let keeps = v.zip_map(&most, |v, most| 1.0 / (1.0 + h * v.abs() / most));
        let (mut p, mut slope) = (B * smooth + impulse, SVector::<f64, N>::zeros());
        for i in 0..N {
            let friction = &robot.friction()[i];
            let stiffness = friction.coulomb / self.way;
            let damping = (stiffness * B[(i, i)]).sqrt();
            let held = stiffness * keeps[i] + damping * (keeps[i] - 1.0) / h;
            p[i] -= h * held * self.bend[i];
            slope[i] = h * (stiffness * keeps[i] * h + damping * keeps[i] + friction.viscous);
        }
        // Positive definite, as the mass matrix is.
        let Some(factors) = Ldlt::new(&B.data.0, &slope.into()) else { return *v };
        let after: SVector<f64, N> = SVector::from(factors.solve(&p.into()));
        for i in 0..N {
            self.bend[i] = (keeps[i] * (self.bend[i] + h * after[i])).clamp(-most[i], most[i]);
        }
        after
    }
}
