//! The robots that come with the program, and loading by name or path.

use super::description::RobotDescription;
use super::dh::DhTable;
use super::error::{Problem, RobotError};
use super::model::STANDARD_GRAVITY;
use crate::geometry::Pose;
use nalgebra::{Translation3, UnitQuaternion, Vector3};
use serde::Deserialize;

/// Names of the robots whose files are part of the program.
pub const SHIPPED: &[&str] = &["scara"];

/// The text of a shipped robot's file.
fn shipped_text(name: &str) -> Option<(&'static str, &'static str)> {
    Some(match name {
        "scara" => ("config/robot/scara.toml", include_str!("../../config/robot/scara.toml")),
        _ => return None,
    })
}

/// A robot's TOML file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RobotFile {
    name: String,
    /// Gravity in B; down along -z of the base without it.
    gravity_m_s2: Option<[f64; 3]>,
    dh: Option<DhTable>,
    tool: Option<ToolRecord>,
}

/// The flange in the last link's frame: fixed-axis angles about x, then y, then z.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct ToolRecord {
    #[serde(default)]
    position_m: [f64; 3],
    #[serde(default)]
    rpy_rad: [f64; 3],
}

/// Reads the description of a shipped robot (a name of [`SHIPPED`]) or of a `.toml` file.
///
/// # Errors
/// [`RobotError`] with file and element.
pub fn load(name_or_path: &str) -> Result<RobotDescription, RobotError> {
    if let Some((file, text)) = shipped_text(name_or_path) {
        return parse(text, file);
    }
    if !name_or_path.ends_with(".toml") {
        return Err(RobotError::Unknown { name: name_or_path.to_owned(), shipped: SHIPPED.join(", ") });
    }
    let text = std::fs::read_to_string(name_or_path)
        .map_err(|source| RobotError::Read { file: name_or_path.to_owned(), source })?;
    parse(&text, name_or_path)
}

/// Reads a robot's TOML `text`; `file` is for messages.
fn parse(text: &str, file: &str) -> Result<RobotDescription, RobotError> {
    let syntax = |message: String| RobotError::Syntax { file: file.to_owned(), message };
    let deserializer = toml::Deserializer::parse(text).map_err(|e| syntax(e.to_string()))?;
    let record: RobotFile = serde_path_to_error::deserialize(deserializer)
        .map_err(|e| syntax(format!("{}: {}", e.path(), e.inner())))?;
    let tool = record.tool.unwrap_or(ToolRecord { position_m: [0.0; 3], rpy_rad: [0.0; 3] });
    let [roll, pitch, yaw] = tool.rpy_rad;
    let mut description = RobotDescription {
        name: record.name,
        file: file.to_owned(),
        gravity_B: record.gravity_m_s2.map_or(Vector3::new(0.0, 0.0, -STANDARD_GRAVITY), Vector3::from),
        joints: Vec::new(),
        X_LE: Pose::from_parts(
            Translation3::from(Vector3::from(tool.position_m)),
            UnitQuaternion::from_euler_angles(roll, pitch, yaw),
        ),
    };
    match record.dh {
        Some(table) => table.add_to(&mut description)?,
        None => return Err(description.error("robot".to_owned(), Problem::OneSource)),
    }
    description.check()?;
    Ok(description)
}
