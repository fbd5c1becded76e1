//! Positions, their derivatives and torques at one instant, all seen through the same smoothing kernel: what it takes from one side of the
//! equations of motion it takes from the other.
//!
//! ```text
//! F[x](t) = sum_k w_k x(t + k T),    w_k ~ cos^4(pi k / (2 (H + 1))),    F[x'] = sum_k -w'_k x(t + k T),    F[x''] = sum_k w''_k x(t + k T)
//! ```

use super::recording::LoadTick;
use crate::time::TICK;
use nalgebra::SVector;

/// H: ticks of the kernel to each side. Chosen by hand: 30 ms, short against motions of seconds, and long enough that encoders with steps of 0.1 mrad tell
/// accelerations to 0.1 rad/s^2.
pub(super) const HALF: usize = 30;
/// Its length.
const LENGTH: usize = 2 * HALF + 1;

/// The kernel with its derivatives.
#[derive(Debug, Clone)]
pub(super) struct SmoothingKernel {
    /// Weights, in 1, 1/s and 1/s^2.
    weights: [[f64; LENGTH]; 3],
}

/// The smoothed state of `N` joints at one instant.
#[derive(Debug, Clone, Copy)]
pub(super) struct SmoothState<const N: usize> {
    pub(super) q: SVector<f64, N>,
    pub(super) qd: SVector<f64, N>,
    pub(super) qdd: SVector<f64, N>,
    pub(super) tau: SVector<f64, N>,
    /// Mean velocities of the halves before and after.
    pub(super) before: SVector<f64, N>,
    pub(super) after: SVector<f64, N>,
}

fn place(k: usize) -> f64 {
    k as f64 - HALF as f64
}

impl SmoothingKernel {
    pub(super) fn new() -> Self {
        let angle = |k: usize| std::f64::consts::FRAC_PI_2 * place(k) / (HALF as f64 + 1.0);
        let mut value: [f64; LENGTH] = std::array::from_fn(|k| angle(k).cos().powi(4));
        let mut slope: [f64; LENGTH] = std::array::from_fn(|k| angle(k).cos().powi(3) * angle(k).sin());
        // (cos^4)'' = 12 cos^2 sin^2 - 4 cos^4
        let mut bend: [f64; LENGTH] = std::array::from_fn(|k| {
            let (sin, cos) = angle(k).sin_cos();
            12.0 * cos * cos * sin * sin - 4.0 * cos.powi(4)
        });
        let sum = |w: &[f64; LENGTH], power: i32| {
            w.iter().enumerate().map(|(k, w)| w * (place(k) * TICK.as_s()).powi(power)).sum::<f64>()
        };
        // As sums and not as integrals: a constant has no slope, a line none but its own, and a parabola its own bend.
        let (total, level) = (sum(&value, 0), sum(&bend, 0));
        for (bend, value) in bend.iter_mut().zip(&value) {
            *bend -= value * level / total;
        }
        let (rise, curve) = (sum(&slope, 1), sum(&bend, 2) / 2.0);
        value.iter_mut().for_each(|w| *w /= total);
        slope.iter_mut().for_each(|w| *w /= rise);
        bend.iter_mut().for_each(|w| *w /= curve);
        Self { weights: [value, slope, bend] }
    }

    /// The state in the middle of `ticks`, which are [`HALF`] and one more to each side; with the torques as they were `measured`, or commanded.
    pub(super) fn at<const N: usize>(&self, ticks: &[LoadTick<N>], measured: bool) -> Option<SmoothState<N>> {
        let (first, inner) = (ticks.first()?, ticks.get(1..=LENGTH)?);
        let last = ticks.get(LENGTH + 1)?;
        let middle = inner.get(HALF)?.q;
        let mut sums = [SVector::<f64, N>::zeros(); 4];
        for (k, tick) in inner.iter().enumerate() {
            let off = tick.q - middle;
            for (sum, weights) in sums.iter_mut().zip(&self.weights) {
                *sum += off * weights[k];
            }
            // A command acts up to the stamp that it stands with: the torque at a stamp is the mean of that and of the next one.
            let tau = match tick.measured.filter(|_| measured) {
                Some(tau) => tau,
                None => (tick.commanded + ticks.get(k + 2)?.commanded) * 0.5,
            };
            sums[3] += tau * self.weights[0][k];
        }
        let half_s = (HALF as f64 + 1.0) * TICK.as_s();
        Some(SmoothState {
            q: middle + sums[0],
            qd: sums[1],
            qdd: sums[2],
            tau: sums[3],
            before: (middle - first.q) / half_s,
            after: (last.q - middle) / half_s,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::load::LoadRecording;
    use crate::time::MonoNs;
    use nalgebra::Vector1;

    /// The kernel takes the same share of a wave from position, velocity and acceleration.
    #[test]
    fn derivatives_are_those_of_what_is_smoothed() {
        for rad_s in [0.0, 3.0, 30.0] {
            let wave = |ms: f64| 0.3 + (rad_s * ms * 1e-3 + 0.4).sin();
            let mut recording = LoadRecording::<1>::default();
            (0..200).for_each(|ms| {
                let tau = Vector1::new(wave(f64::from(ms) - 0.5));
                recording.push(MonoNs(i64::from(ms) * TICK.0), Vector1::new(wave(f64::from(ms))), tau, None);
            });
            let state = SmoothingKernel::new().at(recording.around(100, HALF).unwrap(), false).unwrap();
            let share = (state.q[0] - 0.3) / (wave(100.0) - 0.3);
            let cos = (rad_s * 0.1 + 0.4).cos();
            assert!((0.8..=1.0 + 1e-9).contains(&share), "{share}");
            assert!((state.qd[0] - share * rad_s * cos).abs() < 1e-3 * (1.0 + rad_s), "{}", state.qd[0]);
            let bend = -share * rad_s * rad_s * (wave(100.0) - 0.3);
            assert!((state.qdd[0] - bend).abs() < 1e-2 * (1.0 + rad_s), "{} {bend}", state.qdd[0]);
            assert!((state.tau[0] - state.q[0]).abs() < 1e-3, "torques have no lag");
        }
    }

    #[test]
    fn missing_ticks_are_noticed() {
        let mut recording = LoadRecording::<1>::default();
        (0..300).filter(|ms| *ms != 150).for_each(|ms| {
            recording.push(MonoNs(ms * TICK.0), Vector1::zeros(), Vector1::zeros(), None);
        });
        assert!(recording.around(100, HALF).is_some());
        assert!(recording.around(140, HALF).is_none() && recording.around(10, HALF).is_none());
        assert!(!recording.is_measured());
    }
}
