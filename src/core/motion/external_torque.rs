//! Momentum observer: the torque of each joint that comes from outside, with its standard deviation.
//!
//! The momentum of the joints changes by the applied torque, by what the model takes, and by what acts from outside. In the step of a tick
//!
//! ```text
//! y = B(q) (v' - v) / h + C(q, v) v + g(q) - tau     at the middle of the step: tau_ext less what the model leaves out
//! r' = K (y - r)                                     the residual of De Luca's observer, with the gain K
//! ```
//! An arm is never its model, so that `r` is not the external torque yet. What the model leaves out is [learnt](super::residual_model) for each joint
//! from the residual itself, with the terms
//!
//! ```text
//! x = (1, qdd, sign(qd), qd, tau')      behind the same low-pass as r
//! ```
//! a constant (load, masses), inertia (rotors that no file tells), Coulomb and viscous friction, and the delay from command to effect. What this prediction leaves is
//! the external torque. Its variance is that of the prediction and of the noise, and of what a payload takes that is not known.

use super::payload_estimator::{MOVES, ROTOR};
use super::residual_model::{LEARNS_EVERY, ResidualModel, is_turn};
use crate::robot::Robot;
use crate::time::TICK;
use nalgebra::SVector;

/// Gain of the observer, rad/s: a torque that begins at once is seen to 63 % after 8 ms. Chosen by hand: half of it would use up the 10 ms in which a
/// contact is to be noticed, and double lets through twice the noise of encoders.
const GAIN_RAD_S: f64 = 120.0;
/// Ticks until the residual of what was there before counts no more: six time constants of the observer. Derived from [`GAIN_RAD_S`]: e^-6 is 0.25 %.
pub(crate) const SETTLES: u32 = 50;
/// Ticks of the mean that the observer comes to, for the noise of encoders. Derived: its time constant.
const MEAN_TICKS: u32 = 8;
/// Standard deviation of a constant torque that the model leaves out, as a share of the largest effort. Chosen by hand: half of what a rated payload takes, which standing
/// arms learn within 30 ms.
const CONSTANT: f64 = 0.05;
/// Of Coulomb friction, and of viscous friction at 1 rad/s, as a share of the largest effort, beside all of what the model has. Chosen by hand: arms with untold
/// friction of 5 % are known.
const FRICTION: f64 = 0.03;
/// Of the delay from command to effect, s. Chosen by hand: drives of up to 5 ms are known.
const DELAY_S: f64 = 3e-3;
/// Of the noise at the start, and the least that is ever believed, as shares of the largest effort. Chosen by hand; what is learnt decides.
const NOISE: f64 = 5e-3;
/// The least noise that is believed. Chosen by hand with the one above: a tenth of a percent is 0.15 N m of a UR5.
const LEAST_NOISE: f64 = 1e-3;
/// Error of the model's varying torque, as a share of it: what the inertias of other joints are wrong by. Chosen by hand; masses are drawn up to 20 % wrong.
const MODEL: f64 = 0.1;
/// Standard deviation of what an acceleration of 1 rad/s^2 or m/s^2 takes beyond what is learnt of it, as a share of the largest effort: inertias change with the posture. Chosen by hand: a light
/// wrist that leaps with 170 rad/s^2 as it comes loose is not touched.
const COUPLED: f64 = 5e-4;
/// Time over which a torque counts as varying, s. Chosen by hand: several times that of a reference from rest to its largest acceleration.
const VARYING_S: f64 = 0.3;
/// How far the constant may drift for each radian or metre, as a share of the largest effort: what a payload weighs changes with the posture, in the same way over
/// [`POSTURE`]. Chosen by hand.
const DRIFT_PER_RAD: f64 = 0.1;
/// The way over which that drift keeps its sign, rad or m. Chosen by hand.
const POSTURE: f64 = 0.1;
/// How far it may drift in the square root of a second. Chosen by hand: warm gears.
const DRIFT_1_S: f64 = 0.01;
/// Static friction over the friction of motion, at most. Chosen by hand: 1.2 to 1.5 is usual.
const STATIC: f64 = 1.5;

/// Share of the best gain with which all but the constant is learnt: errors of models last, and look like properties of the arm where they coincide with
/// one. Measured over 64 random arms that differ from their models in everything: with all of it a friction that was not there reached 12 standard deviations when its
/// joint turned back, with 0.3 none but of faulting arms passed 6.6, with 0.1 none passed 4.4, and a touch of 15 N m on ideal arms took 22 instead of 15 ms.
const PATIENT: f64 = 0.3;

/// Coulomb friction of a joint that has not moved yet, as a share of its largest effort: the 12 % up to which friction that no file tells is looked for. A joint that has moved by [`LOOSE`] shows what it has.
const UNTOLD: f64 = 0.12;
/// Way from which on a joint has moved, rad or m. Chosen by hand: five times that after which a joint that resists is probed.
const LOOSE: f64 = 5e-3;

/// What encoders hide counts so many times, because the residual's terms are noisy too. Measured: with once an xArm7 with encoder steps of 5e-4 was stopped by nothing.
const HIDES: f64 = 2.0;

/// Constant, inertia, Coulomb friction, viscous friction, delay: derived, their number.
const TERMS: usize = 5;
type Terms = SVector<f64, TERMS>;

/// The observer of an arm with `N` joints.
#[derive(Debug, Clone)]
pub struct ExternalTorqueObserver<const N: usize> {
    /// Position and velocity at the last tick, and the torque that acted before it.
    last: Option<(SVector<f64, N>, SVector<f64, N>, SVector<f64, N>)>,
    joints: [JointResidual; N],
    /// Ticks that were taken in.
    ticks: u32,
}

/// The residual of one joint.
#[derive(Debug, Clone)]
struct JointResidual {
    model: ResidualModel<TERMS>,
    /// Residual and terms behind the low-pass.
    r: f64,
    x: Terms,
    /// The model's torque behind the low-pass, and its mean over [`VARYING_S`], N m or N.
    modelled: f64,
    steady: f64,
    /// External torque, its variance, and the torque that friction may hold beside that, N m or N.
    external: f64,
    variance: f64,
    held: f64,
    /// Where the joint was first, rad or m, and whether it has moved from there.
    from: Option<f64>,
    is_loose: bool,
    /// Way since the joint learnt last, rad or m.
    way: f64,
    /// Largest effort, N m or N, and the variance of what coarse encoders hide.
    effort: f64,
    hidden: f64,
}

impl<const N: usize> ExternalTorqueObserver<N> {
    /// An observer of an arm of which nothing is learnt yet; `hidden` tells the torque that coarse encoders hide in a mean over some ticks, N m or N.
    #[must_use]
    pub fn new(robot: &Robot<N>, inertia: &SVector<f64, N>, hidden: impl Fn(u32) -> SVector<f64, N>) -> Self {
        let hidden = hidden(MEAN_TICKS);
        let joint = |i: usize| {
            let (friction, effort) = (&robot.friction()[i], robot.limits()[i].effort);
            let coulomb = friction.coulomb + FRICTION * effort;
            let viscous = friction.viscous + FRICTION * effort;
            let sd = Terms::new(CONSTANT * effort, ROTOR * effort + inertia[i], coulomb, viscous, DELAY_S);
            let theta = Terms::new(0.0, 0.0, -friction.coulomb, -friction.viscous, 0.0);
            let hidden = HIDES * HIDES * hidden[i] * hidden[i];
            let noise = (NOISE * effort).powi(2) + hidden;
            JointResidual {
                model: ResidualModel::new(theta, &sd, noise, PATIENT),
                r: 0.0,
                x: Terms::zeros(),
                modelled: 0.0,
                steady: 0.0,
                external: 0.0,
                variance: noise + sd[0] * sd[0],
                held: 0.0,
                from: None,
                is_loose: false,
                way: 0.0,
                effort,
                hidden,
            }
        };
        Self { last: None, joints: std::array::from_fn(joint), ticks: 0 }
    }

    /// Takes in the state at the end of `ticks` in which `tau` acted in the mean, N m or N. A payload takes torques that are not known, with the variances `doubt`, and so do rotors whose
    /// inertias have the variances `rotors`.
    pub fn note(
        &mut self,
        robot: &Robot<N>,
        (q, qd): (&SVector<f64, N>, &SVector<f64, N>),
        (tau, ticks): (&SVector<f64, N>, u32),
        (doubt, rotors): (&SVector<f64, N>, &SVector<f64, N>),
    ) {
        let h = TICK.as_s() * f64::from(ticks);
        let Some((q_before, qd_before, tau_before)) = self.last.replace((*q, *qd, *tau)) else { return };
        let (q_mid, qd_mid, qdd) = ((q_before + q) * 0.5, (qd_before + qd) * 0.5, (qd - qd_before) / h);
        let modelled = robot.inverse_dynamics(&q_mid, &qd_mid, &qdd);
        let share = 1.0 - (-GAIN_RAD_S * h).exp();
        let before = self.ticks;
        for (i, joint) in self.joints.iter_mut().enumerate() {
            let sign = qd_mid[i] / qd_mid[i].abs().max(MOVES);
            let x = Terms::new(1.0, qdd[i], sign, qd_mid[i], (tau[i] - tau_before[i]) / h);
            joint.r += share * (modelled[i] - tau[i] - joint.r);
            joint.x += (x - joint.x) * share;
            joint.modelled += share * (modelled[i] - joint.modelled);
            joint.steady += (joint.modelled - joint.steady) * h / VARYING_S;
            joint.way += (q[i] - q_before[i]).abs();
            joint.is_loose |= (q[i] - *joint.from.get_or_insert(q[i])).abs() > LOOSE;
            joint.held = joint.holds(robot.friction()[i].coulomb);
            joint.judge(doubt[i], rotors[i]);
            if is_turn(i, before, ticks) && before >= SETTLES {
                joint.learn(doubt[i], rotors[i]);
            }
        }
        self.ticks = self.ticks.saturating_add(ticks);
    }

    /// What coarse encoders hide is the torque `hidden` in a mean over some ticks, N m or N: steps that nobody told are found meanwhile.
    pub fn hide(&mut self, hidden: impl Fn(u32) -> SVector<f64, N>) {
        for (joint, hidden) in self.joints.iter_mut().zip(&hidden(MEAN_TICKS)) {
            joint.hidden = HIDES * HIDES * hidden * hidden;
            joint.model.doubt(joint.least_noise());
        }
    }

    /// The model has changed: gravity takes `difference` more, N m or N.
    pub fn change_model(&mut self, difference: &SVector<f64, N>) {
        for (joint, difference) in self.joints.iter_mut().zip(difference) {
            joint.model.change(difference * difference);
        }
    }

    /// The model has rotors with the inertia `change` more, kg m^2 or kg: what was learnt of them is in the model from now on.
    pub fn add_rotors(&mut self, change: &SVector<f64, N>) {
        for (joint, change) in self.joints.iter_mut().zip(change) {
            joint.r += change * joint.x[1];
            joint.model.shift(1, *change);
        }
    }

    /// Forgets the last tick, because the torque that acts since then is not known.
    pub fn skip(&mut self) {
        self.last = None;
    }

    /// The torque of each joint that comes from outside, N m or N.
    #[must_use]
    pub fn torque(&self) -> SVector<f64, N> {
        SVector::from_fn(|i, _| self.joints[i].external)
    }

    /// Its standard deviation.
    #[must_use]
    pub fn sd(&self) -> SVector<f64, N> {
        SVector::from_fn(|i, _| self.joints[i].variance.sqrt())
    }

    /// Standard deviations by which each joint's torque from outside exceeds what friction may hold; 0 before anything is learnt.
    #[must_use]
    pub fn excess(&self) -> SVector<f64, N> {
        if self.ticks <= SETTLES {
            return SVector::zeros();
        }
        SVector::from_fn(|i, _| {
            let joint = &self.joints[i];
            (joint.external.abs() - joint.held).max(0.0) / joint.variance.sqrt()
        })
    }
}

impl JointResidual {
    /// Variance of what the terms do not contain.
    fn doubt(&self, payload: f64) -> f64 {
        let coupled = COUPLED * self.effort * self.x[1];
        payload + (MODEL * (self.modelled - self.steady)).powi(2) + coupled * coupled
    }

    /// The torque by which friction may hold the joint, where `coulomb` is that of the model, N m or N.
    fn holds(&self, coulomb: f64) -> f64 {
        let untold = if self.is_loose { 0.0 } else { UNTOLD * self.effort };
        let coulomb = coulomb.max(-self.model.learnt(2)).max(untold);
        STATIC * coulomb * (1.0 - self.x[2].abs()).max(0.0)
    }

    /// What a rotor may take whose inertia has the variance `rotor`: it resists acceleration. What pushes a joint, or stops it, accelerates it the way that it acts.
    fn resists(&self, rotor: f64) -> f64 {
        if self.external * self.x[1] < 0.0 { rotor * self.x[1] * self.x[1] } else { 0.0 }
    }

    /// The least variance of the noise.
    fn least_noise(&self) -> f64 {
        (LEAST_NOISE * self.effort).powi(2) + self.hidden
    }

    fn judge(&mut self, payload: f64, rotor: f64) {
        let (external, variance) = self.model.excess(self.r, &self.x);
        self.external = external;
        self.variance = variance + self.doubt(payload) + self.resists(rotor);
    }

    fn learn(&mut self, payload: f64, rotor: f64) {
        let drift = DRIFT_PER_RAD.powi(2) * POSTURE * self.way
            + DRIFT_1_S.powi(2) * f64::from(LEARNS_EVERY) * TICK.as_s();
        self.way = 0.0;
        let doubt = self.doubt(payload) + self.resists(rotor) + self.held * self.held;
        self.model.take(self.r, &self.x, doubt, self.least_noise(), drift * self.effort * self.effort);
    }
}

#[cfg(test)]
mod tests;
