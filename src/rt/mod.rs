//! The operating system's part in being punctual: clock, absolute sleep, scheduling.

mod clock;
pub mod doctor;
mod scheduling;

pub use clock::{now, sleep_until};
pub use scheduling::{Awake, Obtained, SchedulingError, prepare_process, prepare_thread};
