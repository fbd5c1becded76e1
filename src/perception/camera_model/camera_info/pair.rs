//! The file of a stereo pair, as `vservo calibrate stereo` writes it.

use super::CameraInfoError;
use super::yaml::Entries;
use crate::geometry::Pose;
use nalgebra::{Quaternion, Translation3, UnitQuaternion};

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
        let [x, y, z, w]: [f64; 4] =
            entries.numbers(ROTATION)?.try_into().map_err(|_| entries.wrong(ROTATION, "has four numbers"))?;
        let rotation = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-6)
            .ok_or_else(|| entries.wrong(ROTATION, "is no rotation"))?;
        let X_LR = Pose::from_parts(Translation3::from(position), rotation);
        Ok(Self { left: name("left")?, right: name("right")?, X_LR })
    }
}
