//! Files that a command writes: whether they can be written is found out before the work, and what could not be is told after it.

use crate::input::printable;
use crate::process::ProcessError;
use crate::rt::{self, tell};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// Whether a file can be written after the work, and is no other output of this command.
pub(super) fn check_writable(path: &Path) -> Result<(), ProcessError> {
    /// What this command is to write so far.
    static OUTPUTS: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());
    // A device or a pipe takes several.
    let is_special = std::fs::metadata(path).is_ok_and(|known| !known.is_file());
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let place = std::fs::canonicalize(path).or_else(|_| {
        std::fs::canonicalize(folder).map(|folder| folder.join(path.file_name().unwrap_or_default()))
    });
    if let (Ok(place), Ok(mut outputs)) = (place, OUTPUTS.lock())
        && !is_special
    {
        if outputs.contains(&place) {
            let path = printable(&path.display().to_string());
            let message =
                format!("{path}: two outputs of this command have this name, of which one would be lost");
            return Err(ProcessError::NoCommand(message));
        }
        outputs.push(place);
    }
    rt::check_writable(path).map_err(|cause| ProcessError::Write { path: path.into(), cause })
}

/// Writes what is also on stdout into a file. A failure is reported and determines the exit code, unless there was a graver
/// one already.
pub(super) fn write_result(path: &Path, text: impl AsRef<[u8]>, exit_code: u8) -> u8 {
    let Err(cause) = rt::write_file(path, text) else { return exit_code };
    lost(path, cause, exit_code)
}

/// Tells that results could not be written; the exit code.
pub(super) fn lost(path: &Path, cause: std::io::Error, exit_code: u8) -> u8 {
    let error = ProcessError::Write { path: path.into(), cause };
    tell(format_args!("vservo: {error}"));
    if exit_code == 0 { error.exit_code() } else { exit_code }
}
