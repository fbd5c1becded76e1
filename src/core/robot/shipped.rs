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
        const EMBEDDED: &[(&str, &str)] = &[$(($file, include_str!(concat!("../../../config/robot/", $file)))),*];
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
    load_noting(name_or_path, &mut |_, _| {})
}

/// Names and texts of the files that [`load`] reads.
///
/// # Errors
/// As [`load`].
pub fn files(name_or_path: &str) -> Result<Vec<(String, String)>, RobotError> {
    let mut files = Vec::new();
    load_noting(name_or_path, &mut |path: &str, text: &str| {
        let name = Path::new(path).file_name().unwrap_or_default().to_string_lossy();
        files.push((name.into_owned(), text.to_owned()));
    })?;
    Ok(files)
}

fn load_noting(name_or_path: &str, note: &mut dyn FnMut(&str, &str)) -> Result<RobotDescription, RobotError> {
    let unknown = || RobotError::Unknown { name: name_or_path.to_owned(), shipped: SHIPPED.join(", ") };
    if SHIPPED.contains(&name_or_path) {
        let file = format!("{name_or_path}.toml");
        let text = embedded(&file).ok_or_else(unknown)?;
        note(&file, text);
        return parse_toml(text, &file, |urdf| {
            let text = embedded(urdf).ok_or_else(unknown)?;
            note(urdf, text);
            Ok((urdf.to_owned(), text.to_owned()))
        });
    }
    let (file, tip) = match name_or_path.rsplit_once('#') {
        Some((file, tip)) if file.ends_with(".urdf") => (file, Some(tip)),
        _ => (name_or_path, None),
    };
    let path = Path::new(file);
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("toml") => {
            let text = read(path, MAX_TOML)?;
            note(file, &text);
            parse_toml(&text, file, |urdf| {
                let urdf = path.with_file_name(urdf);
                let (file, text) = (urdf.display().to_string(), read(&urdf, MAX_URDF)?);
                note(&file, &text);
                Ok((file, text))
            })
        }
        Some("urdf") => {
            let name = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or("robot");
            let text = read(path, MAX_URDF)?;
            note(file, &text);
            parse_urdf(&text, name, file, tip)
        }
        _ => Err(unknown()),
    }
}

fn read(path: &Path, largest: u64) -> Result<String, RobotError> {
    file::read(path, largest).map_err(|source| RobotError::Read { file: path.display().to_string(), source })
}
