//! What a model leaves out of a joint's residual, learnt while the joint moves: recursive least squares with a prior, and the variance of what is left.
//!
//! ```text
//! r = x . theta + excess + noise      theta: what was learnt so far, covariance P; the prior states how wrong models are
//! var(excess) = x^T P x + noise       so bounds are wide at first and become narrow as the run learns what its arm is like
//! ```
//! What comes from outside must not be learnt as a property of the arm: a residual beyond [`DOUBTED`] standard deviations changes the variance only, and a sample is learnt
//! from only when [`HELD_BACK`] further ones have shown nothing.

use nalgebra::{SMatrix, SVector};

/// Standard deviations beyond which a residual is not learnt from. Chosen by hand: of noise alone it is one in 370.
const DOUBTED: f64 = 3.0;
/// Samples that are held back. Chosen by hand: six of 8 ms are 48 ms, in which a contact that begins gently is noticed before it is learnt.
const HELD_BACK: usize = 6;
/// Ticks from one sample of a joint to the next, one joint after the other. Derived: the time constant of the observer of torques, after which its noise is new; arms have at most as many joints.
pub(super) const LEARNS_EVERY: u32 = 8;

/// Whether joint `i` learns at the end of `ticks` that follow `before` others: of several ticks from state to state several joints do.
pub(super) fn is_turn(i: usize, before: u32, ticks: u32) -> bool {
    let ahead = (i as u32 + LEARNS_EVERY - before % LEARNS_EVERY) % LEARNS_EVERY;
    ahead < ticks
}

/// Share of a new square in the variance of the noise: a memory of 50 updates. Chosen by hand.
const FORGET: f64 = 0.02;

/// The residual of one joint, with `T` terms.
#[derive(Debug, Clone)]
pub(super) struct ResidualModel<const T: usize> {
    theta: SVector<f64, T>,
    P: SMatrix<f64, T, T>,
    /// Variance of the noise.
    noise: f64,
    /// Share of the best gain with which all but the first term is learnt.
    patient: f64,
    /// The last samples, the oldest at `next`.
    held_back: [Option<ResidualSample<T>>; HELD_BACK],
    next: usize,
}

/// A residual with its terms.
#[derive(Debug, Clone, Copy)]
struct ResidualSample<const T: usize> {
    r: f64,
    x: SVector<f64, T>,
    /// Variance beside those of terms and noise, the least variance of the noise, and by how much the first term may have changed before, as a variance.
    doubt: f64,
    least: f64,
    drift: f64,
}

impl<const T: usize> ResidualModel<T> {
    /// Nothing is learnt yet: `theta` has the standard deviations `sd`, the noise the variance `noise`. All but the first term is learnt with the share `patient` of
    /// the best gain.
    pub(super) fn new(theta: SVector<f64, T>, sd: &SVector<f64, T>, noise: f64, patient: f64) -> Self {
        Self {
            theta,
            P: SMatrix::from_diagonal(&sd.component_mul(sd)),
            noise,
            patient,
            held_back: [None; HELD_BACK],
            next: 0,
        }
    }

    /// What the terms `x` leave of the residual `r`, and its variance.
    pub(super) fn excess(&self, r: f64, x: &SVector<f64, T>) -> (f64, f64) {
        (r - x.dot(&self.theta), (self.P * x).dot(x) + self.noise + self.drifted())
    }

    /// The noise has at least the variance `least`.
    pub(super) fn doubt(&mut self, least: f64) {
        self.noise = self.noise.max(least);
    }

    /// What was learnt of the term `k`.
    pub(super) fn learnt(&self, k: usize) -> f64 {
        self.theta.get(k).copied().unwrap_or(0.0)
    }

    /// By how much the first term may have changed since the last sample that was learnt from.
    fn drifted(&self) -> f64 {
        self.held_back.iter().flatten().map(|sample| sample.drift).sum()
    }

    /// The first term has changed by something with the variance `change`: samples of before say nothing of it.
    pub(super) fn change(&mut self, change: f64) {
        let drifted = self.drifted();
        if let Some(variance) = self.P.get_mut(0) {
            *variance += change + drifted;
        }
        self.held_back = [None; HELD_BACK];
    }

    /// The residuals contain `change` times the term `k` more, from the first one on.
    pub(super) fn shift(&mut self, k: usize, change: f64) {
        if let Some(learnt) = self.theta.get_mut(k) {
            *learnt += change;
        }
        for sample in self.held_back.iter_mut().flatten() {
            sample.r += change * sample.x.get(k).copied().unwrap_or(0.0);
        }
    }

    /// Takes in the residual `r` with the terms `x`, and learns from an earlier one. `doubt` is a variance beside those of terms and noise, the noise has at least the
    /// variance `least`, and the first term may have changed since the last sample by something with the variance `drift`.
    pub(super) fn take(&mut self, r: f64, x: &SVector<f64, T>, doubt: f64, least: f64, drift: f64) {
        let sample = ResidualSample { r, x: *x, doubt, least, drift };
        let oldest = self.held_back.get_mut(self.next).and_then(|place| place.replace(sample));
        self.next = (self.next + 1) % HELD_BACK;
        if let Some(oldest) = oldest {
            self.learn(&oldest);
        }
    }

    fn learn(&mut self, sample: &ResidualSample<T>) {
        let ResidualSample { r, x, doubt, least, drift } = *sample;
        if let Some(variance) = self.P.get_mut(0) {
            *variance += drift;
        }
        let Px = self.P * x;
        let excess = r - x.dot(&self.theta);
        let variance = Px.dot(&x) + self.noise + doubt;
        if !(excess.is_finite() && variance.is_finite() && variance > 0.0) {
            return;
        }
        let square = excess * excess;
        if square < DOUBTED * DOUBTED * variance {
            let mut gain = Px / variance;
            gain.iter_mut().skip(1).for_each(|gain| *gain *= self.patient);
            // Joseph's form, which holds for every gain.
            let rest = SMatrix::identity() - gain * x.transpose();
            self.theta += gain * excess;
            self.P = rest * self.P * rest.transpose() + gain * gain.transpose() * (variance - Px.dot(&x));
        }
        let sample = square.min(DOUBTED * DOUBTED * self.noise);
        self.noise = (self.noise + FORGET * (sample - self.noise)).max(least);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::Random;
    use nalgebra::Vector2;

    /// The stated variance is that of the error, on draws from the prior, from the first sample on.
    #[test]
    fn the_stated_variance_is_that_of_the_error() {
        let mut random = Random::new(11);
        let sd = Vector2::new(2.0, 0.5);
        let (mut early, mut late) = (0.0, 0.0);
        for _ in 0..400 {
            let truth = Vector2::new(sd[0] * random.gaussian(), sd[1] * random.gaussian());
            let mut model = ResidualModel::new(Vector2::zeros(), &sd, 0.01, 0.3);
            for k in 0..200 {
                let x = Vector2::new(1.0, random.between(-3.0, 3.0));
                let r = x.dot(&truth) + 0.1 * random.gaussian();
                let (excess, variance) = model.excess(r, &x);
                *(if k < 10 { &mut early } else { &mut late }) += excess * excess / variance;
                model.take(r, &x, 0.0, 1e-6, 0.0);
            }
        }
        let (early, late) = (early / 4000.0, late / (400.0 * 190.0));
        // A gain below the best one learns later, and says so.
        assert!((0.7..1.2).contains(&early) && (0.7..1.2).contains(&late), "{early} {late}");
    }

    #[test]
    fn a_touch_is_not_learnt_as_a_property_of_the_arm() {
        let mut random = Random::new(5);
        let mut model = ResidualModel::new(Vector2::zeros(), &Vector2::new(1.0, 1.0), 0.01, 0.3);
        let x = |k: i32| Vector2::new(1.0, (f64::from(k) * 0.1).sin());
        for k in 0..200 {
            model.take(0.1 * random.gaussian(), &x(k), 0.0, 1e-6, 0.0);
        }
        for k in 0..10 {
            model.take(5.0, &x(k), 0.0, 1e-6, 0.0);
        }
        let (excess, variance) = model.excess(5.0, &x(3));
        assert!(excess > 4.9 && excess > 6.0 * variance.sqrt(), "{excess} {variance}");
    }
}
