//! Denavit-Hartenberg tables in TOML, standard and modified.
//!
//! Standard: `A_i = Rz(theta) Tz(d) Tx(a) Rx(alpha)`, link frame i behind the joint's axis by a and alpha.
//! Modified: `A_i = Rx(alpha) Tx(a) Rz(theta) Tz(d)`, link frame i on the joint's axis.
//! The joint's position is added to theta of a turning joint, to d of a sliding one.

use super::bounds::{self, within};
use super::description::{JointDescription, Motor, RobotDescription};
use super::error::{Defect, RobotError};
use super::inertia::Inertia;
use super::model::{Friction, JointKind, JointLimits};
use crate::geometry::{Pose, rotation_x, rotation_z};
use nalgebra::{Matrix3, Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;
use std::ops::RangeInclusive;

/// The `[dh]` table of a robot's file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct DhTable {
    convention: Convention,
    joint: Vec<DhJoint>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Convention {
    Standard,
    Modified,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "snake_case")]
enum DhJointKind {
    Revolute,
    Continuous,
    Prismatic,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct DhJoint {
    name: String,
    #[serde(rename = "type")]
    kind: DhJointKind,
    #[serde(default)]
    a_m: f64,
    #[serde(default)]
    alpha_rad: f64,
    #[serde(default)]
    d_m: f64,
    #[serde(default)]
    theta_rad: f64,
    limits: Limits,
    #[serde(default)]
    friction: FrictionRecord,
    motor: Option<MotorRecord>,
    armature_kg_m2: Option<f64>,
    armature_kg: Option<f64>,
    link: DhLink,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Limits {
    lower_rad: Option<f64>,
    upper_rad: Option<f64>,
    velocity_rad_s: Option<f64>,
    effort_n_m: Option<f64>,
    lower_m: Option<f64>,
    upper_m: Option<f64>,
    velocity_m_s: Option<f64>,
    effort_n: Option<f64>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct FrictionRecord {
    viscous_n_m_s_rad: Option<f64>,
    coulomb_n_m: Option<f64>,
    viscous_n_s_m: Option<f64>,
    coulomb_n: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MotorRecord {
    #[serde(default)]
    mass_kg: f64,
    inertia_kg_m2: f64,
    gear_ratio: f64,
}

impl MotorRecord {
    /// The motor, where its numbers are possible ones.
    pub(super) fn motor(&self) -> Result<Motor, Defect> {
        Ok(Motor {
            mass: bounds::mass("motor.mass_kg", self.mass_kg)?,
            inertia: within("motor.inertia_kg_m2", self.inertia_kg_m2, &bounds::ROTOR)?,
            gear_ratio: within("motor.gear_ratio", self.gear_ratio, &bounds::GEAR_RATIO)?,
        })
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct DhLink {
    mass_kg: f64,
    #[serde(default)]
    com_m: [f64; 3],
    inertia_kg_m2: InertiaMoments,
    #[serde(default)]
    idealised: bool,
}

/// Moments about the centre of mass in the link's frame; `xy` is the matrix entry (minus the product of inertia).
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct InertiaMoments {
    xx: f64,
    yy: f64,
    zz: f64,
    #[serde(default)]
    xy: f64,
    #[serde(default)]
    xz: f64,
    #[serde(default)]
    yz: f64,
}

impl DhLink {
    fn inertia(&self) -> Result<Inertia, Defect> {
        let InertiaMoments { xx, yy, zz, xy, xz, yz } = self.inertia_kg_m2;
        for (key, moment) in [("xx", xx), ("yy", yy), ("zz", zz), ("xy", xy), ("xz", xz), ("yz", yz)] {
            within(&format!("inertia_kg_m2.{key}"), moment, &bounds::MOMENT_KG_M2)?;
        }
        Ok(Inertia {
            mass: bounds::mass("mass_kg", self.mass_kg)?,
            com: bounds::lengths("com_m", self.com_m)?,
            about_com: Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz),
        })
    }
}

/// Picks the value in the unit that fits the joint's type; one in the other unit is an error.
struct Units(JointKind);

impl Units {
    fn pick(
        &self,
        (turning_key, turning): (&'static str, Option<f64>),
        (sliding_key, sliding): (&'static str, Option<f64>),
        allowed: &RangeInclusive<f64>,
    ) -> Result<Option<f64>, Defect> {
        let kind = self.0;
        let (value, (wrong_key, wrong), instead) = if kind == JointKind::Prismatic {
            (sliding, (turning_key, turning), sliding_key)
        } else {
            (turning, (sliding_key, sliding), turning_key)
        };
        match wrong {
            Some(_) => Err(Defect::WrongUnit { key: wrong_key, kind, instead }),
            None => value.map(|value| within(instead, value, allowed)).transpose(),
        }
    }

    fn key(&self, turning: &'static str, sliding: &'static str) -> &'static str {
        if self.0 == JointKind::Prismatic { sliding } else { turning }
    }
}

impl DhTable {
    /// Appends the table's joints to `description`.
    pub(super) fn add_to(self, description: &mut RobotDescription) -> Result<(), RobotError> {
        let convention = self.convention;
        for record in self.joint {
            let (joint, link) = (format!("joint \"{}\"", record.name), record.link_name());
            let inertia = record.link.inertia();
            let inertia =
                inertia.map_err(|problem| description.error(format!("link \"{link}\""), problem))?;
            let joint =
                record.joint(convention, inertia).map_err(|problem| description.error(joint, problem))?;
            description.joints.push(joint);
        }
        Ok(())
    }
}

impl DhJoint {
    fn link_name(&self) -> String {
        format!("link of {}", self.name)
    }

    fn joint(self, convention: Convention, inertia: Inertia) -> Result<JointDescription, Defect> {
        let kind = match self.kind {
            DhJointKind::Revolute => JointKind::Revolute,
            DhJointKind::Continuous => JointKind::Continuous,
            DhJointKind::Prismatic => JointKind::Prismatic,
        };
        let length = bounds::length;
        let angle = |key, value| within(key, value, &bounds::ANGLE_RAD);
        let screw_z = pose_of(
            rotation_z(angle("theta_rad", self.theta_rad)?),
            Vector3::new(0.0, 0.0, length("d_m", self.d_m)?),
        );
        let screw_x = pose_of(
            rotation_x(angle("alpha_rad", self.alpha_rad)?),
            Vector3::new(length("a_m", self.a_m)?, 0.0, 0.0),
        );
        let (X_PJ, X_JL) = match convention {
            Convention::Standard => (screw_z, screw_x),
            Convention::Modified => (screw_x * screw_z, Pose::identity()),
        };
        let units = Units(kind);
        let friction = |turning, sliding| Ok(units.pick(turning, sliding, &bounds::FRICTION)?.unwrap_or(0.0));
        let FrictionRecord { viscous_n_m_s_rad, coulomb_n_m, viscous_n_s_m, coulomb_n } = self.friction;
        let (armature_kg_m2, armature_kg) =
            (("armature_kg_m2", self.armature_kg_m2), ("armature_kg", self.armature_kg));
        Ok(JointDescription {
            link: self.link_name(),
            kind,
            X_PJ,
            axis: Vector3::z_axis(),
            X_JL,
            limits: self.limits.limits(&units)?,
            friction: Friction {
                viscous: friction(
                    ("viscous_n_m_s_rad", viscous_n_m_s_rad),
                    ("viscous_n_s_m", viscous_n_s_m),
                )?,
                coulomb: friction(("coulomb_n_m", coulomb_n_m), ("coulomb_n", coulomb_n))?,
            },
            motor: self.motor.map(|motor| motor.motor()).transpose()?,
            armature: units.pick(armature_kg_m2, armature_kg, &bounds::ROTOR)?.unwrap_or(0.0),
            inertia,
            idealised: self.link.idealised,
            name: self.name,
        })
    }
}

impl Limits {
    fn limits(&self, units: &Units) -> Result<JointLimits, Defect> {
        let lower =
            units.pick(("lower_rad", self.lower_rad), ("lower_m", self.lower_m), &bounds::POSITION)?;
        let upper =
            units.pick(("upper_rad", self.upper_rad), ("upper_m", self.upper_m), &bounds::POSITION)?;
        let velocity = units
            .pick(
                ("velocity_rad_s", self.velocity_rad_s),
                ("velocity_m_s", self.velocity_m_s),
                &bounds::VELOCITY,
            )?
            .ok_or(Defect::MissingKey { key: units.key("velocity_rad_s", "velocity_m_s") })?;
        let effort = units
            .pick(("effort_n_m", self.effort_n_m), ("effort_n", self.effort_n), &bounds::EFFORT)?
            .ok_or(Defect::MissingKey { key: units.key("effort_n_m", "effort_n") })?;
        // A position limit that is not there is infinite; the check of the joint's type decides whether it may be.
        Ok(JointLimits {
            lower: lower.unwrap_or(f64::NEG_INFINITY),
            upper: upper.unwrap_or(f64::INFINITY),
            velocity,
            effort,
        })
    }
}

fn pose_of(R: nalgebra::Rotation3<f64>, p: Vector3<f64>) -> Pose {
    Pose::from_parts(Translation3::from(p), UnitQuaternion::from_rotation_matrix(&R))
}
