//! What has run out. The transport does not pass on the system's word for a failure, so it is asked for at that moment:
//! is there room for a few more descriptors, inodes and pages?

use rustix::fs::{Mode, OFlags, open, statvfs};
use rustix::io::Errno;
use rustix::process::{Resource, getrlimit};
use std::fmt;

use super::runtime_dir::SHARED_MEMORY;
use crate::messages::MAX_CAMERAS;

/// Descriptors that must be free: a clean-up holds the locks of all roles. One step of the transport needs fewer, and closes them when it fails.
const DESCRIPTORS: usize = 10 + 2 * MAX_CAMERAS;
/// Likewise for the files that it makes.
const INODES: u64 = DESCRIPTORS as u64;
/// The smallest segments need a page or two each.
const SPACE_BYTES: u64 = 64 * 1024;
/// A limit of descriptors that is always enough. Chosen by hand: a process of a run holds 30 to 60.
const ENOUGH_DESCRIPTORS: u64 = 1024;

/// Something that there is too little of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scarcity {
    /// This process may open no more files.
    Descriptors {
        /// How many it may open.
        limit: Option<u64>,
    },
    /// The whole machine may open no more files.
    SystemDescriptors,
    /// Shared memory can take no more files.
    Inodes {
        /// How many it still could.
        free: u64,
    },
    /// Shared memory is full, or nearly so.
    Space {
        /// What is left, bytes.
        free_bytes: u64,
        /// What is needed at least, bytes.
        needed_bytes: u64,
    },
}

impl Scarcity {
    /// What this process, or the machine, has run out of; `None` when there is enough of everything.
    #[must_use]
    pub fn found() -> Option<Self> {
        Self::of_descriptors().or_else(|| Self::of_shared_memory(SPACE_BYTES))
    }

    /// Whether shared memory lacks the room for `needed_bytes`.
    #[must_use]
    pub fn of_space(needed_bytes: u64) -> Option<Self> {
        Self::of_shared_memory(needed_bytes)
    }

    /// What an error code of the system says has run out.
    #[must_use]
    pub fn of(cause: Errno) -> Option<Self> {
        match cause {
            Errno::MFILE => Some(Self::Descriptors { limit: getrlimit(Resource::Nofile).current }),
            Errno::NFILE => Some(Self::SystemDescriptors),
            // The system has one word for both.
            Errno::NOSPC | Errno::DQUOT => Self::of_shared_memory(SPACE_BYTES)
                .or(Some(Self::Space { free_bytes: 0, needed_bytes: SPACE_BYTES })),
            _ => None,
        }
    }

    fn of_descriptors() -> Option<Self> {
        let probe = || open("/", OFlags::PATH | OFlags::CLOEXEC, Mode::empty());
        let opened: Result<Vec<_>, Errno> = (0..DESCRIPTORS).map(|_| probe()).collect();
        match opened {
            Err(cause @ (Errno::MFILE | Errno::NFILE)) => Self::of(cause),
            _ => None,
        }
    }

    fn of_shared_memory(needed_bytes: u64) -> Option<Self> {
        let s = statvfs(SHARED_MEMORY).ok()?;
        let free_bytes = s.f_bavail.saturating_mul(s.f_frsize);
        // A file system without limit says 0 of 0.
        if s.f_files > 0 && s.f_favail < INODES {
            Some(Self::Inodes { free: s.f_favail })
        } else if s.f_blocks > 0 && free_bytes < needed_bytes {
            Some(Self::Space { free_bytes, needed_bytes })
        } else {
            None
        }
    }
}

impl fmt::Display for Scarcity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Descriptors { limit } => {
                write!(f, "too few file descriptors")?;
                if let Some(limit) = limit {
                    write!(f, " (this process may open {limit})")?;
                }
                write!(f, "; allow more: ulimit -n {ENOUGH_DESCRIPTORS}")
            }
            Self::SystemDescriptors => write!(
                f,
                "the machine has run out of file descriptors; end what holds them, or as root: sysctl fs.file-max"
            ),
            Self::Inodes { free } => write!(
                f,
                "{SHARED_MEMORY} can take only {free} more files: df -i {SHARED_MEMORY}; remove some there, or as \
                 root: mount -o remount,nr_inodes=100k {SHARED_MEMORY}"
            ),
            Self::Space { free_bytes, needed_bytes } => write!(
                f,
                "{SHARED_MEMORY} is full ({} KiB left, at least {} KiB are needed): df {SHARED_MEMORY}; free some \
                 space there",
                free_bytes / 1024,
                needed_bytes / 1024
            ),
        }
    }
}

/// What helps against `cause`, when something in shared memory could not be used.
pub(super) fn remedy(cause: Errno) -> String {
    match Scarcity::of(cause) {
        Some(scarcity) => scarcity.to_string(),
        None => format!("is {SHARED_MEMORY} mounted, writable for you and not full?"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_of_the_system_are_told_with_their_remedy() {
        assert!(remedy(Errno::MFILE).contains("ulimit -n"));
        assert!(remedy(Errno::NFILE).contains("fs.file-max"));
        assert!(remedy(Errno::NOSPC).contains("df "));
        assert!(remedy(Errno::ACCESS).contains("writable for you"));
        assert!(Scarcity::Inodes { free: 3 }.to_string().contains("df -i /dev/shm"));
    }
}
