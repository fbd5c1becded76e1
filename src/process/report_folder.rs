//! The folder of a run's report: what is in it, and that it can be written, which is found out before the run.

use super::ProcessError;
use crate::rt;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// The page that people open.
pub(super) const PAGE: &str = "index.html";
/// A row a tick; written by control, like the next four.
pub(super) const TRACE: &str = "trace.csv";
/// A row a measurement.
pub(super) const MEASUREMENTS: &str = "measurements.csv";
/// Where the points of the target are to be in the image.
pub(super) const GOAL: &str = "goal.csv";
/// Frames of the cell in B.
pub(super) const POSES: &str = "poses.csv";
/// What is in the kept pictures; written by vision.
pub(super) const FRAMES: &str = "frames.csv";
/// What safety saw.
pub(super) const EVENTS: &str = "events.csv";
/// Deadlines to commands.
pub(super) const TICKS: &str = "tick-times.csv";
/// The effective run file.
pub(super) const CONFIG: &str = "config.toml";
/// The summary.
pub(super) const SUMMARY: &str = "summary.json";

const FILES: [&str; 10] = [PAGE, TRACE, MEASUREMENTS, GOAL, POSES, FRAMES, EVENTS, TICKS, CONFIG, SUMMARY];
/// Longest file of a report that is read back, bytes.
const LONGEST: u64 = 512 << 20;

/// A folder for the report of a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReportFolder(PathBuf);

impl ReportFolder {
    /// Makes `path` a folder where there is none, and finds out whether files can be made in it.
    ///
    /// # Errors
    /// [`ProcessError::Write`] for a file of that name, or where nothing can be written.
    pub fn check(path: &Path) -> Result<Self, ProcessError> {
        let failed = |cause| ProcessError::Write { path: path.into(), cause };
        let path_is_taken = path.symlink_metadata().is_ok() && !path.is_dir();
        if path_is_taken {
            return Err(failed(ErrorKind::NotADirectory.into()));
        }
        std::fs::create_dir_all(path).map_err(failed)?;
        // The children have other working directories, as far as anybody knows.
        let folder = Self(std::path::absolute(path).map_err(failed)?);
        for file in FILES {
            let path = folder.0.join(file);
            rt::check_writable(&path).map_err(|cause| ProcessError::Write { path, cause })?;
        }
        Ok(folder)
    }

    /// The folder that a supervisor has checked.
    #[must_use]
    pub fn of_run(path: &Path) -> Self {
        Self(path.into())
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// Removes what an earlier report left, and nothing else: a page must not show two runs.
    ///
    /// # Errors
    /// [`ProcessError::Write`].
    pub(super) fn clear(&self) -> Result<(), ProcessError> {
        let failed = |path: &Path, cause| ProcessError::Write { path: path.into(), cause };
        let entries = std::fs::read_dir(&self.0).map_err(|e| failed(&self.0, e))?;
        for entry in entries.flatten() {
            let name = entry.file_name();
            let name = name.to_string_lossy();
            if FILES.contains(&name.as_ref()) || is_picture(&name) {
                match std::fs::remove_file(entry.path()) {
                    Err(e) if e.kind() != ErrorKind::NotFound => return Err(failed(&entry.path(), e)),
                    _ => {}
                }
            }
        }
        Ok(())
    }

    /// Writes a file of the report; where it is.
    ///
    /// # Errors
    /// [`ProcessError::Write`].
    pub(super) fn write(&self, name: &str, contents: impl AsRef<[u8]>) -> Result<PathBuf, ProcessError> {
        let path = self.0.join(name);
        match rt::write_file(&path, contents) {
            Ok(()) => Ok(path),
            Err(cause) => Err(ProcessError::Write { path, cause }),
        }
    }

    /// A file of the report; `None` where there is none, or none that a report has.
    pub(super) fn read(&self, name: &str) -> Option<Vec<u8>> {
        let path = self.0.join(name);
        let length = std::fs::metadata(&path).ok().filter(std::fs::Metadata::is_file)?.len();
        (length <= LONGEST).then(|| std::fs::read(&path).ok())?
    }
}

/// `frame-first-000000.png`.
fn is_picture(name: &str) -> bool {
    let middle = name.strip_prefix("frame-").and_then(|n| n.strip_suffix(".png"));
    let parts = middle.and_then(|m| m.split_once('-'));
    parts.is_some_and(|(why, number)| {
        ["first", "lost", "last"].contains(&why) && number.chars().all(|c| c.is_ascii_digit())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_files_of_a_report_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let names = ["index.html", "frame-lost-000012.png", "frame-mine.png", "notes.txt"];
        for name in names {
            std::fs::write(folder.path().join(name), name).unwrap();
        }
        let report = ReportFolder::check(folder.path()).unwrap();
        report.clear().unwrap();
        let mut left: Vec<_> =
            std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        left.sort();
        assert_eq!(left, ["frame-mine.png", "notes.txt"]);
        assert_eq!(report.read("notes.txt").unwrap(), b"notes.txt");
        assert_eq!(report.read("index.html"), None);
    }

    #[test]
    fn a_file_of_that_name_and_a_place_below_one_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, "x").unwrap();
        for path in [file.clone(), file.join("below"), PathBuf::from("/proc/nothing/here")] {
            let error = ReportFolder::check(&path).unwrap_err();
            assert_eq!(error.exit_code(), 3, "{error}");
        }
        let deep = folder.path().join("a/b");
        assert!(ReportFolder::check(&deep).unwrap().path().is_dir());
        assert_eq!(std::fs::read_dir(&deep).unwrap().count(), 0, "no trace of the attempt");
    }
}
