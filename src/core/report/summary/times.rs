//! Durations in a summary: of measurements and of control's ticks.

use crate::report::histogram::Quantiles;
use crate::time::TICK;
use serde::{Deserialize, Serialize};

/// What one of the run's processes used, from its start to its end.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct ProcessUsage {
    /// Time on any core, s.
    pub cpu_s: f64,
    /// The same as a share of one core's time; above 1 for several busy threads.
    pub cpu_share: f64,
    /// Most memory that it had at once, MB, shared memory that it touched included.
    pub max_resident_mb: f64,
}

/// Latencies of the measurements, us.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Latencies {
    /// Middle of the exposure to the command that used it.
    pub exposure_to_command: Quantiles,
    /// Hand-over of the frame to the finished measurement.
    pub frame_to_measurement: Quantiles,
    /// Work of vision.
    pub vision: Quantiles,
    /// Middle of the exposure to hand-over; zero in lockstep, where the two have different clocks.
    pub exposure_to_frame: Quantiles,
    /// Hand-over to the start of vision's work.
    pub frame_to_vision: Quantiles,
    /// Finished measurement to the command that used it; zero in lockstep.
    pub measurement_to_command: Quantiles,
}

/// Times of the control tick, us; all zero in lockstep, where ticks have no deadline.
///
/// `wake` and `total` have an entry for every tick of the run, skipped ones included; `step` one for each tick that was served.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct TickTimes {
    /// Deadline to wake-up.
    pub wake: Quantiles,
    /// Wake-up to command.
    pub step: Quantiles,
    /// Deadline to the next command that was written.
    pub total: Quantiles,
    /// All totals: upper edges of the filled buckets, which belong to the next bucket, and counts. What lies in buckets
    /// with an edge above 1000 us was missed.
    pub total_histogram: Vec<(f64, u64)>,
}

impl TickTimes {
    /// Ticks whose command came a tick or more after their deadline, counted from the histogram.
    #[must_use]
    pub fn late_ticks(&self) -> u64 {
        let late = |(edge_us, count): &(f64, u64)| if *edge_us > TICK.as_us() { *count } else { 0 };
        self.total_histogram.iter().map(late).sum()
    }
}

/// What the real-time thread had from the system.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct RealtimeReport {
    /// Scheduling and memory that it obtained, in words.
    pub scheduling: String,
    /// Pages of memory that its ticks had to fetch.
    pub page_faults: u64,
    /// How long it was to spin before each deadline, us; 0 where it only slept.
    #[serde(default)]
    pub spin_us: f64,
    /// What that cost: the time that it spun, as a share of the run.
    #[serde(default)]
    pub spin_share: f64,
}
