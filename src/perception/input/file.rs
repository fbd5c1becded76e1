//! Text files that somebody gives: regular ones, read no farther than a limit, whatever stands at their place.

use std::fs::{File, OpenOptions};
use std::io::{Error, ErrorKind, Read, Result};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

/// Longest run file and TOML file of a robot, bytes, so that a hostile one takes no memory: real ones have some thousand.
pub const MAX_TOML: u64 = 1 << 20;
/// Longest URDF, bytes, for the same reason: real ones have some hundred thousand, so that this must be more than any.
pub const MAX_URDF: u64 = 8 << 20;

/// The text of the file at `path`, of at most `largest` bytes.
///
/// # Errors
/// The system's; and for a pipe, a device or a folder, a file that is longer, and one that is not UTF-8.
pub fn read(path: &Path, largest: u64) -> Result<String> {
    let regular = |metadata: std::fs::Metadata| {
        let refusal = || Error::new(ErrorKind::InvalidInput, "it is not a regular file");
        metadata.is_file().then_some(()).ok_or_else(refusal)
    };
    // Looked at before it is opened, because opening alone may wait (a pipe) or act (a device); and once more behind the
    // descriptor, because the file may have been exchanged in between.
    regular(std::fs::metadata(path)?)?;
    let file: File =
        OpenOptions::new().read(true).custom_flags(libc::O_NONBLOCK | libc::O_NOCTTY).open(path)?;
    let found = file.metadata()?;
    super::used::note(&found);
    regular(found)?;
    let mut bytes = Vec::new();
    file.take(largest + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > largest {
        let message = format!("it is larger than {} MiB", largest >> 20);
        return Err(Error::new(ErrorKind::FileTooLarge, message));
    }
    let text = String::from_utf8(bytes)
        .map_err(|_| Error::new(ErrorKind::InvalidData, "it is not text in UTF-8"))?;
    // The mark with which editors and spreadsheets begin text in UTF-8 is none of it.
    Ok(text.strip_prefix('\u{feff}').map(str::to_owned).unwrap_or(text))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mark_of_a_spreadsheet_is_none_of_its_text() {
        let path = std::env::temp_dir().join(format!("vservo-mark-{}", std::process::id()));
        std::fs::write(&path, "\u{feff}id,x_m\n1,2\n").unwrap();
        assert_eq!(read(&path, 100).unwrap(), "id,x_m\n1,2\n");
        std::fs::remove_file(&path).unwrap();
    }
}
