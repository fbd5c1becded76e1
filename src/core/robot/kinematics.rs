//! Forward kinematics and the geometric Jacobian, in the order `[v; w]` of (10.16).

use super::joint_axis::{turn_about_z, z_axis};
use super::model::Robot;
use super::trig::sines_and_cosines;
use crate::geometry::{Pose, Twist};
use crate::linalg::products3::{cross, mul, mul_mat};
use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, Translation3, UnitQuaternion, Vector3};

/// The frame in which the columns of a Jacobian are expressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ExpressedIn {
    /// The base frame B.
    Base,
    /// The frame that moves (camera or tool) C.
    Moving,
}

/// Sine and cosine of every joint's position; those of a sliding joint are not used.
pub(super) type Trig<const N: usize> = [(f64, f64); N];

/// Orientation and origin of every body's frame in B.
pub(super) struct BodyFrames<const N: usize> {
    pub(super) R: [Matrix3<f64>; N],
    pub(super) p: [Vector3<f64>; N],
}

impl<const N: usize> Robot<N> {
    #[inline(always)]
    pub(super) fn trig(&self, q: &SVector<f64, N>) -> Trig<N> {
        sines_and_cosines(&q.data.0[0])
    }

    #[inline(always)]
    pub(super) fn frames(&self, q: &SVector<f64, N>, trig: &Trig<N>) -> BodyFrames<N> {
        let mut frames = BodyFrames { R: [Matrix3::identity(); N], p: [Vector3::zeros(); N] };
        let (mut R, mut p) = (Matrix3::identity(), Vector3::zeros());
        for i in 0..N {
            let body = &self.bodies[i];
            if i == 0 {
                (R, p) = (body.R, body.p);
            } else {
                p += mul(&R, &body.p);
                R = mul_mat(&R, &body.R);
            }
            if body.prismatic {
                p += z_axis(&R) * q[i];
            } else {
                R = turn_about_z(&R, trig[i]);
            }
            frames.R[i] = R;
            frames.p[i] = p;
        }
        frames
    }

    /// Orientation and origin of the flange in B.
    #[inline(always)]
    fn flange(&self, frames: &BodyFrames<N>) -> (Matrix3<f64>, Vector3<f64>) {
        match (frames.R.last(), frames.p.last()) {
            (Some(R), Some(p)) => (mul_mat(R, &self.R_flange), p + mul(R, &self.p_flange)),
            _ => (self.R_flange, self.p_flange),
        }
    }

    /// The columns of the Jacobian of the point `p_B` fixed to the last link, expressed in B.
    #[inline(always)]
    fn columns(&self, frames: &BodyFrames<N>, p_B: &Vector3<f64>) -> SMatrix<f64, 6, N> {
        let mut J = SMatrix::<f64, 6, N>::zeros();
        for i in 0..N {
            let z = z_axis(&frames.R[i]);
            let (v, w) = if self.bodies[i].prismatic {
                (z, Vector3::zeros())
            } else {
                (cross(&z, &(p_B - frames.p[i])), z)
            };
            J[(0, i)] = v.x;
            J[(1, i)] = v.y;
            J[(2, i)] = v.z;
            J[(3, i)] = w.x;
            J[(4, i)] = w.y;
            J[(5, i)] = w.z;
        }
        J
    }

    /// The flange's pose `X_BE`.
    #[must_use]
    pub fn forward(&self, q: &SVector<f64, N>) -> Pose {
        let (R, p) = self.flange(&self.frames(q, &self.trig(q)));
        pose(&R, &p)
    }

    /// The origins of the link frames in B, which lie on the joints' axes, from the base to the tip.
    #[must_use]
    pub fn joint_origins(&self, q: &SVector<f64, N>) -> [Vector3<f64>; N] {
        self.frames(q, &self.trig(q)).p
    }

    /// The geometric Jacobian of the flange's origin, 6 x N, expressed in B: `V_BE_B = J qd`.
    #[must_use]
    pub fn jacobian(&self, q: &SVector<f64, N>) -> SMatrix<f64, 6, N> {
        let frames = self.frames(q, &self.trig(q));
        let p = match (frames.R.last(), frames.p.last()) {
            (Some(R), Some(p)) => p + mul(R, &self.p_flange),
            _ => self.p_flange,
        };
        self.columns(&frames, &p)
    }

    /// Pose `X_BC` and Jacobian of a camera or tool frame that sits at `X_EC` on the flange, in one pass.
    ///
    /// The Jacobian is 6 x N and gives `V_BC` expressed in B or in C.
    #[must_use]
    pub fn forward_and_jacobian_of_frame(
        &self,
        q: &SVector<f64, N>,
        X_EC: &Pose,
        expressed_in: ExpressedIn,
    ) -> (Pose, SMatrix<f64, 6, N>) {
        let frames = self.frames(q, &self.trig(q));
        let (R_BE, p_E) = self.flange(&frames);
        let X_BC = pose(&R_BE, &p_E) * X_EC;
        let mut J = self.columns(&frames, &X_BC.translation.vector);
        if expressed_in == ExpressedIn::Moving {
            turn_into(&X_BC, &mut J);
        }
        (X_BC, J)
    }

    /// Orientation and origin in B of the frame of the link behind the first `joints` joints, as the robot file places it; from 1.
    #[inline(always)]
    fn link(&self, frames: &BodyFrames<N>, joints: usize) -> Pose {
        let i = joints.clamp(1, N) - 1;
        match (frames.R.get(i), frames.p.get(i), self.links.get(i)) {
            (Some(R), Some(p), Some((R_ML, p_ML))) => pose(&mul_mat(R, R_ML), &(p + mul(R, p_ML))),
            _ => Pose::identity(), // of an arm without joints
        }
    }

    /// The pose `X_BL` of the link behind the first `joints` joints, counted from 1; its frame is that of the robot file.
    #[must_use]
    pub fn forward_to_link(&self, q: &SVector<f64, N>, joints: usize) -> Pose {
        self.link(&self.frames(q, &self.trig(q)), joints)
    }

    /// Pose `X_BC` of a frame that sits at `X_LC` on the link behind the first `joints` joints, and its Jacobian, 6 x N, which gives `V_BC` expressed in C.
    /// The columns of the joints beyond are zero.
    #[must_use]
    pub fn forward_and_jacobian_on_link(
        &self,
        q: &SVector<f64, N>,
        joints: usize,
        X_LC: &Pose,
    ) -> (Pose, SMatrix<f64, 6, N>) {
        let frames = self.frames(q, &self.trig(q));
        let X_BC = self.link(&frames, joints) * X_LC;
        let mut J = self.columns(&frames, &X_BC.translation.vector);
        J.column_iter_mut().skip(joints).for_each(|mut column| column.fill(0.0));
        turn_into(&X_BC, &mut J);
        (X_BC, J)
    }

    /// The Jacobian part of [`Self::forward_and_jacobian_of_frame`].
    #[must_use]
    pub fn jacobian_of_frame(
        &self,
        q: &SVector<f64, N>,
        X_EC: &Pose,
        expressed_in: ExpressedIn,
    ) -> SMatrix<f64, 6, N> {
        self.forward_and_jacobian_of_frame(q, X_EC, expressed_in).1
    }
}

/// Expresses a Jacobian in B in the frame C.
#[inline(always)]
fn turn_into<const N: usize>(X_BC: &Pose, J: &mut SMatrix<f64, 6, N>) {
    let R_CB = X_BC.rotation.to_rotation_matrix().inverse();
    for mut column in J.column_iter_mut() {
        let v = mul(R_CB.matrix(), &Vector3::new(column[0], column[1], column[2]));
        let w = mul(R_CB.matrix(), &Vector3::new(column[3], column[4], column[5]));
        column.copy_from(&Twist::new(v.x, v.y, v.z, w.x, w.y, w.z));
    }
}

fn pose(R: &Matrix3<f64>, p: &Vector3<f64>) -> Pose {
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*R));
    Pose::from_parts(Translation3::from(*p), rotation)
}
