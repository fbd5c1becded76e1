//! Estimates the payload of an arm that is not in its model, its mass and centre of mass, from the torques of the joints while it moves.
//!
//! The torques of a payload are linear in its mass `m` and its first moment `h` about the flange. Over windows of some ticks the mean torque
//! that was applied, minus that of the model for the measured motion and minus friction, is
//!
//! ```text
//! y = tau - (B qdd + C qd + g) - F(qd) = Y(q, qd, qdd) (m, h) + phi F(qd) + errors
//! ```
//! and `(m, h)` follows by least squares with a prior, and with each joint's own `phi`, the share by which its friction differs from the model's: that of a probed joint
//! cannot be told from a payload that is not known yet. It is eliminated joint by joint. The errors are not noise that a mean takes away: gears rub as they like
//! for as long as a joint moves one way. So a joint counts once for each [`WAY`] that it moves, however long that
//! takes, and errors are stated as large as models are wrong: [`SHAPE`] of the friction, all of it about standstill, [`EFFORT`] of the largest effort, and inertias
//! of rotors that no file tells. What is found is used only when it explains the torques far better than no payload does: an arm that
//! is its model stays its model.
//!
//! The payload's own moment of inertia is taken as zero: joints that carry it close to their axes do not show it beside their friction.

use crate::linalg::Ldlt;
use crate::robot::Robot;
use crate::time::TICK;
use nalgebra::{Matrix4, SMatrix, SVector, Vector3, Vector4};

/// Ticks of a window, beside those until the next state of a slower drive. Chosen by hand: long enough that a command that acts some ticks late hardly changes its mean, short against the 0.1 s in which an
/// arm begins to move.
pub(super) const WINDOW: u32 = 10;
/// Standard deviations of the prior: mass, kg, and first moment, kg m. Chosen by hand: arms that a person can stand beside are rated for up to 16 kg,
/// and grippers of 2 kg have their centre of mass within 0.15 m of the flange. Half and double were not tried.
const PRIOR_KG: f64 = 10.0;
const PRIOR_KG_M: f64 = 0.3;
/// Error of a joint's torque as a share of its largest effort: what gears rub that no file tells. Chosen by hand, and not varied;
/// arms with untold friction of 5 % are known.
const EFFORT: f64 = 0.02;
/// Standard deviation of the share by which a joint's friction differs from the model's. Chosen by hand: from none to twice the model's friction is what arms are tested with.
const FRICTION: f64 = 1.0;
/// Errors of a moving joint's friction beside that, as a share of it: another course over the speed. Chosen by hand.
const SHAPE: f64 = 0.1;
/// Inertia of a joint that no file tells, times acceleration, as a share of its largest effort at 1 rad/s^2 or m/s^2: chosen by hand, because joints are built to
/// accelerate at some 100 rad/s^2 at most, so a rotor takes up to a hundredth.
pub(super) const ROTOR: f64 = 0.01;
/// Error of the inertia of a rotor that the file tells, as a share of it. Chosen by hand, beyond what makers state, as for a calibration of the load: a light joint that gives way to a load at 70 rad/s^2
/// tells of it, while the error of a rotor that no file tells would hide it.
const TOLD_ROTOR: f64 = 0.2;
/// Way after which the errors of a joint are new, rad or m. Chosen by hand: the play and the teeth of gears repeat on shorter ones.
const WAY: f64 = 0.05;
/// Largest weight of one window: one that is disturbed by something else has three others beside it.
const WEIGHT: f64 = 0.3;
/// Least fall of the weighted sum of squares by which a payload is believed. Derived: for four numbers that are zero it is chi-square with four
/// degrees of freedom, 4 in the mean and above 23 in one of 10 000 cases.
const CONFIRMED: f64 = 23.0;
/// Least share of the weighted squares of the torques that it must explain. Chosen by hand, and not varied: something
/// that holds one joint, which the other joints do not feel, is not explained by a payload (`a_jam_is_a_fault_within_a_second_and_a_released_joint_stands`).
const EXPLAINED: f64 = 0.7;
/// Share of the way to a new estimate that is gone in a window: a time constant of 50 ms, so that torques never leap.
const FOLLOW: f64 = 0.2;
/// Standard deviations by which a first moment must differ from zero before it enters the inertia. A light wrist that is believed to carry
/// its payload off its axis gets torques for an inertia that is not there, and swings; one that carries more than is believed is sluggish.
const SURE: f64 = 2.0;
/// Change of an estimate that is not worth a change of the model, kg and kg m. Chosen by hand: 1 mN of weight.
const SAME: f64 = 1e-4;
/// Share of a new window in the mean of recent ones: a memory of 0.1 s. Chosen by hand: what a payload weighs in one posture is learnt by the observer of
/// external torques in that time.
const RECENT: f64 = 0.1;
/// Radius at which a payload's mass lies for its moments of inertia, as a standard deviation, m. Derived from [`PRIOR_KG_M`]: as far as the centre of mass of a gripper of 3 kg.
const RADIUS_M: f64 = 0.1;
/// Farthest centre of mass from the flange that is believed, m. Chosen by hand: twice what grippers have.
const FARTHEST_M: f64 = 0.3;
/// Largest mass that is believed, kg. Chosen by hand: three times the prior's deviation.
const MOST_KG: f64 = 30.0;
/// Share of the efforts that references are planned with. Chosen by hand: a tenth is left to feedback and friction.
const EFFORT_USED: f64 = 0.9;
/// Least share of accelerations that is used even where no effort is left. Chosen by hand: with none of it the arm could not leave such a posture.
const LEAST_SHARE: f64 = 0.1;
/// Share of a joint's effort that gravity may take, and the share before it in which the arm becomes slower. Chosen by hand: 3 % are left to hold it, and an
/// xArm7 with 5 kg, which is too much for it, comes to rest before it can no more; with a third of the latter it sinks.
const HOLDS: f64 = 0.97;
/// Share before [`HOLDS`] in which the arm becomes slower. Chosen by hand, as told there.
const FADES: f64 = 0.15;
/// Speed beyond which a joint has its whole Coulomb friction, rad/s or m/s. Derived: five times the width over which smooth models change its sign. At rest a joint that sticks may bear any part of it.
pub(super) const MOVES: f64 = 5e-3;

/// What the joints did in a tick.
pub(super) struct JointTick<const N: usize> {
    /// Positions and velocities at the end of the tick.
    pub(super) q: SVector<f64, N>,
    pub(super) qd: SVector<f64, N>,
    /// Whether that is of a new state of the drive.
    pub(super) is_new: bool,
    /// Acceleration that coarse encoders do not distinguish from none in a window, as a torque, N m or N.
    pub(super) noise: SVector<f64, N>,
}

/// The estimator of an arm with `N` joints.
#[derive(Debug, Clone)]
pub(super) struct PayloadEstimator<const N: usize> {
    bare: Robot<N>,
    /// Inertia of the rotors that the robot file tells, kg m^2 or kg; 0 where it does not.
    told_rotors: SVector<f64, N>,
    loaded: Robot<N>,
    derivatives: [Robot<N>; 4],
    /// State at the start of the present window, the sum of torques in it, and its ticks.
    start: Option<(SVector<f64, N>, SVector<f64, N>)>,
    tau: SVector<f64, N>,
    ticks: u32,
    /// The last window, and how many columns of `Y` are there: one a tick, so that no tick has all the work.
    sample: Option<Sample<N>>,
    columns: usize,
    Y: SMatrix<f64, N, 4>,
    /// That of the last window.
    last_Y: SMatrix<f64, N, 4>,
    /// Weights that are left to the joints until they have moved on.
    fresh: SVector<f64, N>,
    information: Matrix4<f64>,
    right: Vector4<f64>,
    /// Sum of the weighted squares of the torques.
    squares: f64,
    friction: [FrictionSums; N],
    /// Mass and first moment about the flange that are in the model.
    believed: Vector4<f64>,
    is_confirmed: bool,
    /// Mean of `Y` over the last windows, and the variance of what a payload that is not known takes beyond that mean, (N m)^2 or N^2.
    mean_Y: Option<SMatrix<f64, N, 4>>,
    doubt: SVector<f64, N>,
}

/// Weighted sums over the windows of a joint with its friction by the model, `F`: of `F Y`, `F^2` and `F y`.
#[derive(Debug, Clone, Copy, Default)]
struct FrictionSums {
    by_Y: Vector4<f64>,
    by_F: f64,
    by_y: f64,
}

/// The means of a window.
#[derive(Debug, Clone, Copy)]
struct Sample<const N: usize> {
    q: SVector<f64, N>,
    qd: SVector<f64, N>,
    qdd: SVector<f64, N>,
    tau: SVector<f64, N>,
    friction: SVector<f64, N>,
    /// Standard deviation of the torques.
    sd: SVector<f64, N>,
    moved: SVector<f64, N>,
}

impl<const N: usize> PayloadEstimator<N> {
    /// No payload is known of the arm `bare`.
    pub(super) fn new(bare: Robot<N>) -> Self {
        Self {
            loaded: bare.clone(),
            derivatives: bare.payload_derivatives(),
            told_rotors: bare.armature(),
            bare,
            start: None,
            tau: SVector::zeros(),
            ticks: 0,
            sample: None,
            columns: 0,
            Y: SMatrix::zeros(),
            last_Y: SMatrix::zeros(),
            fresh: SVector::repeat(1.0),
            information: Matrix4::zeros(),
            right: Vector4::zeros(),
            squares: 0.0,
            friction: [FrictionSums::default(); N],
            believed: Vector4::zeros(),
            is_confirmed: false,
            mean_Y: None,
            doubt: SVector::zeros(),
        }
    }

    /// The arm with the payload that was found.
    pub(super) fn robot(&self) -> &Robot<N> {
        &self.loaded
    }

    /// The arm has rotors with the inertia `change` more, kg m^2 or kg. What was learnt without them of a payload that is not believed yet may have been they.
    pub(super) fn add_rotors(&mut self, change: &SVector<f64, N>) {
        for (i, change) in change.iter().enumerate() {
            self.bare.add_armature(i, *change);
            self.loaded.add_armature(i, *change);
        }
        if self.is_new() {
            (self.information, self.right, self.squares) = (Matrix4::zeros(), Vector4::zeros(), 0.0);
            self.friction = [FrictionSums::default(); N];
            self.fresh = SVector::repeat(1.0);
        }
    }

    /// The payload that was found, as it most likely is; the model may have its centre of mass nearer to the flange. `None` where there is none.
    pub(super) fn payload(&self) -> Option<PayloadFound> {
        let PayloadEstimate { found, covariance, .. } = self.estimate();
        (!self.is_new()).then(|| {
            let (mass, com) = mass_and_com(&found);
            // h = m c: of the centre of mass is what is left of the moment's beside the mass's.
            let com_var = |k: usize| {
                let c = com[k - 1];
                covariance[(k, k)] - 2.0 * c * covariance[(0, k)] + c * c * covariance[(0, 0)]
            };
            PayloadFound {
                mass,
                mass_sd: covariance[(0, 0)].max(0.0).sqrt(),
                com,
                com_sd: Vector3::from_fn(|k, _| com_var(k + 1).max(0.0).sqrt() / mass),
            }
        })
    }

    /// What the torques say of a payload beyond the model's.
    pub(super) fn unmodelled(&self) -> UnmodelledPayload {
        let PayloadEstimate { found, covariance, .. } = self.estimate();
        let inertia_sd = found[0].max(0.0) * RADIUS_M * RADIUS_M;
        UnmodelledPayload { mean: found - self.believed, covariance, inertia_sd }
    }

    /// The derivatives of the torques by mass and first moment in the last window that has ended.
    pub(super) fn derivatives(&self) -> &SMatrix<f64, N, 4> {
        &self.last_Y
    }

    /// Whether none of it is in the model yet.
    pub(super) fn is_new(&self) -> bool {
        self.believed == Vector4::zeros()
    }

    /// The variance of what a payload takes that is not known, beyond what it has taken lately, for each joint, (N m)^2 or N^2.
    pub(super) fn doubt(&self) -> &SVector<f64, N> {
        &self.doubt
    }

    /// Whether a window has ended with the last tick.
    pub(super) fn has_finished_window(&self) -> bool {
        self.ticks == 0
    }

    /// Whether the efforts of the arm hold it in `q` with the estimate. One that they do not hold is not taken: an arm that gives way to it comes to
    /// rest, and one that strains against it does not.
    pub(super) fn is_held_in(&mut self, q: &SVector<f64, N>) -> bool {
        let wanted = self.estimate().payload;
        let gravity = self.carry(&wanted).gravity(q);
        let believed = self.believed;
        self.carry(&believed);
        self.loaded.limits().iter().zip(gravity.iter()).all(|(limit, g)| g.abs() < HOLDS * limit.effort)
    }

    fn carry(&mut self, payload: &Vector4<f64>) -> &Robot<N> {
        let (mass, com_E) = mass_and_com(payload);
        self.loaded.set_payload(&self.bare, mass, &com_E);
        &self.loaded
    }

    /// Share of the accelerations `qdd` (rad/s^2 or m/s^2) for which the efforts of the arm suffice in `q`, whatever their signs are, and the share of
    /// velocities with which it may move on: it comes to 0 where gravity takes all of a joint's effort.
    pub(super) fn shares_of_effort(&self, q: &SVector<f64, N>, qdd: &SVector<f64, N>) -> (f64, f64) {
        let (g, B) = (self.loaded.gravity(q), self.loaded.mass_matrix(q));
        let (mut share, mut strength) = (1.0_f64, 1.0_f64);
        for (i, limit) in self.loaded.limits().iter().enumerate() {
            let turns: f64 = B.row(i).iter().zip(qdd.iter()).map(|(b, a)| b.abs() * a).sum();
            let rubs = self.loaded.friction()[i].coulomb;
            share = share.min((EFFORT_USED * limit.effort - g[i].abs() - rubs) / turns);
            strength = strength.min((HOLDS - g[i].abs() / limit.effort) / FADES);
        }
        (share.max(LEAST_SHARE), strength.max(0.0))
    }

    /// Forgets the present window: what moved the arm in it is not known.
    pub(super) fn skip(&mut self) {
        (self.start, self.ticks) = (None, 0);
        self.tau = SVector::zeros();
    }

    /// Takes in what the joints did in the tick in which the torques `tau` acted, N m or N; whether the payload is to be [taken](Self::adopt).
    pub(super) fn note(&mut self, tau: &SVector<f64, N>, motion: &JointTick<N>) -> bool {
        let Some((q, qd)) = self.start else {
            self.start = motion.is_new.then_some((motion.q, motion.qd));
            return false;
        };
        self.tau += tau;
        self.ticks += 1;
        if self.ticks >= WINDOW && motion.is_new {
            self.sample = Some(self.sample_of((q, qd), motion));
            self.columns = 0;
            self.skip();
            self.start = Some((motion.q, motion.qd));
        }
        let Some(sample) = &self.sample else { return false };
        if let Some(derivative) = self.derivatives.get(self.columns) {
            let column = derivative.inverse_dynamics(&sample.q, &sample.qd, &sample.qdd);
            self.Y.set_column(self.columns, &column);
            self.columns += 1;
            return false;
        }
        let sample = *sample;
        self.sample = None;
        self.last_Y = self.Y;
        self.learn(&sample);
        let PayloadEstimate { payload: wanted, is_clear, covariance, .. } = self.estimate();
        self.is_confirmed |= is_clear;
        let mean = *self.mean_Y.get_or_insert(self.Y);
        let varied = self.Y - mean;
        self.doubt = SVector::from_fn(|i, _| (varied.row(i) * covariance).dot(&varied.row(i)));
        self.mean_Y = Some(mean + varied * RECENT);
        self.is_confirmed && (wanted - self.believed).amax() > SAME
    }

    /// Puts the estimate into the model where none is yet, else moves the model towards it; the change of mass and first moment, kg and kg m.
    pub(super) fn adopt(&mut self) -> Vector4<f64> {
        let sure = self.estimate().payload;
        let change = (sure - self.believed) * if self.is_new() { 1.0 } else { FOLLOW };
        self.believed += change;
        let believed = self.believed;
        self.carry(&believed);
        change
    }

    fn sample_of(&self, start: (SVector<f64, N>, SVector<f64, N>), end: &JointTick<N>) -> Sample<N> {
        let (q, qd) = ((start.0 + end.q) * 0.5, (start.1 + end.qd) * 0.5);
        let ticks = f64::from(self.ticks);
        let qdd = (end.qd - start.1) / (ticks * TICK.as_s());
        let friction = self.bare.friction_torque(&qd);
        let sd = SVector::from_fn(|i, _| {
            let effort = self.bare.limits()[i].effort;
            let stands = qd[i].abs() < MOVES;
            let rubs = if stands { self.bare.friction()[i].coulomb } else { SHAPE * friction[i] };
            let told = self.told_rotors[i];
            let rotor = if told > 0.0 { TOLD_ROTOR * told } else { ROTOR * effort };
            let turns = rotor * qdd[i].abs();
            (rubs * rubs + turns * turns + (EFFORT * effort).powi(2) + end.noise[i].powi(2)).sqrt()
        });
        let tau = self.tau / ticks;
        Sample { q, qd, qdd, tau, friction, sd, moved: end.q - start.0 }
    }

    fn learn(&mut self, sample: &Sample<N>) {
        let y = sample.tau - self.bare.inverse_dynamics(&sample.q, &sample.qd, &sample.qdd) - sample.friction;
        for i in 0..N {
            self.fresh[i] = (self.fresh[i] + sample.moved[i].abs() / WAY).min(1.0);
            let weight = self.fresh[i].min(WEIGHT);
            self.fresh[i] -= weight;
            let (row, weight) = (self.Y.row(i), weight / (sample.sd[i] * sample.sd[i]));
            if weight.is_finite() && y[i].is_finite() {
                self.information += row.transpose() * row * weight;
                self.right += row.transpose() * (y[i] * weight);
                self.squares += weight * y[i] * y[i];
                let (F, sums) = (sample.friction[i], &mut self.friction[i]);
                sums.by_Y += row.transpose() * (F * weight);
                sums.by_F += F * F * weight;
                sums.by_y += F * y[i] * weight;
            }
        }
    }

    /// Mass and first moment, the latter nearer to zero by [`SURE`] standard deviations, and whether they explain the torques clearly better than
    /// none.
    fn estimate(&self) -> PayloadEstimate {
        let (m, h) = (PRIOR_KG.powi(-2), PRIOR_KG_M.powi(-2));
        let mut A = self.information + Matrix4::from_diagonal(&Vector4::new(m, h, h, h));
        let (mut right, mut squares) = (self.right, self.squares);
        for FrictionSums { by_Y, by_F, by_y } in &self.friction {
            let per = 1.0 / (by_F + FRICTION.powi(-2));
            A -= by_Y * by_Y.transpose() * per;
            right -= by_Y * (by_y * per);
            squares -= by_y * by_y * per;
        }
        let Some(factors) = Ldlt::of(&A) else {
            return PayloadEstimate {
                found: self.believed,
                payload: self.believed,
                is_clear: false,
                covariance: Matrix4::zeros(),
            };
        };
        let found: Vector4<f64> = factors.solve(&right.into()).into();
        let explained = right.dot(&found);
        let is_clear = explained > CONFIRMED && explained > EXPLAINED * squares && found[0] > 0.0;
        let covariance = Matrix4::from(factors.inverse());
        let mut sure = found;
        for k in 1..4 {
            sure[k] = (found[k].abs() - SURE * covariance[(k, k)].sqrt()).max(0.0) * found[k].signum();
        }
        let mass = found[0].clamp(0.0, MOST_KG);
        let far = sure.fixed_rows::<3>(1).norm();
        let h = sure.fixed_rows::<3>(1) * (FARTHEST_M * mass / far.max(f64::MIN_POSITIVE)).min(1.0);
        PayloadEstimate { found, payload: Vector4::new(mass, h.x, h.y, h.z), is_clear, covariance }
    }
}

/// What the torques say of the payload.
struct PayloadEstimate {
    /// Mass and first moment that are likely, and those that are to be in the model.
    found: Vector4<f64>,
    payload: Vector4<f64>,
    /// Whether it explains the torques clearly better than none.
    is_clear: bool,
    covariance: Matrix4<f64>,
}

/// A payload that was found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PayloadFound {
    /// Mass, kg.
    pub mass: f64,
    /// Its standard deviation, kg.
    pub mass_sd: f64,
    /// Centre of mass in the flange's frame, m.
    pub com: Vector3<f64>,
    /// Its standard deviation along each axis, m.
    pub com_sd: Vector3<f64>,
}

/// What a payload has that is not in the model.
pub(super) struct UnmodelledPayload {
    /// Mass and first moment, kg and kg m.
    pub(super) mean: Vector4<f64>,
    pub(super) covariance: Matrix4<f64>,
    /// Moments of inertia of all of it beyond a point mass, as a standard deviation, kg m^2.
    pub(super) inertia_sd: f64,
}

/// Mass, kg, and centre of mass, m, of a mass and its first moment.
fn mass_and_com(load: &Vector4<f64>) -> (f64, Vector3<f64>) {
    let h = load.fixed_rows::<3>(1).into_owned();
    (load[0], if load[0] > 0.0 { h / load[0] } else { Vector3::zeros() })
}

#[cfg(test)]
mod tests;
