//! The operating system's part in being punctual: clock, absolute sleep, scheduling, memory that is there, output that
//! nobody waits for, and results that are written whole.

mod clock;
#[cfg(feature = "cli")]
mod deadline_wait;
#[cfg(feature = "cli")]
mod log;
#[cfg(feature = "cli")]
mod log_format;
#[cfg(feature = "cli")]
mod output;
#[cfg(feature = "cli")]
mod prefault;
#[cfg(feature = "client")]
mod process_group;
#[cfg(feature = "cli")]
mod scheduling;
#[cfg(feature = "cli")]
mod service_manager;
#[cfg(feature = "cli")]
mod terminal;
mod write_file;

pub use clock::{now, sleep_until, unix_origin};
#[cfg(feature = "cli")]
pub use deadline_wait::DeadlineWait;
#[cfg(feature = "cli")]
pub use log::start_logging;
#[cfg(feature = "cli")]
pub use log_format::{LogFormat, log_environment, log_format};
#[cfg(feature = "cli")]
pub use output::{CLEAR_LINE, Stderr, print, tell};
#[cfg(feature = "cli")]
pub use prefault::{page_faults, prefault};
#[cfg(feature = "client")]
pub use process_group::kill_with_group;
#[cfg(feature = "cli")]
pub use scheduling::{
    Awake, Obtained, SchedulingError, USUAL_SPIN, prefer_thread, prepare_process, prepare_thread,
    spin_before_deadlines, why_not_on, with_priority,
};
#[cfg(feature = "cli")]
pub use service_manager::{ServiceWatchdog, tell_service_manager};
#[cfg(feature = "cli")]
pub use terminal::Terminal;
#[doc(inline)]
pub use vservo_clock::{ClockEstimate, ClockMap};
pub use write_file::{IsRead, check_writable, follow_links, write_file};
