//! SIGUSR1 of the supervisor: a latched stop, asked for by whoever knows no more than the process. The handler itself adds to the stop word, so that it waits for no
//! thread of the supervisor.

use crate::ipc::{Halt, Instance, StopWord};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};

static WORD: OnceLock<StopWord> = OnceLock::new();
/// It came before control had made the word.
static EARLY: AtomicBool = AtomicBool::new(false);

/// Two atomic operations: what a handler of signals may do.
extern "C" fn latch(_signal: libc::c_int) {
    match WORD.get() {
        Some(word) => {
            let _ = word.ask(Halt::Latch);
        }
        None => EARLY.store(true, Ordering::Relaxed),
    }
}

/// The signal, for the stop word of one instance.
#[derive(Debug)]
pub(super) struct LatchSignal {
    instance: Instance,
}

impl LatchSignal {
    /// Handles the signal from now on.
    #[allow(unsafe_code)]
    pub(super) fn handled(instance: &Instance) -> Self {
        let handler: extern "C" fn(libc::c_int) = latch;
        // SAFETY: the handler touches atomics alone, and lives as long as the program.
        unsafe { libc::signal(libc::SIGUSR1, handler as libc::sighandler_t) };
        Self { instance: instance.clone() }
    }

    /// Takes the word as soon as control has made it.
    pub(super) fn look(&self) {
        if WORD.get().is_some() {
            return;
        }
        if let Ok(Some(word)) = self.instance.open_stop_word()
            && WORD.set(word).is_ok()
            && EARLY.swap(false, Ordering::Relaxed)
        {
            latch(libc::SIGUSR1);
        }
    }
}
