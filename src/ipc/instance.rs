//! An instance: the name under which the processes of one run find each other, and nobody else.
//!
//! ```text
//! /dev/shm/vservo-NAME/            the transport's directories, the locks, the effective configuration
//! /dev/shm/vservo.NAME.*           the transport's segments
//! ```
//! A role is held by a lock on a file, which the kernel releases when the process dies in whatever way. Whoever
//! leaves last removes everything.

use super::agreement::{self, Agreement};
use super::caretaker::Caretaker;
use super::heartbeat::Heartbeat;
use super::role::Role;
use super::runtime_dir::{self, RuntimeDir, SHARED_MEMORY};
use super::scarcity::{Scarcity, remedy};
use super::stop_word::StopWord;
use iceoryx2::prelude::*;
use rustix::fs::{FlockOperation, OFlags, flock};
use rustix::io::Errno;
use std::fmt;
use std::fs::File;
use std::io::Write;
use std::os::fd::OwnedFd;
use std::path::{Path as FsPath, PathBuf};
use std::str::FromStr;
use thiserror::Error;

/// Paths of sockets have 107 characters at most (the kernel's `sun_path`), and the transport does not look, so that longer ones run over its stack. The longest is
/// `/dev/shm/vservo-NAME/vservo.NAME.ID.event` with up to 39 digits of the port's number.
const LONGEST_NAME: usize = 18;
const CONFIG: &str = "config.toml";
const LOCK_ENDING: &str = ".lock";
const LOCK_ATTEMPTS: u32 = 10;
const LOCK_PAUSE: std::time::Duration = std::time::Duration::from_millis(20);

/// The name of an instance is not usable, or its place is not.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum InstanceError {
    /// The name has other characters or another length.
    #[error("instance name `{0}`: use 1 to {LONGEST_NAME} letters, digits, `-` or `_`")]
    Name(String),
    /// Another process holds the role.
    #[error(
        "instance `{instance}` already has a running {role} process; stop it, or give this run a name of its own: \
         --instance NAME"
    )]
    Taken {
        /// The instance.
        instance: String,
        /// The role.
        role: Role,
    },
    /// Something lies under the instance's names that is not this user's, or that others may write in.
    #[error(
        "{path} is {what}: nothing of a run may lie there; have it removed (rm -r {path}), or give this run a name \
         of its own: --instance NAME",
        path = path.display()
    )]
    NotOurs {
        /// Where.
        path: PathBuf,
        /// What it is, and whose.
        what: String,
    },
    /// Anybody may exchange anybody's files in shared memory.
    #[error(
        "{path} is writable for other users and has no sticky bit: anybody could exchange the files of a run there; \
         as root: chmod 1777 {path}",
        path = .0.display()
    )]
    NotSticky(PathBuf),
    /// There is too little of something to begin with.
    #[error("instance `{instance}` cannot be used: {scarcity}")]
    Scarce {
        /// The instance.
        instance: String,
        /// What there is too little of.
        scarcity: Scarcity,
    },
    /// Shared memory cannot be used.
    #[error("cannot use {path}: {cause}; {remedy}", path = path.display(), remedy = remedy(*cause))]
    Place {
        /// What could not be used.
        path: PathBuf,
        /// The system's word for it.
        cause: Errno,
    },
}

impl InstanceError {
    /// The exit code: 1 when the system refuses shared memory, 3 when another name helps.
    #[must_use]
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Name(_) | Self::Taken { .. } | Self::NotOurs { .. } => 3,
            Self::NotSticky(_) | Self::Scarce { .. } | Self::Place { .. } => 1,
        }
    }
}

fn lock_name(role: Role) -> String {
    format!("{role}{LOCK_ENDING}")
}

/// A run's name and its places in shared memory.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Instance {
    name: String,
}

/// A held role; released when dropped or when the process dies.
#[derive(Debug)]
pub struct RoleLock {
    file: OwnedFd,
}

impl RoleLock {
    /// The signs of life of the process that holds the role; `None` when it has no file descriptors left.
    #[must_use]
    pub fn heartbeat(&self) -> Option<Heartbeat> {
        self.file.try_clone().ok().map(Heartbeat::new)
    }

    /// Lets the others know what they must have in common with the process that holds the role.
    pub fn state(&self, agreement: &Agreement) {
        agreement::write(&self.file, agreement);
    }
}

impl FromStr for Instance {
    type Err = InstanceError;

    fn from_str(name: &str) -> Result<Self, InstanceError> {
        let good = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if name.is_empty() || name.len() > LONGEST_NAME || !name.chars().all(good) {
            return Err(InstanceError::Name(name.into()));
        }
        Ok(Self { name: name.into() })
    }
}

impl fmt::Display for Instance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name)
    }
}

impl Instance {
    /// The instance's directory.
    #[must_use]
    pub fn directory(&self) -> PathBuf {
        FsPath::new(SHARED_MEMORY).join(self.directory_name())
    }

    pub(super) fn directory_name(&self) -> String {
        format!("vservo-{}", self.name)
    }

    /// Where the supervisor leaves the effective configuration for people and for the program of an external drive.
    #[must_use]
    pub fn config_path(&self) -> PathBuf {
        self.directory().join(CONFIG)
    }

    /// Writes the effective configuration into a new file, and gives that very file, open for reading and writing.
    ///
    /// # Errors
    /// [`InstanceError`] when the place is not usable.
    pub fn write_config(&self, text: &str) -> Result<File, InstanceError> {
        let mut file = File::from(RuntimeDir::open_or_create(&self.directory_name())?.new_file(CONFIG)?);
        file.write_all(text.as_bytes()).map_err(|e| InstanceError::Place {
            path: self.config_path(),
            cause: Errno::from_io_error(&e).unwrap_or(Errno::IO),
        })?;
        Ok(file)
    }

    /// Makes sure that the instance's directory is there, ours alone, and that all segments under its prefix are ours.
    ///
    /// # Errors
    /// [`InstanceError::NotOurs`] for what is not; [`InstanceError::Place`] when shared memory is not usable.
    pub fn check_place(&self) -> Result<(), InstanceError> {
        RuntimeDir::open_or_create(&self.directory_name())?;
        runtime_dir::check_segments(&self.prefix())
    }

    /// What a program that is no part of this one needs to join: name, prefix, root path, run file.
    #[must_use]
    pub fn environment(&self) -> [(&'static str, String); 4] {
        [
            ("VSERVO_INSTANCE", self.name.clone()),
            ("VSERVO_PREFIX", self.prefix()),
            ("VSERVO_ROOT", self.directory().display().to_string()),
            ("VSERVO_CONFIG", self.config_path().display().to_string()),
        ]
    }

    /// No instance name contains a dot, so that no prefix is the beginning of another one.
    fn prefix(&self) -> String {
        format!("vservo.{}.", self.name)
    }

    /// The transport's configuration for this instance alone.
    ///
    /// # Errors
    /// When the transport refuses the instance's names.
    pub fn transport_config(&self) -> Result<Config, InstanceError> {
        let mut config = Config::default();
        let name_error = |_| InstanceError::Name(self.name.clone());
        config.global.prefix = FileName::new(self.prefix().as_bytes()).map_err(name_error)?;
        let root = self.directory();
        config.global.set_root_path(
            &iceoryx2::prelude::Path::new(root.as_os_str().as_encoded_bytes()).map_err(name_error)?,
        );
        Ok(config)
    }

    /// Takes a role of this instance.
    ///
    /// # Errors
    /// [`InstanceError::Taken`] when a living process has it; [`InstanceError::Scarce`] before anything is made that could
    /// not be removed again; [`InstanceError::NotOurs`] and [`InstanceError::Place`] when shared memory is not usable.
    pub fn lock(&self, role: Role) -> Result<RoleLock, InstanceError> {
        self.require_room()?;
        // A process that cleans up holds all roles for a moment: one refusal is not yet a rival.
        for _ in 0..LOCK_ATTEMPTS {
            match self.try_lock(role) {
                Err(InstanceError::Taken { .. }) => std::thread::sleep(LOCK_PAUSE),
                other => return other,
            }
        }
        self.try_lock(role)
    }

    /// Refuses a run that needs more room in shared memory than there is.
    ///
    /// # Errors
    /// [`InstanceError::Scarce`].
    pub fn require_space(&self, needed_bytes: u64) -> Result<(), InstanceError> {
        self.refuse(Scarcity::of_space(needed_bytes))
    }

    /// Gives every page of the instance's segments its memory.
    ///
    /// # Errors
    /// [`InstanceError::Place`] when there is too little.
    pub fn reserve(&self) -> Result<(), InstanceError> {
        runtime_dir::reserve_segments(&self.prefix())
    }

    pub(super) fn take_care(&self) -> std::io::Result<Caretaker> {
        Caretaker::begin(self.prefix())
    }

    pub(super) fn require_room(&self) -> Result<(), InstanceError> {
        self.refuse(Scarcity::found())
    }

    fn refuse(&self, scarcity: Option<Scarcity>) -> Result<(), InstanceError> {
        match scarcity {
            Some(scarcity) => Err(InstanceError::Scarce { instance: self.name.clone(), scarcity }),
            None => Ok(()),
        }
    }

    fn try_lock(&self, role: Role) -> Result<RoleLock, InstanceError> {
        let name = lock_name(role);
        loop {
            let place = RuntimeDir::open_or_create(&self.directory_name())?;
            let Some(file) = place.open_file(&name, OFlags::CREATE | OFlags::RDWR)? else {
                continue; // a clean-up removed the directory in between
            };
            match flock(&file, FlockOperation::NonBlockingLockExclusive) {
                Ok(()) => {}
                Err(Errno::WOULDBLOCK) => {
                    return Err(InstanceError::Taken { instance: self.name.clone(), role });
                }
                Err(cause) => {
                    return Err(InstanceError::Place { path: self.directory().join(name), cause });
                }
            }
            // The lock counts only if its file is still the one that the next process will find.
            if place.holds(&name, &file) {
                // What the file says is a dead process's word: nobody may take it for that of the next one.
                let _ = rustix::fs::ftruncate(&file, 0);
                return Ok(RoleLock { file });
            }
        }
    }

    /// Whether a living process holds `role`.
    #[must_use]
    pub fn is_running(&self, role: Role) -> bool {
        self.find(role).unwrap_or(false)
    }

    /// Whether a living process of this user holds `role`.
    ///
    /// # Errors
    /// [`InstanceError::NotOurs`] where the instance is another user's.
    pub fn find(&self, role: Role) -> Result<bool, InstanceError> {
        let Some(place) = RuntimeDir::open(&self.directory_name())? else { return Ok(false) };
        let Some(file) = place.open_file(&lock_name(role), OFlags::RDWR)? else { return Ok(false) };
        Ok(flock(&file, FlockOperation::NonBlockingLockShared) == Err(Errno::WOULDBLOCK))
    }

    /// The file of the lock of `role`; `None` where nobody has held it yet.
    pub(super) fn lock_file(&self, role: Role) -> Option<OwnedFd> {
        let place = RuntimeDir::open(&self.directory_name()).ok()??;
        place.open_file(&lock_name(role), OFlags::RDONLY).ok()?
    }

    /// What the process that plays `role` now has in common with the others; `None` where there is none, or it has not said it yet.
    pub(crate) fn agreement_of(&self, role: Role) -> Option<Agreement> {
        let place = RuntimeDir::open(&self.directory_name()).ok()??;
        let file = place.open_file(&lock_name(role), OFlags::RDWR).ok()??;
        let is_held = flock(&file, FlockOperation::NonBlockingLockShared) == Err(Errno::WOULDBLOCK);
        if is_held { agreement::read(&file) } else { None }
    }

    /// Makes the page through which this run's control is stopped; for control, once it holds its role.
    ///
    /// # Errors
    /// [`InstanceError::Place`] when shared memory is full or not usable.
    pub fn make_stop_word(&self) -> Result<StopWord, InstanceError> {
        StopWord::create(&RuntimeDir::open_or_create(&self.directory_name())?, &self.directory())
    }

    /// The page through which the control of this instance is stopped; `None` when there is none yet. Needs neither room nor slot.
    ///
    /// # Errors
    /// [`InstanceError::NotOurs`] for the run of another user.
    pub fn open_stop_word(&self) -> Result<Option<StopWord>, InstanceError> {
        match RuntimeDir::open(&self.directory_name())? {
            Some(place) => StopWord::open(&place, &self.directory()),
            None => Ok(None),
        }
    }

    /// Removes what dead processes of this instance left in shared memory, and clients that are stopped, unless a living one plays any other role
    /// or has joined the transport. To be called at the start by the holder of a role, and at the end by every process.
    pub fn remove_leftovers(&self, own: Option<Role>) {
        // All other roles are held meanwhile: nobody can start in a directory that is about to vanish.
        let others = || Role::all().filter(|role| Some(*role) != own);
        let Ok(locks) = others().map(|role| self.try_lock(role)).collect::<Result<Vec<_>, _>>() else {
            return;
        };
        if self.has_living_node() {
            return;
        }
        let Ok(Some(place)) = RuntimeDir::open(&self.directory_name()) else { return };
        runtime_dir::remove_segments(&self.prefix());
        place.clear(|name| name.ends_with(LOCK_ENDING));
        if own.is_none() {
            // The locks go last, and no others: whoever comes now finds them gone, and makes its own.
            for (role, lock) in others().zip(&locks) {
                place.remove(&lock_name(role), &lock.file);
            }
            place.remove_directory();
        }
    }

    fn has_living_node(&self) -> bool {
        let Ok(config) = self.transport_config() else { return false };
        let mut living = false;
        let listed = Node::<ipc::Service>::list(&config, |state| {
            // A client that is stopped cannot leave by itself, and would leave its files to the next run of that name if it was killed then.
            let pid = state.node_id().pid::<ipc::Service>();
            let is_there = pid.map_or(true, |pid| !is_suspended(pid.value()));
            living |= matches!(state, NodeState::Alive(_)) && is_there;
            CallbackProgression::Continue
        });
        living && listed.is_ok()
    }
}

/// The letter by which the kernel tells the state of process `pid`, as proc(5) lists them; none of a process that there is not.
pub(crate) fn process_state(pid: impl std::fmt::Display) -> Option<char> {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    // After the name, which is in brackets and may have spaces and brackets itself.
    stat.rsplit(')').next()?.trim_start().chars().next()
}

/// Whether process `pid` has been suspended by a signal, as by Ctrl-Z.
pub(crate) fn is_suspended(pid: i32) -> bool {
    process_state(pid) == Some('T')
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::CameraId;

    const CAMERA: Role = Role::Camera(CameraId::FIRST);
    const VISION: Role = Role::Vision(CameraId::FIRST);

    fn instance(test: &str) -> Instance {
        format!("{}-{}", test.get(..10).unwrap_or(test), std::process::id()).parse().unwrap()
    }

    #[test]
    fn names_are_checked() {
        for bad in ["", "a b", "a/b", "a.b", "..", "ä", &"x".repeat(LONGEST_NAME + 1)] {
            assert!(bad.parse::<Instance>().is_err(), "{bad}");
        }
        assert!("Run-7_b".parse::<Instance>().is_ok());
        let longest: Instance = "x".repeat(LONGEST_NAME).parse().unwrap();
        let socket = longest.directory().join(format!("{}{}.event", longest.prefix(), u128::MAX));
        // sun_path of sockaddr_un, with the zero at its end
        assert!(socket.as_os_str().len() < 108, "{}", socket.display());
    }

    #[test]
    fn a_role_is_held_once_and_leaves_nothing_behind() {
        let i = instance("roles");
        let lock = i.lock(CAMERA).unwrap();
        assert!(i.is_running(CAMERA));
        assert!(matches!(i.lock(CAMERA), Err(InstanceError::Taken { role: CAMERA, .. })));
        let other = i.lock(VISION).unwrap();
        let second = i.lock(Role::Camera(CameraId(1))).unwrap();
        i.remove_leftovers(Some(Role::Supervisor));
        assert!(i.is_running(Role::Camera(CameraId(1))), "the second camera is one of its own");
        drop((lock, second));
        i.remove_leftovers(None);
        assert!(i.directory().exists(), "vision still runs");
        drop(other);
        i.remove_leftovers(None);
        assert!(!i.directory().exists());
    }

    #[test]
    fn leftovers_of_the_dead_go_but_own_locks_stay() {
        let i = instance("leftovers");
        let _lock = i.lock(Role::Supervisor).unwrap();
        let segment = FsPath::new(SHARED_MEMORY).join(format!("vservo.{}.segment", i.name));
        std::fs::write(&segment, "x").unwrap();
        std::fs::create_dir_all(i.directory().join("nodes/old")).unwrap();
        i.remove_leftovers(Some(Role::Supervisor));
        assert!(!segment.exists() && !i.directory().join("nodes").exists());
        assert!(i.is_running(Role::Supervisor));
        drop(_lock);
        i.remove_leftovers(None);
        assert!(!i.directory().exists());
    }
}
