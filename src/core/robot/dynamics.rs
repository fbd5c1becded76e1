//! Inverse dynamics by the recursive Newton-Euler algorithm, `B(q) qdd + C(q, qd) qd + g(q) = tau`, and its parts.
//!
//! Every body is worked on in its own frame, whose z is the joint's axis: outwards the motion, inwards the forces.
//! Textbook rotors: a motor sits on the link before its joint and spins about the joint's axis z at `k_r qd` against
//! that link. Its mass and its inertia at rest belong to that link; what is left is the angular momentum
//! `k_r I_m qd z`, which turns with the link, and the joint's own share `k_r I_m (z . dw/dt + k_r qdd)`.

use super::joint_axis::{turn_about_z, z_axis};
use super::kinematics::Trig;
use super::model::Robot;
use crate::linalg::products3::{cross, dot, mul, tr_mul};
use nalgebra::{Matrix3, SVector, Vector3};

impl<const N: usize> Robot<N> {
    /// The joint torques (N m or N) that make the arm accelerate with `qdd`; rotors and gravity are included, friction is not.
    #[must_use]
    pub fn inverse_dynamics(
        &self,
        q: &SVector<f64, N>,
        qd: &SVector<f64, N>,
        qdd: &SVector<f64, N>,
    ) -> SVector<f64, N> {
        self.newton_euler(&self.trig(q), q, qd, qdd)
    }

    /// The joint torques (N m or N) of two accelerations in the same motion, as [`Self::inverse_dynamics`] gives them.
    #[must_use]
    pub fn inverse_dynamics_of(
        &self,
        q: &SVector<f64, N>,
        qd: &SVector<f64, N>,
        qdd: [&SVector<f64, N>; 2],
    ) -> [SVector<f64, N>; 2] {
        let trig = self.trig(q);
        qdd.map(|qdd| self.newton_euler(&trig, q, qd, qdd))
    }

    /// `g(q)`: the torques that hold the arm still.
    #[must_use]
    pub fn gravity(&self, q: &SVector<f64, N>) -> SVector<f64, N> {
        let frames = self.frames(q, &self.trig(q));
        let mut tau = SVector::<f64, N>::zeros();
        // First moment of all links from i on about the origin of frame i, in B.
        let (mut mass, mut h, mut p) = (0.0, Vector3::zeros(), Vector3::zeros());
        for i in (0..N).rev() {
            let body = &self.bodies[i];
            h += (p - frames.p[i]) * mass + mul(&frames.R[i], &body.h);
            mass += body.mass;
            p = frames.p[i];
            let z = z_axis(&frames.R[i]);
            tau[i] = if body.prismatic {
                -mass * dot(&z, &self.gravity_B)
            } else {
                -dot(&cross(&z, &h), &self.gravity_B)
            };
        }
        tau
    }

    pub(super) fn newton_euler(
        &self,
        trig: &Trig<N>,
        q: &SVector<f64, N>,
        qd: &SVector<f64, N>,
        qdd: &SVector<f64, N>,
    ) -> SVector<f64, N> {
        let mut R = [Matrix3::zeros(); N];
        let mut p = [Vector3::zeros(); N];
        let mut force = [Vector3::zeros(); N];
        let mut moment = [Vector3::zeros(); N];
        let mut rotor_moment = [Vector3::zeros(); N];
        let mut tau = SVector::<f64, N>::zeros();

        let (mut w, mut w_dot) = (Vector3::zeros(), Vector3::zeros());
        let mut a = -self.gravity_B;
        for i in 0..N {
            let body = &self.bodies[i];
            R[i] = if body.prismatic { body.R } else { turn_about_z(&body.R, trig[i]) };
            p[i] = if body.prismatic { body.p + z_axis(&body.R) * q[i] } else { body.p };
            a = tr_mul(&R[i], &(a + cross(&w_dot, &p[i]) + cross(&w, &cross(&w, &p[i]))));
            w = tr_mul(&R[i], &w);
            w_dot = tr_mul(&R[i], &w_dot);
            // (w x z) for the link before, in this frame; z = (0, 0, 1).
            let w_cross_z = Vector3::new(w.y, -w.x, 0.0);
            let coupling = body.rotor_coupling;
            rotor_moment[i] = w_cross_z * (coupling * qd[i]) + Vector3::new(0.0, 0.0, coupling * qdd[i]);
            tau[i] = coupling * w_dot.z + body.rotor_own * qdd[i];
            if body.prismatic {
                a += w_cross_z * (2.0 * qd[i]);
                a.z += qdd[i];
            } else {
                w_dot += w_cross_z * qd[i];
                w_dot.z += qdd[i];
                w.z += qd[i];
            }
            force[i] = a * body.mass + cross(&w_dot, &body.h) + cross(&w, &cross(&w, &body.h));
            moment[i] = mul(&body.I, &w_dot) + cross(&w, &mul(&body.I, &w)) + cross(&body.h, &a);
        }

        let (mut f, mut n) = (Vector3::zeros(), Vector3::zeros());
        for i in (0..N).rev() {
            f += force[i];
            n += moment[i];
            tau[i] += if self.bodies[i].prismatic { f.z } else { n.z };
            n += rotor_moment[i];
            f = mul(&R[i], &f);
            n = mul(&R[i], &n) + cross(&p[i], &f);
        }
        tau
    }
}
