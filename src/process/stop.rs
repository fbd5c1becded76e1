//! Requests to stop: SIGINT, SIGTERM, SIGHUP, and the death of the supervisor.

use super::ProcessError;
use crate::rt::now;
use crate::time::SpanNs;
use rustix::process::{Pid, Signal, getppid, set_parent_process_death_signal};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Set once a stop is requested; shared by all threads of a process.
#[derive(Debug, Clone, Default)]
pub struct StopFlag {
    requested: Arc<AtomicBool>,
}

impl StopFlag {
    /// A flag that the signals of this process set.
    ///
    /// # Errors
    /// When the handler cannot be installed.
    pub fn on_signals() -> Result<Self, ProcessError> {
        let flag = Self::default();
        let handle = flag.clone();
        ctrlc::set_handler(move || handle.request())?;
        Ok(flag)
    }

    /// Asks for the stop.
    pub fn request(&self) {
        self.requested.store(true, Ordering::Relaxed);
    }

    /// Whether a stop was asked for, or is within `longest`. A signal interrupts the calls of a thread before the thread that
    /// handles it has set the flag.
    #[must_use]
    pub fn is_requested_within(&self, longest: Duration) -> bool {
        let deadline = now() + SpanNs::from_s(longest.as_secs_f64());
        while !self.is_requested() && now() < deadline {
            std::thread::sleep(Duration::from_millis(1));
        }
        self.is_requested()
    }

    /// Whether a stop was asked for.
    #[must_use]
    pub fn is_requested(&self) -> bool {
        self.requested.load(Ordering::Relaxed)
    }
}

/// Makes the kernel send this process a SIGTERM when its supervisor, `parent`, dies in whatever way.
pub fn follow_parent(parent: i32, stop: &StopFlag) {
    let armed = set_parent_process_death_signal(Some(Signal::TERM));
    // It may have died before: then this process has another parent by now.
    if armed.is_err() || getppid().map(Pid::as_raw_pid) != Some(parent) {
        stop.request();
    }
}
