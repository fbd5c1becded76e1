//! The file of a recording, written by threads of their own: who gathers messages never waits for a disk.
//!
//! ```text
//! write: gathers ── flush: a block ──► queue, bounded ──► thread: write ──► thread: fdatasync
//!        ▲ empty blocks come back ◄──────────────────────────┘
//!        a full queue (the disk is too slow) or a failure (it is full) ends the writing; what comes later is dropped
//! ```

use crate::process::ProcessError;
use rustix::fs::{Advice, fadvise};
use std::fs::File;
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// Most bytes that wait for the disk. Chosen by hand: seven seconds of a VGA camera at 25 Hz, which a disk may spend on others.
const MAX_BACKLOG: usize = 64 << 20;
/// Between two looks at a queue that is full, where the run waits for nobody's clock. Chosen by hand: a block takes milliseconds.
const LOOK_AGAIN: Duration = Duration::from_millis(1);

/// What the two sides know of each other.
#[derive(Debug, Default)]
struct Backlog {
    bytes: usize,
    failure: Option<io::Error>,
}

impl Backlog {
    /// Notes how something went; whether anything has failed by now.
    fn note(&mut self, result: io::Result<()>) -> bool {
        if let Err(error) = result {
            self.failure.get_or_insert(error);
        }
        self.failure.is_some()
    }
}

/// How the writing goes.
#[derive(Debug, Clone)]
pub(super) struct DiskState {
    path: PathBuf,
    backlog: Arc<Mutex<Backlog>>,
}

impl DiskState {
    /// Why nothing is written any more.
    pub(super) fn failure(&self) -> Option<ProcessError> {
        let cause = self.with(|backlog| backlog.failure.as_ref().map(copy_of))?;
        Some(ProcessError::Write { path: self.path.clone(), cause })
    }

    fn with<T>(&self, look: impl FnOnce(&mut Backlog) -> T) -> T {
        look(&mut self.backlog.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

/// Gathers bytes to blocks, and has them written.
#[derive(Debug)]
pub(super) struct DiskQueue {
    state: DiskState,
    block: Vec<u8>,
    blocks: Option<Sender<Vec<u8>>>,
    /// Blocks that were written, to be filled again: their memory is there already.
    spare: Receiver<Vec<u8>>,
    /// A full queue is waited for; else it is a failure.
    patient: bool,
    /// That which writes, which ends the other.
    threads: Vec<JoinHandle<()>>,
}

impl DiskQueue {
    /// Makes the file `path`; `patient` says whether a slow disk is waited for.
    pub(super) fn create(path: &Path, patient: bool) -> Result<Self, ProcessError> {
        let file = File::create(path).map_err(|cause| ProcessError::Write { path: path.into(), cause })?;
        let state = DiskState { path: path.into(), backlog: Arc::default() };
        let (blocks, receiver) = channel();
        let (written, spare) = channel();
        let (to_sync, asked) = channel();
        let (file, theirs) = (Arc::new(file), state.clone());
        let syncing = {
            let (file, theirs) = (Arc::clone(&file), state.clone());
            start("recorder-sync", move || sync(&file, &asked, &theirs))?
        };
        let writing =
            start("recorder-disk", move || write_blocks(&file, &receiver, &written, &to_sync, &theirs))?;
        Ok(Self {
            state,
            block: Vec::new(),
            blocks: Some(blocks),
            spare,
            patient,
            threads: vec![writing, syncing],
        })
    }

    /// How the writing goes, to be asked from elsewhere.
    pub(super) fn state(&self) -> DiskState {
        self.state.clone()
    }

    /// Waits until all is on the disk.
    pub(super) fn close(mut self) -> Result<(), ProcessError> {
        let _ = self.flush(); // which never fails
        self.blocks = None;
        for thread in self.threads.drain(..) {
            thread.join().map_err(|_| ProcessError::Panicked("recorder-disk"))?;
        }
        self.state.failure().map_or(Ok(()), Err)
    }

    /// Takes `bytes` into account, if there is room; whether there was.
    fn has_room(&self, bytes: usize) -> bool {
        self.state.with(|backlog| {
            // one block always fits, however large its frame is
            let fits = backlog.bytes == 0 || backlog.bytes + bytes <= MAX_BACKLOG;
            backlog.bytes += if fits { bytes } else { 0 };
            fits
        })
    }
}

/// Gathers; a failure is told by [`DiskState::failure`], because what writes a recording could not go on after one here.
impl Write for DiskQueue {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.block.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        // One is enough: after a disk that was busy for seconds there are many.
        let next = self.spare.try_iter().last().unwrap_or_default();
        let block = std::mem::replace(&mut self.block, next);
        while !block.is_empty() && !self.state.with(|backlog| backlog.failure.is_some()) {
            if self.has_room(block.len()) {
                if let Some(blocks) = &self.blocks {
                    let _ = blocks.send(block); // the thread ends after a failure, which is told
                }
                return Ok(());
            }
            if !self.patient {
                let cause = io::Error::new(ErrorKind::TimedOut, "the disk is too slow");
                self.state.with(|backlog| backlog.failure = Some(cause));
            }
            std::thread::sleep(LOOK_AGAIN);
        }
        Ok(())
    }
}

fn start(name: &str, work: impl FnOnce() + Send + 'static) -> Result<JoinHandle<()>, ProcessError> {
    let thread = std::thread::Builder::new().name(name.into());
    thread
        .spawn(work)
        .map_err(|cause| ProcessError::Start { what: "the thread that writes the recording", cause })
}

fn copy_of(error: &io::Error) -> io::Error {
    error
        .raw_os_error()
        .map_or_else(|| io::Error::new(error.kind(), error.to_string()), io::Error::from_raw_os_error)
}

/// Writes each block at once: what is written outlives this process, also while the disk is still busy with earlier ones.
fn write_blocks(
    file: &File,
    blocks: &Receiver<Vec<u8>>,
    written_blocks: &Sender<Vec<u8>>,
    to_sync: &Sender<()>,
    state: &DiskState,
) {
    let mut file = file;
    for mut block in blocks {
        let written = file.write_all(&block);
        let failed = state.with(|backlog| {
            backlog.bytes = backlog.bytes.saturating_sub(block.len());
            backlog.note(written)
        });
        if failed {
            return;
        }
        let _ = to_sync.send(()); // the other thread ends after a failure, which is told
        block.clear();
        let _ = written_blocks.send(block); // who made it may have gone
    }
}

/// Has the disk take what is written, as often as it can.
fn sync(file: &File, asked: &Receiver<()>, state: &DiskState) {
    while asked.recv().is_ok() {
        // One does for all that was written until now.
        while asked.try_recv().is_ok() {}
        let synchronized = match file.sync_data() {
            // what is no file on a disk has nothing to be synchronized
            Err(e) if e.kind() == ErrorKind::InvalidInput => Ok(()),
            other => other,
        };
        if state.with(|backlog| backlog.note(synchronized)) {
            return;
        }
        // Nobody reads it soon, and an hour would push everything else out of memory; a system that does not know the advice loses nothing.
        let _ = fadvise(file, 0, None, Advice::DontNeed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_flushed_is_in_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        let mut disk = DiskQueue::create(&path, false).unwrap();
        for part in ["one ", "two ", "three"] {
            disk.write_all(part.as_bytes()).unwrap();
            disk.flush().unwrap();
        }
        disk.close().unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "one two three");
    }

    #[test]
    fn a_full_disk_is_told_and_what_follows_is_dropped() {
        let mut disk = DiskQueue::create(Path::new("/dev/full"), true).unwrap();
        disk.write_all(b"something").unwrap();
        disk.flush().unwrap();
        while disk.state().failure().is_none() {
            std::thread::yield_now();
        }
        disk.write_all(&vec![0; 2 * MAX_BACKLOG]).unwrap();
        disk.flush().unwrap();
        let error = disk.close().unwrap_err();
        assert_eq!(error.exit_code(), 3);
        assert!(error.to_string().contains("/dev/full: cannot be written: No space left"), "{error}");
    }
}
