//! The inertia matrix B(q) by composite rigid bodies, and forward dynamics with its factors.

use super::joint_axis::z_axis;
use super::kinematics::Trig;
use super::model::Robot;
use crate::linalg::Ldlt;
use crate::linalg::products3::{cross, dot, mul};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// A symmetric 3x3 matrix: xx, yy, zz, xy, xz, yz.
#[derive(Clone, Copy, Default)]
struct Symmetric([f64; 6]);

impl Symmetric {
    /// `R I R^T`.
    #[inline(always)]
    fn rotated(R: &Matrix3<f64>, I: &Matrix3<f64>) -> Self {
        let row = |r: &Vector3<f64>| {
            Vector3::new(
                I.m11 * r.x + I.m12 * r.y + I.m13 * r.z,
                I.m12 * r.x + I.m22 * r.y + I.m23 * r.z,
                I.m13 * r.x + I.m23 * r.y + I.m33 * r.z,
            )
        };
        let (x, y, z) = (
            Vector3::new(R.m11, R.m12, R.m13),
            Vector3::new(R.m21, R.m22, R.m23),
            Vector3::new(R.m31, R.m32, R.m33),
        );
        let (Ix, Iy, Iz) = (row(&x), row(&y), row(&z));
        Self([dot(&x, &Ix), dot(&y, &Iy), dot(&z, &Iz), dot(&x, &Iy), dot(&x, &Iz), dot(&y, &Iz)])
    }

    #[inline(always)]
    fn mul(&self, v: &Vector3<f64>) -> Vector3<f64> {
        let [xx, yy, zz, xy, xz, yz] = self.0;
        Vector3::new(
            xx * v.x + xy * v.y + xz * v.z,
            xy * v.x + yy * v.y + yz * v.z,
            xz * v.x + yz * v.y + zz * v.z,
        )
    }

    #[inline(always)]
    fn add(&mut self, other: &Self) {
        for (a, b) in self.0.iter_mut().zip(other.0) {
            *a += b;
        }
    }

    /// Moves the reference point of a body of `mass` and first moment `h` back by `r` (so that it lies at `+r`).
    #[inline(always)]
    fn shift(&mut self, mass: f64, h: &Vector3<f64>, r: &Vector3<f64>) {
        // 2 (h . r) 1 - h r^T - r h^T + m (|r|^2 1 - r r^T), with u = h + m r / 2.
        let u = h + r * (0.5 * mass);
        let (x, y, z) = (2.0 * u.x * r.x, 2.0 * u.y * r.y, 2.0 * u.z * r.z);
        self.0[0] += y + z;
        self.0[1] += x + z;
        self.0[2] += x + y;
        self.0[3] -= u.x * r.y + u.y * r.x;
        self.0[4] -= u.x * r.z + u.z * r.x;
        self.0[5] -= u.y * r.z + u.z * r.y;
    }
}

impl<const N: usize> Robot<N> {
    /// The inertia matrix B(q), N x N, symmetric; rotors are included.
    #[must_use]
    pub fn mass_matrix(&self, q: &SVector<f64, N>) -> SMatrix<f64, N, N> {
        self.composite_bodies(&self.trig(q), q)
    }

    pub(super) fn composite_bodies(&self, trig: &Trig<N>, q: &SVector<f64, N>) -> SMatrix<f64, N, N> {
        let frames = self.frames(q, trig);
        let mut B = SMatrix::<f64, N, N>::zeros();
        // All links from i on as one body: its moments about the origin of frame i, in B.
        let (mut mass, mut h, mut I) = (0.0, Vector3::zeros(), Symmetric::default());
        let mut p = Vector3::zeros();
        for i in (0..N).rev() {
            let body = &self.bodies[i];
            let r = p - frames.p[i];
            I.shift(mass, &h, &r);
            I.add(&Symmetric::rotated(&frames.R[i], &body.I));
            h += r * mass + mul(&frames.R[i], &body.h);
            mass += body.mass;
            p = frames.p[i];

            // Momentum (linear; angular about p) of that body while joint i alone moves at unit speed.
            let z = z_axis(&frames.R[i]);
            let (linear, mut angular) =
                if body.prismatic { (z * mass, cross(&h, &z)) } else { (cross(&z, &h), I.mul(&z)) };
            B[(i, i)] = body.rotor_own + if body.prismatic { dot(&z, &linear) } else { dot(&z, &angular) };
            angular += z * body.rotor_coupling;
            let mut about = p;
            for j in (0..i).rev() {
                angular += cross(&(about - frames.p[j]), &linear);
                about = frames.p[j];
                let moved = if self.bodies[j].prismatic { &linear } else { &angular };
                let value = dot(&z_axis(&frames.R[j]), moved);
                B[(i, j)] = value;
                B[(j, i)] = value;
            }
        }
        B
    }

    /// The accelerations (rad/s^2 or m/s^2) under the torques `tau`; rotors and gravity are included, friction is not.
    ///
    /// A state that is not finite gives NaN.
    #[must_use]
    pub fn forward_dynamics(
        &self,
        q: &SVector<f64, N>,
        qd: &SVector<f64, N>,
        tau: &SVector<f64, N>,
    ) -> SVector<f64, N> {
        let trig = self.trig(q);
        let rest = tau - self.newton_euler(&trig, q, qd, &SVector::zeros());
        // B(q) of an arm that passed the checks at loading is positive definite at every finite q.
        Ldlt::of(&self.composite_bodies(&trig, q))
            .map_or_else(|| SVector::repeat(f64::NAN), |factors| factors.solve(&rest.into()).into())
    }
}
