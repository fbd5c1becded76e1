//! The robots that come with the program, and loading by name or path.

use super::description::RobotDescription;
use super::error::RobotError;
use super::file::{parse_toml, parse_urdf};
use crate::input::file::{self, MAX_TOML, MAX_URDF};
use std::path::Path;

/// Names of the robots whose files are part of the program.
pub const SHIPPED: &[&str] = &["scara", "ur5", "panda", "xarm7", "pan_tilt"];

macro_rules! embedded {
    ($($file:literal),*) => {
        /// The files in config/robot/, compiled in.
        const EMBEDDED: &[(&str, &str)] = &[$(($file, include_str!(concat!("../../config/robot/", $file)))),*];
    };
}

embedded!(
    "scara.toml",
    "ur5.toml",
    "ur5.urdf",
    "panda.toml",
    "panda.urdf",
    "xarm7.toml",
    "xarm7.urdf",
    "pan_tilt.toml"
);

fn embedded(file: &str) -> Option<&'static str> {
    EMBEDDED.iter().find(|(name, _)| *name == file).map(|(_, text)| *text)
}

/// Reads the description of a shipped robot (a name of [`SHIPPED`]), or of a `.toml` or `.urdf` file.
///
/// A URDF that branches needs the name of the chain's last link: `arm.urdf#tool0`, or `tip` in a TOML file.
///
/// # Errors
/// [`RobotError`] with file and element.
pub fn load(name_or_path: &str) -> Result<RobotDescription, RobotError> {
    let unknown = || RobotError::Unknown { name: name_or_path.to_owned(), shipped: SHIPPED.join(", ") };
    if SHIPPED.contains(&name_or_path) {
        let file = format!("{name_or_path}.toml");
        let text = embedded(&file).ok_or_else(unknown)?;
        return parse_toml(text, &file, |urdf| {
            embedded(urdf).map(|text| (urdf.to_owned(), text.to_owned())).ok_or_else(unknown)
        });
    }
    let (file, tip) = match name_or_path.rsplit_once('#') {
        Some((file, tip)) if file.ends_with(".urdf") => (file, Some(tip)),
        _ => (name_or_path, None),
    };
    let path = Path::new(file);
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("toml") => parse_toml(&read(path, MAX_TOML)?, file, |urdf| {
            let urdf = path.with_file_name(urdf);
            Ok((urdf.display().to_string(), read(&urdf, MAX_URDF)?))
        }),
        Some("urdf") => {
            let name = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or("robot");
            parse_urdf(&read(path, MAX_URDF)?, name, file, tip)
        }
        _ => Err(unknown()),
    }
}

fn read(path: &Path, largest: u64) -> Result<String, RobotError> {
    file::read(path, largest).map_err(|source| RobotError::Read { file: path.display().to_string(), source })
}
