//! What asks for a stop: SIGINT, SIGTERM, SIGHUP, and the death of the supervisor.

use super::{ProcessError, StopFlag};
use rustix::process::{Pid, Signal, getppid, set_parent_process_death_signal};

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
}

/// Makes the kernel send this process a SIGTERM when its supervisor, `parent`, dies in whatever way.
pub fn follow_parent(parent: i32, stop: &StopFlag) {
    let armed = set_parent_process_death_signal(Some(Signal::TERM));
    // It may have died before: then this process has another parent by now.
    if armed.is_err() || getppid().map(Pid::as_raw_pid) != Some(parent) {
        stop.request();
    }
}
