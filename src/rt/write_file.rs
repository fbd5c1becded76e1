//! Writing results: a file is there whole, or not at all.
//!
//! ```text
//! plain file   ─► temporary file beside it ─► fsync ─► rename      a failure leaves what was there before
//! anything else (/dev/stdout, a pipe) ─────► written directly
//! ```
//! A link stays and what it leads to is replaced. Where a file may be written but nothing beside it, it is written in place.
//! What this program has read is not written at all.

use crate::input::used;
use rustix::fs::{AtFlags, Mode, OFlags, fchmod, fchown, fstat, open, statat};
use std::fs::{File, OpenOptions};
use std::io::{self, ErrorKind, Write};
use std::os::unix::fs::{FileTypeExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use thiserror::Error;

/// Longest chain of symbolic links, as the kernel's path resolution has it (path_resolution(7): 40).
const LONGEST_CHAIN: usize = 40;

/// The file is one that this program has read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("it is read by this command, and would be lost")]
pub struct IsRead;

impl IsRead {
    /// Whether this is why something was not written.
    #[must_use]
    pub fn is_cause_of(error: &io::Error) -> bool {
        error.get_ref().is_some_and(|inner| inner.is::<Self>())
    }
}

/// How a path is to be written.
enum WriteMethod {
    /// Beside the file, then renamed.
    Beside(PathBuf),
    /// As it is.
    Directly(PathBuf),
}

/// Writes `contents` to `path`.
///
/// # Errors
/// When it cannot be written; what was there before is then still there.
pub fn write_file(path: &Path, contents: impl AsRef<[u8]>) -> io::Result<()> {
    let text = contents.as_ref();
    match way(path)? {
        WriteMethod::Directly(path) => write_directly(&path, text),
        WriteMethod::Beside(target) => match Temporary::beside(&target) {
            Ok(temporary) => temporary.write(text)?.replace(&target, text),
            Err(e) if in_place_only(&e) && target.exists() => write_in_place(&target, text),
            Err(e) => Err(e),
        },
    }
}

/// Finds out before the work whether `path` can be written after it, and leaves no trace of the attempt.
///
/// # Errors
/// When it cannot.
pub fn check_writable(path: &Path) -> io::Result<()> {
    match way(path)? {
        // A pipe may get its reader later; opening it may wait for one.
        WriteMethod::Directly(path) if std::fs::metadata(&path)?.file_type().is_fifo() => Ok(()),
        WriteMethod::Directly(path) => open_directly(&path).map(drop),
        WriteMethod::Beside(target) => {
            if target.exists() {
                OpenOptions::new().append(true).open(&target)?;
            }
            match Temporary::beside(&target) {
                Ok(_) => Ok(()),
                Err(e) if in_place_only(&e) && target.exists() => Ok(()),
                Err(e) => Err(e),
            }
        }
    }
}

fn way(path: &Path) -> io::Result<WriteMethod> {
    let target = follow_links(path)?;
    match std::fs::metadata(&target) {
        Ok(found) if found.is_dir() => Err(ErrorKind::IsADirectory.into()),
        Ok(found) if found.is_file() && used::is_used(&found) => {
            Err(io::Error::new(ErrorKind::InvalidInput, IsRead))
        }
        // A plain file that is our stdout or stderr is not exchanged: the rest of the output goes there.
        Ok(found) if !found.is_file() || is_output(found.dev(), found.ino()) => {
            Ok(WriteMethod::Directly(target))
        }
        Ok(_) if is_descriptor(&target) => Ok(WriteMethod::Directly(target)),
        Ok(_) => Ok(WriteMethod::Beside(target)),
        Err(e) if e.kind() == ErrorKind::NotFound && !is_descriptor(&target) => {
            Ok(WriteMethod::Beside(target))
        }
        Err(e) => Err(e),
    }
}

/// Follows links of the last part of a path, so that what they lead to can be replaced. Those of open descriptors are no
/// names of files and stay.
///
/// # Errors
/// When a link cannot be read, or leads round in a circle.
pub fn follow_links(path: &Path) -> io::Result<PathBuf> {
    let mut path = path.to_path_buf();
    for _ in 0..LONGEST_CHAIN {
        if is_descriptor(&path) || !path.is_symlink() {
            return Ok(path);
        }
        let link = std::fs::read_link(&path)?;
        path = path.parent().unwrap_or(Path::new("")).join(link);
    }
    Err(rustix::io::Errno::LOOP.into())
}

/// `/dev/stdout`, `/dev/fd/3`, `/proc/self/fd/3`. Elsewhere below `/dev`, as in `/dev/shm`, files are files.
fn is_descriptor(path: &Path) -> bool {
    let streams = ["/dev/stdin", "/dev/stdout", "/dev/stderr"];
    streams.iter().any(|stream| path == Path::new(stream))
        || path.starts_with("/dev/fd")
        || path.starts_with("/proc")
}

fn is_output(device: u64, inode: u64) -> bool {
    let same = |stat: rustix::io::Result<rustix::fs::Stat>| {
        stat.is_ok_and(|s| s.st_dev == device && s.st_ino == inode)
    };
    same(fstat(io::stdout())) || same(fstat(io::stderr()))
}

fn in_place_only(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem)
}

fn open_directly(path: &Path) -> io::Result<File> {
    // Appended, because a file behind /dev/stdout holds what was printed before. Nobody at the other end of a pipe is an
    // error, not a reason to wait.
    let flags = OFlags::NONBLOCK.bits() as i32;
    OpenOptions::new().append(true).custom_flags(flags).open(path)
}

fn write_directly(path: &Path, text: &[u8]) -> io::Result<()> {
    let mut file = open_directly(path)?;
    let flags = rustix::fs::fcntl_getfl(&file)?;
    rustix::fs::fcntl_setfl(&file, flags - OFlags::NONBLOCK)?;
    file.write_all(text)
}

fn write_in_place(path: &Path, text: &[u8]) -> io::Result<()> {
    let mut file = OpenOptions::new().write(true).truncate(true).open(path)?;
    file.write_all(text)?;
    file.sync_all()
}

/// A file of its own name; removed when dropped.
struct Temporary {
    path: PathBuf,
    file: File,
}

impl Temporary {
    fn beside(target: &Path) -> io::Result<Self> {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let name = target.file_name().ok_or(ErrorKind::InvalidInput)?.to_string_lossy();
        // Names may be up to 255 bytes long.
        let name: String = name.chars().take(40).collect();
        loop {
            let count = COUNT.fetch_add(1, Ordering::Relaxed);
            let path = target.with_file_name(format!(".{name}.{}-{count}.tmp", std::process::id()));
            let flags = OFlags::WRONLY | OFlags::CREATE | OFlags::EXCL | OFlags::NOFOLLOW | OFlags::CLOEXEC;
            match open(&path, flags, Mode::from_raw_mode(0o666)) {
                Ok(file) => return Ok(Self { path, file: file.into() }),
                Err(rustix::io::Errno::EXIST) => {} // of a process that was killed
                Err(e) => return Err(e.into()),
            }
        }
    }

    fn write(mut self, text: &[u8]) -> io::Result<Self> {
        self.file.write_all(text)?;
        Ok(self)
    }

    fn replace(self, target: &Path, text: &[u8]) -> io::Result<()> {
        if let Ok(old) = statat(rustix::fs::CWD, target, AtFlags::SYMLINK_NOFOLLOW) {
            let own = fstat(&self.file)?;
            if (own.st_uid, own.st_gid) != (old.st_uid, old.st_gid) {
                let owner = rustix::fs::Uid::from_raw(old.st_uid);
                let group = rustix::fs::Gid::from_raw(old.st_gid);
                let _ = fchown(&self.file, Some(owner), Some(group));
            }
            let _ = fchmod(&self.file, Mode::from_raw_mode(old.st_mode & 0o777));
        }
        self.file.sync_all()?;
        match std::fs::rename(&self.path, target) {
            Ok(()) => {}
            // A file that is mounted by itself can be written but not exchanged.
            Err(e) if e.kind() == ErrorKind::ResourceBusy => return write_in_place(target, text),
            Err(e) => return Err(e),
        }
        // The name is on disk only when its folder is; where that cannot be asked for, the file is whole nevertheless.
        let folder = target.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let _ = File::open(folder).and_then(|folder| folder.sync_all());
        Ok(())
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::{PermissionsExt, symlink};

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> = std::fs::read_dir(folder)
            .unwrap()
            .map(|e| e.unwrap().file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_is_replaced_whole_and_keeps_its_mode_and_its_links() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("a.json"), folder.path().join("latest"));
        check_writable(&file).unwrap();
        assert!(names(folder.path()).is_empty(), "the attempt leaves no trace");
        write_file(&file, "one").unwrap();
        std::fs::set_permissions(&file, std::fs::Permissions::from_mode(0o640)).unwrap();
        symlink("a.json", &link).unwrap();
        let reader = File::open(&file).unwrap();
        check_writable(&link).unwrap();
        write_file(&link, "two").unwrap();
        assert_eq!(std::fs::read_to_string(&file).unwrap(), "two");
        assert_eq!(io::read_to_string(reader).unwrap(), "one", "whoever reads the old file reads it whole");
        assert_eq!(std::fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o640);
        assert!(link.is_symlink());
        assert_eq!(names(folder.path()), ["a.json", "latest"]);
    }

    #[test]
    fn what_is_no_plain_file_is_written_directly_or_refused() {
        assert_eq!(write_file(Path::new("/dev/full"), "x").unwrap_err().kind(), ErrorKind::StorageFull);
        write_file(Path::new("/dev/null"), "x").unwrap();
        let folder = tempfile::tempdir().unwrap();
        let there = folder.path().join("there");
        let opened = File::create(&there).unwrap();
        let by_descriptor = format!("/proc/self/fd/{}", std::os::fd::AsRawFd::as_raw_fd(&opened));
        write_file(Path::new(&by_descriptor), "x").unwrap();
        assert_eq!(opened.metadata().unwrap().len(), 1, "the very file that is open");
        assert!(check_writable(folder.path()).is_err() && write_file(folder.path(), "x").is_err());
        symlink("loop", folder.path().join("loop")).unwrap();
        assert!(check_writable(&folder.path().join("loop")).is_err());
        assert!(check_writable(&folder.path().join("absent/a")).is_err());
        symlink("new", folder.path().join("dangling")).unwrap();
        write_file(&folder.path().join("dangling"), "y").unwrap();
        assert_eq!(std::fs::read_to_string(folder.path().join("new")).unwrap(), "y");
    }

    #[test]
    fn what_was_read_is_not_written_under_any_name() {
        let folder = tempfile::tempdir().unwrap();
        let [file, link, hard] = ["in.toml", "link", "hard"].map(|name| folder.path().join(name));
        std::fs::write(&file, "a = 1").unwrap();
        symlink("in.toml", &link).unwrap();
        std::fs::hard_link(&file, &hard).unwrap();
        check_writable(&file).unwrap();
        crate::input::file::read(&file, 100).unwrap();
        for path in [&file, &link, &hard] {
            let refusals = [check_writable(path).unwrap_err(), write_file(path, "x").unwrap_err()];
            assert!(refusals.iter().all(IsRead::is_cause_of), "{}: {refusals:?}", path.display());
        }
        assert_eq!(std::fs::read_to_string(&file).unwrap(), "a = 1");
        write_file(&folder.path().join("other"), "x").unwrap();
    }

    #[test]
    fn new_files_below_dev_are_files() {
        let folder = tempfile::tempdir_in("/dev/shm").unwrap();
        let file = folder.path().join("new.json");
        check_writable(&file).unwrap();
        write_file(&file, "one").unwrap();
        write_file(&file, "two").unwrap();
        assert_eq!(std::fs::read_to_string(&file).unwrap(), "two");
        assert_eq!(names(folder.path()), ["new.json"]);
    }

    #[test]
    fn a_pipe_without_reader_is_an_error_and_not_a_wait() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        rustix::fs::mknodat(rustix::fs::CWD, &pipe, rustix::fs::FileType::Fifo, Mode::RUSR | Mode::WUSR, 0)
            .unwrap();
        check_writable(&pipe).unwrap();
        assert!(write_file(&pipe, "x").is_err());
        let reader =
            OpenOptions::new().read(true).custom_flags(OFlags::NONBLOCK.bits() as i32).open(&pipe).unwrap();
        write_file(&pipe, "x").unwrap();
        assert_eq!(io::read_to_string(reader).unwrap(), "x");
    }
}
