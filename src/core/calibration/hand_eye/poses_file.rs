//! The robot's poses as a table: one line an image, comma separated.
//!
//! ```text
//! image,x_m,y_m,z_m,qx,qy,qz,qw[,vx_m_s,vy_m_s,vz_m_s,wx_rad_s,wy_rad_s,wz_rad_s]
//! left01.png,0.335,-0.032,0.309,-0.98,0.01,-0.15,0.05
//! ```
//! Position and unit quaternion of the flange in the base, `X_BE`; where the flange moves, the velocity of its origin and its angular
//! velocity, both along the axes of the base. Lines may be empty or begin with `#`; the line of names may be left out.

use super::MAX_VIEWS;
use crate::geometry::{Pose, Twist, rotate_twist};
use nalgebra::{Quaternion, Translation3, UnitQuaternion};
use thiserror::Error;

/// Most lines of poses, so that a hostile file takes no memory; a table may have more than there are images.
const MAX_LINES: usize = 50 * MAX_VIEWS;
/// How far from 1 the norm of a quaternion may be: that of one written with three digits after the point is off by 1e-3 at
/// most, and one of numbers that are no quaternion must not pass.
const NORM_SLACK: f64 = 0.01;
/// Farthest from the base, m; mm would be beyond.
const FARTHEST_M: f64 = 20.0;

const NAMES: [&str; 7] = ["x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"];
const VELOCITY: [&str; 6] = ["vx_m_s", "vy_m_s", "vz_m_s", "wx_rad_s", "wy_rad_s", "wz_rad_s"];

/// A file of poses that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[error("line {line}: {message}")]
pub struct PosesFileError {
    /// Where, from 1.
    pub line: usize,
    /// What is wrong and how to mend it.
    pub message: String,
}

impl PosesFileError {
    pub(super) fn at(line: usize, message: impl Into<String>) -> Self {
        Self { line, message: message.into() }
    }
}

/// Where the arm was in one image.
#[derive(Debug, Clone, PartialEq)]
pub struct ArmPose {
    /// The image, as the table names it.
    pub image: String,
    /// The flange in the base.
    pub X_BE: Pose,
    /// Its twist relative to the base, expressed in E, m/s and rad/s, where the table states it.
    pub V_BE_E: Option<Twist>,
}

/// The poses of a table.
///
/// # Errors
/// [`PosesFileError`] with the line: columns that are missing, numbers that are none, quaternions that are no rotation, positions beyond
/// 20 m, images named twice.
pub fn read_poses(text: &str) -> Result<Vec<ArmPose>, PosesFileError> {
    let mut poses: Vec<ArmPose> = Vec::new();
    let mut names = std::collections::BTreeSet::new();
    for (line, row) in text.lines().enumerate().map(|(i, row)| (i + 1, row.trim())) {
        if row.is_empty() || row.starts_with('#') {
            continue;
        }
        let mut cells = row.split(',').map(str::trim);
        let image = cells.next().unwrap_or_default();
        let cells: Vec<&str> = cells.take(64).collect();
        if cells.first().is_some_and(|cell| *cell == "x_m") {
            named_columns(line, &cells)?;
            continue;
        }
        if image.is_empty() {
            return Err(PosesFileError::at(line, "begins with no image"));
        }
        if !names.insert(image.to_owned()) {
            let shown: String = image.chars().take(60).collect();
            return Err(PosesFileError::at(line, format!("names {shown} a second time")));
        }
        if poses.len() >= MAX_LINES {
            return Err(PosesFileError::at(line, format!("there are more than {MAX_LINES} poses")));
        }
        poses.push(pose(line, image, &cells)?);
    }
    Ok(poses)
}

/// The names, where they are given, must be the known ones in their order.
fn named_columns(line: usize, cells: &[&str]) -> Result<(), PosesFileError> {
    let known = NAMES.iter().chain(&VELOCITY).copied();
    let right = cells.iter().copied().eq(known.take(cells.len()));
    if right && [NAMES.len(), NAMES.len() + VELOCITY.len()].contains(&cells.len()) {
        return Ok(());
    }
    let (names, velocity) = (NAMES.join(","), VELOCITY.join(","));
    Err(PosesFileError::at(
        line,
        format!("the columns must be image,{names}, and {velocity} or nothing after them"),
    ))
}

fn pose(line: usize, image: &str, cells: &[&str]) -> Result<ArmPose, PosesFileError> {
    let names = NAMES.iter().chain(&VELOCITY);
    let mut numbers = Vec::with_capacity(cells.len());
    for (cell, name) in cells.iter().zip(names) {
        let number = cell.parse::<f64>().ok().filter(|x| x.is_finite());
        numbers.push(number.ok_or_else(|| {
            let shown: String = cell.chars().take(40).collect();
            PosesFileError::at(line, format!("{name} is `{shown}`, not a number"))
        })?);
    }
    let ([x, y, z, qx, qy, qz, qw], V) = match (numbers.as_slice(), cells.len()) {
        (&[x, y, z, qx, qy, qz, qw], 7) => ([x, y, z, qx, qy, qz, qw], None),
        (&[x, y, z, qx, qy, qz, qw, vx, vy, vz, wx, wy, wz], 13) => {
            ([x, y, z, qx, qy, qz, qw], Some(Twist::new(vx, vy, vz, wx, wy, wz)))
        }
        _ => {
            let found = cells.len() + 1;
            return Err(PosesFileError::at(
                line,
                format!("has {found} columns: image,{} are 8, with velocities 14", NAMES.join(",")),
            ));
        }
    };
    if [x, y, z].iter().any(|m| m.abs() > FARTHEST_M) {
        return Err(PosesFileError::at(
            line,
            format!("is more than {FARTHEST_M} m from the base: positions are in m"),
        ));
    }
    let q = Quaternion::new(qw, qx, qy, qz);
    if !((q.norm() - 1.0).abs() < NORM_SLACK) {
        return Err(PosesFileError::at(
            line,
            format!("qx,qy,qz,qw have the norm {:.4}, a rotation has 1: x y z w, in this order", q.norm()),
        ));
    }
    let X_BE = Pose::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_quaternion(q));
    let R_EB = X_BE.rotation.to_rotation_matrix().inverse();
    Ok(ArmPose { image: image.to_owned(), X_BE, V_BE_E: V.map(|V_B| rotate_twist(&R_EB, &V_B)) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use proptest::prelude::*;

    #[test]
    fn tables_are_read() {
        let text = "# by hand\nimage,x_m,y_m,z_m,qx,qy,qz,qw\n\na.png, 0.1, 0.2, 0.3, 0, 0, 0.70710678, 0.70710678\n\
                    b.png,0,0,1,1,0,0,0,0.1,0,0,0,0,0.5\n";
        let poses = read_poses(text).unwrap();
        assert_eq!(poses.len(), 2);
        let [a, b] = poses.as_slice() else { unreachable!() };
        assert!(
            (a.X_BE * nalgebra::Point3::new(1.0, 0.0, 0.0) - nalgebra::Point3::new(0.1, 1.2, 0.3)).norm()
                < 1e-7
        );
        assert_eq!((a.image.as_str(), a.V_BE_E), ("a.png", None));
        // half a turn about x: y and z of the base are -y and -z of the flange
        let V = b.V_BE_E.unwrap();
        assert!((V - Twist::new(0.1, 0.0, 0.0, 0.0, 0.0, -0.5)).norm() < 1e-12, "{V}");
        assert!((b.X_BE.translation.vector - Vector3::z()).norm() < 1e-12);
    }

    #[test]
    fn what_is_wrong_is_told_with_its_line() {
        for (text, line, told) in [
            ("image,x_m,y_m,z_m,qw,qx,qy,qz\n", 1, "columns must be"),
            ("a,0,0,0,0,0,0,1\na,0,0,0,0,0,0,1\n", 2, "second time"),
            ("a,0,0,0,0,0,0\n", 1, "columns"),
            ("a,0,0,x,0,0,0,1\n", 1, "z_m is `x`"),
            ("a,0,0,inf,0,0,0,1\n", 1, "z_m is `inf`"),
            ("\n\na,0,0,0,0,0,0,0.5\n", 3, "norm 0.5"),
            ("a,300,0,0,0,0,0,1\n", 1, "in m"),
            (",0,0,0,0,0,0,1\n", 1, "no image"),
            ("a,0,0,0,0,0,0,1,2\n", 1, "columns"),
        ] {
            let error = read_poses(text).unwrap_err();
            assert!(error.line == line && error.message.contains(told), "{text}: {error}");
        }
        assert_eq!(read_poses("").unwrap(), []);
    }

    proptest! {
        #[test]
        fn any_text_is_a_table_or_an_error(text in "([a-c,.\n#0-9e-]|image,x_m|nan){0,60}") {
            let _ = read_poses(&text);
        }
    }
}
