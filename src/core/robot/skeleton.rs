//! The axes and origins of an arm's joints and its flange in B, from which the place and the velocity of any point on it follow.
//!
//! A point `p` that is fixed to a link, or to anything it carries, moves with `v = sum_i qd_i (z_i x (p - p_i))` over the joints before it that turn, and
//! with `z_i qd_i` for those that slide.

use super::joint_axis::z_axis;
use super::model::Robot;
use crate::linalg::products3::{cross, mul, mul_mat};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

/// An arm in one posture.
#[derive(Debug, Clone, Copy)]
pub struct Skeleton<const N: usize> {
    axis: [Vector3<f64>; N],
    origin: [Vector3<f64>; N],
    slides: [bool; N],
    R_BE: Matrix3<f64>,
    p_BE: Vector3<f64>,
}

impl<const N: usize> Robot<N> {
    /// The axes, origins and flange in the posture `q`, rad or m.
    #[must_use]
    pub fn skeleton(&self, q: &SVector<f64, N>) -> Skeleton<N> {
        let frames = self.frames(q, &self.trig(q));
        let (R, p) = match (frames.R.last(), frames.p.last()) {
            (Some(R), Some(p)) => (mul_mat(R, &self.R_flange), p + mul(R, &self.p_flange)),
            _ => (self.R_flange, self.p_flange),
        };
        Skeleton {
            axis: frames.R.map(|R| z_axis(&R)),
            origin: frames.p,
            slides: std::array::from_fn(|i| self.bodies[i].prismatic),
            R_BE: R,
            p_BE: p,
        }
    }
}

impl<const N: usize> Skeleton<N> {
    /// The origin of the frame of link `i`, from 0, in B, m; B's own for links that there are not.
    #[must_use]
    pub fn origin(&self, i: usize) -> Vector3<f64> {
        self.origin.get(i).copied().unwrap_or_else(Vector3::zeros)
    }

    /// The direction in B of the axis about which joint `i`, from 0, turns, or along which it slides; zero for joints that there are not.
    #[must_use]
    pub fn axis(&self, i: usize) -> Vector3<f64> {
        self.axis.get(i).copied().unwrap_or_else(Vector3::zeros)
    }

    /// The point `p_E` of the flange's frame, m, in B.
    #[must_use]
    pub fn on_flange(&self, p_E: &Vector3<f64>) -> Vector3<f64> {
        self.p_BE + mul(&self.R_BE, p_E)
    }

    /// Velocity in B of the point `p` (m, in B) of a link behind joint `i` for each rad/s or m/s of that joint.
    #[must_use]
    pub fn velocity_of(&self, i: usize, p: &Vector3<f64>) -> Vector3<f64> {
        match (self.axis.get(i), self.origin.get(i), self.slides.get(i)) {
            (Some(z), _, Some(true)) => *z,
            (Some(z), Some(origin), _) => cross(z, &(p - origin)),
            _ => Vector3::zeros(),
        }
    }

    /// The rate at which the point `p` (m, in B), which the joints before `joints` move, goes along `n` for each rad/s or m/s of every joint.
    #[must_use]
    pub fn rates_along(&self, n: &Vector3<f64>, p: &Vector3<f64>, joints: usize) -> SVector<f64, N> {
        SVector::from_fn(|i, _| if i < joints { n.dot(&self.velocity_of(i, p)) } else { 0.0 })
    }

    /// The geometric Jacobian of the point `p` (m, in B) of the flange, 6 x N, expressed in B: `[v; w]`.
    #[must_use]
    pub fn jacobian_at(&self, p: &Vector3<f64>) -> SMatrix<f64, 6, N> {
        let mut J = SMatrix::<f64, 6, N>::zeros();
        for i in 0..N {
            let (v, w) =
                (self.velocity_of(i, p), if self.slides[i] { Vector3::zeros() } else { self.axis[i] });
            J[(0, i)] = v.x;
            J[(1, i)] = v.y;
            J[(2, i)] = v.z;
            J[(3, i)] = w.x;
            J[(4, i)] = w.y;
            J[(5, i)] = w.z;
        }
        J
    }
}

#[cfg(test)]
mod tests {
    use crate::robot::{ExpressedIn, load};
    use nalgebra::{Translation3, Vector3, Vector4, Vector6};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn places_are_those_of_the_forward_kinematics(q in prop::array::uniform6(-3.0..3.0f64), p in prop::array::uniform3(-0.2..0.2f64)) {
            let (robot, q, p) = (load("ur5").unwrap().build::<6>().unwrap(), Vector6::from(q), Vector3::from(p));
            let (s, X_EC) = (robot.skeleton(&q), Translation3::from(p).into());
            let (X_BC, J) = robot.forward_and_jacobian_of_frame(&q, &X_EC, ExpressedIn::Base);
            let there = s.on_flange(&p);
            prop_assert!((there - X_BC.translation.vector).norm() < 1e-12);
            prop_assert!((s.jacobian_at(&there) - J).norm() < 1e-12);
            for (i, origin) in robot.joint_origins(&q).into_iter().enumerate() {
                prop_assert!((s.origin(i) - origin).norm() == 0.0);
            }
        }

        /// Rates against the way that a point of a link makes.
        #[test]
        fn rates_are_the_derivatives_of_places(q in prop::array::uniform4(-1.0..1.0f64), n in prop::array::uniform3(-1.0..1.0f64), link in 0usize..4) {
            let (robot, q, n) = (load("scara").unwrap().build::<4>().unwrap(), Vector4::from(q), Vector3::from(n));
            let s = robot.skeleton(&q);
            let rates = s.rates_along(&n, &s.origin(link), link + 1);
            for i in 0..4 {
                let mut step = Vector4::zeros();
                step[i] = 1e-6;
                let at = |q: &Vector4<f64>| n.dot(&robot.skeleton(q).origin(link));
                let slope = (at(&(q + step)) - at(&(q - step))) / 2e-6;
                prop_assert!((slope - rates[i]).abs() < 1e-8, "{slope} {}", rates[i]);
            }
        }
    }
}
