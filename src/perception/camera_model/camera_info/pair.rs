//! The file of a stereo pair, as `vservo calibrate stereo` writes it.

use super::CameraInfoError;
use super::yaml::Entries;
use crate::geometry::{Pose, unit_quaternion};
use nalgebra::Translation3;

/// Where the right camera is in the left one, and the names of both calibration files.
#[derive(Debug, Clone, PartialEq)]
pub struct PairInfo {
    /// Calibration file of the left camera, relative to the pair's own.
    pub left: String,
    /// Calibration file of the right camera.
    pub right: String,
    /// Pose of the right camera in the left one, m.
    pub X_LR: Pose,
}

impl PairInfo {
    /// Reads `left`, `right` and `X_LR` with `position_m` (3 numbers) and `rotation_xyzw` (4); all else is passed over.
    ///
    /// # Errors
    /// [`CameraInfoError`] says the line, the key and what is wrong.
    pub fn read(text: &str) -> Result<Self, CameraInfoError> {
        let entries = Entries::read(text)?;
        let name = |key| entries.text(key)?.map(str::to_owned).ok_or_else(|| entries.missing(key));
        const POSITION: &str = "X_LR.position_m";
        const ROTATION: &str = "X_LR.rotation_xyzw";
        let position: [f64; 3] = entries
            .numbers(POSITION)?
            .try_into()
            .map_err(|_| entries.wrong(POSITION, "has three numbers"))?;
        let xyzw: [f64; 4] =
            entries.numbers(ROTATION)?.try_into().map_err(|_| entries.wrong(ROTATION, "has four numbers"))?;
        let rotation = unit_quaternion(xyzw).ok_or_else(|| {
            entries.wrong(ROTATION, "is no rotation, whose quaternion x, y, z, w has length 1: write it anew with `vservo calibrate stereo`")
        })?;
        let X_LR = Pose::from_parts(Translation3::from(position), rotation);
        Ok(Self { left: name("left")?, right: name("right")?, X_LR })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pair_has_a_rotation_of_length_one() {
        let read = |q: &str| {
            let text = format!(
                "left: \"a.yaml\"\nright: \"b.yaml\"\nX_LR:\n  position_m: [0.1, 0.0, 0.0]\n  rotation_xyzw: [{q}]\n"
            );
            PairInfo::read(&text)
        };
        assert_eq!(read("0.0, 0.0, 0.707, 0.707").map(|pair| pair.right), Ok("b.yaml".to_owned()));
        let told = read("0.0, 0.0, 0.0, 2.0").unwrap_err().to_string();
        assert!(told.contains("X_LR.rotation_xyzw") && told.contains("length 1"), "{told}");
    }
}
