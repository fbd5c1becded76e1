//! Is this machine fit for 1 kHz? Looks at what the kernel, the limits and the clock allow, and measures how late a
//! thread wakes up.

mod checks;
mod jitter;
mod slices;

pub use jitter::{Bar, Jitter, Measured, measure, measure_each};
pub use slices::{Median, SliceComparison, compare, median_slice};

use serde::Serialize;
use std::fmt::Write as _;

/// One thing that was looked at.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct DoctorCheck {
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
    pub checks: Vec<DoctorCheck>,
    /// Lateness of a 1 kHz thread that sleeps all the way to its deadlines; `null` when it was not measured.
    pub jitter: Option<Jitter>,
    /// Likewise, of one that spins the last part, as a run under SCHED_FIFO does (`realtime.spin_us`).
    pub jitter_with_spin: Option<Jitter>,
}

/// Looks at everything but the jitter.
#[must_use]
pub fn examine() -> Vec<DoctorCheck> {
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
        let _ = writeln!(t, "verdict  {}", self.verdict());
        t
    }

    /// What it comes to, in a sentence.
    #[must_use]
    pub fn verdict(&self) -> String {
        let warnings = self.checks.iter().filter(|check| !check.ok).count();
        let first = self.checks.iter().find_map(|check| check.remedy).unwrap_or("see above");
        let mend = match warnings {
            0 => String::new(),
            1 => format!("; one warning, which would help: {first}"),
            many => format!("; {many} warnings, of which this helps first: {first}"),
        };
        let Some(jitter) = self.jitter_with_spin.as_ref().or(self.jitter.as_ref()) else {
            return match warnings {
                0 => "the settings are fit for 1 kHz; the wake-up latency was not measured".into(),
                _ => format!("the wake-up latency was not measured{mend}"),
            };
        };
        let wake = &jitter.wake_us;
        let late = jitter.histogram.iter().filter(|bar| bar.up_to_us.is_none_or(|edge| edge > TICK_US));
        let (late, wakes) = (late.map(|bar| bar.count).sum::<u64>(), jitter.wakes);
        let judged = if late == 0 && wake.p999 <= FIT_US {
            "fit for 1 kHz".to_owned()
        } else if late as f64 <= BEARABLE * wakes as f64 {
            format!(
                "fit for trials at 1 kHz, not for an arm that must not miss: {late} of {wakes} ticks came too late"
            )
        } else {
            format!(
                "not fit for 1 kHz: {late} of {wakes} ticks came too late; lockstep runs need no punctual machine"
            )
        };
        format!("{judged} (p99.9 {:.0} us, greatest {:.0} us late){mend}", wake.p999, wake.max)
    }
}

/// A wake-up that is later than the period of 1 ms has missed its tick, since the next one is due.
const TICK_US: u64 = 1_000;
/// Largest latency of 999 of 1000 wake-ups of a suitable machine, us. Chosen by hand: a fifth of the period; a tick's own work takes microseconds.
const FIT_US: f64 = 200.0;
/// Share of missed ticks that is tolerable for a trial. Chosen by hand: one a second, which the supervision of the arm tolerates.
const BEARABLE: f64 = 1e-3;

/// Examines this machine and tells it.
pub(super) fn doctor(json: bool, jitter_s: f64) -> u8 {
    let checks = examine();
    let request = crate::config::RealtimeRequest { priority: 80, cpu: None, lock_memory: false };
    // chosen by hand: an hour tells all that such a measurement tells
    let measured = (jitter_s > 0.0).then(|| measure(jitter_s.min(3600.0), request)).flatten();
    let (jitter, jitter_with_spin) = measured.map(|m| (m.sleeping, m.spinning)).unzip();
    let report = Examination { checks, jitter, jitter_with_spin };
    let text = if json { super::json(&report) } else { report.to_text() };
    super::shown(&text, 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::histogram::Quantiles;

    fn examined(late: u64, p999: f64, warnings: usize) -> Examination {
        let check =
            |ok| DoctorCheck { name: "x", ok, found: String::new(), remedy: (!ok).then_some("buy another") };
        let wake_us = Quantiles { p50: 1.0, p99: 2.0, p999, max: 3.0 * p999 };
        let bars = [(Some(1), 9_000), (Some(TICK_US), 1_000 - late), (Some(2_000), late), (None, 0)];
        let jitter = Jitter {
            wakes: 10_000,
            scheduling: String::new(),
            spin_us: 50.0,
            spin_share: 0.05,
            wake_us,
            histogram: bars.map(|(up_to_us, count)| Bar { up_to_us, count }).into(),
        };
        let checks = (0..3).map(|i| check(i >= warnings)).collect();
        Examination { checks, jitter: None, jitter_with_spin: Some(jitter) }
    }

    #[test]
    fn the_verdict_goes_by_late_ticks_and_names_the_first_remedy() {
        for (late, p999, warnings, begin, has) in [
            (0, 20.0, 0, "fit for 1 kHz (p99.9 20 us", ""),
            (0, 20.0, 1, "fit for 1 kHz", "one warning, which would help: buy another"),
            (0, 500.0, 0, "fit for trials", "0 of 10000"),
            (10, 20.0, 2, "fit for trials", "2 warnings"),
            (11, 20.0, 2, "not fit", "11 of 10000 ticks"),
        ] {
            let verdict = examined(late, p999, warnings).verdict();
            assert!(verdict.starts_with(begin) && verdict.contains(has), "{verdict}");
        }
        let unmeasured = Examination { jitter_with_spin: None, ..examined(0, 1.0, 0) };
        assert!(unmeasured.to_text().ends_with("was not measured\n"));
    }
}
