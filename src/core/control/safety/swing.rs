//! Oscillation of a joint about its reference, which no sum of distances shows.
//!
//! The velocity by which a joint differs from its reference is the mean over [`SPAN`] ticks of measured positions, so that quantized and noisy encoders do not look
//! like a swing. A half swing is a change of its sign with [`AMPLITUDE`] on both sides; [`HALVES`] of them within [`WITHIN`] are a fault. Faster swings than 50 Hz are
//! averaged out; drives and gears damp them. A single state that is off, as by a spike of an encoder, is none either: of three states the middle one counts.
//!
//! Of a drive that is slower than control the ticks between two states have errors between theirs: a position that stays the same for some ticks and then leaps is no swing.

use nalgebra::SVector;

/// Ticks over which velocities are averaged: with encoder noise of 5e-4 rad the standard deviation of a mean velocity is 0.07 rad/s. Chosen by hand: the double would halve swings of 25 Hz.
const SPAN: usize = 10;
/// Velocity error of a half swing, rad/s or m/s: seven deviations of that noise, and a fifth of the smallest velocity limit of the shipped arms. Chosen by hand between
/// what friction and an untold payload make of a healthy start and a wrist that oscillates at 2.6 rad/s.
const AMPLITUDE: f64 = 0.5;
/// Half swings that are a fault: four whole swings. Chosen by hand: a lag that is corrected swings once or twice.
const HALVES: usize = 8;
/// Ticks within which they have to come: swings of 8 Hz and faster. Chosen above the 6.4 Hz of the joint controller (`motion.natural_frequency_rad_s` = 40).
const WITHIN: u64 = 500;

/// Watches the joints for swings about their reference.
#[derive(Debug, Clone)]
pub(super) struct SwingWatch<const N: usize> {
    /// Displacement of the reference, rad or m.
    gone: SVector<f64, N>,
    /// Positions less those of the reference, the oldest at `next`, rad or m.
    error: [SVector<f64, N>; SPAN],
    next: usize,
    /// The errors of the two states before.
    before: [SVector<f64, N>; 2],
    /// The middle error of the last new state, and the ticks since then.
    last: SVector<f64, N>,
    without: u32,
    /// Ticks since the last restart.
    ticks: u64,
    joints: [HalfSwings; N],
}

/// The half swings of one joint.
#[derive(Debug, Clone, Copy)]
struct HalfSwings {
    /// Sign of the last one.
    sign: f64,
    /// When the last ones began, the oldest at `next`; none before the first.
    times: [Option<u64>; HALVES],
    next: usize,
}

impl<const N: usize> Default for SwingWatch<N> {
    fn default() -> Self {
        let joint = HalfSwings { sign: 0.0, times: [None; HALVES], next: 0 };
        Self {
            gone: SVector::zeros(),
            error: [SVector::zeros(); SPAN],
            next: 0,
            before: [SVector::zeros(); 2],
            last: SVector::zeros(),
            without: 0,
            ticks: 0,
            joints: [joint; N],
        }
    }
}

impl<const N: usize> SwingWatch<N> {
    /// Takes in the joint positions of this tick, which may be those of the tick before (`is_old`), and the displacement of their reference in it, rad or m; whether a joint swings.
    pub(super) fn note(&mut self, q: &SVector<f64, N>, way: &SVector<f64, N>, is_old: bool) -> bool {
        let error = q - self.gone;
        self.gone += way;
        if is_old {
            self.without += 1;
            return false;
        }
        let [a, b] = if self.ticks == 0 { [error; 2] } else { self.before };
        self.before = [b, error];
        let error = SVector::from_fn(|i, _| a[i].max(b[i]).min(a[i].min(b[i]).max(error[i])));
        let ticks = std::mem::take(&mut self.without) + 1;
        let last = std::mem::replace(&mut self.last, error);
        let from = if self.ticks == 0 { error } else { last };
        let at = |k: u32| from + (error - from) * (f64::from(k) / f64::from(ticks));
        let mut swings = false;
        for k in 1..=ticks {
            swings |= self.note_error(at(k));
        }
        swings
    }

    fn note_error(&mut self, error: SVector<f64, N>) -> bool {
        let Some(place) = self.error.get_mut(self.next) else { return false };
        let oldest = std::mem::replace(place, error);
        self.next = (self.next + 1) % SPAN;
        self.ticks += 1;
        if self.ticks <= SPAN as u64 {
            return false;
        }
        let velocity = (error - oldest) / (SPAN as f64 * crate::time::TICK.as_s());
        let mut swings = false;
        for (joint, v) in self.joints.iter_mut().zip(velocity.iter()) {
            if v.abs() < AMPLITUDE || v.signum() == joint.sign {
                continue;
            }
            joint.sign = v.signum();
            let first = joint.times.get_mut(joint.next).and_then(|time| time.replace(self.ticks));
            joint.next = (joint.next + 1) % HALVES;
            swings |= first.is_some_and(|first| self.ticks - first <= WITHIN);
        }
        swings
    }

    /// The reference was reset, or states arrive late: what came before does not count.
    pub(super) fn restart(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::Random;
    use nalgebra::Vector2;

    /// The tick at which the error of `joint(k)` is told as a swing.
    fn told(ticks: u32, mut joint: impl FnMut(f64) -> f64) -> Option<u32> {
        let mut watch = SwingWatch::<2>::default();
        (0..ticks)
            .find(|k| watch.note(&Vector2::new(0.0, joint(f64::from(*k) * 1e-3)), &Vector2::zeros(), false))
    }

    #[test]
    fn a_wrist_that_swings_is_told_within_half_a_second() {
        for (hz, speed) in [(9.0, 1.0), (12.0, 2.6), (25.0, 1.0), (40.0, 2.6)] {
            let omega = 2.0 * std::f64::consts::PI * hz;
            let at = told(2000, |t| speed / omega * (omega * t).sin()).unwrap_or(u32::MAX);
            assert!(at <= 520, "{hz} Hz at {speed} rad/s: {at}");
        }
    }

    #[test]
    fn what_dies_away_and_what_noise_does_is_no_swing() {
        let omega = 2.0 * std::f64::consts::PI * 12.0;
        assert_eq!(told(2000, |t| 2.6 / omega * (omega * t).sin() * (-12.0 * t).exp()), None);
        assert_eq!(told(2000, |t| 0.4 / omega * (omega * t).sin()), None, "below the amplitude");
        let mut random = Random::new(3);
        assert_eq!(told(60_000, |_| 5e-4 * random.gaussian()), None);
        assert_eq!(told(60_000, |_| if random.uniform() < 0.02 { 0.02 } else { 0.0 }), None, "spikes");
        assert_eq!(told(60_000, |t| ((0.3 * t).sin() / 5e-4).round() * 5e-4 - (0.3 * t).sin()), None);
    }
}
