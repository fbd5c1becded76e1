//! A recording with the configuration that it was made of.

use super::ProcessError;
use crate::config::Config;
use crate::input::used;
use crate::record::{ABOUT, RUN_FILE, RecordingError, RecordingReader};
use crate::replay::{self, ReplayError};
use crate::robot;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use tracing::warn;

/// A recording with the run file and the robot files that are in it.
pub struct OpenRecording {
    /// Its messages, from the first one on.
    pub reader: RecordingReader<BufReader<File>>,
    /// Its run file, with the changes that were asked for.
    pub config: Config,
    /// A word about the version that recorded it, where that is another one.
    pub other_version: Option<String>,
}

impl OpenRecording {
    /// Opens it, and changes its settings by `set`.
    ///
    /// # Errors
    /// When it cannot be read, or its run file is not one of this version.
    pub fn open(path: &Path, set: &[String]) -> Result<Self, ProcessError> {
        let wrong = |cause: ReplayError| ProcessError::Replay { path: path.into(), cause: Box::new(cause) };
        let reader = Self::reader_of(path).map_err(wrong)?.telling_of_cut(warning_of_cut(path));
        let robots = RobotFiles::of(&reader)?;
        let settings: Vec<_> = robots.settings.iter().chain(set).cloned().collect();
        let config = replay::recorded_config(&reader, &settings).map_err(wrong)?;
        let version = reader.metadata().get(ABOUT).and_then(|about| about.get("version"));
        let this = env!("CARGO_PKG_VERSION");
        let other_version = version.filter(|version| *version != this).map(|version| {
            format!("recorded by version {version}, replayed by {this}: what differs may be the program\n")
        });
        Ok(Self { reader, config, other_version })
    }

    /// Its reader alone, which says nothing where the recording is cut off.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn reader_of(path: &Path) -> Result<RecordingReader<BufReader<File>>, ReplayError> {
        let file = File::open(path).map_err(RecordingError::from)?;
        used::note_path(path);
        Ok(RecordingReader::open(BufReader::new(file))?)
    }
}

/// What is said once a reader comes to where the recording at `path` is cut off.
pub(super) fn warning_of_cut(path: &Path) -> impl FnOnce(&str) + Send + use<> {
    let path = path.to_owned();
    move |why| {
        warn!(
            "{}: damaged or cut off; it is read up to there, what follows is left out: {why}",
            path.display()
        )
    }
}

/// The robot files of a recording where this machine has not the same, in a folder that goes when they have been read.
struct RobotFiles {
    folder: PathBuf,
    settings: Vec<String>,
}

impl RobotFiles {
    fn of<R: std::io::Read>(reader: &RecordingReader<R>) -> Result<Self, ProcessError> {
        let folder = std::env::temp_dir().join(format!("vservo-replay-{}", std::process::id()));
        let mut robots = Self { folder, settings: Vec::new() };
        let text = reader.attachments().get(RUN_FILE).cloned().unwrap_or_default();
        // what is wrong with it is told when it is validated
        let table = toml::Value::Table(String::from_utf8_lossy(&text).parse().unwrap_or_default());
        for (name, keys) in [("robot", &["robot", "model"][..]), ("scene.arm", &["scene", "arm", "model"])] {
            let model = keys.iter().try_fold(&table, |at, key| at.get(*key)).and_then(toml::Value::as_str);
            let Some(model) = model else { continue };
            let prefix = format!("{name}/");
            let recorded: Vec<_> = reader
                .attachments()
                .iter()
                .filter_map(|(file, data)| Some((file.strip_prefix(&prefix)?, data)))
                .filter(|(file, _)| !file.contains('/') && *file != "..")
                .collect();
            let here = robot::files(model).unwrap_or_default();
            let is_here = |(file, data): &(&str, &Vec<u8>)| {
                here.iter().any(|(name, text)| name == file && text.as_bytes() == data.as_slice())
            };
            if recorded.iter().all(is_here) {
                continue;
            }
            let place = robots.folder.join(name);
            let write = |path: &Path, data: &[u8]| {
                std::fs::write(path, data).map_err(|cause| ProcessError::Write { path: path.into(), cause })
            };
            std::fs::create_dir_all(&place)
                .map_err(|cause| ProcessError::Write { path: place.clone(), cause })?;
            recorded.iter().try_for_each(|(file, data)| write(&place.join(file), data))?;
            let file = model.rsplit('/').next().unwrap_or(model);
            let file = if robot::SHIPPED.contains(&file) { format!("{file}.toml") } else { file.to_owned() };
            robots.settings.push(format!("{}={:?}", keys.join("."), place.join(file).display().to_string()));
        }
        Ok(robots)
    }
}

impl Drop for RobotFiles {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.folder); // mostly there is none
    }
}
