//! Faults that are put into the simulated parts of a cell on purpose, `[[faults]]` of a run file: into frames, into measurements, into the simulated arm.
//!
//! ```text
//! a fault acts on number k at the time t where   from <= t < from + duration   and   u(seed, k) < probability,   u uniform in [0, 1)
//! ```
//! The number k is that of the frame or of the tick. All that is random comes from it and from the seed, so that the same run file has the same faults in every
//! process and under every clock; before and after its time a fault changes nothing, to the last bit.
//!
//! | who | puts in | where |
//! | --- | --- | --- |
//! | [`FrameFaults`] | frames that are lost, late, repeated, dark, white, torn, corrupt, wrongly stamped, with a second target | the camera's schedule, and its images ([`ImageDamage`]) |
//! | [`MeasurementFaults`] | measurements that are stale, overtaken, displaced, mislabelled; noise of points | the last step of vision; before their pose is computed |
//! | [`JointFaults`] | encoders that leap, freeze or shift, torque and commands that are lost, states that are stale | the simulated arm |
//! | [`ProcessFaults`] | camera or vision dies, hangs, is slow | the process itself, in real time |
//!
//! Sheets in front of the target, walls, pushes and jams are no business of this module: `scene.occluder` and `drive.simulated` have them.

mod frames;
mod joints;
mod measurements;
mod processes;

pub use frames::{FrameFault, FrameFaults, ImageDamage};
pub use joints::{JointFault, JointFaults};
pub use measurements::{MeasurementFault, MeasurementFaults};
pub use processes::{FaultyProcess, ProcessFault, ProcessFaults};

use crate::linalg::Random;
use crate::time::SpanNs;

/// Most faults of a run. Chosen by hand: a schedule carries those of frames with it, and tells whoever wants more to make runs of them.
pub const MAX_FAULTS: usize = 16;

/// When a fault acts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FaultWindow {
    /// From when on: of frames since the exposure of frame 0, of the arm since its first state.
    pub from: SpanNs,
    /// Until when, itself not included.
    pub until: SpanNs,
    /// Of each frame, measurement or state of that time, 0 to 1.
    pub probability: f64,
    /// Seed of all that is random about it.
    pub seed: u64,
}

impl FaultWindow {
    /// Whether it acts on number `k` at `time`.
    #[must_use]
    pub fn acts(&self, time: SpanNs, k: u64) -> bool {
        self.from <= time && time < self.until && self.random(k).uniform() < self.probability
    }

    /// The random numbers of number `k`, of which the first one has said whether it acts.
    fn random(&self, k: u64) -> Random {
        Random::new(self.seed ^ k)
    }

    /// The same with a seed of its own, the `i`-th of `seed`.
    #[must_use]
    pub fn seeded(self, seed: u64, i: u64) -> Self {
        Self { seed: Random::new(seed ^ (i + 1).rotate_right(16)).bits(), ..self }
    }
}

/// All faults of a run, each with its time; their seeds are those of the run.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct InjectedFaults {
    /// Those of frames; each camera draws its own.
    pub frames: Vec<(FrameFault, FaultWindow)>,
    /// Those of measurements.
    pub measurements: Vec<(MeasurementFault, FaultWindow)>,
    /// Those of the simulated arm, each with its joint, from 0.
    pub joints: Vec<(JointFault, usize, FaultWindow)>,
    /// Those of the processes that see, in real time.
    pub processes: Vec<(FaultyProcess, ProcessFault, FaultWindow)>,
}

#[cfg(test)]
mod tests {
    use super::*;

    const WINDOW: FaultWindow =
        FaultWindow { from: SpanNs(1_000), until: SpanNs(2_000), probability: 0.3, seed: 5 };

    #[test]
    fn probability_and_duration_are_kept() {
        let acts = |window: &FaultWindow| (0..10_000).filter(|k| window.acts(SpanNs(1_500), *k)).count();
        // 10 000 draws of 0.3: 3000, standard deviation 46
        assert!((2800..3200).contains(&acts(&WINDOW)), "{}", acts(&WINDOW));
        assert_eq!(acts(&FaultWindow { probability: 1.0, ..WINDOW }), 10_000);
        assert_eq!(acts(&FaultWindow { probability: 0.0, ..WINDOW }), 0);
        let always = FaultWindow { probability: 1.0, ..WINDOW };
        let times = [999, 1_000, 1_999, 2_000].map(|ns| always.acts(SpanNs(ns), 0));
        assert_eq!(times, [false, true, true, false]);
    }

    #[test]
    fn the_same_seed_has_the_same_faults_and_others_differ() {
        let acts =
            |window: FaultWindow| -> Vec<bool> { (0..1000).map(|k| window.acts(SpanNs(1_500), k)).collect() };
        assert_eq!(acts(WINDOW.seeded(7, 0)), acts(WINDOW.seeded(7, 0)));
        assert_ne!(acts(WINDOW.seeded(7, 0)), acts(WINDOW.seeded(7, 1)));
        assert_ne!(acts(WINDOW.seeded(7, 0)), acts(WINDOW.seeded(8, 0)));
    }
}
