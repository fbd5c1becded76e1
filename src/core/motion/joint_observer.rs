//! Joint velocity and disturbance observer: estimates how fast the joints move, and the torque that acts on them and is not in the model
//! (friction, load, masses).
//!
//! The controller commands `B u + C qd + g + F(w) + f - (B p + t)`: an acceleration `u`, friction compensation for the velocity `w`,
//! feedback torques `f`, minus the estimated disturbance. A disturbance `d` then satisfies
//!
//! ```text
//! d - (B p + t) = B (v' - u) + F(v) - F(w) - f
//! p' = r (v' - u)        t' = r (F(v) - F(w) - f)     estimate of d: B p + t, with the estimation rate r, rad/s
//! ```
//! The inertial part of the disturbance is estimated as an acceleration and the friction part as a torque, so that neither needs the
//! mass matrix. `F` contains static friction too, where a small velocity is a large torque: this frees a joint that sticks. The part
//! that changes sign with the velocity is estimated as a [share of the model's friction](friction). Torque that the effort limits cut is
//! not a disturbance: `u` is the acceleration that was in fact commanded.
//!
//! Where positions are quantized or noisy, velocities are those of an observer. It is predicted with the command and corrected with the
//! part of the position error that exceeds half an encoder step.
//!
//! ```text
//! q^' = v^ + (2 + m) l e      v^' = u + a + (1 + 2 m) l^2 e      a' = m l^3 e - f a      e = dead zone of (q - q^)
//! ```
//! `a` is the acceleration that is not explained by the command, while the arm moves (`m` = 1). Without it, a load that makes a wrist five
//! times as heavy as modelled would cause a velocity error that makes the arm oscillate. At rest `m` is 0.
//!
//! Encoder steps carry information about the motion only when they occur. So `l` and `r` fall with the speed of the reference, `l` no further than steps are coarse, and rise when
//! the position error exceeds a step: at rest the estimate is frozen, and single steps do not excite the arm. Steps that nobody told are [found](found_steps). Within a step the camera
//! measures the motion ([`UnobservedMotion`]): the joint displacement between two exposures, minus the estimated one, is an error of `v^`.

mod bandwidth;
mod bound;
mod breakaway;
mod camera_correction;
mod confirmed_friction;
mod found_steps;
mod friction;
mod model_change;
mod past;
mod reversals;
mod settings;
mod sticking;
mod unheard;
mod untold_friction;

pub use settings::ObserverSettings;

use crate::robot::{Friction, Robot};
use crate::servo::UnobservedMotion;
use crate::time::{MonoNs, TICK};
use bandwidth::{QUIET, STEP_GAIN};
use bound::within;
use camera_correction::CameraCorrection;
use confirmed_friction::{ConfirmedFriction, FrictionResponse};
use found_steps::FoundSteps;
use friction::{FrictionShare, TorqueResidual};
use nalgebra::SVector;
use past::Past;
use reversals::Reversals;
use sticking::{StandingTick, Sticking};
use untold_friction::UntoldFriction;

// `tests/cores/arm_unlike_model.rs` holds these numbers together: it draws encoder steps of 1e-6 to 5e-4, loads and friction that differ
// from the model, and bounds the share of runs that fail.

/// Share of the full bandwidth above which the unexplained acceleration is estimated, and its decay rate, rad/s. Chosen by hand; the
/// full bandwidth is 400 rad/s by default.
const ACCELERATION_FROM: f64 = 0.6;
const FORGET_RAD_S: f64 = 100.0;
/// Bandwidth of the velocity observer in units of the rate of encoder steps. Chosen by hand: a correction every half step.
const CORRECTIONS: f64 = 2.0;
/// Share of its bandwidth that the velocity observer keeps at rest, and the part of that which a trusted camera replaces. Chosen by hand:
/// with none of it a joint that creeps would be taken for one at rest until the next encoder step, with all of it single steps excite the arm.
const BANDWIDTH_AT_REST: f64 = 0.2;
const LEFT_TO_A_CAMERA: f64 = 0.5;
/// Encoder steps per second from which on the disturbance is estimated at the full rate. Chosen by hand: one in ten ticks.
const STEPS_TO_LEARN_1_S: f64 = 100.0;
/// Encoder steps per second below which a velocity cannot be distinguished from standstill, for the sign of Coulomb friction. Chosen by
/// hand: one in five ticks.
const STEPS_WIDE_1_S: f64 = 200.0;
/// Speed below which a joint stands, and speeds of its reference and of the decay of its error up to which it is left standing, rad/s or m/s.
/// Chosen by hand: a tenth of the width over which friction changes its sign in smooth models, and four times that width; at 40 rad/s the error is
/// then within 0.1 mrad. Where all joints were treated so, an xArm7 with hard friction hunted for 9 to 17 s with a quarter of it, and for 2 to 13 s with this.
const STANDS: f64 = 1e-4;
const STUCK: f64 = 4e-3;
/// Times the Coulomb friction that may drive a joint that comes loose: static friction may be larger than the model's, and turns into torque at once. Chosen: friction is tested up to twice that of the file.
const LOOSE: f64 = 2.0;
/// Largest share of the model's friction that is compensated, over the confirmed one where that is more than [`MOST_UNMEASURED`]: a joint that sticks and
/// slips makes the estimate grow, and more than its true friction drives it. Chosen by hand: a quarter more than the confirmed share.
const MOST_FRICTION: f64 = 1.25;
/// The confirmed share from which on it is friction of another kind. Chosen by hand: above twice the model's friction, measured with an error of 0.15.
const OTHER: f64 = 2.3;
/// The confirmed share up to which that is a quarter of this: twice the model's friction is what arms are tested with.
const MOST_UNMEASURED: f64 = 2.0;
/// Share of the estimation rate that is kept at rest. Chosen by hand: 1 / 50, so that an arm that is held by friction still adapts.
const RATE_AT_REST: f64 = 0.02;

/// A command that acts until the next tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Commanded<const N: usize> {
    /// Acceleration, with the disturbance compensated.
    pub(super) u: SVector<f64, N>,
    /// Mean velocity for which friction is compensated, and the one for which its Coulomb part is.
    pub(super) w: SVector<f64, N>,
    pub(super) w_coulomb: SVector<f64, N>,
    /// Velocity that is requested.
    pub(super) velocity: SVector<f64, N>,
    /// Torque of the feedback.
    pub(super) feedback: SVector<f64, N>,
    /// Friction of the model.
    pub(super) friction: SVector<f64, N>,
    /// The part of it that was compensated.
    pub(super) compensated: SVector<f64, N>,
    /// Velocity at which the error is to decay.
    pub(super) slip: SVector<f64, N>,
    /// Velocity beyond `w` for which viscous friction is compensated.
    pub(super) extra: SVector<f64, N>,
    /// Velocity of the reference that the joints follow; `None` where they follow none.
    pub(super) reference: Option<SVector<f64, N>>,
}

/// Velocities and disturbances of the joints.
#[derive(Debug, Clone)]
pub(super) struct JointObserver<const N: usize> {
    settings: ObserverSettings<N>,
    /// Step of each encoder, told or found, with its noise, rad or m.
    steps: SVector<f64, N>,
    found: FoundSteps<N>,
    /// Position and velocity at the last tick.
    state: Option<(SVector<f64, N>, SVector<f64, N>)>,
    commanded: Option<Commanded<N>>,
    /// The disturbance: its acceleration and its torque.
    p: SVector<f64, N>,
    t: SVector<f64, N>,
    /// Its means over earlier seconds.
    past: Past<N>,
    /// Acceleration of the joints that the present command does not explain, rad/s^2 or m/s^2; used for their velocity alone.
    a: SVector<f64, N>,
    /// Whether the estimation is frozen.
    settled: bool,
    /// Whether the model's friction is believed wholly, after a fault: what is estimated then carries an arm that sinks.
    believed: bool,
    /// Factor of the estimation rate, less than 1 for an arm that oscillates.
    share: f64,
    /// Velocity corrections from the camera.
    camera: CameraCorrection<N>,
    /// The estimated share of friction.
    friction: FrictionShare<N>,
    /// How much of the model's friction there is at all.
    confirmed: ConfirmedFriction<N>,
    /// Friction that the file does not tell, and the disturbance when the reference last stood.
    untold: UntoldFriction<N>,
    at_rest: (SVector<f64, N>, SVector<f64, N>),
    /// The last readings, and the disturbance when each of them last changed.
    heard: (SVector<f64, N>, SVector<f64, N>, SVector<f64, N>),
    /// Joints whose encoders are not trusted: nothing is learnt from them.
    unheard: [bool; N],
    sticking: Sticking<N>,
    reversals: Reversals<N>,
}

impl<const N: usize> JointObserver<N> {
    pub(super) fn new(settings: ObserverSettings<N>) -> Self {
        let zero = SVector::zeros();
        Self {
            settings,
            steps: settings.encoder_step,
            found: FoundSteps::default(),
            state: None,
            commanded: None,
            p: zero,
            t: zero,
            past: Past::default(),
            settled: false,
            believed: false,
            share: 1.0,
            a: zero,
            camera: CameraCorrection::default(),
            friction: FrictionShare::default(),
            confirmed: ConfirmedFriction::new(&settings.inertia),
            untold: UntoldFriction::default(),
            at_rest: (zero, zero),
            heard: (zero, zero, zero),
            unheard: [false; N],
            sticking: Sticking::default(),
            reversals: Reversals::default(),
        }
    }

    /// The estimated disturbance: its part as an acceleration and its part as a torque.
    pub(super) fn disturbance(&self) -> (&SVector<f64, N>, &SVector<f64, N>) {
        (&self.p, &self.t)
    }

    /// The share of the model's friction that is compensated.
    pub(super) fn friction_share(&self) -> SVector<f64, N> {
        let share = self.friction.share().add_scalar(1.0).component_mul(self.confirmed.share());
        share.zip_map(self.confirmed.share(), |share, confirmed| {
            share.min(MOST_FRICTION * confirmed.max(MOST_UNMEASURED))
        })
    }

    /// The share of the torque against an error's decay that each joint may have because it sticks; none for joints that do not.
    pub(super) fn slip_share(&self) -> SVector<f64, N> {
        self.sticking.slip_share()
    }

    /// The share of its Coulomb friction that each joint gets towards its reference because it sticks; `None` for joints that do not.
    pub(super) fn coulomb_share(&self) -> [Option<f64>; N] {
        self.sticking.coulomb_share()
    }

    /// The friction of each joint of `robot`, of which the share is compensated: that of its file, or what is looked for where the file tells none.
    pub(super) fn friction(&self, robot: &Robot<N>) -> [Friction; N] {
        std::array::from_fn(|i| self.friction_of(robot, i))
    }

    /// That of joint `i`. A share beyond those of warm and cold gears is friction of another kind beside the file's: Coulomb friction, because it was measured at a creep.
    fn friction_of(&self, robot: &Robot<N>, i: usize) -> Friction {
        let friction = self.untold.friction(robot, i);
        let share = self.confirmed.share()[i];
        let is_other = share > OTHER;
        if is_other { Friction { viscous: friction.viscous / share, ..friction } } else { friction }
    }

    /// The inertia of joints that have been found to stick and whose viscous friction is too little to be of use against an error that is to decay with `rate_1_s`: less than
    /// what accelerates the joint so; kg m^2 or kg, 0 for the others.
    pub(super) fn sticking_inertia(&self, robot: &Robot<N>, rate_1_s: f64) -> SVector<f64, N> {
        let inertia = &self.settings.inertia;
        SVector::from_fn(|i, _| {
            let is_stiffer = robot.friction()[i].viscous < inertia[i] * rate_1_s;
            if is_stiffer { self.sticking.stiffness()[i] * inertia[i] } else { 0.0 }
        })
    }

    /// Whether joints have begun to be probed that were found to resist, so that the reference is to be set to the arm: true once.
    pub(super) fn begins_anew(&mut self) -> bool {
        self.untold.take_new()
    }

    /// Lets the joints of an arm be probed that is to move next, or not; whether that is still to be done.
    pub(super) fn probe(&mut self, wanted: bool) -> bool {
        self.confirmed.probe(wanted)
    }

    /// Believes the friction of the model.
    pub(super) fn believe_friction(&mut self) {
        self.confirmed.believe();
    }

    /// The velocities that the joints of a standing arm, at the distances `e` to their reference (rad or m), are asked for while their friction
    /// is probed, rad/s or m/s.
    pub(super) fn probe_velocity(&self, e: &SVector<f64, N>) -> SVector<f64, N> {
        self.confirmed.probe_velocity(e)
    }

    /// Resets position and velocity to the measured ones, and keeps the disturbance estimate.
    pub(super) fn reset_to_measured(&mut self, q: &SVector<f64, N>, qd: &SVector<f64, N>) {
        self.state = Some((*q, *qd));
        self.commanded = None;
        self.a = SVector::zeros();
    }

    /// Freezes the disturbance estimate at its mean of a second or more ago, or releases it: an estimate from an arm that oscillates or is
    /// blocked oscillates and pushes itself.
    pub(super) fn settle(&mut self, settled: bool) {
        self.settled = settled;
        self.believed = settled;
        if settled {
            (self.p, self.t) = self.past.before;
            self.forget_unheard();
        }
    }

    /// The inertia of each joint while the others are free, about, kg m^2 or kg.
    pub(super) fn inertia(&self) -> &SVector<f64, N> {
        &self.settings.inertia
    }

    /// Freezes the disturbance estimate as it is, or releases it.
    pub(super) fn pause(&mut self, paused: bool) {
        self.settled = paused;
    }

    /// Scales the estimation rate by `share`.
    pub(super) fn learn_at(&mut self, share: f64) {
        self.share = share;
    }

    /// Corrects the velocities, at `now`, by the joint displacement that a camera measured in excess of the estimated one.
    pub(super) fn learn(&mut self, drift: &UnobservedMotion<N>, now: MonoNs) {
        let (true, Some((_, v))) = (self.settings.velocity_rad_s > 0.0, &mut self.state) else { return };
        let velocity = self.commanded.map_or(SVector::zeros(), |commanded| commanded.velocity);
        let dv = self.camera.correction(drift, now, &self.steps, &velocity);
        *v += dv;
        if !self.settled && self.settings.disturbance_rad_s > 0.0 {
            let most = &self.settings.max_acceleration;
            self.p = within(self.p, self.p + dv * camera_correction::RATE_1_S, most);
        }
    }

    /// Notes the command that acts until the next tick.
    pub(super) fn command(&mut self, commanded: Commanded<N>) {
        self.commanded = Some(commanded);
    }

    /// The command that acts accelerates the joints by so much more than was noted, rad/s^2 or m/s^2.
    pub(super) fn add_to_command(&mut self, acceleration: &SVector<f64, N>) {
        if let Some(commanded) = &mut self.commanded {
            commanded.u += acceleration;
        }
    }

    /// Takes in the measured state of a tick; returns the estimated position and velocity.
    pub(super) fn observe(
        &mut self,
        robot: &Robot<N>,
        q: &SVector<f64, N>,
        qd: &SVector<f64, N>,
    ) -> (SVector<f64, N>, SVector<f64, N>) {
        self.found.note(q, &self.settings.encoder_step, &mut self.steps);
        let settings = &self.settings;
        let h = TICK.as_s();
        let (Some((q_before, v_before)), Some(commanded)) = (self.state, self.commanded) else {
            let state = *self.state.get_or_insert((*q, *qd));
            return if settings.velocity_rad_s > 0.0 { state } else { (*q, *qd) };
        };
        let (mut q_now, mut v_now) = (*q, *qd);
        for i in 0..N {
            if q[i] != self.heard.0[i] && !self.unheard[i] {
                (self.heard.0[i], self.heard.1[i], self.heard.2[i]) = (q[i], self.p[i], self.t[i]);
            }
        }
        let learns = settings.disturbance_rad_s > 0.0 && !self.settled;
        if let Some(velocity) = commanded.reference.filter(|_| learns)
            && self.untold.note(robot, &velocity, q, &self.steps)
        {
            let untold = UntoldFriction::joints(robot);
            self.confirmed.probe_untold(&untold);
            // What was learnt since the joints should have moved is the friction that is looked for.
            for i in (0..N).filter(|i| untold[*i]) {
                (self.p[i], self.t[i]) = (self.at_rest.0[i], self.at_rest.1[i]);
            }
        }
        let rests = commanded.reference.is_some_and(|velocity| velocity.iter().all(|v| *v == 0.0));
        if rests {
            self.at_rest = (self.p, self.t);
        }
        let joints = self.friction(robot);
        let bandwidths: [f64; N] = std::array::from_fn(|i| self.bandwidth(i));
        let trust = self.camera.trust();
        let probing = !self.believed && self.confirmed.is_probing();
        let mut p = self.p;
        for i in 0..N {
            let mut rate =
                if self.settled || self.unheard[i] { 0.0 } else { settings.disturbance_rad_s * self.share };
            if settings.velocity_rad_s > 0.0 {
                let v = v_before[i] + h * (commanded.u[i] + self.a[i]);
                let predicted = q_before[i] + 0.5 * h * (v_before[i] + v);
                // Between two steps nothing is known; noise has a mean, which the observer takes by its bandwidth.
                let step = self.steps[i] - settings.encoder_noise[i];
                let e = outside(q[i] - predicted, 0.5 * step);
                let most = bandwidths[i];
                let mut l = most;
                if step > 0.0 {
                    let (steps_1_s, steps_off) = (commanded.velocity[i].abs() / step, e.abs() / step);
                    let least = BANDWIDTH_AT_REST * (1.0 - LEFT_TO_A_CAMERA * trust[i]);
                    let least = least.max(QUIET / (step * l)).min(1.0);
                    l *= (CORRECTIONS * steps_1_s / l).max(steps_off - 0.5).clamp(least, 1.0);
                    rate *= (steps_1_s / STEPS_TO_LEARN_1_S).max(steps_off - 0.5).clamp(RATE_AT_REST, 1.0);
                }
                let share = l / most;
                let m = ((share - ACCELERATION_FROM) / (1.0 - ACCELERATION_FROM)).max(0.0);
                let (k_q, k_v, k_a) = ((2.0 + m) * l, (1.0 + 2.0 * m) * l * l, m * l * l * l);
                q_now[i] = predicted + (k_q * h).min(1.0) * e;
                v_now[i] = v + k_v * h * e;
                self.a[i] += h * (k_a * e - FORGET_RAD_S * self.a[i]);
            }
            let friction = &joints[i];
            let width = STEPS_WIDE_1_S * self.steps[i];
            let speed = (q_now[i] - q_before[i]) / h;
            let accelerated = v_now[i] - v_before[i] - h * commanded.u[i];
            let response = FrictionResponse {
                torque: commanded.compensated[i],
                excess: accelerated / h,
                inertia: settings.inertia[i],
                requested: commanded.w[i],
                speed,
                rests,
                noise: (width, STEP_GAIN * self.steps[i] * bandwidths[i].powi(2)),
            };
            self.confirmed.note(i, friction, &response);
            let standing = StandingTick {
                reading: q[i],
                step: self.steps[i],
                speed,
                slip: commanded.slip[i],
                lead: speed - commanded.velocity[i],
                has_coulomb: friction.coulomb > 0.0,
                loose: (commanded.u[i] - self.p[i]).abs()
                    + (self.t[i].abs() + LOOSE * friction.coulomb) / settings.inertia[i],
            };
            self.sticking.note(i, probing, &standing);
            if self.reversals.note(i, commanded.velocity[i]) && friction.coulomb > 0.0 {
                rate = 0.0;
            }
            if rate > 0.0 && !probing {
                // The mean over the step, as for the compensation: at its end the friction of a joint that reverses has the other sign. What
                // is not confirmed neither acts nor is compensated.
                let is_told = robot.friction()[i].coulomb > 0.0;
                let confirmed = if self.believed && is_told { 1.0 } else { self.confirmed.share()[i] };
                let rubbed = confirmed
                    * confirmed.min(1.0)
                    * (friction.viscous * (speed - commanded.w[i] - commanded.extra[i])
                        + friction.coulomb_part(speed, width)
                        - friction.coulomb_part(commanded.w_coulomb[i], width));
                // The share that is learnt is one of what is confirmed: a nominal friction is many times the true one.
                let known = self.confirmed.share()[i];
                let residual = TorqueResidual {
                    rho: settings.inertia[i] * accelerated / h + rubbed - commanded.feedback[i],
                    friction: known * commanded.friction[i],
                    inertial: settings.inertia[i] * commanded.u[i],
                    gain: rate * h,
                };
                // A joint that sticks near its reference is left alone: torque that grows until it leaps would make it hunt.
                let w = commanded.velocity[i].abs();
                if self.sticking.stiffness()[i] > 0.0
                    && speed.abs() < STANDS
                    && w.max(commanded.slip[i].abs()) < STUCK
                {
                    continue;
                }
                self.friction.learn(i, known * friction.coulomb, &residual, h);
                p[i] += rate * accelerated;
                let most = robot.limits()[i].effort;
                self.t[i] = (self.t[i] + rate * h * (rubbed - commanded.feedback[i])).clamp(-most, most);
            }
        }
        self.p = within(self.p, p, &settings.max_acceleration);
        if !self.settled {
            self.past.note(&self.p, &self.t);
        }
        self.state = Some((q_now, v_now));
        (q_now, v_now)
    }
}

/// By how much `x` lies outside of `-half..half`.
fn outside(x: f64, half: f64) -> f64 {
    x - x.clamp(-half, half)
}
