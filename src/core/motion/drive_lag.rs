//! How far a drive that closes its own loop stays behind its commands, and what of that is not its own way of doing so: what its joints meet.
//!
//! Torques are not known there. In the modes velocity and position
//!
//! ```text
//! l = int (qd_r - qd), forgetting over half a second      or  l = q_r - q
//! l = T qd_r + S qdd_r + excess + noise                   a drive with the delay T has S = -T^2/2, one that lags S = -T^2
//! ```
//! `T` and `S` are [learnt](super::residual_model) for each joint, like the noise. A joint that something stops falls behind by more than that at once.

use super::residual_model::{LEARNS_EVERY, ResidualModel, is_turn};
use crate::time::TICK;
use nalgebra::{SVector, Vector3};

/// Time over which a lag of velocities is forgotten, s. Chosen by hand: a drive whose velocities are some percent off comes to no sum, and a joint that something
/// stops falls behind for far less than that.
const FORGET_S: f64 = 0.5;
/// Standard deviation of the delay of a drive, s, and of its square. Chosen by hand: drives in cyclic modes interpolate over up to 8 ms and close loops of some Hertz.
const DELAY_S: f64 = 0.02;
/// Standard deviation of a lag without any reason at the start, and the least that is ever believed, rad or m. Chosen by hand: friction that a drive
/// takes up in its first motion, and a tenth of the millimetre that a robot repeats to.
const NOISE: f64 = 1e-3;
/// Lag that a drive takes up by itself under a load that its maker does not know, rad or m, beside the noise. Chosen by hand: with none of it 10 of 16 runs of Panda and xArm7 in the modes
/// velocity and position, with payloads of 1 or 2 kg, coarse encoders and late commands, were stopped by nothing; with this none.
const TAKES_UP: f64 = 0.02;
/// The least of it. Chosen by hand, as told there.
const LEAST_NOISE: f64 = 4e-4;
/// Variance by which a constant lag may change in a second, rad^2 or m^2. Chosen by hand: friction that changes within some seconds.
const DRIFT_1_S: f64 = 1e-7;

/// The observer of the lags of `N` joints.
#[derive(Debug, Clone)]
pub struct DriveLagObserver<const N: usize> {
    joints: [JointLag; N],
    /// Steps of the encoders, rad or m.
    step: SVector<f64, N>,
    /// The commanded velocity of the last tick, rad/s or m/s.
    last: Option<SVector<f64, N>>,
    ticks: u32,
}

/// The lag of one joint.
#[derive(Debug, Clone)]
struct JointLag {
    model: ResidualModel<3>,
    lag: f64,
    excess: f64,
    variance: f64,
}

impl<const N: usize> DriveLagObserver<N> {
    /// An observer of a drive of which nothing is learnt yet, with encoders of these steps, rad or m.
    #[must_use]
    pub fn new(step: SVector<f64, N>) -> Self {
        let sd = Vector3::new(NOISE, DELAY_S, DELAY_S * DELAY_S);
        let joint = |_| JointLag {
            model: ResidualModel::new(Vector3::zeros(), &sd, NOISE * NOISE, 1.0),
            lag: 0.0,
            excess: 0.0,
            variance: NOISE * NOISE,
        };
        Self { joints: std::array::from_fn(joint), step, last: None, ticks: 0 }
    }

    /// Takes in `ticks` in which the joints were commanded to move with `qd_r` in the mean and moved by `moved` (rad/s or m/s, rad or m); `lag` is by how much they are behind their
    /// commanded positions, `None` for a drive that obeys velocities.
    pub fn note(
        &mut self,
        (qd_r, ticks): (&SVector<f64, N>, u32),
        moved: &SVector<f64, N>,
        lag: Option<&SVector<f64, N>>,
    ) {
        let h = TICK.as_s() * f64::from(ticks);
        let before = self.last.replace(*qd_r).unwrap_or(*qd_r);
        for (i, joint) in self.joints.iter_mut().enumerate() {
            joint.lag =
                lag.map_or_else(|| joint.lag * (1.0 - h / FORGET_S) + qd_r[i] * h - moved[i], |lag| lag[i]);
            let x = Vector3::new(1.0, qd_r[i], (qd_r[i] - before[i]) / h);
            // Two readings are off by a step each, and noise comes beside it.
            let step = 4.0 * self.step[i] * self.step[i];
            let (excess, variance) = joint.model.excess(joint.lag, &x);
            (joint.excess, joint.variance) = (excess, variance + step);
            if is_turn(i, self.ticks, ticks) {
                let drift = DRIFT_1_S * TICK.as_s() * f64::from(LEARNS_EVERY);
                joint.model.take(joint.lag, &x, step, LEAST_NOISE * LEAST_NOISE, drift);
            }
        }
        self.ticks = self.ticks.wrapping_add(ticks);
    }

    /// By how much each joint is behind beyond what its drive does by itself, rad or m.
    #[must_use]
    pub fn lag(&self) -> SVector<f64, N> {
        SVector::from_fn(|i, _| self.joints[i].excess)
    }

    /// By how many standard deviations that is more than what a drive takes up under a load.
    #[must_use]
    pub fn excess(&self) -> SVector<f64, N> {
        SVector::from_fn(|i, _| {
            let joint = &self.joints[i];
            (joint.excess.abs() - TAKES_UP).max(0.0) / joint.variance.sqrt()
        })
    }

    /// Begins anew with what was learnt: commands and arm were brought together.
    pub fn restart(&mut self) {
        self.joints.iter_mut().for_each(|joint| joint.lag = 0.0);
        self.last = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::Random;
    use nalgebra::Vector1;

    /// Commands that go to and fro for `ticks`, obeyed `delay` ticks late with a lag of `tau_s`, and stopped from `stop` on; when that is told.
    fn told(delay: usize, tau_s: f64, scale: f64, stop: usize, by_position: bool) -> Option<usize> {
        let mut observer = DriveLagObserver::<1>::new(Vector1::new(1e-5));
        let mut random = Random::new(7);
        let command = |k: usize| 0.4 * (k as f64 * 4e-3).sin();
        let (mut q, mut qd, mut q_r) = (0.0, 0.0, 0.0);
        for k in 0..3000_usize {
            let late = k.checked_sub(delay).map_or(0.0, command);
            qd += (scale * late - qd) * (1e-3 / tau_s).min(1.0);
            let moved = if k >= stop { 0.0 } else { qd * 1e-3 + 1e-5 * random.gaussian() };
            (q, q_r) = (q + moved, q_r + command(k) * 1e-3);
            let lag = Vector1::new(q_r - q);
            observer.note((&Vector1::new(command(k)), 1), &Vector1::new(moved), by_position.then_some(&lag));
            if observer.excess()[0] > 6.0 {
                return Some(k);
            }
        }
        None
    }

    #[test]
    fn a_stopped_joint_is_told_and_a_drive_of_its_own_kind_is_not() {
        for by_position in [false, true] {
            for (delay, tau_s) in [(0, 1e-3), (1, 5e-3), (5, 1e-2), (8, 3e-2)] {
                assert_eq!(told(delay, tau_s, 1.0, usize::MAX, by_position), None, "{delay} {tau_s}");
                let stop = 2000;
                let at = told(delay, tau_s, 1.0, stop, by_position).unwrap();
                assert!((stop..stop + 200).contains(&at), "{delay} {tau_s}: {at}");
            }
        }
        assert_eq!(told(1, 5e-3, 0.97, usize::MAX, false), None, "velocities that are 3 % short");
    }
}
