//! Model of a joint's encoder: quantization, noise, and a velocity that is only the filtered
//! difference of positions. All noise comes from the seed.

use crate::linalg::Random;
use nalgebra::SVector;
use std::f64::consts::TAU;

/// Imperfections of the encoders.
#[derive(Debug, Clone, PartialEq)]
pub struct EncoderModel<const N: usize> {
    /// Step of each encoder, rad or m; 0 has none.
    pub step: SVector<f64, N>,
    /// Standard deviation of the noise of each reading before it is rounded to steps, rad or m.
    pub noise_sd: SVector<f64, N>,
    /// Cut-off of the low-pass behind the difference of positions, Hz.
    pub velocity_filter_hz: f64,
    /// Seed of the noise.
    pub seed: u64,
}

impl<const N: usize> EncoderModel<N> {
    /// Exact positions and velocities.
    #[must_use]
    pub fn exact() -> Self {
        Self { step: SVector::zeros(), noise_sd: SVector::zeros(), velocity_filter_hz: 100.0, seed: 0 }
    }

    fn is_exact(&self) -> bool {
        self.step.amax() == 0.0 && self.noise_sd.amax() == 0.0
    }
}

/// The encoders of an arm.
#[derive(Debug, Clone)]
pub(super) struct Encoder<const N: usize> {
    model: EncoderModel<N>,
    exact: bool,
    random: Random,
    reading: Option<(SVector<f64, N>, SVector<f64, N>)>,
}

impl<const N: usize> Encoder<N> {
    pub(super) fn new(model: EncoderModel<N>) -> Self {
        let (exact, random) = (model.is_exact(), Random::new(model.seed));
        Self { model, exact, random, reading: None }
    }

    /// Reads positions and velocities, `dt_s` after the reading before; at the same time, the same reading again.
    pub(super) fn read(
        &mut self,
        q: &SVector<f64, N>,
        qd: &SVector<f64, N>,
        dt_s: f64,
    ) -> (SVector<f64, N>, SVector<f64, N>) {
        if self.exact {
            return (*q, *qd);
        }
        if let Some(reading) = self.reading
            && dt_s <= 0.0
        {
            return reading;
        }
        let mut seen = *q;
        for i in 0..N {
            seen[i] += self.model.noise_sd[i] * self.random.gaussian();
            let step = self.model.step[i];
            if step > 0.0 {
                seen[i] = (seen[i] / step).round() * step;
            }
        }
        let velocity = match &self.reading {
            None => *qd,
            Some((before, velocity)) => {
                let share = dt_s / (dt_s + 1.0 / (TAU * self.model.velocity_filter_hz));
                velocity + ((seen - before) / dt_s - velocity) * share
            }
        };
        self.reading = Some((seen, velocity));
        (seen, velocity)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;

    fn model() -> EncoderModel<2> {
        EncoderModel {
            step: Vector2::new(1e-3, 0.0),
            noise_sd: Vector2::new(0.0, 1e-4),
            velocity_filter_hz: 50.0,
            seed: 3,
        }
    }

    #[test]
    fn steps_are_steps_and_noise_has_its_size() {
        let mut e = Encoder::new(model());
        let q = Vector2::new(0.123_46, -0.5);
        let (mut sum, mut squares) = (0.0, 0.0);
        for _ in 0..20_000 {
            let (seen, _) = e.read(&q, &Vector2::zeros(), 1e-3);
            assert!((seen[0] - 0.123).abs() < 1e-12);
            let noise = seen[1] - q[1];
            sum += noise;
            squares += noise * noise;
        }
        assert!((sum / 20_000.0).abs() < 3e-6, "{sum}");
        assert!(((squares / 20_000.0).sqrt() - 1e-4).abs() < 2e-6);
    }

    #[test]
    fn velocity_settles_on_the_true_one() {
        let mut e = Encoder::new(model());
        let qd = Vector2::new(0.4, -0.3);
        let mut seen = Vector2::zeros();
        let mut mean = Vector2::zeros();
        for k in 0..2000 {
            let t = f64::from(k) * 1e-3;
            (_, seen) = e.read(&(qd * t), &qd, 1e-3);
            mean += seen / 2000.0;
        }
        assert!((seen - qd).amax() < 0.2, "{seen}");
        assert!((mean - qd).amax() < 2e-4, "{mean}"); // the noise of one reading is 0.1
    }

    #[test]
    fn a_seed_repeats_and_an_exact_encoder_reads_the_truth() {
        let (q, qd) = (Vector2::new(0.2, 0.3), Vector2::new(1.0, 2.0));
        let (mut a, mut b) = (Encoder::new(model()), Encoder::new(model()));
        let mut c = Encoder::new(EncoderModel { seed: 4, ..model() });
        let (ra, rb, rc) = (a.read(&q, &qd, 1e-3), b.read(&q, &qd, 1e-3), c.read(&q, &qd, 1e-3));
        assert_eq!(ra, rb);
        assert_ne!(ra, rc);
        assert_eq!(a.read(&q, &qd, 0.0), ra, "no time, no new reading");
        assert_eq!(Encoder::new(EncoderModel::exact()).read(&q, &qd, 1e-3), (q, qd));
    }
}
