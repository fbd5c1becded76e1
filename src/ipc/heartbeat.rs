//! Heartbeats: each process writes the time of its last one to the file of its role's lock, where the others can read it.
//!
//! A process that hangs still holds its lock, its node and its ports: only the progress of its main loop shows that it is alive.

use crate::rt::now;
use crate::time::{MonoNs, SpanNs};
use rustix::io::{pread, pwrite};
use std::cell::Cell;
use std::os::fd::{AsFd, OwnedFd};

/// Heartbeats come no more often than this, since a silence is reported after twenty of them.
const PERIOD: SpanNs = SpanNs(100_000_000);

/// The signs of life of this process; it holds the role as the lock does, because they share its file. Costs a look at the clock, and ten times a second a system call.
#[derive(Debug)]
pub struct Heartbeat {
    file: OwnedFd,
    last: Cell<MonoNs>,
}

impl Heartbeat {
    pub(super) fn new(file: OwnedFd) -> Self {
        let heartbeat = Self { file, last: Cell::new(MonoNs::ZERO) };
        heartbeat.beat();
        heartbeat
    }

    /// Marks a pass of the main loop.
    pub fn beat(&self) {
        let time = now();
        if time - self.last.get() >= PERIOD {
            self.last.set(time);
            let _ = pwrite(&self.file, &time.0.to_le_bytes(), 0);
        }
    }
}

/// The last sign of life in the file of a role's lock.
pub(super) fn read(file: impl AsFd) -> Option<MonoNs> {
    let mut bytes = [0; 8];
    (pread(file, &mut bytes, 0) == Ok(bytes.len())).then(|| MonoNs(i64::from_le_bytes(bytes)))
}
