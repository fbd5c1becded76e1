//! What a disturbance was a second and more ago.

use nalgebra::SVector;

/// Ticks over which the mean of a disturbance is taken. It must be longer than the detection of a blocked or oscillating arm takes, so
/// that the mean before it is still good: a joint that does not follow is reported within 0.6 s (tested in `control/safety/arm.rs`).
const MEAN_TICKS: u32 = 1000;
/// Means of the disturbance over consecutive seconds, as accelerations and as torques.
#[derive(Debug, Clone)]
pub(super) struct Past<const N: usize> {
    /// Over the second before the last complete one: one to three seconds ago.
    pub(super) before: (SVector<f64, N>, SVector<f64, N>),
    pub(super) last: (SVector<f64, N>, SVector<f64, N>),
    sum: (SVector<f64, N>, SVector<f64, N>),
    ticks: u32,
}

impl<const N: usize> Default for Past<N> {
    fn default() -> Self {
        let zero = (SVector::zeros(), SVector::zeros());
        Self { before: zero, last: zero, sum: zero, ticks: 0 }
    }
}

impl<const N: usize> Past<N> {
    /// These means, and nothing since.
    pub(super) fn of(
        before: (SVector<f64, N>, SVector<f64, N>),
        last: (SVector<f64, N>, SVector<f64, N>),
    ) -> Self {
        Self { before, last, ..Self::default() }
    }

    /// Takes in the disturbance of a tick.
    pub(super) fn note(&mut self, p: &SVector<f64, N>, t: &SVector<f64, N>) {
        self.sum.0 += p;
        self.sum.1 += t;
        self.ticks += 1;
        if self.ticks == MEAN_TICKS {
            let share = 1.0 / f64::from(MEAN_TICKS);
            self.before = self.last;
            self.last = (self.sum.0 * share, self.sum.1 * share);
            self.sum = (SVector::zeros(), SVector::zeros());
            self.ticks = 0;
        }
    }
}
