//! The folder of a run's report: what is in it, and that it can be written, which is found out before the run.
//!
//! ```text
//! DIR/.vservo-report-PID.tmp/ ◄─ control, vision, supervisor write ─► the run is over, the page is made: each file is renamed into DIR
//! ```

use super::ProcessError;
use crate::report::page::GENERATOR;
use crate::rt;
use std::fs::File;
use std::io::{ErrorKind, Read};
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
/// What is in the kept images; written by vision.
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
/// The folder in which a report is made has this name around the number of the process that makes it.
const WORK: &str = ".vservo-report-";
const WORK_END: &str = ".tmp";
/// Longest file of a report that is read back, bytes. Chosen by hand: a history is bounded to 120 000 rows (`report/history`).
const LONGEST: u64 = 512 << 20;

/// The folder in which the files of a report are made.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ReportFolder(PathBuf);

/// A report on its way: made in a folder within the one that was asked for, and put into its place when it is whole. Until then, and
/// when it never is, an earlier report stays as it was.
#[derive(Debug)]
pub struct NewReport {
    target: PathBuf,
    /// The folder that was asked for was not there before.
    is_new: bool,
    folder: ReportFolder,
}

impl NewReport {
    /// Finds out before the run whether a report can be made in `path`, which is a folder that is new, empty or has an earlier
    /// report, or a link to one.
    ///
    /// # Errors
    /// [`ProcessError::NoReport`] for a folder of something else; [`ProcessError::Write`] for a file of that name, or where
    /// nothing can be written.
    pub fn begin(path: &Path) -> Result<Self, ProcessError> {
        let failed = |cause| ProcessError::Write { path: path.into(), cause };
        let led_to = rt::follow_links(path).map_err(failed)?;
        let path_is_taken = led_to.exists() && !led_to.is_dir();
        if path_is_taken {
            return Err(failed(ErrorKind::NotADirectory.into()));
        }
        // The children have other working directories, as far as anybody knows.
        let target = std::path::absolute(led_to).map_err(failed)?;
        let is_new = !target.exists();
        std::fs::create_dir_all(&target).map_err(failed)?;
        let mut holds_files = false;
        for entry in std::fs::read_dir(&target).map_err(failed)? {
            let entry = entry.map_err(failed)?;
            match maker(&entry.file_name().to_string_lossy()) {
                Some(pid) if !Path::new("/proc").join(pid).exists() => {
                    let _ = std::fs::remove_dir_all(entry.path()); // of a run that was killed
                }
                Some(_) => {}
                None => holds_files = true,
            }
        }
        if holds_files && !is_report(&target) {
            return Err(ProcessError::NoReport(path.into()));
        }
        for file in FILES {
            let path = target.join(file);
            rt::check_writable(&path).map_err(|cause| ProcessError::Write { path, cause })?;
        }
        let work = target.join(format!("{WORK}{}{WORK_END}", std::process::id()));
        std::fs::create_dir(&work).map_err(failed)?;
        Ok(Self { target, is_new, folder: ReportFolder(work) })
    }

    /// Where its files are made.
    #[must_use]
    pub fn folder(&self) -> &ReportFolder {
        &self.folder
    }

    /// Where it will be.
    #[must_use]
    pub fn target(&self) -> &Path {
        &self.target
    }

    /// Whether there is an earlier one in its place.
    #[must_use]
    pub fn replaces(&self) -> bool {
        self.target.join(PAGE).exists()
    }

    /// Puts the report into its place. What of an earlier one has no successor goes, so that no page shows two runs; all else in
    /// the folder stays. Where the page is.
    ///
    /// # Errors
    /// [`ProcessError::Write`].
    pub fn publish(self) -> Result<PathBuf, ProcessError> {
        let failed = |path: &Path, cause| ProcessError::Write { path: path.into(), cause };
        let names = |folder: &Path| -> Result<Vec<_>, ProcessError> {
            let entries = std::fs::read_dir(folder).map_err(|e| failed(folder, e))?;
            Ok(entries.flatten().map(|entry| entry.file_name()).collect())
        };
        let made = names(&self.folder.0)?;
        for name in &made {
            let path = self.target.join(name);
            std::fs::rename(self.folder.0.join(name), &path).map_err(|e| failed(&path, e))?;
        }
        for name in names(&self.target)? {
            let text = name.to_string_lossy();
            if !made.contains(&name) && (FILES.contains(&text.as_ref()) || is_image(&text)) {
                let path = self.target.join(&name);
                std::fs::remove_file(&path).map_err(|e| failed(&path, e))?;
            }
        }
        Ok(self.target.join(PAGE))
    }
}

impl Drop for NewReport {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.folder.0);
        if self.is_new {
            let _ = std::fs::remove_dir(&self.target); // empty, where nothing was published
        }
    }
}

/// The process that makes a report in a folder of this name.
fn maker(name: &str) -> Option<&str> {
    name.strip_prefix(WORK)?.strip_suffix(WORK_END)
}

/// Whether the page in this folder is one of this program.
fn is_report(folder: &Path) -> bool {
    let mut head = [0; 512];
    let read = File::open(folder.join(PAGE)).and_then(|mut page| page.read(&mut head));
    read.is_ok_and(|n| String::from_utf8_lossy(head.get(..n).unwrap_or_default()).contains(GENERATOR))
}

impl ReportFolder {
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
fn is_image(name: &str) -> bool {
    let middle = name.strip_prefix("frame-").and_then(|n| n.strip_suffix(".png"));
    let parts = middle.and_then(|m| m.split_once('-'));
    parts.is_some_and(|(why, number)| {
        ["first", "lost", "last"].contains(&why) && number.chars().all(|c| c.is_ascii_digit())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::page::document;

    fn names(folder: &Path) -> Vec<String> {
        let entries = std::fs::read_dir(folder).unwrap();
        let mut names: Vec<_> =
            entries.map(|e| e.unwrap().file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }

    /// As for files: what a link leads to is made, and the link stays.
    #[test]
    fn a_link_stays_and_what_it_leads_to_is_made() {
        let folder = tempfile::tempdir().unwrap();
        let link = folder.path().join("latest");
        std::os::unix::fs::symlink("new", &link).unwrap();
        for _ in 0..2 {
            let report = NewReport::begin(&link).unwrap();
            report.folder().write(PAGE, document("new", "", &[])).unwrap();
            report.publish().unwrap();
            assert!(link.is_symlink() && folder.path().join("new").join(PAGE).is_file());
        }
        std::fs::write(folder.path().join("file"), "x").unwrap();
        let to_file = folder.path().join("to_file");
        std::os::unix::fs::symlink("file", &to_file).unwrap();
        assert!(NewReport::begin(&to_file).is_err());
    }

    #[test]
    fn a_report_takes_the_place_of_an_earlier_one_when_it_is_whole() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["frame-lost-000012.png", "frame-mine.png", "notes.txt", "trace.csv"] {
            std::fs::write(folder.path().join(name), "old").unwrap();
        }
        std::fs::write(folder.path().join(PAGE), document("old", "", &[])).unwrap();
        let before = names(folder.path());
        let given_up = NewReport::begin(folder.path()).unwrap();
        given_up.folder().write(TRACE, "new").unwrap();
        drop(given_up);
        assert_eq!(names(folder.path()), before);
        assert_eq!(std::fs::read_to_string(folder.path().join(TRACE)).unwrap(), "old");
        let report = NewReport::begin(folder.path()).unwrap();
        for name in [PAGE, TRACE, "frame-first-000000.png"] {
            report.folder().write(name, "new").unwrap();
        }
        assert_eq!(report.folder().read(TRACE).unwrap(), b"new");
        report.publish().unwrap();
        let after = ["frame-first-000000.png", "frame-mine.png", PAGE, "notes.txt", TRACE];
        assert_eq!(names(folder.path()), after);
        assert_eq!(std::fs::read_to_string(folder.path().join(TRACE)).unwrap(), "new");
        assert_eq!(std::fs::read_to_string(folder.path().join("notes.txt")).unwrap(), "old");
    }

    #[test]
    fn a_folder_of_something_else_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in [(TRACE, "theirs"), (PAGE, "<html>theirs</html>")] {
            std::fs::write(folder.path().join(name), text).unwrap();
            let refusal = NewReport::begin(folder.path()).unwrap_err();
            assert!(matches!(refusal, ProcessError::NoReport(_)) && refusal.exit_code() == 2, "{refusal}");
            assert_eq!(std::fs::read_to_string(folder.path().join(name)).unwrap(), text);
        }
        let left = folder.path().join(format!("{WORK}4000000000{WORK_END}")); // no process has this number
        let killed = tempfile::tempdir_in(folder.path()).unwrap();
        std::fs::rename(killed.path(), &left).unwrap();
        std::fs::remove_file(folder.path().join(TRACE)).unwrap();
        std::fs::remove_file(folder.path().join(PAGE)).unwrap();
        drop(NewReport::begin(folder.path()).unwrap());
        assert_eq!(names(folder.path()), Vec::<String>::new(), "what a killed run left is gone");
    }

    #[test]
    fn a_file_of_that_name_and_a_place_below_one_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, "x").unwrap();
        for path in [file.clone(), file.join("below"), PathBuf::from("/proc/nothing/here")] {
            let error = NewReport::begin(&path).unwrap_err();
            assert_eq!(error.exit_code(), 3, "{error}");
        }
        let deep = folder.path().join("a/b");
        assert!(NewReport::begin(&deep).unwrap().folder().path().is_dir());
        assert!(!deep.exists(), "no trace of the attempt");
    }
}
