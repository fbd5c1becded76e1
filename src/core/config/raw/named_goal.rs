//! Goals and postures that have a name.

use crate::config::goal_file::GoalFile;
use crate::config::keys::{PoseTable, RotationForms};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// `[goals.NAME]` as it is written.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RawNamedGoal {
    /// File of `vservo teach`, only where it is read.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<PathBuf>,
    /// What stands in it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub taught: Option<GoalFile>,
    /// Of which target it is: a name in `[targets]`, or `target`; left out: of `[target]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target: Option<String>,
    /// Position of the target in the camera, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_m: Option<[f64; 3]>,
    /// Its roll, pitch, yaw, rad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotation_rpy_rad: Option<[f64; 3]>,
    /// The same, deg.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotation_rpy_deg: Option<[f64; 3]>,
    /// Or as unit quaternion x, y, z, w.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotation_xyzw: Option<[f64; 4]>,
    /// Or as axis times angle, rad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rotation_vector_rad: Option<[f64; 3]>,
}

/// `[postures.NAME]` as it is written.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RawPosture {
    /// Joint positions, rad or m.
    pub q_rad_or_m: Vec<f64>,
    /// File of `vservo ctl teach --save`, which has them; only where it is read.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub file: Option<PathBuf>,
}

impl PoseTable for RawNamedGoal {
    fn take_forms(&mut self) -> RotationForms {
        RotationForms {
            rpy_deg: self.rotation_rpy_deg.take(),
            xyzw: self.rotation_xyzw.take(),
            vector_rad: self.rotation_vector_rad.take(),
            matrix: None,
        }
    }

    fn set_position_m(&mut self, position_m: [f64; 3]) {
        self.position_m = Some(position_m);
    }

    fn set_rotation_rpy_rad(&mut self, rotation_rpy_rad: [f64; 3]) {
        self.rotation_rpy_rad = Some(rotation_rpy_rad);
    }
}
