//! Looks after the segments of an instance, in a thread of each process that has joined.
//!
//! - The transport makes a segment in two steps: the file, then its size. Who opens a file without size waits for the second
//!   step, by name, and without an end: a process that is killed in between would hold up everybody who meets its file, while they
//!   join, talk or leave. Files that stay without a size and that nobody has open are removed: a maker that is only kept from its
//!   processor has its file open.
//! - The transport does not reserve what it makes. A page that cannot be had when it is first used ends the process that uses it,
//!   so all of them are reserved as soon as they are seen. Control makes sure of that itself before an arm moves.

use super::runtime_dir::{self, Id};
use crate::rt::now;
use crate::time::{MonoNs, SpanNs};
use std::collections::HashMap;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// Between two looks. Each takes about 0.1 ms with the 50 segments of a run, measured, so that they are 0.2 % of a core.
const PERIOD: Duration = Duration::from_millis(50);
/// A file is without a size for some microseconds. On a machine with much to do its maker may be kept from its processor for longer, just
/// there; of one in another container, whose files cannot be seen, a connection would be removed that its maker goes on with.
const GRACE: SpanNs = SpanNs(100_000_000);
/// Stack of the thread, bytes. Chosen by hand: it lists names and compares numbers, for which a few pages suffice. Control would prefault
/// the default of 2 MB.
const STACK: usize = 128 * 1024;

/// The thread; it ends when this is dropped.
#[derive(Debug)]
pub(super) struct Caretaker {
    ends: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Caretaker {
    /// Looks after the segments under `prefix` from now on.
    pub(super) fn begin(prefix: String) -> std::io::Result<Self> {
        let (ends, ended) = channel();
        let care = move || {
            let mut seen = HashMap::new();
            while ended.recv_timeout(PERIOD) == Err(RecvTimeoutError::Timeout) {
                remove_half_made(&prefix, &mut seen, now());
                // Where shared memory is full this is tried again; whom it concerns asks by itself.
                let _ = runtime_dir::reserve_segments(&prefix);
            }
        };
        let thread = std::thread::Builder::new().name("caretaker".into()).stack_size(STACK).spawn(care)?;
        Ok(Self { ends: Some(ends), thread: Some(thread) })
    }
}

impl Drop for Caretaker {
    fn drop(&mut self) {
        self.ends = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join(); // it has nothing to tell
        }
    }
}

/// Removes what has been without a size since [`GRACE`]; `seen` says since when each is.
fn remove_half_made(prefix: &str, seen: &mut HashMap<Id, MonoNs>, time: MonoNs) {
    let empty = runtime_dir::empty_segments(prefix);
    seen.retain(|id, _| empty.iter().any(|(_, is)| is == id));
    for (name, id) in empty {
        if time - *seen.entry(id).or_insert(time) >= GRACE && !is_open(id) {
            runtime_dir::remove_segment(&name, id);
        }
    }
}

/// Whether any process has this file open, of those that this one may ask.
fn is_open(file: Id) -> bool {
    let list = |path: &Path| std::fs::read_dir(path).into_iter().flatten().flatten();
    list(Path::new("/proc")).any(|process| {
        list(&process.path().join("fd"))
            .filter_map(|open| std::fs::metadata(open.path()).ok())
            .any(|open| (open.dev(), open.ino()) == file)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ipc::{Instance, Role, Services};
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn only_what_stays_without_a_size_is_removed() {
        let prefix = format!("vservo.unit-half-{}.", std::process::id());
        let path = |name: &str| std::path::PathBuf::from(format!("/dev/shm/{prefix}{name}"));
        let (empty, full, late) = (path("empty"), path("full"), path("late"));
        std::fs::write(&empty, "").unwrap();
        std::fs::write(&late, "").unwrap();
        let made = std::fs::File::create(path("made")).unwrap();
        std::fs::write(&full, "x").unwrap();
        let (mut seen, start) = (HashMap::new(), now());
        remove_half_made(&prefix, &mut seen, start);
        remove_half_made(&prefix, &mut seen, start + SpanNs(GRACE.0 - 1));
        assert!(empty.exists() && late.exists() && full.exists());
        std::fs::write(&late, "it was only slow").unwrap();
        remove_half_made(&prefix, &mut seen, start + GRACE);
        assert!(!empty.exists() && late.exists() && full.exists());
        // a maker that is slow still has it
        assert!(path("made").exists());
        drop(made);
        remove_half_made(&prefix, &mut seen, start + GRACE);
        assert!(!path("made").exists());
        runtime_dir::remove_segments(&prefix);
    }

    /// What a client leaves that is killed between the two steps: its node with a connection that has no size yet. As an ordinary
    /// user the file cannot be opened and nobody waits for it; then this shows less.
    #[test]
    fn a_process_joins_and_leaves_beside_a_half_made_connection() {
        let instance: Instance = format!("half-join-{}", std::process::id()).parse().unwrap();
        let lock = instance.lock(Role::Control).unwrap();
        let serving = Services::join(&instance).unwrap();
        let server = serving.command_server().unwrap();
        let known = runtime_dir::segments_of(&format!("vservo.{instance}."));
        let client = Services::join(&instance).unwrap().command_client().unwrap();
        // The names that this client uses for its connections, without their content, as if it had died while it made them.
        let connections: Vec<_> = runtime_dir::segments_of(&format!("vservo.{instance}."))
            .into_iter()
            .filter(|name| name.ends_with("connection") && !known.contains(name))
            .collect();
        assert!(!connections.is_empty());
        for name in &connections {
            let path = std::path::Path::new("/dev/shm").join(name);
            std::fs::remove_file(&path).unwrap();
            std::fs::write(&path, "").unwrap();
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o200)).unwrap();
        }
        // All that may meet them; without the thread the first of it never ends.
        let _ = server.receive();
        let later = Services::join(&instance).unwrap();
        later.remove_dead_peers();
        let _ = later.command_client();
        drop((later, client, server, serving, lock));
        instance.remove_leftovers(None);
        assert!(!instance.directory().exists());
    }
}
