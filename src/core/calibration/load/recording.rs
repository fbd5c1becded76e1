//! What a load calibration is to remember: positions and torques of all joints at each tick.

use crate::messages::{JointState, MAX_JOINTS};
use crate::time::{MonoNs, TICK};
use nalgebra::SVector;

/// Stamps of two ticks may differ from a tick by this share of it; of others one is missing between them. Chosen by hand: half way to a missing one.
const STAMP_SHARE: f64 = 0.5;

/// The ticks of one run with `N` joints.
#[derive(Debug, Clone, Default)]
pub struct LoadRecording<const N: usize> {
    ticks: Vec<LoadTick<N>>,
}

/// One tick.
#[derive(Debug, Clone, Copy)]
pub(super) struct LoadTick<const N: usize> {
    stamp: MonoNs,
    /// Measured positions, rad or m.
    pub(super) q: SVector<f64, N>,
    /// The torque that acted in the tick before the stamp as it was commanded, N m or N.
    pub(super) commanded: SVector<f64, N>,
    /// The torque at the stamp, where the drive measures it.
    pub(super) measured: Option<SVector<f64, N>>,
}

impl<const N: usize> LoadRecording<N> {
    /// Takes in a tick, with the torques that the drive `measured`, N m or N. What a simulation knows beyond is left aside.
    pub fn note(&mut self, state: &JointState, measured: Option<&[f64; MAX_JOINTS]>) {
        let vector =
            |all: &[f64; MAX_JOINTS]| SVector::from_fn(|i, _| all.get(i).copied().unwrap_or_default());
        self.push(state.stamp, vector(&state.q), vector(&state.tau), measured.map(vector));
    }

    /// Takes in positions, rad or m, with the torques that were commanded until then and that are measured there, N m or N.
    pub fn push(
        &mut self,
        stamp: MonoNs,
        q: SVector<f64, N>,
        commanded: SVector<f64, N>,
        measured: Option<SVector<f64, N>>,
    ) {
        if self.ticks.last().is_none_or(|last| stamp > last.stamp) {
            self.ticks.push(LoadTick { stamp, q, commanded, measured });
        }
    }

    /// How many ticks there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.ticks.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.ticks.is_empty()
    }

    /// Whether each tick has measured torques: these are used then.
    #[must_use]
    pub fn is_measured(&self) -> bool {
        !self.ticks.is_empty() && self.ticks.iter().all(|tick| tick.measured.is_some())
    }

    /// The ticks about the one at `middle`, `half` and one more to each side; `None` where one is missing.
    pub(super) fn around(&self, middle: usize, half: usize) -> Option<&[LoadTick<N>]> {
        let first = middle.checked_sub(half + 1)?;
        let ticks = self.ticks.get(first..=middle + half + 1)?;
        let follows = |pair: &[LoadTick<N>]| match pair {
            [a, b] => (((b.stamp - a.stamp).0 - TICK.0) as f64).abs() < STAMP_SHARE * TICK.0 as f64,
            _ => false,
        };
        ticks.windows(2).all(follows).then_some(ticks)
    }
}
