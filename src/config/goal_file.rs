//! A goal that was taught: the file that `vservo teach` writes and `servo.set_point.file` reads.

use super::Document;
use super::problem::Problem;
use super::raw::{RawConfig, SetPointKind};
use crate::geometry::Pose;
use crate::input::file;
use crate::target::Target;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The key that names such a file.
const KEY: &str = "servo.set_point.file";

/// A taught goal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GoalFile {
    /// Kind of target that was seen.
    pub target: String,
    /// How many measurements it is the mean of.
    pub measurements: u32,
    /// A picture of the view, beside the file, for people.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub thumbnail: Option<String>,
    /// The target in the camera, for people: runs go by the features.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pose: Option<GoalPose>,
    /// The points of the target.
    pub features: Vec<GoalFeature>,
}

/// A pose, as in a run file.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GoalPose {
    /// Position, m.
    pub position_m: [f64; 3],
    /// Roll, pitch, yaw, rad.
    pub rotation_rpy_rad: [f64; 3],
}

/// A point of the target as it was seen.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GoalFeature {
    /// Which one.
    pub id: u32,
    /// Normalized coordinates.
    pub s: [f64; 2],
    /// Place in the picture, px.
    pub px: [f64; 2],
    /// How far single measurements were from it, root mean square, px.
    pub spread_px: f64,
}

impl GoalFile {
    /// The text of the file.
    #[must_use]
    pub fn to_toml(&self) -> String {
        let how = "# A taught goal: servo.set_point.file names it in a run file with the same camera and target.\n";
        how.to_owned() + &toml::to_string(self).unwrap_or_default()
    }

    /// A pose as it stands in the file.
    #[must_use]
    pub fn pose_of(X_DO: &Pose) -> GoalPose {
        let (roll, pitch, yaw) = X_DO.rotation.euler_angles();
        GoalPose { position_m: X_DO.translation.vector.into(), rotation_rpy_rad: [roll, pitch, yaw] }
    }
}

/// Puts the features of `servo.set_point.file` where they could have been written. `absolute` makes a path of the run file absolute.
pub(super) fn resolve(
    raw: &mut RawConfig,
    document: &Document,
    absolute: impl Fn(&str, &Path) -> PathBuf,
    problems: &mut Vec<Problem>,
) {
    let set_point = &mut raw.servo.set_point;
    let Some(name) = set_point.file.take() else { return };
    let mut wrong = |message: String| problems.push(document.problem(KEY, message));
    if !set_point.features.is_empty() || set_point.kind == SetPointKind::Taught {
        return wrong("servo.set_point.features or kind = \"taught\" is given too: leave out one of them".into());
    }
    let path = absolute(KEY, &name);
    let place = path.display();
    let text = match file::read(&path, file::LARGEST_TOML) {
        Ok(text) => text,
        Err(e) => return wrong(format!("{place} cannot be read: {e}; `vservo teach --out FILE` writes one")),
    };
    match toml::from_str::<GoalFile>(&text) {
        Err(e) => wrong(format!("{place}: {}; a file of `vservo teach` is expected", e.message())),
        Ok(goal) if goal.target != raw.target.kind.as_str() => {
            let kind = raw.target.kind.as_str();
            wrong(format!("{place} is of a target of kind \"{}\", target.kind is \"{kind}\"", goal.target));
        }
        Ok(goal) => {
            set_point.kind = SetPointKind::Features;
            set_point.features = goal.features.iter().map(|feature| feature.s).collect();
        }
    }
}

/// Whether a goal can be taught of so many points: all that serve as features.
#[must_use]
pub fn taught_ids(target: &Target) -> Vec<u32> {
    target.features().map(|point| point.id).collect()
}
