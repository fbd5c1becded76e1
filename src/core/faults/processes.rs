//! Faults of the processes that see: they die, hang, or are slow.

use super::FaultWindow;
use crate::time::SpanNs;
use serde::{Deserialize, Serialize};

/// A process that something is wrong with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FaultyProcess {
    /// That of a camera; of a pair each.
    Camera,
    /// That of vision.
    Vision,
}

/// What is wrong with a process.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ProcessFault {
    /// It ends at once, without a word, as by `kill -9`.
    Dies,
    /// It does nothing until the fault is over, and shows no sign of life.
    Hangs,
    /// It takes so much longer for a frame.
    Slows(SpanNs),
}

/// The faults of one process, by the numbers of its frames.
#[derive(Debug, Clone)]
pub struct ProcessFaults {
    list: Vec<(ProcessFault, FaultWindow)>,
    period_ns: f64,
}

impl ProcessFaults {
    /// Those of `list` that are of `process`, drawn by `seed`, for a camera with `rate_hz`.
    #[must_use]
    pub fn new(
        list: &[(FaultyProcess, ProcessFault, FaultWindow)],
        process: FaultyProcess,
        seed: u64,
        rate_hz: f64,
    ) -> Self {
        // Beside the seeds of frames, measurements and joints.
        let seeded = |(i, (whose, fault, window)): (u64, &(_, _, FaultWindow))| {
            (*whose == process).then(|| (*fault, window.seeded(seed.rotate_left(16), i)))
        };
        Self { list: (0..).zip(list).filter_map(seeded).collect(), period_ns: 1e9 / rate_hz }
    }

    /// What acts at frame `id`, each with how long it lasts from then on.
    pub fn acting(&self, id: u64) -> impl Iterator<Item = (ProcessFault, SpanNs)> {
        let time = SpanNs((id as f64 * self.period_ns).round() as i64);
        let acts = move |(_, window): &&(_, FaultWindow)| window.acts(time, id);
        self.list.iter().filter(acts).map(move |(fault, window)| (*fault, SpanNs(window.until.0 - time.0)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_are_of_their_process_and_time_alone() {
        let window =
            FaultWindow { from: SpanNs(100_000_000), until: SpanNs(200_000_000), probability: 1.0, seed: 0 };
        let list = [
            (FaultyProcess::Vision, ProcessFault::Hangs, window),
            (FaultyProcess::Camera, ProcessFault::Slows(SpanNs(7)), window),
        ];
        let of = |process| {
            let faults = ProcessFaults::new(&list, process, 3, 25.0);
            (0..8).map(|id| faults.acting(id).collect::<Vec<_>>()).collect::<Vec<_>>()
        };
        let left = |id: i64| SpanNs(200_000_000 - 40_000_000 * id);
        for (process, fault) in [
            (FaultyProcess::Vision, ProcessFault::Hangs),
            (FaultyProcess::Camera, ProcessFault::Slows(SpanNs(7))),
        ] {
            for (id, acting) in (0..).zip(of(process)) {
                let wanted = if (3..5).contains(&id) { vec![(fault, left(id))] } else { vec![] };
                assert_eq!(acting, wanted, "frame {id}");
            }
        }
    }
}
