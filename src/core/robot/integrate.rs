//! The motion of an arm under torque, step by step.

use super::model::Robot;
use nalgebra::SVector;

impl<const N: usize> Robot<N> {
    /// One Runge-Kutta step of fourth order, `h` s long, under the constant torques `tau`: positions and velocities at its
    /// end. Rotors and gravity are included, friction is not.
    #[must_use]
    pub fn integrate(
        &self,
        q: &SVector<f64, N>,
        qd: &SVector<f64, N>,
        tau: &SVector<f64, N>,
        h: f64,
    ) -> (SVector<f64, N>, SVector<f64, N>) {
        let acceleration = |q: &SVector<f64, N>, qd: &SVector<f64, N>| self.forward_dynamics(q, qd, tau);
        let a1 = acceleration(q, qd);
        let qd2 = qd + a1 * (h / 2.0);
        let a2 = acceleration(&(q + qd * (h / 2.0)), &qd2);
        let qd3 = qd + a2 * (h / 2.0);
        let a3 = acceleration(&(q + qd2 * (h / 2.0)), &qd3);
        let qd4 = qd + a3 * h;
        let a4 = acceleration(&(q + qd3 * h), &qd4);
        (q + (qd + qd2 * 2.0 + qd3 * 2.0 + qd4) * (h / 6.0), qd + (a1 + a2 * 2.0 + a3 * 2.0 + a4) * (h / 6.0))
    }
}
