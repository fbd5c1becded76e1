//! The instance's directory in shared memory, and the transport's segments beside it: what may be trusted there.
//!
//! Every user may write into `/dev/shm` and take a name first. Three rules keep others out:
//! - The directory is opened once, never through a link, and looked at through its descriptor: it must be ours, and
//!   writable for nobody else. All files in it are opened from that descriptor, so that no path is walked twice.
//! - `/dev/shm` must have the sticky bit: then nobody else can rename or remove what is ours. What was found to be ours
//!   stays what it is.
//! - Segments lie in `/dev/shm` itself. Under the instance's prefix nothing may lie there that is not a plain file of ours.
//!
//! Nothing that belongs to another user is written, repaired or removed.

use super::InstanceError;
use rustix::fs::{AtFlags, Dir, FallocateFlags, FileType, Mode, OFlags, Stat, fallocate};
use rustix::fs::{fchmod, fstat, mkdirat, open, openat, renameat, statat, unlinkat};
use rustix::io::Errno;
use rustix::process::geteuid;
use std::ffi::CStr;
use std::os::fd::{AsFd, OwnedFd};
use std::path::{Path, PathBuf};

/// Where shared memory lies.
pub(super) const SHARED_MEMORY: &str = "/dev/shm";
/// Depth to which the files of an instance are nested, which follows from the transport's `nodes/ID/FILE`, with one level to spare.
const DEEPEST: u32 = 4;
/// Permission bits of group and others, and of these the write bits, by the POSIX standard.
const OTHERS: u32 = 0o077;
const OTHERS_WRITE: u32 = 0o022;
/// The unit of `st_blocks`, bytes, as Linux has it on every file system (stat(2)).
const BLOCK_BYTES: u64 = 512;

/// The opened directory of an instance.
#[derive(Debug)]
pub(super) struct RuntimeDir {
    shared_memory: OwnedFd,
    directory: OwnedFd,
    name: String,
}

impl RuntimeDir {
    /// Opens the directory `name` of shared memory; `None` when there is none.
    ///
    /// # Errors
    /// [`InstanceError::NotOurs`] for what must not be used, [`InstanceError::Place`] for what cannot be.
    pub(super) fn open(name: &str) -> Result<Option<Self>, InstanceError> {
        let shared_memory = open_shared_memory()?;
        let path = Path::new(SHARED_MEMORY).join(name);
        let flags = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::NOFOLLOW | OFlags::CLOEXEC;
        let directory = match openat(&shared_memory, name, flags, Mode::empty()) {
            Ok(directory) => directory,
            Err(Errno::NOENT) => return Ok(None),
            Err(cause) => {
                return Err(refusal(shared_memory.as_fd(), name, &path, FileType::Directory, cause));
            }
        };
        let stat = fstat(&directory).map_err(|cause| InstanceError::Place { path: path.clone(), cause })?;
        judge(&path, &stat, FileType::Directory)?;
        if stat.st_mode & OTHERS_WRITE != 0 {
            let what =
                format!("a directory in which other users may write (mode {:o})", stat.st_mode & 0o7777);
            return Err(InstanceError::NotOurs { path, what });
        }
        if stat.st_mode & OTHERS != 0 {
            // Ours, and nobody else could write: the transport makes it so when it comes first.
            fchmod(&directory, Mode::RWXU).map_err(|cause| InstanceError::Place { path, cause })?;
        }
        Ok(Some(Self { shared_memory, directory, name: name.into() }))
    }

    /// Opens the directory, which is made where there is none.
    ///
    /// # Errors
    /// As for [`RuntimeDir::open`].
    pub(super) fn open_or_create(name: &str) -> Result<Self, InstanceError> {
        loop {
            if let Some(place) = Self::open(name)? {
                return Ok(place);
            }
            match mkdirat(open_shared_memory()?, name, Mode::RWXU) {
                Ok(()) | Err(Errno::EXIST) => {} // whoever made it: it is looked at
                Err(cause) => {
                    return Err(InstanceError::Place { path: Path::new(SHARED_MEMORY).join(name), cause });
                }
            }
        }
    }

    /// Opens the plain file `name` in it; never a link, a device or a pipe. `None` when there is no such file, or
    /// when the directory has been removed.
    ///
    /// # Errors
    /// As for [`RuntimeDir::open`].
    pub(super) fn open_file(&self, name: &str, flags: OFlags) -> Result<Option<OwnedFd>, InstanceError> {
        let path = Path::new(SHARED_MEMORY).join(&self.name).join(name);
        let flags = flags | OFlags::NOFOLLOW | OFlags::CLOEXEC | OFlags::NONBLOCK;
        let file = match openat(&self.directory, name, flags, Mode::RUSR | Mode::WUSR) {
            Ok(file) => file,
            Err(Errno::NOENT) => return Ok(None),
            Err(cause) => {
                return Err(refusal(self.directory.as_fd(), name, &path, FileType::RegularFile, cause));
            }
        };
        let stat = fstat(&file).map_err(|cause| InstanceError::Place { path: path.clone(), cause })?;
        judge(&path, &stat, FileType::RegularFile)?;
        Ok(Some(file))
    }

    /// A new file `name`; what lay there before is replaced, not written. It is made beside and renamed, so that
    /// nobody who puts a file under that name at this moment makes it fail.
    ///
    /// # Errors
    /// As for [`RuntimeDir::open`].
    pub(super) fn new_file(&self, name: &str) -> Result<OwnedFd, InstanceError> {
        let beside = format!("{name}.{}.new", std::process::id());
        let fault = |cause| InstanceError::Place {
            path: Path::new(SHARED_MEMORY).join(&self.name).join(name),
            cause,
        };
        match unlinkat(&self.directory, &beside, AtFlags::empty()) {
            Ok(()) | Err(Errno::NOENT) => {}
            Err(cause) => return Err(fault(cause)),
        }
        let file = self
            .open_file(&beside, OFlags::RDWR | OFlags::CREATE | OFlags::EXCL)?
            .ok_or_else(|| fault(Errno::NOENT))?;
        renameat(&self.directory, &beside, &self.directory, name).map_err(fault)?;
        Ok(file)
    }

    /// Whether `file` is what the next process will find under `name`, in the directory that it will find.
    pub(super) fn holds(&self, name: &str, file: &OwnedFd) -> bool {
        same(fstat(file), statat(&self.directory, name, AtFlags::SYMLINK_NOFOLLOW))
            && same(
                fstat(&self.directory),
                statat(&self.shared_memory, self.name.as_str(), AtFlags::SYMLINK_NOFOLLOW),
            )
    }

    /// Removes everything in the directory but what `keep` names. Links are removed, not followed.
    pub(super) fn clear(&self, keep: impl Fn(&str) -> bool) {
        clear(&self.directory, &keep, DEEPEST);
    }

    /// Removes `name` if it still is `file`.
    pub(super) fn remove(&self, name: &str, file: &OwnedFd) {
        if same(fstat(file), statat(&self.directory, name, AtFlags::SYMLINK_NOFOLLOW)) {
            let _ = unlinkat(&self.directory, name, AtFlags::empty());
        }
    }

    /// Removes the directory, if it is empty: a process that has joined meanwhile keeps it.
    pub(super) fn remove_directory(self) {
        if same(
            fstat(&self.directory),
            statat(&self.shared_memory, self.name.as_str(), AtFlags::SYMLINK_NOFOLLOW),
        ) {
            let _ = unlinkat(&self.shared_memory, self.name.as_str(), AtFlags::REMOVEDIR);
        }
    }
}

/// Looks at all segments under `prefix`: each must be a plain file of ours. Rights that the transport gives to others
/// are taken back.
///
/// # Errors
/// [`InstanceError::NotOurs`] names the first that is not.
pub(super) fn check_segments(prefix: &str) -> Result<(), InstanceError> {
    let shared_memory = open_shared_memory()?;
    for name in segments(&shared_memory, prefix)? {
        let path = Path::new(SHARED_MEMORY).join(&name);
        let Ok(stat) = statat(&shared_memory, name.as_str(), AtFlags::SYMLINK_NOFOLLOW) else { continue };
        judge(&path, &stat, FileType::RegularFile)?;
        if stat.st_mode & OTHERS != 0 {
            let flags = OFlags::RDONLY | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
            if let Ok(file) = openat(&shared_memory, name.as_str(), flags, Mode::empty()) {
                let _ = fchmod(&file, Mode::RUSR | Mode::WUSR);
            }
        }
    }
    Ok(())
}

/// Removes the segments under `prefix` that are ours.
pub(super) fn remove_segments(prefix: &str) {
    let Ok(shared_memory) = open_shared_memory() else { return };
    for name in segments(&shared_memory, prefix).unwrap_or_default() {
        let stat = statat(&shared_memory, name.as_str(), AtFlags::SYMLINK_NOFOLLOW);
        if stat.is_ok_and(|s| s.st_uid == geteuid().as_raw()) {
            let _ = unlinkat(&shared_memory, name.as_str(), AtFlags::empty());
        }
    }
}

/// What tells a file from another one of the same name: device and number.
pub(super) type Id = (u64, u64);

/// The segments under `prefix` that have no size, and are ours.
pub(super) fn empty_segments(prefix: &str) -> Vec<(String, Id)> {
    let Ok(shared_memory) = open_shared_memory() else { return Vec::new() };
    let mut empty = Vec::new();
    for name in segments(&shared_memory, prefix).unwrap_or_default() {
        if let Ok(stat) = statat(&shared_memory, name.as_str(), AtFlags::SYMLINK_NOFOLLOW)
            && stat.st_size == 0
            && judge(Path::new(&name), &stat, FileType::RegularFile).is_ok()
        {
            empty.push((name, id(&stat)));
        }
    }
    empty
}

/// Removes the segment `name` if it still is `is`.
pub(super) fn remove_segment(name: &str, is: Id) {
    let Ok(shared_memory) = open_shared_memory() else { return };
    if statat(&shared_memory, name, AtFlags::SYMLINK_NOFOLLOW).is_ok_and(|stat| id(&stat) == is) {
        let _ = unlinkat(&shared_memory, name, AtFlags::empty());
    }
}

/// Gives every page of the segments under `prefix` its memory: a page that cannot be had when it is first used ends the process
/// that uses it, and the kernel has no milder way to say so then.
///
/// # Errors
/// [`InstanceError::Place`] when there is too little; the remedy is in its words.
pub(super) fn reserve_segments(prefix: &str) -> Result<(), InstanceError> {
    let shared_memory = open_shared_memory()?;
    for name in segments(&shared_memory, prefix)? {
        let lacks = |stat: &Stat| {
            let size = u64::try_from(stat.st_size).unwrap_or(0);
            let held = u64::try_from(stat.st_blocks).unwrap_or(0).saturating_mul(BLOCK_BYTES);
            let is_file = FileType::from_raw_mode(stat.st_mode) == FileType::RegularFile;
            (is_file && held < size).then_some(size)
        };
        let stat = statat(&shared_memory, name.as_str(), AtFlags::SYMLINK_NOFOLLOW);
        if stat.is_ok_and(|stat| lacks(&stat).is_none()) {
            continue;
        }
        let fault = |cause| InstanceError::Place { path: Path::new(SHARED_MEMORY).join(&name), cause };
        let flags = OFlags::RDWR | OFlags::NOFOLLOW | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let file = match openat(&shared_memory, name.as_str(), flags, Mode::empty()) {
            Ok(file) => file,
            // Gone meanwhile, or not a file that anybody of ours maps.
            Err(Errno::NOENT | Errno::LOOP | Errno::NXIO | Errno::ISDIR | Errno::ACCESS) => continue,
            Err(cause) => return Err(fault(cause)),
        };
        if let Some(size) = lacks(&fstat(&file).map_err(fault)?) {
            fallocate(&file, FallocateFlags::empty(), 0, size).map_err(fault)?;
        }
    }
    Ok(())
}

fn id(stat: &Stat) -> Id {
    (stat.st_dev, stat.st_ino)
}

#[cfg(test)]
pub(super) fn segments_of(prefix: &str) -> Vec<String> {
    segments(&open_shared_memory().unwrap(), prefix).unwrap()
}

fn segments(shared_memory: &OwnedFd, prefix: &str) -> Result<Vec<String>, InstanceError> {
    let failed = |cause| InstanceError::Place { path: SHARED_MEMORY.into(), cause };
    let mut found = Vec::new();
    for entry in Dir::read_from(shared_memory).map_err(failed)? {
        // The prefix is ASCII; a name that is not text may still begin with it, and is then told as it can be.
        let name = entry.map_err(failed)?.file_name().to_string_lossy().into_owned();
        if name.starts_with(prefix) {
            found.push(name);
        }
    }
    Ok(found)
}

/// Shared memory itself. Without the sticky bit anybody could exchange what is ours there.
fn open_shared_memory() -> Result<OwnedFd, InstanceError> {
    let path = || PathBuf::from(SHARED_MEMORY);
    let failed = |cause| InstanceError::Place { path: path(), cause };
    let flags = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::CLOEXEC;
    let directory = open(SHARED_MEMORY, flags, Mode::empty()).map_err(failed)?;
    let mode = fstat(&directory).map_err(failed)?.st_mode;
    if mode & OTHERS_WRITE != 0 && !Mode::from_raw_mode(mode).contains(Mode::SVTX) {
        return Err(InstanceError::NotSticky(path()));
    }
    Ok(directory)
}

/// Why `name` could not be opened: what lies there says more than the system's word.
fn refusal(folder: impl AsFd, name: &str, path: &Path, expected: FileType, cause: Errno) -> InstanceError {
    let judged = statat(folder, name, AtFlags::SYMLINK_NOFOLLOW).map(|stat| judge(path, &stat, expected));
    match judged {
        Ok(Err(error)) => error,
        _ => InstanceError::Place { path: path.into(), cause },
    }
}

fn judge(path: &Path, stat: &Stat, expected: FileType) -> Result<(), InstanceError> {
    let own = geteuid().as_raw();
    let found = FileType::from_raw_mode(stat.st_mode);
    let mut what = kind(found).to_string();
    if stat.st_uid != own {
        what += &format!(" of user {}, not yours (you are user {own})", stat.st_uid);
    } else if found != expected {
        what += &format!(", not {}", kind(expected));
    } else {
        return Ok(());
    }
    Err(InstanceError::NotOurs { path: path.into(), what })
}

fn kind(file_type: FileType) -> &'static str {
    match file_type {
        FileType::RegularFile => "a file",
        FileType::Directory => "a directory",
        FileType::Symlink => "a symbolic link",
        FileType::Fifo => "a pipe",
        FileType::Socket => "a socket",
        _ => "a device",
    }
}

fn same(a: rustix::io::Result<Stat>, b: rustix::io::Result<Stat>) -> bool {
    matches!((a, b), (Ok(a), Ok(b)) if a.st_ino == b.st_ino && a.st_dev == b.st_dev)
}

fn clear(folder: &OwnedFd, keep: &dyn Fn(&str) -> bool, depth: u32) {
    let Ok(entries) = Dir::read_from(folder) else { return };
    let entries: Vec<_> = entries.flatten().map(|e| e.file_name().to_owned()).collect();
    for name in entries {
        if is_dots(&name) || name.to_str().is_ok_and(keep) {
            continue;
        }
        if unlinkat(folder, &name, AtFlags::empty()).is_ok() || depth == 0 {
            continue;
        }
        let flags = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::NOFOLLOW | OFlags::CLOEXEC;
        if let Ok(inner) = openat(folder, &name, flags, Mode::empty()) {
            clear(&inner, &|_| false, depth - 1);
            let _ = unlinkat(folder, &name, AtFlags::REMOVEDIR);
        }
    }
}

fn is_dots(name: &CStr) -> bool {
    matches!(name.to_bytes(), b"." | b"..")
}
