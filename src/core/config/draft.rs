//! A draft: a run file that was parsed but not validated yet, for commands that fill in values which the file leaves open.

use super::check::pose;
use super::goal_file::{GoalFile, word};
use super::raw::{DriveKind, MountKind, RawConfig, RawDrive, RawMotion, SetPointKind, Task};
use super::targets::FIRST_TARGET;
use super::{Config, ConfigError, DEFAULT_TOML, Document, Problem, SHIPPED_FILES, ShippedFile};
use super::{lens_file, pose_forms, second_view, stereo, tables, validate};
use crate::geometry::{Pose, roll_pitch_yaw};
use crate::input::{file, nearest};
use crate::robot::{Mount, RobotDescription};
use std::path::{Path, PathBuf};

/// A run file with its defaults and absolute paths, and where each key stands.
#[derive(Debug, Clone)]
pub struct Draft {
    /// Every key; those that cannot be read have their defaults.
    raw: RawConfig,
    document: Document,
    folder: PathBuf,
    /// The problems so far.
    problems: Vec<Problem>,
    /// Number of further problems.
    more: usize,
    /// Files that a shipped run file names and that are not part of the program.
    needed: Option<Problem>,
    /// Keys that are written with the name that they had in the version before.
    renamed: Vec<Problem>,
}

/// Keys that had another name in the version before: table, old name, new name.
const RENAMED: [(&str, &str, &str); 1] = [("servo", "calm_gain_1_s", "gain_at_goal_1_s")];

impl Draft {
    /// Reads a run file, or the embedded default where `path` is `None`, and applies `--set` arguments.
    ///
    /// # Errors
    /// When the file cannot be read or is no TOML. Other problems are reported by [`Self::validate`].
    pub fn load(path: Option<&Path>, set: &[String]) -> Result<Self, ConfigError> {
        let Some(path) = path else {
            return Self::parse("embedded default configuration", DEFAULT_TOML, Path::new("."), set);
        };
        let name = path.display().to_string();
        if let Some(shipped) = path.to_str().and_then(ShippedFile::find).filter(|_| !path.is_file()) {
            return Self::of_shipped(shipped, set);
        }
        let text = file::read(path, file::MAX_TOML).map_err(|e| {
            ConfigError::new(vec![Problem::of_file(&name, format!("cannot be read: {e}{}", hint(path)))], 0)
        })?;
        // A file that is named without a folder has an empty parent: it stands in the working directory.
        let folder = path.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."));
        Self::parse(&name, &text, folder, set)
    }

    fn of_shipped(shipped: &ShippedFile, set: &[String]) -> Result<Self, ConfigError> {
        let name = shipped.name;
        let needed = (!shipped.needs.is_empty()).then(|| {
            let message = format!(
                "names files that are not part of the program ({}): write it to a file with `vservo config {name}`, and put \
                 yours there",
                shipped.needs.join(", ")
            );
            Problem::of_file(name, message)
        });
        match Self::parse(&format!("{name} (shipped)"), shipped.text, Path::new("."), set) {
            Ok(draft) => Ok(Self { needed, ..draft }),
            Err(error) => Err(error.beside(needed)),
        }
    }

    /// Reads a run file from `text`; see [`Config::parse`].
    ///
    /// # Errors
    /// As for [`Self::load`].
    pub fn parse(name: &str, text: &str, folder: &Path, set: &[String]) -> Result<Self, ConfigError> {
        let mut document = Document::parse(name, text)?;
        let mut renamed = with_new_names(&mut document);
        let mut problems = Vec::new();
        for argument in set {
            problems.extend(document.set(argument).err());
            renamed.extend(with_new_names(&mut document));
        }
        let (mut raw, more) = tables::read(&mut document, &mut problems);
        resolve_paths(&mut raw, &document, folder, &mut problems);
        Ok(Self { raw, document, folder: folder.into(), problems, more, needed: None, renamed })
    }

    /// The validated configuration.
    ///
    /// # Errors
    /// All its problems.
    pub fn validate(self) -> Result<Config, ConfigError> {
        self.judged(true)
    }

    /// The configuration, also where the target is outside of the image at the start or at the goal: for display, not for a run.
    ///
    /// # Errors
    /// All its other problems.
    pub fn validate_whatever_is_seen(self) -> Result<Config, ConfigError> {
        self.judged(false)
    }

    fn judged(self, views: bool) -> Result<Config, ConfigError> {
        let Self { raw, document, mut problems, more, needed, renamed, .. } = self;
        match validate::validate(raw, &document, views, &mut problems) {
            Some(mut config) if problems.is_empty() => {
                second_view::add(&mut config, &document, views, &mut problems);
                if !problems.is_empty() {
                    return Err(ConfigError::new(problems, more).beside(needed));
                }
                config.warnings.extend(needed.into_iter().chain(renamed));
                Ok(config)
            }
            _ => Err(ConfigError::new(problems, more).beside(needed)),
        }
    }

    /// The same run from `q_start` (rad or m), with the object at `X_WO` and the goal `X_DO`.
    #[must_use]
    pub fn placed(mut self, q_start: &[f64], X_WO: &Pose, X_DO: &Pose) -> Self {
        let parts =
            |X: &Pose| (X.translation.vector.into(), roll_pitch_yaw(&X.rotation.to_rotation_matrix()));
        self.raw.robot.q_start_rad_or_m = q_start.to_vec();
        (self.raw.scene.object.position_m, self.raw.scene.object.rotation_rpy_rad) = parts(X_WO);
        (self.raw.servo.desired.position_m, self.raw.servo.desired.rotation_rpy_rad) = parts(X_DO);
        self
    }

    /// The same cell servoing to a pose in simulation: an external drive is replaced by the simulated arm.
    #[must_use]
    pub fn simulated(mut self) -> Self {
        if matches!(self.raw.drive.kind, DriveKind::External | DriveKind::Replay | DriveKind::None) {
            self.raw.drive = RawDrive { simulated: self.raw.drive.simulated.clone(), ..RawDrive::default() };
            self.raw.motion.controller = RawMotion::default().controller;
        }
        self.raw.run.task = Task::Servo;
        self.raw.run.serve = false;
        self.raw.servo.set_point.kind = SetPointKind::Pose;
        self
    }

    /// File or shipped name of the robot.
    #[must_use]
    pub fn robot_model(&self) -> &str {
        &self.raw.robot.model
    }

    /// Where the goal comes from.
    #[must_use]
    pub fn set_point_kind(&self) -> SetPointKind {
        self.raw.servo.set_point.kind
    }

    /// Where the first camera is mounted on `robot`. On a link that this has not, it counts as on the flange; [`Self::validate`] tells.
    #[must_use]
    pub fn mount(&self, robot: &RobotDescription) -> Mount {
        let camera = self.raw.cameras.first().unwrap_or(&self.raw.camera);
        let X = pose(camera.mount.position_m, camera.mount.rotation_rpy_rad);
        let link = camera.mount.link.as_deref().and_then(|name| robot.joints_to_link(name));
        match (camera.mount.kind, link) {
            (MountKind::EyeInHand, Some(joints)) => Mount::EyeOnLink { joints, X_LC: X },
            (MountKind::EyeInHand, None) => Mount::EyeInHand { X_EC: X },
            (MountKind::EyeToHand, _) => Mount::EyeToHand { X_BC: X },
        }
    }

    /// The keys that are written, with what `--set` gave.
    #[must_use]
    pub fn written(&self) -> &toml::Table {
        &self.document.table
    }

    /// The folder from which relative paths of the file count.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Whether a `--set` argument gave the value at `key`.
    #[must_use]
    pub fn is_argument(&self, key: &str) -> bool {
        self.document.is_argument(key)
    }

    /// Problems with the values at keys, or warnings, as an error that names their positions.
    #[must_use]
    pub fn error(&self, told: Vec<(impl AsRef<str>, String)>) -> ConfigError {
        ConfigError::new(self.problems_of(told), 0)
    }

    /// The same as single problems.
    #[must_use]
    pub fn problems_of(&self, told: Vec<(impl AsRef<str>, String)>) -> Vec<Problem> {
        told.into_iter().map(|(key, message)| self.document.problem(key.as_ref(), message)).collect()
    }
}

/// A hint where a name is no file.
fn hint(path: &Path) -> String {
    let is_word = path.extension().is_none() && path.components().count() == 1;
    let Some(word) = path.to_str().filter(|_| is_word) else { return String::new() };
    let meant = nearest(word, SHIPPED_FILES.iter().map(|file| file.name))
        .map_or("`vservo config --list` tells them".into(), |name| format!("did you mean `{name}`?"));
    format!("; nor is it the name of a shipped run file: {meant}")
}

/// Renames keys of the previous version. Returns the warnings about them.
fn with_new_names(document: &mut Document) -> Vec<Problem> {
    RENAMED.iter().filter_map(|(table, old, new)| document.rename(table, old, new)).collect()
}

/// Loads the features of `servo.set_point.file` into the table, as if they had been written there. `absolute` makes a path of the run file absolute.
fn taught_set_point(
    raw: &mut RawConfig,
    document: &Document,
    absolute: impl Fn(&str, &Path) -> PathBuf,
    problems: &mut Vec<Problem>,
) {
    const KEY: &str = "servo.set_point.file";
    let set_point = &mut raw.servo.set_point;
    let Some(name) = set_point.file.take() else { return };
    let mut wrong = |message: String| problems.push(document.problem(KEY, message));
    if !set_point.features.is_empty() || set_point.kind == SetPointKind::Taught {
        return wrong(
            "servo.set_point.features or kind = \"taught\" is given too: leave out one of them".into(),
        );
    }
    let path = absolute(KEY, &name);
    let place = path.display();
    match GoalFile::load(&path) {
        Err(why) => wrong(why),
        Ok(GoalFile { target_name: Some(name), .. }) if name != FIRST_TARGET => wrong(format!(
            "{place} is of the target `{name}`, and this is the goal of [target]: name it in [goals.NAME], with file"
        )),
        Ok(goal) if goal.target != word(raw.target.kind) => {
            let kind = word(raw.target.kind);
            wrong(format!("{place} is of a target of kind \"{}\", target.kind is \"{kind}\"", goal.target));
        }
        Ok(goal) => {
            set_point.kind = SetPointKind::Features;
            set_point.features = goal.features.iter().map(|feature| feature.s).collect();
        }
    }
}

/// Puts what stands in the files of named goals and postures in their places.
fn named_goals(
    raw: &mut RawConfig,
    document: &Document,
    absolute: impl Fn(&str, &Path) -> PathBuf,
    problems: &mut Vec<Problem>,
) {
    for (name, goal) in &mut raw.goals {
        let key = format!("goals.{name}");
        goal.resolve(&key, document, |path| absolute(&format!("{key}.file"), path), problems);
    }
    for (name, posture) in &mut raw.postures {
        let key = format!("postures.{name}");
        posture.resolve(&key, document, |path| absolute(&format!("{key}.file"), path), problems);
    }
}

fn resolve_paths(raw: &mut RawConfig, document: &Document, folder: &Path, problems: &mut Vec<Problem>) {
    let absolute = |key: &str, path: &Path| {
        let base = if document.is_argument(key) { Path::new(".") } else { folder };
        std::path::absolute(base.join(path)).unwrap_or_else(|_| base.join(path))
    };
    let images = |key: &str, folder: &mut PathBuf| {
        if !folder.as_os_str().is_empty() {
            *folder = absolute(key, folder);
        }
    };
    pose_forms::resolve(raw, document, problems);
    lens_file::resolve(raw, document, absolute, problems);
    stereo::resolve(raw, document, absolute, problems);
    taught_set_point(raw, document, absolute, problems);
    named_goals(raw, document, absolute, problems);
    images("camera.replay.folder", &mut raw.camera.replay.folder);
    images("camera.replay.recording", &mut raw.camera.replay.recording);
    images("drive.replay.recording", &mut raw.drive.replay.recording);
    for (i, camera) in raw.cameras.iter_mut().enumerate() {
        images(&format!("cameras[{i}].replay.folder"), &mut camera.replay.folder);
        images(&format!("cameras[{i}].replay.recording"), &mut camera.replay.recording);
    }
    raw.camera.external.folder = absolute("camera.external.folder", &raw.camera.external.folder);
    for (i, camera) in raw.cameras.iter_mut().enumerate() {
        camera.external.folder = absolute(&format!("cameras[{i}].external.folder"), &camera.external.folder);
    }
    let folder = &raw.drive.external.folder;
    raw.drive.external.folder = absolute("drive.external.folder", folder);
    // A word without ending or folder is a name; `robot::load` says which names there are.
    let model = |key: &str, model: &mut String| {
        if model.contains(['.', '/']) {
            *model = absolute(key, Path::new(model)).display().to_string();
        }
    };
    model("robot.model", &mut raw.robot.model);
    if let Some(true_model) = &mut raw.scene.arm.model {
        model("scene.arm.model", true_model);
    }
}
