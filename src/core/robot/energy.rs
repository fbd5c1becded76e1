//! Kinetic and potential energy: what an arm without torque and friction must conserve.

use super::model::Robot;
use crate::linalg::products3::{dot, mul};
use nalgebra::SVector;

impl<const N: usize> Robot<N> {
    /// `qd^T B(q) qd / 2` in J; rotors are included.
    #[must_use]
    pub fn kinetic_energy(&self, q: &SVector<f64, N>, qd: &SVector<f64, N>) -> f64 {
        0.5 * qd.dot(&(self.mass_matrix(q) * qd))
    }

    /// `-sum m_i g . p_i` in J: zero when every centre of mass lies level with the base's origin.
    #[must_use]
    pub fn potential_energy(&self, q: &SVector<f64, N>) -> f64 {
        let frames = self.frames(q, &self.trig(q));
        let mut energy = 0.0;
        for i in 0..N {
            let body = &self.bodies[i];
            energy -= dot(&self.gravity_B, &(frames.p[i] * body.mass + mul(&frames.R[i], &body.h)));
        }
        energy
    }
}
