//! How quickly velocities are taken from positions, by the steps of the encoders.

use super::JointObserver;
use crate::time::TICK;
use nalgebra::SVector;

/// The speed that a step may tell, rad/s or m/s: its size times the bandwidth of the velocity observer. Measured (`tests/cores/everything_at_once.rs`, with steps set to a size): with 2e-4 rad
/// a bandwidth of 250 to 400 rad/s brings most arms home, with 5e-4 one of 150, with 1e-5 and less 400 and more.
const STEP_SPEED: f64 = 0.08;
/// Size of a step times the bandwidth at rest below which a step is no excitation, rad/s or m/s. Measured: a step moves the velocity by up to 0.7 of that, and a joint controller of 40 rad/s without overshoot
/// then accelerates by 0.17 rad/s^2. With four times that 18 % more of the xArm7s in `tests/cores/everything_at_once.rs` converge, and SCARAs of `tests/cores/arm_unlike_model.rs` hunt by 0.1 px.
pub(super) const QUIET: f64 = 0.003;
/// Acceleration that the velocity observer takes from an encoder step, in steps times the square of its bandwidth. Derived from its gain `1 + 2 m`, with
/// `m` = 1.
pub(super) const STEP_GAIN: f64 = 3.0;

impl<const N: usize> JointObserver<N> {
    /// Steps of the encoders, told or found, rad or m.
    pub(in crate::motion) fn encoder_step(&self) -> &SVector<f64, N> {
        &self.steps
    }

    /// What coarse encoders hide of an acceleration in a mean of `ticks`, as a torque, N m or N.
    pub(in crate::motion) fn hidden_torque(&self, ticks: u32) -> SVector<f64, N> {
        SVector::from_fn(|i, _| {
            let gain = STEP_GAIN * self.bandwidth(i) / (f64::from(ticks) * TICK.as_s());
            self.steps[i] * self.settings.inertia[i] * gain
        })
    }

    /// How much farther than with fine encoders positions are behind an acceleration that is not in the command, for each rad/s^2 or m/s^2, once the observer has settled: s^2. Derived: they are behind by
    /// `e = qdd / l^2` with a bandwidth `l`, from the observer's equations without the part that learns it.
    pub(in crate::motion) fn position_lag_by_steps(&self) -> SVector<f64, N> {
        let fine = self.settings.velocity_rad_s;
        SVector::from_fn(|i, _| {
            let bandwidth = self.bandwidth(i);
            if bandwidth > 0.0 { bandwidth.powi(-2) - fine.powi(-2) } else { 0.0 }
        })
    }

    /// The largest bandwidth of the velocity observer of joint `i`, rad/s: coarse steps allow less.
    pub(super) fn bandwidth(&self, i: usize) -> f64 {
        let step = self.steps[i] - self.settings.encoder_noise[i];
        let allowed = if step > 0.0 { STEP_SPEED / step } else { f64::INFINITY };
        self.settings.velocity_rad_s.min(allowed)
    }
}

#[cfg(test)]
mod tests {
    use super::super::ObserverSettings;
    use super::*;

    /// Fine encoders leave nothing: the watches over them stay as sharp as they are.
    #[test]
    fn only_coarse_steps_make_positions_lag_more() {
        let settings = ObserverSettings {
            velocity_rad_s: 400.0,
            encoder_step: SVector::from([1e-5, 2e-4, 1e-3]),
            ..ObserverSettings::none()
        };
        let lag = JointObserver::<3>::new(settings).position_lag_by_steps();
        assert_eq!(lag.fixed_rows::<2>(0).amax(), 0.0);
        // 80 rad/s: derived by hand from `STEP_SPEED`.
        assert!((lag[2] - (1.0 / 6400.0 - 1.0 / 160_000.0)).abs() < 1e-12, "{lag}");
    }
}
