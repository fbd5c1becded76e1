//! Requests to stop, for all threads of a process.

use crate::rt::now;
use crate::time::SpanNs;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Why a run ends on request.
#[cfg(feature = "cli")]
pub(super) const STOP_REASON: &str = "a stop was requested";

/// Set once a stop is requested; shared by all threads of a process.
#[derive(Debug, Clone, Default)]
pub struct StopFlag {
    requested: Arc<AtomicBool>,
}

impl StopFlag {
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
