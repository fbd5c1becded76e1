//! Denavit-Hartenberg tables in TOML, standard and modified.
//!
//! Standard: `A_i = Rz(theta) Tz(d) Tx(a) Rx(alpha)`, link frame i behind the joint's axis by a and alpha.
//! Modified: `A_i = Rx(alpha) Tx(a) Rz(theta) Tz(d)`, link frame i on the joint's axis.
//! The joint's position is added to theta of a turning joint, to d of a sliding one.

use super::description::{JointDescription, Motor, RobotDescription};
use super::error::{Problem, RobotError};
use super::inertia::Inertia;
use super::model::{Friction, JointKind, JointLimits};
use crate::geometry::{Pose, rotation_x, rotation_z};
use nalgebra::{Matrix3, Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;

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
enum Kind {
    Revolute,
    Continuous,
    Prismatic,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct DhJoint {
    name: String,
    #[serde(rename = "type")]
    kind: Kind,
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
    link: Link,
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

impl From<MotorRecord> for Motor {
    fn from(record: MotorRecord) -> Self {
        Self { mass: record.mass_kg, inertia: record.inertia_kg_m2, gear_ratio: record.gear_ratio }
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Link {
    mass_kg: f64,
    #[serde(default)]
    com_m: [f64; 3],
    inertia_kg_m2: Moments,
    #[serde(default)]
    idealised: bool,
}

/// Moments about the centre of mass in the link's frame; `xy` is the matrix entry (minus the product of inertia).
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Moments {
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

/// Picks the value in the unit that fits the joint's type; one in the other unit is an error.
struct Units(JointKind);

impl Units {
    fn pick(
        &self,
        (turning_key, turning): (&'static str, Option<f64>),
        (sliding_key, sliding): (&'static str, Option<f64>),
    ) -> Result<Option<f64>, Problem> {
        let kind = self.0;
        let (value, (wrong_key, wrong), instead) = if kind == JointKind::Prismatic {
            (sliding, (turning_key, turning), sliding_key)
        } else {
            (turning, (sliding_key, sliding), turning_key)
        };
        match wrong {
            Some(_) => Err(Problem::WrongUnit { key: wrong_key, kind, instead }),
            None => Ok(value),
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
            let element = format!("joint \"{}\"", record.name);
            let joint = record.joint(convention).map_err(|problem| description.error(element, problem))?;
            description.joints.push(joint);
        }
        Ok(())
    }
}

impl DhJoint {
    fn joint(self, convention: Convention) -> Result<JointDescription, Problem> {
        let kind = match self.kind {
            Kind::Revolute => JointKind::Revolute,
            Kind::Continuous => JointKind::Continuous,
            Kind::Prismatic => JointKind::Prismatic,
        };
        let screw_z = pose_of(rotation_z(self.theta_rad), Vector3::new(0.0, 0.0, self.d_m));
        let screw_x = pose_of(rotation_x(self.alpha_rad), Vector3::new(self.a_m, 0.0, 0.0));
        let (X_PJ, X_JL) = match convention {
            Convention::Standard => (screw_z, screw_x),
            Convention::Modified => (screw_x * screw_z, Pose::identity()),
        };
        let Moments { xx, yy, zz, xy, xz, yz } = self.link.inertia_kg_m2;
        let units = Units(kind);
        Ok(JointDescription {
            link: format!("link of {}", self.name),
            kind,
            X_PJ,
            axis: Vector3::z_axis(),
            X_JL,
            limits: self.limits.limits(&units)?,
            friction: Friction {
                viscous: units
                    .pick(
                        ("viscous_n_m_s_rad", self.friction.viscous_n_m_s_rad),
                        ("viscous_n_s_m", self.friction.viscous_n_s_m),
                    )?
                    .unwrap_or(0.0),
                coulomb: units
                    .pick(("coulomb_n_m", self.friction.coulomb_n_m), ("coulomb_n", self.friction.coulomb_n))?
                    .unwrap_or(0.0),
            },
            motor: self.motor.map(Motor::from),
            armature: units
                .pick(("armature_kg_m2", self.armature_kg_m2), ("armature_kg", self.armature_kg))?
                .unwrap_or(0.0),
            inertia: Inertia {
                mass: self.link.mass_kg,
                com: Vector3::from(self.link.com_m),
                about_com: Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz),
            },
            idealised: self.link.idealised,
            name: self.name,
        })
    }
}

impl Limits {
    fn limits(&self, units: &Units) -> Result<JointLimits, Problem> {
        let lower = units.pick(("lower_rad", self.lower_rad), ("lower_m", self.lower_m))?;
        let upper = units.pick(("upper_rad", self.upper_rad), ("upper_m", self.upper_m))?;
        let velocity = units
            .pick(("velocity_rad_s", self.velocity_rad_s), ("velocity_m_s", self.velocity_m_s))?
            .ok_or(Problem::MissingKey { key: units.key("velocity_rad_s", "velocity_m_s") })?;
        let effort = units
            .pick(("effort_n_m", self.effort_n_m), ("effort_n", self.effort_n))?
            .ok_or(Problem::MissingKey { key: units.key("effort_n_m", "effort_n") })?;
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
