//! Estimates the inertia of rotors that no file tells, from the torques of the joints while they accelerate.
//!
//! A rotor behind a gear takes `R qdd` of its own joint's torque and nothing of the others'. In each joint, over windows of some ticks,
//!
//! ```text
//! y = tau - (B qdd + C qd + g) - F(qd) = c + R qdd + f qd + d tau' + errors
//! ```
//! with a part `c` that drifts (Coulomb friction, load, masses that are not as modelled), viscous friction `f`, and the delay `d` from command to effect: a Kalman filter
//! of four numbers for each joint. The acceleration is the second difference of measured positions over two windows, and torques are weighted alike, by a triangle, so that
//! no observer with a wrong inertia stands between.
//!
//! What makes a joint stop or stick (contact, a jam, Coulomb friction) takes torque while the acceleration is negative, and looks like less inertia. So only inertia
//! that is clearly more than the model's is believed, and of that what is certain.
//!
//! A payload that is not in the model takes `Y (m, h)` of the torques ([payload estimator](super::payload_estimator)), and looks like more inertia. The derivative `S` of the
//! four numbers by `(m, h)` goes through the filter beside them, `S <- (1 - K x^T) S + K Y`: when a payload is put into the model its part is taken out of them by `S`, and
//! what is not sure of it makes a rotor unsure that is told.

use super::payload_estimator::{MOVES, UnmodelledPayload};
use crate::robot::Robot;
use crate::time::TICK;
use nalgebra::{Matrix4, SMatrix, SVector, Vector4};

/// Least ticks of a window, beside those until the next state of a slower drive. Chosen by hand: double would find a rotor when the arm has already accelerated for as long as it takes to fall behind, and with 7 of them
/// 19 instead of 60 of 80 Pandas of `tests/cores/everything_at_once.rs` come home.
const WINDOW: u32 = 10;
/// Acceleration that coarse encoders may hide in a window, as a standard deviation, rad/s^2 or m/s^2; windows are longer where it would be more. An error of the acceleration is one of the torque that it takes, too,
/// and the two together look like a joint without inertia: with windows of 10 ms and steps of 2e-4 rad (1.4 rad/s^2) UR5 and Panda found no rotor of twice their inertia. Measured (`tests/cores/everything_at_once.rs`, 120 draws
/// with steps of 5e-5 to 1e-3 rad): with 0.1 31 come home and 25 end with a fault, with 0.3 32 and 16, with 1.0 18 and 25. Longer windows see less of light wrists that swing; with 1e-3 rad one is 49 ms.
const HIDDEN: f64 = 0.3;
/// The standard deviation of a second difference of positions that are uniformly off by half a step, in steps. Derived: each has one of 12^-1/2, and they count 1, -2 and 1 times.
const SECOND_DIFFERENCE: f64 = std::f64::consts::FRAC_1_SQRT_2;
/// Standard deviation of a rotor's inertia beyond the model, in units of the one that is [likely](crate::robot::JointLimits::likely_rotor), beside once the joint's own
/// inertia. Derived from that estimate, which is good to a factor of 2.5.
const LIKELY: f64 = 2.0;
/// Time in which the largest effort takes a joint with the largest rotor that is believed to 1 rad/s or 1 m/s, s. Chosen by hand: a joint that is slower than this is no arm's.
const BELIEVED_S: f64 = 0.5;
/// Standard deviation of the delay from command to effect, s. Chosen by hand: drives of up to 5 ms are known.
const DELAY_S: f64 = 3e-3;
/// Standard deviation of the drifting part at first, as a share of the largest effort: what a rated payload weighs. Chosen by hand.
const CONSTANT: f64 = 0.2;
/// How far it drifts from one window to the next. Chosen by hand: what gravity of a payload that is not known changes by at 1 rad/s.
const DRIFT: f64 = 5e-3;
/// Errors of a window's torque as a share of the largest effort. Chosen by hand: ripple of gears.
const NOISE: f64 = 3e-3;
/// Errors of the model's inertias, as a share of the torque that accelerations take. Chosen by hand; masses are drawn up to 20 % wrong.
const MODEL: f64 = 0.15;
/// Coulomb friction that is not known, and viscous friction at 1 rad/s, as a share of the largest effort, beside the model's. Chosen by hand: arms with untold
/// friction of 5 % are known.
const FRICTION: f64 = 0.03;
/// Errors of the model's friction as a share of it. Chosen by hand: what is within that share of a joint's friction needs no inertia to be held. Without it the wrists of an xArm7, which
/// are moved against their friction, had rotors that they do not have where friction was double and commands were late.
const RUBS: f64 = 0.3;
/// Standard deviations beyond which a window counts less. Chosen by hand: of noise alone it is one in 370.
const DOUBTED: f64 = 3.0;
/// Standard deviations by which a rotor must differ from none. Chosen by hand as above.
const CLEAR: f64 = 3.0;
/// Share of the joint's own inertia by which it must. Chosen by hand: masses that are 20 % wrong are no rotors, and a controller holds with a quarter more inertia as without.
const WORTH: f64 = 0.25;
/// Change of what is believed that is worth a change of the model, as a share of the joint's inertia with it. Chosen by hand: what it changes in torques is within [`MODEL`].
const SAME: f64 = 0.03;

/// The estimator of an arm with `N` joints.
#[derive(Debug, Clone)]
pub(super) struct RotorEstimator<const N: usize> {
    /// Positions at the ends of the last two windows.
    last: Option<SVector<f64, N>>,
    before: Option<SVector<f64, N>>,
    /// Sums of torques and of rising weights times torques in this window, and the latter in the last one.
    sum: SVector<f64, N>,
    rising: SVector<f64, N>,
    rose: SVector<f64, N>,
    ticks: u32,
    ticks_before: u32,
    /// What is taken in next, one joint in a tick so that no tick has all the work, and the joint that is next.
    sample: Option<RotorSample<N>>,
    next: usize,
    tau_before: Option<SVector<f64, N>>,
    joints: [RotorFilter; N],
    /// Inertia of rotors that is in the model, and what is to be, kg m^2 or kg.
    believed: SVector<f64, N>,
    wanted: SVector<f64, N>,
}

/// The means about the end of a window.
#[derive(Debug, Clone, Copy)]
struct RotorSample<const N: usize> {
    qd: SVector<f64, N>,
    qdd: SVector<f64, N>,
    y: SVector<f64, N>,
    /// Torques that the model takes for the acceleration and for friction, N m or N, the torque's rate of change, and what encoders hide as a standard deviation, N m or N.
    turns: SVector<f64, N>,
    friction: SVector<f64, N>,
    tau_dot: SVector<f64, N>,
    hidden: SVector<f64, N>,
    /// Derivatives of the torques by mass and first moment of a payload.
    Y: SMatrix<f64, N, 4>,
}

/// The filter of one joint: the drifting part, the rotor's inertia, viscous friction and the delay.
#[derive(Debug, Clone, Copy)]
struct RotorFilter {
    theta: Vector4<f64>,
    P: Matrix4<f64>,
    /// Derivative of `theta` by mass and first moment of a payload that is not in the model, by kg and by kg m.
    S: Matrix4<f64>,
    /// Velocity in the last sample, rad/s or m/s.
    qd: f64,
    effort: f64,
    coulomb: f64,
}

impl<const N: usize> RotorEstimator<N> {
    /// Nothing is known of the rotors of `robot`, whose joints have the inertias `own` while the others are free, kg m^2 or kg.
    pub(super) fn new(robot: &Robot<N>, own: &SVector<f64, N>) -> Self {
        let joint = |i: usize| {
            let effort = robot.limits()[i].effort;
            let rotor = LIKELY * robot.limits()[i].likely_rotor() + own[i];
            let viscous = robot.friction()[i].viscous + FRICTION * effort;
            let sd = Vector4::new(CONSTANT * effort, rotor, viscous, DELAY_S);
            RotorFilter {
                theta: Vector4::zeros(),
                P: Matrix4::from_diagonal(&sd.component_mul(&sd)),
                S: Matrix4::zeros(),
                qd: 0.0,
                effort,
                coulomb: robot.friction()[i].coulomb + FRICTION * effort,
            }
        };
        let zero = SVector::zeros();
        Self {
            last: None,
            before: None,
            sum: zero,
            rising: zero,
            rose: zero,
            ticks: 0,
            ticks_before: 0,
            sample: None,
            next: N,
            tau_before: None,
            joints: std::array::from_fn(joint),
            believed: zero,
            wanted: zero,
        }
    }

    /// Forgets the present window: what moved the arm in it is not known.
    pub(super) fn skip(&mut self) {
        (self.last, self.before, self.sample, self.tau_before) = (None, None, None, None);
        self.ticks = 0;
    }

    /// The inertia of rotors that is believed beyond the model's, kg m^2 or kg.
    pub(super) fn believed(&self) -> &SVector<f64, N> {
        &self.believed
    }

    /// The variances of what is known of the rotors, (kg m^2)^2 or kg^2.
    pub(super) fn variance(&self) -> SVector<f64, N> {
        SVector::from_fn(|i, _| self.joints[i].P[(1, 1)])
    }

    /// Forgets everything; what was believed.
    pub(super) fn forget(&mut self, robot: &Robot<N>, own: &SVector<f64, N>) -> SVector<f64, N> {
        std::mem::replace(self, Self::new(robot, own)).believed
    }

    /// Takes over what was found; the change.
    pub(super) fn adopt(&mut self) -> SVector<f64, N> {
        let change = self.wanted - self.believed;
        self.believed = self.wanted;
        change
    }

    /// The model has a payload whose mass and first moment are `more`, kg and kg m: what it takes is in it now, and none of it the rotors'.
    pub(super) fn payload_changed(&mut self, more: &Vector4<f64>) {
        self.joints.iter_mut().for_each(|joint| joint.theta -= joint.S * more);
    }

    /// The inertia of rotors beyond the model's, and its standard deviation, kg m^2 or kg, of joints that have some whatever the arm carries; 0 for the others. `payload` is
    /// what is not in the model of it, `own` the inertia of each joint, [those that are believed](Self::believed) included.
    pub(super) fn sure(&self, payload: &UnmodelledPayload, own: &SVector<f64, N>) -> [SVector<f64, N>; 2] {
        let of = |i: usize| self.joints[i].sure(payload, own[i] - self.believed[i]);
        let sure: [_; N] = std::array::from_fn(|i| of(i).filter(|_| self.believed[i] > 0.0));
        [0, 1].map(|k| SVector::from_fn(|i, _| sure[i].map_or(0.0, |of| of[k])))
    }

    /// Takes in where the joints are after a tick in which the torques `tau` acted, N m or N; `q` is `None` where no new state came. `robot` has the payload and the rotors that are believed, and `Y` are the
    /// derivatives of the torques by mass and first moment of a payload, as they were up to some windows ago.
    /// `inertia_and_step`: of each joint while the others are free, kg m^2 or kg, and of its encoder, rad or m. Whether what is believed is to [change](Self::adopt).
    pub(super) fn note(
        &mut self,
        (robot, Y): (&Robot<N>, &SMatrix<f64, N, 4>),
        tau: &SVector<f64, N>,
        q: Option<&SVector<f64, N>>,
        inertia_and_step: (&SVector<f64, N>, &SVector<f64, N>),
    ) -> bool {
        let Some(last) = self.last else {
            (self.last, self.ticks) = (q.copied(), 0);
            (self.sum, self.rising) = (SVector::zeros(), SVector::zeros());
            return false;
        };
        self.rising += tau * (f64::from(self.ticks) + 0.5);
        self.sum += tau;
        self.ticks += 1;
        if self.ticks >= window(inertia_and_step.1)
            && let Some(q) = q
        {
            self.end_window((robot, Y), &last, q, inertia_and_step);
        }
        let Some(sample) = &self.sample else { return false };
        if let Some(joint) = self.joints.get_mut(self.next) {
            joint.take(sample, self.next);
            self.wanted[self.next] = joint.worth(self.believed[self.next], inertia_and_step.0[self.next]);
            self.next += 1;
            return false;
        }
        self.sample = None;
        self.wanted != self.believed
    }

    fn end_window(
        &mut self,
        (robot, Y): (&Robot<N>, &SMatrix<f64, N, 4>),
        last: &SVector<f64, N>,
        q: &SVector<f64, N>,
        (inertia, step): (&SVector<f64, N>, &SVector<f64, N>),
    ) {
        if let Some(before) = self.before {
            // The rates in both windows, of which the one before may have been longer.
            let [a, b] = [self.ticks_before, self.ticks].map(f64::from);
            let [a_s, b_s] = [a, b].map(|ticks| ticks * TICK.as_s());
            let span_s = 0.5 * (a_s + b_s);
            let [rose, rises] = [(last - before) / a_s, (q - last) / b_s];
            let qd = (rose * b + rises * a) / (a + b);
            let qdd = (rises - rose) / span_s;
            let tau = (self.rose / a + self.sum - self.rising / b) * (TICK.as_s() / span_s);
            let [taken, still] = robot.inverse_dynamics_of(last, &qd, [&qdd, &SVector::zeros()]);
            let friction = robot.friction_torque(&qd);
            let tau_dot = self.tau_before.map_or(SVector::zeros(), |before| (tau - before) / span_s);
            self.tau_before = Some(tau);
            self.sample = Some(RotorSample {
                qd,
                qdd,
                y: tau - taken - friction + self.believed.component_mul(&qdd),
                turns: taken - still,
                friction,
                tau_dot,
                hidden: step.component_mul(inertia) * (SECOND_DIFFERENCE / (a_s * b_s)),
                Y: *Y,
            });
            self.next = 0;
        }
        (self.before, self.last) = (Some(*last), Some(*q));
        (self.rose, self.ticks_before) = (self.rising, self.ticks);
        (self.sum, self.rising, self.ticks) = (SVector::zeros(), SVector::zeros(), 0);
    }
}

/// Ticks of a window before encoders with these steps, rad or m.
fn window<const N: usize>(steps: &SVector<f64, N>) -> u32 {
    let hidden_s = (SECOND_DIFFERENCE * steps.amax() / HIDDEN).sqrt();
    WINDOW.max((hidden_s / TICK.as_s()).ceil() as u32)
}

impl RotorFilter {
    fn take<const N: usize>(&mut self, sample: &RotorSample<N>, i: usize) {
        let x = Vector4::new(1.0, sample.qdd[i], sample.qd[i], sample.tau_dot[i]);
        // Friction about standstill and where the velocity changes its sign is any.
        let (v, before) = (sample.qd[i], std::mem::replace(&mut self.qd, sample.qd[i]));
        let turns_back = v.abs() < 2.0 * MOVES || before.abs() < 2.0 * MOVES || v * before < 0.0;
        let rubs = if turns_back { self.coulomb } else { 0.0 };
        self.P[(0, 0)] += (DRIFT * self.effort).powi(2) + rubs * rubs;
        let noise = (NOISE * self.effort).powi(2)
            + sample.hidden[i].powi(2)
            + (MODEL * sample.turns[i]).powi(2)
            + (RUBS * sample.friction[i]).powi(2);
        let Px = self.P * x;
        let excess = sample.y[i] - x.dot(&self.theta);
        let expected = Px.dot(&x) + noise;
        if !(excess.is_finite() && expected.is_finite() && expected > 0.0) {
            return;
        }
        let variance = expected.max(excess * excess / (DOUBTED * DOUBTED));
        let gain = Px / variance;
        self.theta += gain * excess;
        self.S += gain * (sample.Y.row(i) - x.transpose() * self.S);
        // Joseph's form, with the noise that the gain is best for.
        let rest = Matrix4::identity() - gain * x.transpose();
        self.P =
            rest * self.P * rest.transpose() + gain * gain.transpose() * (variance - Px.dot(&x)).max(0.0);
    }

    /// The inertia that is to be believed where `believed` is now, for a joint with `inertia` including that, kg m^2 or kg.
    fn worth(&self, believed: f64, inertia: f64) -> f64 {
        let sd = self.P[(1, 1)].max(0.0).sqrt();
        let found = self.theta[1];
        let own = (inertia - believed).max(0.0);
        let is_clear = believed > 0.0 || found - CLEAR * sd > WORTH * own;
        let wanted = (found - sd).clamp(0.0, BELIEVED_S * self.effort);
        if is_clear && (wanted - believed).abs() > SAME * (own + wanted) { wanted } else { believed }
    }

    /// The inertia of the rotor without what a `payload` takes that is not in the model, and its standard deviation, where that is clearly more than none beside the inertia `own`.
    fn sure(&self, payload: &UnmodelledPayload, own: f64) -> Option<[f64; 2]> {
        let by = self.S.row(1);
        let found = self.theta[1] - by.dot(&payload.mean.transpose());
        let variance = self.P[(1, 1)] + (by * payload.covariance).dot(&by) + payload.inertia_sd.powi(2);
        let sd = variance.max(0.0).sqrt();
        (found - CLEAR * sd > WORTH * own).then_some([found, sd])
    }
}

#[cfg(test)]
mod tests;
