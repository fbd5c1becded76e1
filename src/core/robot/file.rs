//! A robot's file: TOML with a Denavit-Hartenberg table or with a reference to a URDF, or a URDF alone.

use super::bounds::{self, all_within, within};
use super::description::RobotDescription;
use super::dh::{DhTable, MotorRecord};
use super::error::{Defect, RobotError};
use super::model::STANDARD_GRAVITY;
use super::urdf::{self, ChainSelection};
use crate::geometry::Pose;
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;
use std::collections::BTreeMap;

/// A robot's TOML file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RobotFile {
    name: String,
    /// Gravity in B; down along -z of the base without it.
    gravity_m_s2: Option<[f64; 3]>,
    dh: Option<DhTable>,
    urdf: Option<UrdfRecord>,
    tool: Option<ToolRecord>,
}

/// The URDF, the part of it that is the arm, and properties for which URDF has no element.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct UrdfRecord {
    /// Path relative to the TOML file.
    file: String,
    base: Option<String>,
    tip: Option<String>,
    #[serde(default)]
    fixed_joints: BTreeMap<String, f64>,
    #[serde(default)]
    joint: Vec<JointRecord>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct JointRecord {
    name: String,
    motor: Option<MotorRecord>,
    /// kg m^2; kg for a sliding joint.
    #[serde(default, alias = "armature_kg")]
    armature_kg_m2: f64,
}

/// A frame beyond the tip (URDF) or the last link (DH) that is the flange: fixed-axis angles about x, y, z in turn.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ToolRecord {
    #[serde(default)]
    position_m: [f64; 3],
    #[serde(default)]
    rpy_rad: [f64; 3],
}

/// Reads a robot's TOML `text`; `file` is for messages, `open` gives the text of the URDF that it names.
pub(super) fn parse_toml(
    text: &str,
    file: &str,
    open: impl FnOnce(&str) -> Result<(String, String), RobotError>,
) -> Result<RobotDescription, RobotError> {
    let syntax = |path: String, error: &toml::de::Error| {
        let before = text.get(..error.span().map_or(0, |span| span.start)).unwrap_or("");
        let (line, column) =
            (1 + before.matches('\n').count(), 1 + before.chars().rev().take_while(|&c| c != '\n').count());
        RobotError::Syntax {
            place: format!("{file}:{line}:{column}"),
            message: format!("{path}{}", error.message()),
        }
    };
    let deserializer = toml::Deserializer::parse(text).map_err(|e| syntax(String::new(), &e))?;
    let record: RobotFile = serde_path_to_error::deserialize(deserializer)
        .map_err(|e| syntax(format!("{}: ", e.path()), e.inner()))?;
    let mut description = empty(&record.name, file);
    let wrong = |element: &str, problem| empty(&record.name, file).error(element.to_owned(), problem);
    if let Some(gravity) = record.gravity_m_s2 {
        description.gravity_B = all_within("gravity_m_s2", gravity, &bounds::GRAVITY_M_S2)
            .map_err(|problem| wrong("robot", problem))?;
    }
    match (record.dh, record.urdf) {
        (Some(table), None) => table.add_to(&mut description)?,
        (None, Some(urdf)) => urdf.add_to(&mut description, open)?,
        _ => return Err(description.error("robot".to_owned(), Defect::OneSource)),
    }
    if let Some(tool) = record.tool {
        description.X_LE *= tool.pose().map_err(|problem| wrong("tool", problem))?;
    }
    description.check()?;
    description.note_length();
    Ok(description)
}

impl ToolRecord {
    fn pose(&self) -> Result<Pose, Defect> {
        let rpy = all_within("rpy_rad", self.rpy_rad, &bounds::ANGLE_RAD)?;
        Ok(Pose::from_parts(
            Translation3::from(bounds::lengths("position_m", self.position_m)?),
            UnitQuaternion::from_euler_angles(rpy.x, rpy.y, rpy.z),
        ))
    }
}

/// Keys of `[urdf]` that choose the chain; what is wrong with them is the TOML file's fault.
const SELECTION_KEYS: [&str; 3] = ["base", "tip", "fixed_joints"];

/// Reads a URDF `text` from its root to the link `tip`, or to its end when that is evident.
pub(super) fn parse_urdf(
    text: &str,
    name: &str,
    file: &str,
    tip: Option<&str>,
) -> Result<RobotDescription, RobotError> {
    let mut description = empty(name, file);
    let selection = ChainSelection { tip: tip.map(str::to_owned), ..ChainSelection::default() };
    urdf::read(text, &selection, &mut description)?;
    description.check()?;
    description.note_length();
    Ok(description)
}

fn empty(name: &str, file: &str) -> RobotDescription {
    RobotDescription {
        name: name.to_owned(),
        file: file.to_owned(),
        gravity_B: Vector3::new(0.0, 0.0, -STANDARD_GRAVITY),
        joints: Vec::new(),
        X_LE: Pose::identity(),
        notes: Vec::new(),
    }
}

impl UrdfRecord {
    fn add_to(
        self,
        description: &mut RobotDescription,
        open: impl FnOnce(&str) -> Result<(String, String), RobotError>,
    ) -> Result<(), RobotError> {
        for (joint, position) in &self.fixed_joints {
            within(joint, *position, &bounds::POSITION)
                .map_err(|problem| description.error("urdf.fixed_joints".to_owned(), problem))?;
        }
        let (urdf_file, text) = open(&self.file)?;
        // Links and joints are elements of the URDF; names given here are checked against it below.
        let toml_file = std::mem::replace(&mut description.file, urdf_file);
        let selection = ChainSelection { base: self.base, tip: self.tip, held: self.fixed_joints };
        urdf::read(&text, &selection, description).map_err(|error| match error {
            RobotError::Element { element, problem, .. } if SELECTION_KEYS.contains(&element.as_str()) => {
                RobotError::Element { file: toml_file.clone(), element: format!("urdf.{element}"), problem }
            }
            other => other,
        })?;
        for record in self.joint {
            let known = description.joints.iter().map(|j| j.name.as_str()).collect::<Vec<_>>().join(", ");
            let Some(joint) = description.joints.iter_mut().find(|joint| joint.name == record.name) else {
                let problem = Defect::NoSuchJoint { joint: record.name.clone(), known };
                description.file = toml_file;
                return Err(description.error(format!("urdf.joint \"{}\"", record.name), problem));
            };
            let numbers = record.motor.map(|motor| motor.motor()).transpose().and_then(|motor| {
                Ok((motor, within("armature_kg_m2", record.armature_kg_m2, &bounds::ROTOR)?))
            });
            (joint.motor, joint.armature) = match numbers {
                Ok(numbers) => numbers,
                Err(problem) => {
                    description.file = toml_file;
                    return Err(description.error(format!("urdf.joint \"{}\"", record.name), problem));
                }
            };
        }
        Ok(())
    }
}
