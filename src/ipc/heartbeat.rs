//! Heartbeats: each process writes the time of its last one to the file of its role's lock, where the others can read it.
//!
//! A process that hangs still holds its lock, its node and its ports: only the progress of its main loop shows that it is alive.

use super::{Instance, Role};
use crate::rt::now;
use crate::time::{MonoNs, SpanNs};
use rustix::io::{pread, pwrite};
use std::cell::Cell;
use std::os::fd::OwnedFd;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Heartbeats come no more often than this, since a silence is reported after twenty of them.
const PERIOD: SpanNs = SpanNs(100_000_000);

/// Time between two looks whether a piece of work is done. Chosen by hand: it delays the end of a run by no more than this.
const LOOK_AGAIN: Duration = Duration::from_millis(2);

/// Where in the file stands how far its process has come: behind the sign of life, which needs so many bytes.
const PROGRESS_AT: u64 = 8;

/// The progress of control once its last tick is done: what it works out of the run afterwards takes its time.
pub const TICKS_ARE_OVER: u64 = 1;

/// The signs of life of this process; it holds the role as the lock does, because they share its file. Costs a look at the clock, and ten times a second a system call.
#[derive(Debug)]
pub struct Heartbeat {
    file: OwnedFd,
    last: Cell<MonoNs>,
}

impl Heartbeat {
    pub(super) fn new(file: OwnedFd) -> Self {
        let heartbeat = Self { file, last: Cell::new(MonoNs::ZERO) };
        // Before the first beat: who lives has come nowhere yet, and will come further.
        heartbeat.tell_progress(0);
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

    /// Marks passes while `work` is done, which comes round in no loop, for `longest` at most. Where there is no thread for it, `work` is done without.
    pub fn beat_during<T>(&self, longest: SpanNs, work: impl FnOnce() -> T) -> T {
        let (file, done) = (self.file.try_clone(), AtomicBool::new(false));
        std::thread::scope(|scope| {
            if let Ok(file) = file {
                let beats = Self { file, last: Cell::new(MonoNs::ZERO) };
                let (done, start) = (&done, now());
                // Without one it may be taken for hung, as it would have been.
                let _ = std::thread::Builder::new().name("heartbeat".into()).spawn_scoped(scope, move || {
                    while !done.load(Ordering::Relaxed) && now() - start < longest {
                        beats.beat();
                        std::thread::sleep(LOOK_AGAIN);
                    }
                });
            }
            let result = work();
            done.store(true, Ordering::Relaxed);
            result
        })
    }

    /// Lets others know how far this process has come. Costs a system call.
    pub fn tell_progress(&self, count: u64) {
        let _ = pwrite(&self.file, &count.to_le_bytes(), PROGRESS_AT);
    }
}

impl Instance {
    /// The last sign of life of the process that plays `role`; `None` before the first.
    #[must_use]
    pub fn last_heartbeat(&self, role: Role) -> Option<MonoNs> {
        let last = self.number_of(role, 0).map(|bytes| MonoNs(i64::from_le_bytes(bytes)))?;
        // What stands behind it in the file is written earlier, and leaves zeroes here.
        (last != MonoNs::ZERO).then_some(last)
    }

    /// How far the process that plays `role` said that it has come; `None` where it has not.
    #[must_use]
    pub fn progress(&self, role: Role) -> Option<u64> {
        self.number_of(role, PROGRESS_AT).map(u64::from_le_bytes)
    }

    fn number_of(&self, role: Role, at: u64) -> Option<[u8; 8]> {
        let mut bytes = [0; 8];
        (pread(self.lock_file(role)?, &mut bytes, at) == Ok(bytes.len())).then_some(bytes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::CameraId;

    const VISION: Role = Role::Vision(CameraId::FIRST);
    const CAMERA: Role = Role::Camera(CameraId::FIRST);

    fn instance(test: &str) -> Instance {
        format!("{test}-{}", std::process::id()).parse().unwrap()
    }

    #[test]
    fn signs_of_life_are_seen_from_outside() {
        let i = instance("heartbeat");
        let lock = i.lock(VISION).unwrap();
        assert_eq!(i.last_heartbeat(VISION), None, "not before the first");
        lock.state(&[("clock".to_owned(), "lockstep".to_owned())].into());
        assert_eq!(i.last_heartbeat(VISION), None, "what else is told in the file is no sign of life");
        let before = crate::rt::now();
        let heartbeat = lock.heartbeat().unwrap();
        let seen = i.last_heartbeat(VISION).unwrap();
        assert!(seen >= before && seen <= crate::rt::now());
        heartbeat.beat();
        assert!(i.last_heartbeat(VISION).unwrap() >= seen);
        assert_eq!(i.last_heartbeat(CAMERA), None);
        heartbeat.tell_progress(7);
        assert_eq!(i.progress(VISION), Some(7));
        drop((heartbeat, lock)); // both hold the role: they share its file
        let next = i.lock(VISION).unwrap();
        let heartbeat = next.heartbeat().unwrap();
        assert_eq!(i.progress(VISION), Some(0), "the next process has not come as far as the last one");
        drop((heartbeat, next));
        i.remove_leftovers(None);
    }

    #[test]
    fn a_process_that_works_long_is_alive() {
        let i = instance("works");
        let lock = i.lock(VISION).unwrap();
        let heartbeat = lock.heartbeat().unwrap();
        let first = i.last_heartbeat(VISION).unwrap();
        let long = crate::time::SpanNs(10_000_000_000);
        let heard = heartbeat.beat_during(long, || {
            let start = crate::rt::now();
            while i.last_heartbeat(VISION) == Some(first) && crate::rt::now() - start < long {
                std::thread::sleep(std::time::Duration::from_millis(5));
            }
            i.last_heartbeat(VISION)
        });
        assert!(heard.unwrap() > first);
        drop((heartbeat, lock));
        i.remove_leftovers(None);
    }
}
