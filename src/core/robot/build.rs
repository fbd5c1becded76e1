//! From a description to the chain with which everything is computed: link frames are turned so that z is the joint's axis, and motors are added.

use super::description::RobotDescription;
use super::error::{Defect, RobotError};
use super::inertia::Inertia;
use super::model::{Body, Robot};
use crate::geometry::{Pose, rotation_x};
use crate::linalg::Ldlt;
use nalgebra::{Matrix3, SVector, UnitQuaternion, UnitVector3, Vector3};

/// Least inertia that a joint moves while the others are free, kg m^2 or kg: what is less accelerates without bounds. A milligram
/// at a millimetre, which must be less than any real joint moves.
const MIN_INERTIA: f64 = 1e-12;

impl RobotDescription {
    /// The arm, ready to compute.
    ///
    /// # Errors
    /// Those of [`Self::check`]; [`RobotError::WrongBuild`] when the arm has not `N` joints; and
    /// [`Defect::MassMatrix`] when some joint moves neither mass nor inertia.
    pub fn build<const N: usize>(&self) -> Result<Robot<N>, RobotError> {
        self.check()?;
        let wrong = || RobotError::WrongBuild { file: self.file.clone(), found: self.joints.len(), asked: N };
        let joints: [_; N] =
            self.joints.iter().collect::<Vec<_>>().try_into().map_err(|_: Vec<_>| wrong())?;

        // X_ML: the description's link frame in the body's frame M, which has z along the joint's axis.
        let align = joints.map(|joint| Pose::from_parts(Default::default(), z_onto(&joint.axis)));
        let X_link: [Pose; N] = std::array::from_fn(|i| align[i].inverse() * joints[i].X_JL);
        let bodies: [Body; N] = std::array::from_fn(|i| {
            let joint = joints[i];
            let X_before = if i == 0 { Pose::identity() } else { X_link[i - 1] };
            let X = X_before * joint.X_PJ * align[i];
            let mut inertia = joint.inertia;
            if let Some(next) = joints.get(i + 1) {
                inertia = inertia.plus(&motor_at_rest(next));
            }
            let inertia = inertia.in_frame(&X_link[i]);
            let (I_m, k_r) = joint.motor.map_or((0.0, 0.0), |motor| (motor.inertia, motor.gear_ratio));
            Body {
                prismatic: joint.kind == super::JointKind::Prismatic,
                R: *X.rotation.to_rotation_matrix().matrix(),
                p: X.translation.vector,
                mass: inertia.mass,
                h: inertia.com * inertia.mass,
                I: inertia.about_origin(),
                rotor_coupling: k_r * I_m,
                rotor_own: k_r * k_r * I_m + joint.armature,
            }
        });
        let X_flange = X_link.last().copied().unwrap_or_else(Pose::identity) * self.X_LE;
        let robot = Robot {
            name: self.name.clone(),
            joint_names: joints.map(|joint| joint.name.clone()),
            bodies,
            links: X_link.map(|X| (*X.rotation.to_rotation_matrix().matrix(), X.translation.vector)),
            limits: joints.map(|joint| joint.limits),
            friction: joints.map(|joint| joint.friction),
            R_flange: *X_flange.rotation.to_rotation_matrix().matrix(),
            p_flange: X_flange.translation.vector,
            gravity_B: self.gravity_B,
        };
        // Idealised links are not checked one by one; it is sufficient that every motion needs energy. Five postures spread
        // over the turn leave no room for a zero that depends on the posture.
        for k in 0..5 {
            let q = SVector::from_fn(|i, _| f64::from(k) * (0.7 + 0.31 * i as f64));
            let factors = Ldlt::of(&robot.mass_matrix(&q));
            if !factors.is_some_and(|factors| factors.min_pivot() >= MIN_INERTIA) {
                return Err(self.error(format!("robot \"{}\"", self.name), Defect::MassMatrix));
            }
        }
        Ok(robot)
    }
}

/// The motor of `joint` as a part of the link before it, in that link's frame.
fn motor_at_rest(joint: &super::JointDescription) -> Inertia {
    let Some(motor) = joint.motor else { return Inertia::ZERO };
    let axis: Vector3<f64> = joint.X_PJ.rotation * joint.axis.into_inner();
    let about_com: Matrix3<f64> = axis * axis.transpose() * motor.inertia;
    Inertia { mass: motor.mass, com: joint.X_PJ.translation.vector, about_com }
}

/// The rotation that takes z to `axis`.
fn z_onto(axis: &UnitVector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between_axis(&Vector3::z_axis(), axis)
        .unwrap_or_else(|| UnitQuaternion::from_rotation_matrix(&rotation_x(std::f64::consts::PI)))
}
