//! What an arm carries as a whole body, and the torques that each of its numbers takes.

use super::inertia::Inertia;
use super::model::Robot;
use nalgebra::{Matrix3, Vector3};

impl<const N: usize> Robot<N> {
    /// The same arm with `load` on its flange, a body in the flange's frame.
    #[must_use]
    pub fn with_load(mut self, load: &Inertia) -> Self {
        self.carry(load.mass, &load.com);
        let about_com = self.R_flange * load.about_com * self.R_flange.transpose();
        if let Some(last) = self.bodies.last_mut() {
            last.I += about_com;
        }
        self
    }

    /// The derivatives of this arm by a load that is zero: by its mass (kg), its first moment about the flange along the axes of E (kg m), and
    /// its moments of inertia about the flange's origin xx, yy, zz, xy, xz, yz along these axes (kg m^2).
    pub(crate) fn load_derivatives(&self) -> [Self; 10] {
        let [massless, ..] = self.payload_derivatives();
        let R = self.R_flange;
        let moments = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)].map(|(i, j)| {
            let mut arm = massless.clone();
            if let Some(last) = arm.bodies.last_mut() {
                let mut one = Matrix3::zeros();
                (one[(i, j)], one[(j, i)]) = (1.0, 1.0);
                (last.mass, last.h, last.I) = (0.0, Vector3::zeros(), R * one * R.transpose());
            }
            arm
        });
        let mut arms = self.payload_derivatives().into_iter().chain(moments);
        std::array::from_fn(|_| arms.next().unwrap_or_else(|| massless.clone()))
    }
}
