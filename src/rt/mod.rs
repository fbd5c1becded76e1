//! The operating system's part in being punctual: clock, absolute sleep, scheduling, memory that is there.

mod clock;
pub mod doctor;
mod prefault;
mod scheduling;

pub use clock::{now, sleep_until};
pub use prefault::{page_faults, prefault};
pub use scheduling::{Awake, Obtained, SchedulingError, prepare_process, prepare_thread};
