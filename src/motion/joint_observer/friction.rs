//! How much more friction a joint has than its model, as a share `c` of the model's. It turns about with the motion, where a torque
//! that was learnt while the joint went one way pushes wrongly after each reversal, until it is learnt anew.
//!
//! Each joint has a Kalman filter of two states: the disturbance `d`, a random walk (loads, masses), and `c`, nearly constant. It goes by the
//! torque `rho` by which the joint's motion differs from the expected one, in units of the model's Coulomb friction:
//!
//! ```text
//! rho = d - c F + noise        of d and c what is left after what was learnt before
//! ```
//! While a joint moves one way the two cannot be told apart. At a reversal `d` is known well and `c` is not: it takes the blame.

use crate::robot::Friction;
use nalgebra::SVector;

/// Standard deviation of the share before anything is known, and by how much it may change within a second.
const PRIOR: f64 = 0.3;
const DRIFT_1_SQRT_S: f64 = 0.02;
/// The shares that are believed: hardly any friction, and three times as much.
const LEAST: f64 = -0.9;
const MOST: f64 = 2.0;

/// What a tick tells of a joint, torques in N m or forces in N.
#[derive(Debug, Clone, Copy)]
pub(super) struct TorqueResidual {
    /// By which the joint's motion differs from the expected one.
    pub(super) rho: f64,
    /// Friction that was made up for, by the model.
    pub(super) friction: f64,
    /// That accelerates the joint: a load makes it uncertain by as much.
    pub(super) inertial: f64,
    /// Share of `rho` that the disturbance learns in a tick.
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
    /// Of the model's friction, what acts beyond it.
    pub(super) fn share(&self) -> &SVector<f64, N> {
        &self.share
    }

    /// Learns of joint `i`, counted from 0; nothing where its model has no Coulomb friction.
    pub(super) fn learn(&mut self, i: usize, model: &Friction, residual: &TorqueResidual, tick_s: f64) {
        let unit = model.coulomb;
        if !(unit > 0.0) {
            return;
        }
        let TorqueResidual { rho, friction, inertial, gain } = *residual;
        let (rho, friction, inertial) = (rho / unit, friction / unit, inertial / unit);
        // In units of its noise, which is that of the Coulomb friction itself: the walk for which `gain` is the best one.
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
        self.share[i] = (self.share[i] + kc * rho).clamp(LEAST, MOST);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
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
            learner.learn(0, &MODEL, &residual, 1e-3);
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
        learner.learn(0, &Friction::default(), &residual, 1e-3);
        assert_eq!(*learner.share(), Vector1::zeros());
        for _ in 0..100 {
            learner.learn(0, &MODEL, &residual, 1e-3);
        }
        assert_eq!(learner.share()[0], MOST);
    }
}
