//! Estimates how much a joint's friction differs from its model, as a share `c` of the model's friction. Friction changes its sign with the
//! velocity. A constant disturbance torque that was estimated in one direction of motion is therefore wrong after each reversal, and a
//! share is not.
//!
//! Each joint has a Kalman filter with two states: the disturbance `d`, a random walk (loads, masses), and `c`, which is nearly constant. Its
//! measurement is the torque residual `rho` between the joint's motion and the predicted one, in units of the Coulomb friction that is compensated, which where no file tells of friction is a small share of what is looked for:
//!
//! ```text
//! rho = d - c F + noise        d and c here are the errors of the present estimates
//! ```
//! While a joint moves in one direction, `d` and `c` cannot be distinguished. At a reversal the variance of `d` is small and that of `c` is
//! large, so that the residual corrects `c`.

use nalgebra::SVector;

/// Standard deviation of the share at the start, and its random walk within a second. Chosen by hand: the walk reaches half of the
/// prior within a minute, and it is bounded by the prior. Shares of up to 0.3 are found to 0.03 within 4 s (tests below).
const PRIOR: f64 = 0.3;
const DRIFT_1_SQRT_S: f64 = 0.02;
/// Bounds of the estimated share, chosen by hand: a tenth of the model's friction, and three times as much. The lower one must stay above
/// -1, where no friction would be left to compensate.
const MIN_SHARE: f64 = -0.9;
const MAX_SHARE: f64 = 2.0;

/// The torque residual of one joint in one tick; torques in N m or forces in N.
#[derive(Debug, Clone, Copy)]
pub(super) struct TorqueResidual {
    /// Torque by which the joint's motion differs from the predicted one.
    pub(super) rho: f64,
    /// Friction that was confirmed, without the share that is learnt here.
    pub(super) friction: f64,
    /// Torque that accelerates the joint. An unknown load makes it uncertain by up to its own amount.
    pub(super) inertial: f64,
    /// Share of `rho` by which the disturbance estimate is corrected in a tick.
    pub(super) gain: f64,
}

/// The share of each joint.
#[derive(Debug, Clone)]
pub(super) struct FrictionShare<const N: usize> {
    share: SVector<f64, N>,
    /// Covariance of `d` and `c`, `[dd, dc, cc]`; `None` before the first residual.
    covariance: [Option<[f64; 3]>; N],
}

impl<const N: usize> Default for FrictionShare<N> {
    fn default() -> Self {
        Self { share: SVector::zeros(), covariance: [None; N] }
    }
}

impl<const N: usize> FrictionShare<N> {
    /// Friction in excess of the model's, as a share of the model's.
    pub(super) fn share(&self) -> &SVector<f64, N> {
        &self.share
    }

    /// Updates the estimate of joint `i`, counted from 0, of whose friction `unit` is the Coulomb part, N m or N. A joint without any is left alone.
    pub(super) fn learn(&mut self, i: usize, unit: f64, residual: &TorqueResidual, tick_s: f64) {
        if !(unit > 0.0) {
            return;
        }
        let TorqueResidual { rho, friction, inertial, gain } = *residual;
        let (rho, friction, inertial) = (rho / unit, friction / unit, inertial / unit);
        // In units of the noise of `rho`, which is taken as the Coulomb friction itself: the random walk for which `gain` is the stationary
        // Kalman gain of `d` alone.
        let walk = gain * gain;
        let [dd, dc, cc] = self.covariance[i].get_or_insert([gain, 0.0, PRIOR * PRIOR]);
        *dd += walk;
        *cc = (*cc + DRIFT_1_SQRT_S * DRIFT_1_SQRT_S * tick_s).min(PRIOR * PRIOR);
        let (hd, hc) = (*dd - friction * *dc, *dc - friction * *cc);
        let variance = hd - friction * hc + 1.0 + inertial * inertial;
        let (kd, kc) = (hd / variance, hc / variance);
        *dd -= kd * hd;
        *dc -= kd * hc;
        *cc -= kc * hc;
        self.share[i] = (self.share[i] + kc * rho).clamp(MIN_SHARE, MAX_SHARE);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Friction;
    use nalgebra::Vector1;

    const MODEL: Friction = Friction { viscous: 5.0, coulomb: 2.0 };

    /// What is learnt of a joint that goes to and fro, whose friction differs from the model's by `share` and on which `load` acts;
    /// the disturbance is learnt beside it.
    fn learnt(share: f64, load: f64, ticks: i32) -> f64 {
        let mut learner = FrictionShare::<1>::default();
        let mut d = 0.0;
        for k in 0..ticks {
            let speed = 0.3 * (f64::from(k) * 6e-3).sin();
            let friction = MODEL.viscous * speed + MODEL.coulomb * (speed / 1e-3).tanh();
            let rho = load - share * friction - (d - learner.share()[0] * friction);
            let residual = TorqueResidual { rho, friction, inertial: 0.0, gain: 0.01 };
            learner.learn(0, MODEL.coulomb, &residual, 1e-3);
            d += 0.01 * rho;
        }
        learner.share()[0]
    }

    #[test]
    fn a_share_is_told_from_a_load_by_reversals() {
        for (share, load) in [(0.3, 0.0), (-0.3, 0.0), (0.0, 3.0), (0.2, -3.0), (-0.2, 5.0)] {
            let found = learnt(share, load, 4000);
            assert!((found - share).abs() < 0.03, "{share} under {load}: {found}");
        }
    }

    #[test]
    fn no_friction_learns_nothing_and_estimates_stay_bounded() {
        let residual = TorqueResidual { rho: 1e9, friction: -1.0, inertial: 0.0, gain: 0.01 };
        let mut learner = FrictionShare::<1>::default();
        learner.learn(0, 0.0, &residual, 1e-3);
        assert_eq!(*learner.share(), Vector1::zeros());
        for _ in 0..100 {
            learner.learn(0, MODEL.coulomb, &residual, 1e-3);
        }
        assert_eq!(learner.share()[0], MAX_SHARE);
    }
}
