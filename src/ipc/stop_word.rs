//! The stop word: a page of the instance's memory through which a run is stopped without a port, a slot, an allocation or free
//! space, so that neither too many clients nor full shared memory keep a stop out.
//!
//! ```text
//! asker                                   control, every tick
//! asked += 1  ────────────────────────►   asked differs from taken: does it
//! waits until taken has come that far ◄── state, then taken = asked
//! ```
//! A latched stop is not taken before it is reset: whoever asks for it anew meanwhile changes nothing.
//!
//! ```text
//! file                                    offset  8 bytes each, little endian, 0 at first
//! /dev/shm/vservo-NAME/stop                    0  stop: add 1 to ask for it
//!                                             24  shutdown: the same
//!                                             48  latched stop: the same, or any other number than lies there
//!                                             72  of the supervisor: restarts (`restarts.rs`)
//!                                             88  stop of the guardian: how often it was asked for; an external drive brakes by itself and
//!                                             96  holds as long as this number, up to which such stops were reset, is another one
//!                                            112  of control: its process id, 4 bytes
//! ```
//! Control makes the page anew when it takes its role; it is reserved then, and removed with the rest of the instance.

mod file;
mod restarts;

use crate::messages::{ControlState, NamedCode};
use restarts::RestartCounters;
pub use restarts::RestartCounts;
use rustix::io::Errno;
use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};
use std::mem::offset_of;
use std::os::fd::{AsFd, OwnedFd};
use std::ptr::NonNull;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

/// One page, on every machine whose pages are no smaller, since less cannot be mapped.
const BYTES: usize = 4096;

/// What can be asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Halt {
    /// The arm comes to rest.
    Stop,
    /// The arm comes to rest, and the run ends.
    Shutdown,
    /// The arm comes to rest as by a fault, which is there until it is reset.
    Latch,
    /// The same, asked for by the guardian: an external drive looks at it too, and brakes by itself.
    Guardian,
}

impl Halt {
    /// All.
    pub const ALL: [Self; 4] = [Self::Stop, Self::Shutdown, Self::Latch, Self::Guardian];
}

/// One thing that can be asked for: how often it was, how far control has come with that, and the state it led to. Zero at first.
#[repr(C)]
struct RequestCounter {
    asked: AtomicU64,
    taken: AtomicU64,
    state: AtomicU32,
    reserved: AtomicU32,
}

/// The page as it lies in memory; the rest is zero.
#[repr(C)]
struct Page {
    stop: RequestCounter,
    shutdown: RequestCounter,
    latch: RequestCounter,
    restarts: RestartCounters,
    guardian: RequestCounter,
    control_process: AtomicU32,
}

/// Where programs in other languages find the numbers of the page, in bytes from its begin (`vservo layouts`).
pub const STOP_WORD_OFFSETS: [NamedCode; 5] = [
    NamedCode {
        name: "STOP",
        code: offset_of!(Page, stop) as u32,
        about: "Add 1 to bring the arm to rest. The file is /dev/shm/vservo-NAME/stop of the instance NAME; each number has 8 bytes.",
    },
    NamedCode {
        name: "SHUTDOWN",
        code: offset_of!(Page, shutdown) as u32,
        about: "Add 1 to bring the arm to rest and end the run.",
    },
    NamedCode {
        name: "LATCHED_STOP",
        code: offset_of!(Page, latch) as u32,
        about: "Add 1, or write any other number than lies there, to bring the arm to rest by a fault that stays until it is reset.",
    },
    NamedCode {
        name: "GUARDIAN_STOP",
        code: offset_of!(Page, guardian) as u32,
        about: "How often the guardian has stopped the arm. A drive brakes by itself, and holds, as long as the next number is another one.",
    },
    NamedCode {
        name: "GUARDIAN_RESET",
        code: (offset_of!(Page, guardian) + offset_of!(RequestCounter, taken)) as u32,
        about: "Up to which of them a reset has come.",
    },
];

/// The page, mapped; any thread may use it.
#[derive(Debug)]
pub struct StopWord {
    page: NonNull<Page>,
}

// SAFETY: the page is shared memory in which everything is atomic, and lives as long as this value.
#[allow(unsafe_code)]
unsafe impl Send for StopWord {}
// SAFETY: as above.
#[allow(unsafe_code)]
unsafe impl Sync for StopWord {}

impl StopWord {
    #[allow(unsafe_code)]
    fn map(file: &OwnedFd) -> Result<Self, Errno> {
        let rights = ProtFlags::READ | ProtFlags::WRITE;
        let flags = MapFlags::SHARED | MapFlags::POPULATE;
        // SAFETY: the kernel chooses an address that is free.
        let page = unsafe { mmap(std::ptr::null_mut(), BYTES, rights, flags, file.as_fd(), 0) }?;
        // A page is aligned for everything in it, and every content of it is valid.
        Ok(Self { page: NonNull::new(page.cast()).ok_or(Errno::NOMEM)? })
    }

    #[allow(unsafe_code)]
    fn page(&self) -> &Page {
        // SAFETY: the page is mapped as long as `self` is, and as long as a `Page`; all of it is atomic.
        unsafe { self.page.as_ref() }
    }

    fn restart_counters(&self) -> &RestartCounters {
        &self.page().restarts
    }

    fn line(&self, halt: Halt) -> &RequestCounter {
        let page = self.page();
        match halt {
            Halt::Stop => &page.stop,
            Halt::Shutdown => &page.shutdown,
            Halt::Latch => &page.latch,
            Halt::Guardian => &page.guardian,
        }
    }

    /// Asks for `halt`. The number says when it is done: [`StopWord::answer`].
    #[must_use]
    pub fn ask(&self, halt: Halt) -> u64 {
        self.line(halt).asked.fetch_add(1, Ordering::AcqRel).wrapping_add(1)
    }

    /// Control's state right after it took request `number`; `None` as long as it has not.
    #[must_use]
    pub fn answer(&self, halt: Halt, number: u64) -> Option<ControlState> {
        let line = self.line(halt);
        // Numbers go round before they run out: the nearer half of them lies ahead.
        let has_come = line.taken.load(Ordering::Acquire).wrapping_sub(number) < u64::MAX / 2;
        has_come.then(|| ControlState::from_code(line.state.load(Ordering::Relaxed)))
    }

    /// For control: has begun what request `number` asks for, and stays in it; [`Self::take`] is its end.
    pub fn begin(&self, halt: Halt, state: ControlState) {
        self.line(halt).state.store(state as u32, Ordering::Relaxed);
    }

    /// Control's state since it has begun what is asked for and not taken; `None` where it has not.
    #[must_use]
    pub fn begun(&self, halt: Halt) -> Option<ControlState> {
        let code = self.line(halt).state.load(Ordering::Relaxed);
        (code != 0 && self.asked(halt).is_some()).then(|| ControlState::from_code(code))
    }

    /// For control: the newest request for `halt` that it has not taken. Two loads, no system call.
    #[must_use]
    pub fn asked(&self, halt: Halt) -> Option<u64> {
        let line = self.line(halt);
        let asked = line.asked.load(Ordering::Acquire);
        (asked != line.taken.load(Ordering::Relaxed)).then_some(asked)
    }

    /// For control: takes all requests for `halt` up to `number`, which led to `state`.
    pub fn take(&self, halt: Halt, number: u64, state: ControlState) {
        let line = self.line(halt);
        line.state.store(state as u32, Ordering::Relaxed);
        line.taken.store(number, Ordering::Release);
    }

    /// For an external drive, in each of its cycles: whether the guardian's stop stands, so that the arm is to be braked by the drive's own means and held, whatever
    /// is commanded. Two loads, no system call.
    #[must_use]
    pub fn is_stopped_by_guardian(&self) -> bool {
        self.asked(Halt::Guardian).is_some()
    }

    /// The process of the control that made this page.
    #[must_use]
    pub fn control_process(&self) -> u32 {
        self.page().control_process.load(Ordering::Relaxed)
    }
}

impl Drop for StopWord {
    #[allow(unsafe_code)]
    fn drop(&mut self) {
        // SAFETY: mapped by this value with this length, and used through it alone.
        let _ = unsafe { munmap(self.page.as_ptr().cast(), BYTES) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ipc::{Instance, Role};

    /// Drives in other languages find these numbers by where they lie.
    #[test]
    fn the_places_on_the_page_are_fixed() {
        let asked = [offset_of!(Page, stop), offset_of!(Page, shutdown), offset_of!(Page, latch)];
        assert_eq!(asked, [0, 24, 48]);
        assert_eq!((offset_of!(Page, restarts), offset_of!(Page, guardian)), (72, 88));
        assert_eq!((offset_of!(RequestCounter, taken), offset_of!(Page, control_process)), (8, 112));
    }

    #[test]
    fn a_stop_of_the_guardian_is_seen_until_it_is_reset() {
        let instance: Instance = format!("u-guard-{}", std::process::id()).parse().unwrap();
        let lock = instance.lock(Role::Control).unwrap();
        let control = instance.make_stop_word().unwrap();
        let drive = instance.open_stop_word().unwrap().unwrap();
        assert_eq!(drive.control_process(), std::process::id());
        assert!(!drive.is_stopped_by_guardian());
        let number = instance.open_stop_word().unwrap().unwrap().ask(Halt::Guardian);
        assert!(drive.is_stopped_by_guardian() && control.asked(Halt::Latch).is_none());
        control.take(Halt::Guardian, number, ControlState::default());
        assert!(!drive.is_stopped_by_guardian());
        drop(lock);
        instance.remove_leftovers(None);
    }

    #[test]
    fn a_request_is_seen_until_it_is_taken_and_then_answered() {
        let instance: Instance = format!("u-stop-{}", std::process::id()).parse().unwrap();
        let lock = instance.lock(Role::Control).unwrap();
        assert!(instance.open_stop_word().unwrap().is_none());
        let control = instance.make_stop_word().unwrap();
        let asker = instance.open_stop_word().unwrap().unwrap();
        assert_eq!(control.asked(Halt::Stop), None);
        let numbers = [asker.ask(Halt::Stop), asker.ask(Halt::Stop)];
        assert_eq!(numbers.map(|n| asker.answer(Halt::Stop, n)), [None, None]);
        assert_eq!(control.asked(Halt::Shutdown), None);
        let newest = control.asked(Halt::Stop).unwrap();
        let late = asker.ask(Halt::Stop);
        control.take(Halt::Stop, newest, ControlState::Stopping);
        assert_eq!(numbers.map(|n| asker.answer(Halt::Stop, n)), [Some(ControlState::Stopping); 2]);
        assert_eq!(asker.answer(Halt::Stop, late), None, "asked after control had looked");
        assert_eq!(control.asked(Halt::Stop), Some(late));
        // A control that comes next is not stopped by what was asked of the one before.
        let next = instance.make_stop_word().unwrap();
        assert!(control.asked(Halt::Stop).is_some() && next.asked(Halt::Stop).is_none());
        drop(lock);
        instance.remove_leftovers(None);
        assert!(!instance.directory().exists());
    }
}
