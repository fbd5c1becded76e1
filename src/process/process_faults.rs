//! A process that sees does to itself what its run file asks for: it dies, hangs or is slow.

use crate::config::Config;
use crate::faults::{FaultyProcess, ProcessFault, ProcessFaults};
use rustix::process::{Signal, getpid, kill_process};
use std::time::Duration;
use tracing::warn;

/// The faults of `process` in a run of `config`.
pub(super) fn of(config: &Config, process: FaultyProcess) -> ProcessFaults {
    ProcessFaults::new(&config.faults.processes, process, config.seed, config.camera.rate_hz)
}

/// Suffers what acts at frame `id`.
pub(super) fn suffer(faults: &ProcessFaults, id: u64) {
    for (fault, left) in faults.acting(id) {
        let span = match fault {
            ProcessFault::Dies => {
                warn!(frame = id, "dies, as its run file asks for ([[faults]])");
                // Its own process takes the signal; what could fail is that there is none of this number.
                let _ = kill_process(getpid(), Signal::KILL);
                continue;
            }
            ProcessFault::Hangs => {
                warn!(frame = id, "hangs, as its run file asks for ([[faults]])");
                left
            }
            ProcessFault::Slows(span) => span,
        };
        std::thread::sleep(Duration::from_nanos(span.0.max(0).unsigned_abs()));
    }
}
