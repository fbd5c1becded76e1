//! What the joint controller knows of the arm beyond its model: how fast the joints really move, and which torque acts
//! on them that the model does not know (friction, load, masses).
//!
//! The controller commands `B u + C qd + g + F(w) + f - (B p + t)`: an acceleration `u`, friction for the velocity `w`,
//! joint torques `f` of its feedback, less the disturbance. A disturbance `d` then shows in
//!
//! ```text
//! d - (B p + t) = B (v' - u) + F(v) - F(w) - f
//! p' = r (v' - u)        t' = r (F(v) - F(w) - f)     estimate of d: B p + t, learnt at the rate r, rad/s
//! ```
//! What is moved by inertia is learnt as acceleration, what is held by friction as torque, so that neither asks for the
//! mass matrix. That `F` is all of the friction is what frees a joint that sticks: there a small velocity is a large torque. What
//! turns about with the motion is learnt as a [share of the model's friction](friction). What the effort limits cut is no disturbance: `u` is the acceleration that was really commanded.
//!
//! Where positions come in steps or with noise, velocities are those of an observer: the command moves it, the positions
//! correct it, as far as they lie outside of the step in which it is.
//!
//! ```text
//! q^' = v^ + (2 + m) l e      v^' = u + a + (1 + 2 m) l^2 e      a' = m l^3 e - f a      e = dead zone of (q - q^)
//! ```
//! `a` is what the arm does beside the command while it moves (`m` = 1): without it a load that makes a wrist five times as heavy as
//! believed would make the velocity wrong by so much that the arm swings. At rest `m` is 0.
//!
//! Steps tell of a motion only as often as they come. So `l` and `r` fall with the speed of the reference, and rise when the
//! arm is found a step away: at rest the estimate stands, and no step shakes the arm. Within a step it is the camera that tells
//! of a motion ([`Drift`]): what the joints did between two exposures beyond what was believed is an error of `v^`.

mod friction;
mod seen;

use crate::linalg::Ldlt;
use crate::robot::Robot;
use crate::servo::Drift;
use crate::time::{MonoNs, TICK};
use friction::{FrictionShare, TorqueResidual};
use nalgebra::SVector;
use seen::ObservedMotion;

/// Share of the full bandwidth from which on what accelerates the arm is estimated, and the rate at which that is forgotten, rad/s.
const QUICK_FROM: f64 = 0.6;
const FORGET_RAD_S: f64 = 100.0;
/// Corrections of the velocity for each step that comes by.
const CORRECTIONS: f64 = 2.0;
/// Share of its bandwidth that the velocity observer keeps at rest, and how much of that it leaves to a camera.
const BANDWIDTH_AT_REST: f64 = 0.2;
const LEFT_TO_A_CAMERA: f64 = 0.5;
/// Steps a second from which on a disturbance is learnt at the full rate.
const STEPS_TO_LEARN_1_S: f64 = 100.0;
/// Steps a second up to which a velocity is not told from a standstill, in judging by friction.
const STEPS_WIDE_1_S: f64 = 200.0;
/// Ticks over which the mean of a disturbance is taken: longer than it takes to tell that an arm is jammed or swings.
const MEAN_TICKS: u32 = 1000;
/// Share of that rate that is kept at rest.
const RATE_AT_REST: f64 = 0.02;

/// What the observer goes by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObserverSettings<const N: usize> {
    /// Rate at which a disturbance is learnt, rad/s; 0: none is.
    pub disturbance_rad_s: f64,
    /// Bandwidth of the velocity observer, rad/s; 0: velocities are taken as they are measured.
    pub velocity_rad_s: f64,
    /// Step of each encoder, with its noise, rad or m.
    pub encoder_step: SVector<f64, N>,
    /// Largest disturbance of each joint, rad/s^2 or m/s^2.
    pub max_acceleration: SVector<f64, N>,
    /// Inertia of each joint while the others are free, about, kg m^2 or kg.
    pub inertia: SVector<f64, N>,
}

impl<const N: usize> ObserverSettings<N> {
    /// The disturbances that the arm can make up for at all: what the efforts of all joints do to each in the posture `q`.
    #[must_use]
    pub fn bound(robot: &Robot<N>, q: &SVector<f64, N>) -> SVector<f64, N> {
        let effort = robot.limits().map(|limit| limit.effort);
        Ldlt::of(&robot.mass_matrix(q)).map_or(SVector::zeros(), |factors| {
            let inverse = factors.inverse();
            SVector::from_fn(|i, _| inverse[i].iter().zip(&effort).map(|(x, effort)| x.abs() * effort).sum())
        })
    }

    /// The inertia of each joint while the others are free, in the posture `q`.
    #[must_use]
    pub fn free_inertia(robot: &Robot<N>, q: &SVector<f64, N>) -> SVector<f64, N> {
        Ldlt::of(&robot.mass_matrix(q)).map_or(SVector::zeros(), |factors| {
            let inverse = factors.inverse();
            SVector::from_fn(|i, _| inverse[i][i].recip())
        })
    }

    /// No disturbance, velocities as they are measured.
    #[must_use]
    pub fn none() -> Self {
        let zero = SVector::zeros();
        Self {
            disturbance_rad_s: 0.0,
            velocity_rad_s: 0.0,
            encoder_step: zero,
            max_acceleration: zero,
            inertia: zero,
        }
    }
}

/// A command that acts until the next tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Commanded<const N: usize> {
    /// Acceleration, disturbance made up for.
    pub(super) u: SVector<f64, N>,
    /// Mean velocity for which friction is made up.
    pub(super) w: SVector<f64, N>,
    /// Velocity that is requested.
    pub(super) velocity: SVector<f64, N>,
    /// Torque of the feedback.
    pub(super) feedback: SVector<f64, N>,
    /// Friction that was made up for, by the model.
    pub(super) friction: SVector<f64, N>,
}

/// Velocities and disturbances of the joints.
#[derive(Debug, Clone)]
pub(super) struct JointObserver<const N: usize> {
    settings: ObserverSettings<N>,
    /// Position and velocity at the last tick.
    state: Option<(SVector<f64, N>, SVector<f64, N>)>,
    commanded: Option<Commanded<N>>,
    /// The disturbance: its acceleration and its torque.
    p: SVector<f64, N>,
    t: SVector<f64, N>,
    /// What it was in the mean of some time ago.
    past: Past<N>,
    /// What accelerates the joints beside what was commanded just now, rad/s^2 or m/s^2: for their velocity alone.
    a: SVector<f64, N>,
    /// Whether nothing is learnt.
    settled: bool,
    /// Share of the rate of learning that is left to an arm that swings.
    share: f64,
    /// What the camera has told.
    seen: ObservedMotion<N>,
    /// What is known of friction.
    friction: FrictionShare<N>,
}

impl<const N: usize> JointObserver<N> {
    pub(super) fn new(settings: ObserverSettings<N>) -> Self {
        let zero = SVector::zeros();
        Self {
            settings,
            state: None,
            commanded: None,
            p: zero,
            t: zero,
            past: Past::default(),
            settled: false,
            share: 1.0,
            a: zero,
            seen: ObservedMotion::default(),
            friction: FrictionShare::default(),
        }
    }

    /// The disturbance: what of it is known as an acceleration, and what as a torque.
    pub(super) fn disturbance(&self) -> (&SVector<f64, N>, &SVector<f64, N>) {
        (&self.p, &self.t)
    }

    /// Steps of the encoders, rad or m.
    pub(super) fn encoder_step(&self) -> &SVector<f64, N> {
        &self.settings.encoder_step
    }

    /// Friction beyond the model's, as a share of it.
    pub(super) fn friction_share(&self) -> &SVector<f64, N> {
        self.friction.share()
    }

    /// Forgets how the arm moves, not what disturbs it.
    pub(super) fn reset_to_measured(&mut self, q: &SVector<f64, N>, qd: &SVector<f64, N>) {
        self.state = Some((*q, *qd));
        self.commanded = None;
        self.a = SVector::zeros();
    }

    /// From now on the disturbance is what it was in the mean of some time ago, and nothing is learnt: what was learnt from an
    /// arm that swings or is jammed swings and pushes itself. Or no more so.
    pub(super) fn settle(&mut self, settled: bool) {
        self.settled = settled;
        if settled {
            (self.p, self.t) = self.past.before;
        }
    }

    /// From now on nothing is learnt, and what was learnt stays. Or no more so.
    pub(super) fn pause(&mut self, paused: bool) {
        self.settled = paused;
    }

    /// From now on a disturbance is learnt at `share` of the rate.
    pub(super) fn learn_at(&mut self, share: f64) {
        self.share = share;
    }

    /// Takes in, at `now`, what a camera saw of the joints beyond what was believed.
    pub(super) fn learn(&mut self, drift: &Drift<N>, now: MonoNs) {
        let (true, Some((_, v))) = (self.settings.velocity_rad_s > 0.0, &mut self.state) else { return };
        let velocity = self.commanded.map_or(SVector::zeros(), |commanded| commanded.velocity);
        let dv = self.seen.correction(drift, now, &self.settings.encoder_step, &velocity);
        *v += dv;
        if !self.settled && self.settings.disturbance_rad_s > 0.0 {
            let most = &self.settings.max_acceleration;
            self.p = (self.p + dv * seen::RATE_1_S).zip_map(most, |p, most| p.clamp(-most, most));
        }
    }

    /// What acts until the next tick.
    pub(super) fn command(&mut self, commanded: Commanded<N>) {
        self.commanded = Some(commanded);
    }

    /// Takes the measured state of a tick in; position and velocity to go by.
    pub(super) fn observe(
        &mut self,
        robot: &Robot<N>,
        q: &SVector<f64, N>,
        qd: &SVector<f64, N>,
    ) -> (SVector<f64, N>, SVector<f64, N>) {
        let settings = &self.settings;
        let h = TICK.as_s();
        let (Some((q_before, v_before)), Some(commanded)) = (self.state, self.commanded) else {
            let state = *self.state.get_or_insert((*q, *qd));
            return if settings.velocity_rad_s > 0.0 { state } else { (*q, *qd) };
        };
        let (mut q_now, mut v_now) = (*q, *qd);
        let trust = self.seen.trust();
        for i in 0..N {
            let mut rate = if self.settled { 0.0 } else { settings.disturbance_rad_s * self.share };
            if settings.velocity_rad_s > 0.0 {
                let v = v_before[i] + h * (commanded.u[i] + self.a[i]);
                let predicted = q_before[i] + 0.5 * h * (v_before[i] + v);
                let step = settings.encoder_step[i];
                let e = outside(q[i] - predicted, 0.5 * step);
                let mut l = settings.velocity_rad_s;
                if step > 0.0 {
                    let (steps_1_s, steps_off) = (commanded.velocity[i].abs() / step, e.abs() / step);
                    let least = BANDWIDTH_AT_REST * (1.0 - LEFT_TO_A_CAMERA * trust[i]);
                    l *= (CORRECTIONS * steps_1_s / l).max(steps_off - 0.5).clamp(least, 1.0);
                    rate *= (steps_1_s / STEPS_TO_LEARN_1_S).max(steps_off - 0.5).clamp(RATE_AT_REST, 1.0);
                }
                let m = ((l / settings.velocity_rad_s - QUICK_FROM) / (1.0 - QUICK_FROM)).max(0.0);
                let (k_q, k_v, k_a) = ((2.0 + m) * l, (1.0 + 2.0 * m) * l * l, m * l * l * l);
                q_now[i] = predicted + (k_q * h).min(1.0) * e;
                v_now[i] = v + k_v * h * e;
                self.a[i] += h * (k_a * e - FORGET_RAD_S * self.a[i]);
            }
            if rate > 0.0 {
                let friction = &robot.friction()[i];
                let accelerated = v_now[i] - v_before[i] - h * commanded.u[i];
                // Over the step, like what was made up for: at its end a joint that turns about rubs the other way already.
                let width = STEPS_WIDE_1_S * settings.encoder_step[i];
                let rubbed = friction.viscous * ((q_now[i] - q_before[i]) / h - commanded.w[i])
                    + friction.coulomb_part((q_now[i] - q_before[i]) / h, width)
                    - friction.coulomb_part(commanded.w[i], width);
                let residual = TorqueResidual {
                    rho: settings.inertia[i] * accelerated / h + rubbed - commanded.feedback[i],
                    friction: commanded.friction[i],
                    inertial: settings.inertia[i] * commanded.u[i],
                    gain: rate * h,
                };
                self.friction.learn(i, friction, &residual, h);
                let most = settings.max_acceleration[i];
                self.p[i] = (self.p[i] + rate * accelerated).clamp(-most, most);
                let most = robot.limits()[i].effort;
                self.t[i] = (self.t[i] + rate * h * (rubbed - commanded.feedback[i])).clamp(-most, most);
            }
        }
        if !self.settled {
            self.past.note(&self.p, &self.t);
        }
        self.state = Some((q_now, v_now));
        (q_now, v_now)
    }
}

/// Means of the disturbance over one second after the other, as accelerations and as torques.
#[derive(Debug, Clone)]
struct Past<const N: usize> {
    /// Over the second before the last one that is complete: from one to three seconds ago.
    before: (SVector<f64, N>, SVector<f64, N>),
    last: (SVector<f64, N>, SVector<f64, N>),
    sum: (SVector<f64, N>, SVector<f64, N>),
    ticks: u32,
}

impl<const N: usize> Default for Past<N> {
    fn default() -> Self {
        let zero = (SVector::zeros(), SVector::zeros());
        Self { before: zero, last: zero, sum: zero, ticks: 0 }
    }
}

impl<const N: usize> Past<N> {
    fn note(&mut self, p: &SVector<f64, N>, t: &SVector<f64, N>) {
        self.sum.0 += p;
        self.sum.1 += t;
        self.ticks += 1;
        if self.ticks == MEAN_TICKS {
            let share = 1.0 / f64::from(MEAN_TICKS);
            self.before = self.last;
            self.last = (self.sum.0 * share, self.sum.1 * share);
            self.sum = (SVector::zeros(), SVector::zeros());
            self.ticks = 0;
        }
    }
}

/// By how much `x` lies outside of `-half..half`.
fn outside(x: f64, half: f64) -> f64 {
    x - x.clamp(-half, half)
}
