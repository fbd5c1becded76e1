//! A whole run in one process and in simulated time.

mod system;

pub use system::{Moment, SimError, SystemRun, simulate_system};
