//! Taught set-points: the file that `vservo teach` writes and `servo.set_point.file` reads.

use super::Config;
use super::target::TargetKind;
use crate::geometry::Pose;
use crate::input::file;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// A taught goal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GoalFile {
    /// Kind of target.
    pub target: String,
    /// Name of the target in the run file, where it is one of `[targets]`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub target_name: Option<String>,
    /// How many measurements it is the mean of, where that is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measurements: Option<u32>,
    /// The posture in which it was taught, rad or m, of a running arm: `vservo ctl goto` goes there.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub q_rad_or_m: Vec<f64>,
    /// An image of the view, beside the file, for people.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub thumbnail: Option<String>,
    /// Pose of the target in the camera, for information: runs use the features.
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

/// Measured features of one point of the target.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GoalFeature {
    /// Which one.
    pub id: u32,
    /// Normalized coordinates.
    pub s: [f64; 2],
    /// Position in the image, px, where it is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub px: Option<[f64; 2]>,
    /// Root mean square deviation of single measurements from it, px, where it is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spread_px: Option<f64>,
}

impl GoalFile {
    /// Reads a file.
    ///
    /// # Errors
    /// Why it cannot be read, or is none.
    pub fn load(path: &Path) -> Result<Self, String> {
        let place = path.display();
        let text = file::read(path, file::MAX_TOML)
            .map_err(|e| format!("{place} cannot be read: {e}; `vservo teach --out FILE` writes one"))?;
        toml::from_str(&text)
            .map_err(|e| format!("{place}: {}; a file of `vservo teach` is expected", e.message()))
    }

    /// Whether `text` is that of a taught goal.
    #[must_use]
    pub fn is_one(text: &str) -> bool {
        toml::from_str::<Self>(text).is_ok()
    }

    /// The text of the file.
    #[must_use]
    pub fn to_toml(&self) -> String {
        let how =
            "# A taught goal: servo.set_point.file names it in a run file with the same camera and target.\n";
        how.to_owned() + &toml::to_string(self).unwrap_or_default()
    }

    /// The word for the kind of a target of a run file; `name` is one of `[targets]`, or `None` for `[target]`.
    #[must_use]
    pub fn target_word(config: &Config, name: Option<&str>) -> String {
        let further = name.and_then(|name| config.effective.targets.get(name));
        word(further.unwrap_or(&config.effective.target).kind)
    }

    /// A pose as it stands in the file.
    #[must_use]
    pub fn pose_of(X_DO: &Pose) -> GoalPose {
        let (roll, pitch, yaw) = X_DO.rotation.euler_angles();
        GoalPose { position_m: X_DO.translation.vector.into(), rotation_rpy_rad: [roll, pitch, yaw] }
    }
}

/// The word of a run file for it.
pub(super) fn word(kind: TargetKind) -> String {
    let value = toml::Value::try_from(kind).ok();
    value.as_ref().and_then(toml::Value::as_str).unwrap_or_default().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn goal(target: &str, count: usize) -> GoalFile {
        let s = [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]];
        let features = (0..).zip(s).take(count);
        let features =
            features.map(|(id, s)| GoalFeature { id, s, px: None, spread_px: Some(0.01) }).collect();
        GoalFile {
            target: target.into(),
            target_name: None,
            measurements: Some(10),
            q_rad_or_m: Vec::new(),
            thumbnail: None,
            pose: None,
            features,
        }
    }

    fn load(goal: &GoalFile, more: &[&str]) -> Result<Config, String> {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("goal.toml"), goal.to_toml()).unwrap();
        let text = "[servo.set_point]\nfile = \"goal.toml\"\n";
        let more: Vec<String> = more.iter().map(|&s| s.into()).collect();
        Config::parse("run.toml", text, folder.path(), &more).map_err(|e| e.to_string())
    }

    #[test]
    fn a_taught_goal_is_that_of_its_features() {
        let config = load(&goal("four_dots", 4), &[]).unwrap();
        let s = config.set_point.features();
        assert_eq!((s.len(), s[2].x), (4, 0.1));
        // 0.2 wide, of a square of 0.1 m
        let X_DO = config.set_point.X_DO().unwrap();
        assert!((X_DO.translation.vector.z - 0.5).abs() < 1e-9);
        assert!(GoalFile::pose_of(X_DO).rotation_rpy_rad.iter().all(|a| a.abs() < 1e-6));
    }

    #[test]
    fn what_is_no_goal_of_this_cell_is_told() {
        for (goal, more, told) in [
            (goal("chessboard", 4), vec![], "of a target of kind \"chessboard\""),
            (goal("four_dots", 3), vec![], "has 3 points, the target has 4"),
            (goal("four_dots", 4), vec!["servo.set_point.kind=taught"], "leave out one of them"),
            (
                goal("four_dots", 4),
                vec!["servo.set_point.file=absent.toml"],
                "`vservo teach --out FILE` writes one",
            ),
        ] {
            let wrong = load(&goal, &more).unwrap_err();
            assert!(wrong.contains(told) && wrong.contains("servo.set_point"), "{wrong}");
        }
    }
}
