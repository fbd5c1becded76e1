//! Steps of encoders that nobody told, found in the readings: a reading that was held and then changes, changes by one step when its joint is slow.

use nalgebra::SVector;

/// Readings for which a reading must have been held before its change counts. Measured (`tests/cores/everything_at_once.rs`): with four, steps are found later, and as many arms come home to 2 %. Drives that
/// repeat each state are no matter: their first changes, from rest, are the smallest, and do not come again.
const HELD: u32 = 1;
/// Changes of the same, smallest size that make a step. Chosen by hand: first motions of an exact joint that sticks differ from one another by more than [`SAME`].
const CHANGES: u32 = 4;
/// Relative difference of two changes that are the same. Chosen by hand: makers' calibrations stretch steps by less.
const SAME: f64 = 0.01;
/// Largest change that is taken for a step, rad or m. Chosen by hand: twice the coarsest encoders that are tested; more is a motion whose states come seldom.
const MOST: f64 = 2e-3;

/// The steps of `N` encoders.
#[derive(Debug, Clone)]
pub(super) struct FoundSteps<const N: usize> {
    last: SVector<f64, N>,
    held: [u32; N],
    /// The smallest change of a held reading, rad or m, and how often it came.
    smallest: SVector<f64, N>,
    times: [u32; N],
}

impl<const N: usize> Default for FoundSteps<N> {
    fn default() -> Self {
        Self {
            last: SVector::repeat(f64::NAN),
            held: [0; N],
            smallest: SVector::repeat(f64::INFINITY),
            times: [0; N],
        }
    }
}

impl<const N: usize> FoundSteps<N> {
    /// Takes in the readings of a tick, rad or m, and writes into `steps` those of the joints for which none is `told`: 0 where none is found.
    pub(super) fn note(&mut self, q: &SVector<f64, N>, told: &SVector<f64, N>, steps: &mut SVector<f64, N>) {
        for i in 0..N {
            let change = (q[i] - self.last[i]).abs();
            self.last[i] = q[i];
            if change == 0.0 {
                self.held[i] = self.held[i].saturating_add(1);
                continue;
            }
            if std::mem::take(&mut self.held[i]) < HELD || told[i] > 0.0 || change > MOST {
                continue;
            }
            if change < self.smallest[i] * (1.0 - SAME) {
                (self.smallest[i], self.times[i]) = (change, 0);
            }
            if change < self.smallest[i] * (1.0 + SAME) {
                self.times[i] = self.times[i].saturating_add(1);
            }
            steps[i] = if self.times[i] >= CHANGES { self.smallest[i] } else { 0.0 };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector1;

    /// What is found of a joint that goes to and fro, read every `period` ticks, after rounding to `step`.
    fn found(step: f64, period: u32) -> f64 {
        let (mut finder, mut steps) = (FoundSteps::<1>::default(), Vector1::zeros());
        let mut q = 0.0;
        for k in 0..4000_u32 {
            if k % period == 0 {
                q = 1e-2 * (1.0 - (f64::from(k) * 1.57e-3).cos());
            }
            let read = if step > 0.0 { (q / step).round() * step } else { q };
            finder.note(&Vector1::new(read), &Vector1::zeros(), &mut steps);
        }
        steps[0]
    }

    #[test]
    fn steps_are_found_as_they_are() {
        for step in [3e-6, 1e-5, 1e-4, 7e-4] {
            assert!((found(step, 1) / step - 1.0).abs() < 0.01, "{step}: {}", found(step, 1));
        }
    }

    #[test]
    fn even_leaps_of_a_joint_that_moves_are_no_steps() {
        let (mut finder, mut steps) = (FoundSteps::<1>::default(), Vector1::zeros());
        for k in 0..100_u32 {
            finder.note(&Vector1::new(f64::from(k / 2) * 5e-3), &Vector1::zeros(), &mut steps);
            assert_eq!(steps[0], 0.0);
        }
    }

    #[test]
    fn exact_readings_and_slow_drives_have_none() {
        for period in [1, 2, 4, 8] {
            assert_eq!(found(0.0, period), 0.0, "every {period} ms");
        }
    }
}
