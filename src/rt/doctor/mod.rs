//! Is this machine fit for 1 kHz? Looks at what the kernel, the limits and the clock allow, and measures how late a
//! thread wakes up.

mod checks;
mod jitter;
mod slices;

pub use jitter::{Bar, Jitter, Measured, measure, measure_each};
pub use slices::{Median, Verdict, compare, median_slice};

use serde::Serialize;
use std::fmt::Write as _;

/// One thing that was looked at.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Check {
    /// What.
    pub name: &'static str,
    /// Whether it is good as it is.
    pub ok: bool,
    /// What was found.
    pub found: String,
    /// What to do about it, where it is not good.
    pub remedy: Option<&'static str>,
}

/// The whole examination.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Examination {
    /// Settings of kernel, limits and clock.
    pub checks: Vec<Check>,
    /// Lateness of a 1 kHz thread that sleeps all the way to its deadlines; `null` when it was not measured.
    pub jitter: Option<Jitter>,
    /// Likewise, of one that spins the last part, as a run under SCHED_FIFO does (`realtime.spin_us`).
    pub jitter_with_spin: Option<Jitter>,
}

/// Looks at everything but the jitter.
#[must_use]
pub fn examine() -> Vec<Check> {
    checks::all()
}

impl Examination {
    /// Lines for people.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut t = String::new();
        for c in &self.checks {
            let _ = writeln!(t, "{:<8} {:<18} {}", if c.ok { "ok" } else { "warning" }, c.name, c.found);
            if let Some(remedy) = c.remedy {
                let _ = writeln!(t, "{:27} -> {remedy}", "");
            }
        }
        for jitter in self.jitter.iter().chain(&self.jitter_with_spin) {
            t += &jitter.to_text();
        }
        t
    }
}
