//! The operating system's part in being punctual: clock, absolute sleep, scheduling, memory that is there, output that
//! nobody waits for, and results that are written whole.

mod clock;
mod deadline_wait;
mod log;
mod log_format;
mod output;
mod prefault;
mod scheduling;
mod terminal;
mod write_file;

pub use clock::{now, sleep_until, unix_origin};
pub use deadline_wait::DeadlineWait;
pub use log::start_logging;
pub use log_format::{LogFormat, log_environment, log_format};
pub use output::{CLEAR_LINE, Stderr, print, tell};
pub use prefault::{page_faults, prefault};
pub use scheduling::{
    Awake, Obtained, SchedulingError, USUAL_SPIN, prepare_process, prepare_thread, spin_before_deadlines,
    why_not_on,
};
pub use terminal::Terminal;
pub use write_file::{IsRead, check_writable, write_file};
