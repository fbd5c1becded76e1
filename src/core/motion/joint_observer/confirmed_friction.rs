//! How much of the friction that the model states has been confirmed by the joint's motion, as a share of it; only that is compensated.
//!
//! Friction that is compensated and does not act accelerates the joint: a wrist of 1.4e-4 kg m^2 by 7000 rad/s^2 for each N m. Where that
//! would be more than [`HARMLESS`], nothing is compensated before the joint has resisted.
//!
//! **At rest.** When the arm is to move for the first time, each such joint is probed first. It is asked for a small velocity, and the torque `P` against
//! friction grows until the joint creeps. Then the torque is held until the speed `v` is steady, and the share is what was resisted over the
//! model's friction at that speed, with the acceleration `x` of the joint beyond the commanded one and its inertia `m`:
//!
//! ```text
//! share = (P - m x) / F(v)
//! ```
//! Then the joint goes back to where it was. A joint that jerks loose instead of creeping has the share of `P` at that moment, and stays. A joint that
//! sinks slowly before anything is applied carries a payload that its model does not know. Probing waits until it is
//! [found](crate::motion::payload_estimator); where joints sink on, payload and friction cannot be distinguished, and the model is believed. It
//! is believed too where encoders are so coarse that the probing speed is not distinguished from none.
//!
//! **In motion.** A share that could not be measured is adapted, by the speeds along `P`, requested `w` and true `v`:
//!
//! | the joint | share |
//! | --- | --- |
//! | lags behind `w`, `x` is small | grows: all of the torque was resisted |
//! | is faster than `w`, `x` is more than harmless | falls to the part that was resisted, `(P - m x) / P` |
//! | is faster than `w`, or `m x` is most of `P` | sinks |
//!
//! The bound does not depend on inertias that may not be known: a torque grows until the joint shows `x`, whatever its inertia is, and then no
//! more. Between a torque and what is seen of it, `n` ticks of delay, it grows by `GROWS^n`.
//!
//! `tests/cores/friction.rs` shows the numbers here together: shares 0 to 2 of the model's friction, with commands up to two ticks late.

use crate::robot::Friction;
use crate::time::TICK;
use nalgebra::SVector;

/// Acceleration beyond the commanded one that is harmless, rad/s^2 or m/s^2: a fifth of the default limit.
const HARMLESS: f64 = 2.0;
/// What is compensated before anything is confirmed, as an acceleration, rad/s^2 or m/s^2: a hundredth of that, so that a frictionless joint
/// shows a motion that is far below all limits.
const FIRST: f64 = 0.02;
/// Growth in a tick up to [`LITTLE`]: friction of 7000 rad/s^2 is reached from `FIRST` on within 50 ticks, and with commands that are two
/// ticks late an acceleration grows to 2.2 times the harmless one.
const GROWS: f64 = 1.3;
/// Growth in a tick beyond. A joint that begins to slip leaps by `0.02 F / D` in a tick, 10 rad/s^2 for the wrists of the xArm7 (1 N m and
/// 2 N m s/rad); so it must be much slower.
const GROWS_ON: f64 = 1.02;
/// Share up to which `GROWS` holds. Chosen by hand: from there on 70 ticks are left to the whole friction.
const LITTLE: f64 = 0.25;
/// What is left in a tick in which a joint is too fast. Chosen by hand: slower than it grows at first, so that a share is found once.
const SINKS: f64 = 0.97;
/// Shares of the requested speed below which a joint lags behind and above which it is too fast. Chosen by hand.
const LAGS: f64 = 0.9;
const LEADS: f64 = 1.1;
/// Speed difference that does not count, rad/s or m/s: what an acceleration of 5 rad/s^2 makes in the two ticks by which a command may be late.
const SAME: f64 = 0.01;
/// The same while a joint is probed, where nothing else is accelerated: less than half of [`PROBE`], so that it follows from the speed itself.
const SAME_AT_REST: f64 = 2e-3;
/// Share of a torque that may show as an acceleration where it counts as resisted, and where it counts as not resisted. Chosen by hand: a
/// quarter on either side of the middle is left to noise and to the coupling of other joints.
const RESISTED: f64 = 0.25;
const UNRESISTED: f64 = 0.75;
/// Speed at which the model's friction is called all of it, rad/s or m/s: that of slow motion, in which friction is mostly Coulomb friction.
const SLOW: f64 = 0.05;
/// Share of the compensated friction from which on a torque tells of it, because a small part of friction is resisted by any joint.
const TELLS: f64 = 0.5;
/// Largest share that is believed of a joint in motion; twice the model's friction is what the tests go up to.
const MAX_SHARE: f64 = 2.0;
/// Largest share that is believed when it is measured: an xArm7 whose file tells 1 N m, and which has 10 % of an effort of 50 N m beside it, has six
/// times the friction of its file.
const MAX_MEASURED: f64 = 7.0;
/// Share below which a joint counts as frictionless, and change of a share in a few ticks above which it is not steady. Chosen by hand.
const STEADY: f64 = 0.02;
/// Difference from 1 up to which a measured share is that of the model: on the xArm7 with the model's friction, joints that move beside
/// others are measured with errors of up to 0.056. The joint's observer estimates such differences while it moves.
const AS_MODELLED: f64 = 0.08;
/// Speed that a probed joint is asked for, rad/s or m/s: a quarter of what counts as rest (0.02), so that an arm that is probed is at rest.
const PROBE: f64 = 5e-3;
/// Slope at which that speed rises and falls, rad/s^2 or m/s^2: a step of it in a tick is half of the default limit of jerk.
const PROBE_SLOPE: f64 = 0.25;
/// Ticks after which probing ends, whatever was found: the growth from `FIRST` to the largest share of the largest friction takes 220.
const PROBE_TICKS: u32 = 260;
/// Ticks at the start in which nothing is applied: longer than commands may be late.
const REST_TICKS: u32 = 20;
/// Speed at the end of these above which a joint sinks, rad/s or m/s: the smooth friction of the model gives way like that
/// to 2 % of its Coulomb friction.
const SINKING: f64 = 2e-5;
/// How often it is waited for so many ticks while joints sink, until the payload that makes them sink is found: 0.1 s together; the payload of
/// an xArm7, half of its rated load or all of it, is found within 0.03 to 0.08 s.
const WAITS: u32 = 5;
/// How many times as fast as in this tick a joint may be at their end, and still sink slowly rather than fall. A joint with friction sinks
/// with one speed; one without, held by a controller of 40 rad/s with critical damping, is 2.2 times as fast.
const FALLS: f64 = 1.5;
const EARLY_TICKS: u32 = 5;
/// Rate at which a joint goes back after it was probed, 1/s, the ticks within which it comes to that rate, so that it keeps its limit of
/// jerk, and the ticks that it is given: it is left with 1e-4 of the distance.
const BACK_1_S: f64 = 200.0;
const BACK_TICKS: f64 = 15.0;
const SETTLE_TICKS: u32 = 60;
/// Share of the probing speed that noise may hide.
const HIDDEN: f64 = 0.4;
/// Speed from which on a joint creeps, rad/s or m/s: the smooth friction of the model has a fifth of its Coulomb friction there, and the
/// joint is still far from leaping.
const CREEPS: f64 = 2e-4;
/// Share of that speed that such a joint has in the tick before; while the torque grows by `GROWS` it is 0.77.
const CREPT: f64 = 0.5;
/// Ticks for which the torque is held on a joint that creeps: first, until a speed is steady with commands up to three ticks late; then as
/// many again to see that it is.
const HOLD_FROM: u32 = 5;
const HOLD_TICKS: u32 = 10;

/// What a joint did in a tick.
#[derive(Debug, Clone, Copy)]
pub(super) struct FrictionResponse {
    /// Torque that was applied against friction, N m or N.
    pub(super) torque: f64,
    /// Acceleration beyond the commanded one, rad/s^2 or m/s^2.
    pub(super) excess: f64,
    /// Inertia of the joint by the model, kg m^2 or kg.
    pub(super) inertia: f64,
    /// Requested and true speed, rad/s or m/s.
    pub(super) requested: f64,
    pub(super) speed: f64,
    /// Whether the reference of the arm is at rest: it is then probed.
    pub(super) rests: bool,
    /// Speeds and accelerations that coarse encoders do not distinguish from none, rad/s and rad/s^2 or m/s and m/s^2.
    pub(super) noise: (f64, f64),
}

/// The confirmed share of the model's friction, of each joint.
#[derive(Debug, Clone)]
pub(super) struct ConfirmedFriction<const N: usize> {
    share: SVector<f64, N>,
    /// The speed that is asked for while a joint is probed, rad/s or m/s.
    speed: SVector<f64, N>,
    probes: [FrictionProbe; N],
    /// Whether the arm is to move next, so that its joints may be probed.
    wanted: bool,
    /// How often the ticks in which nothing is applied began anew because a joint sank.
    waits: u32,
    /// The share that is believed of a joint whose friction cannot be probed: 1, and 0 where the file tells none.
    believed: SVector<f64, N>,
    /// Whether joints are probed that were found to resist.
    again: bool,
}

/// How far the probing of a joint is.
#[derive(Debug, Clone, Copy, Default)]
struct FrictionProbe {
    /// Ticks that are left for it.
    left: u32,
    /// Ticks since the start in which nothing was applied, and the speed early in them.
    rested: u32,
    early: f64,
    /// Ticks that are left in which the joint goes back, after all are probed: one that is probed moves the others.
    settles: u32,
    /// Ticks for which the torque has been held.
    held: u32,
    /// Speed from which on the torque is held next, rad/s or m/s.
    hold_from: f64,
    /// Resisted torque over the model's friction at the joint's speed, some ticks ago.
    ratio: f64,
    /// The speed in the last tick, and whether the joint crept before the torque was held; else it jerked loose, and what sticks cannot be
    /// brought back.
    speed: f64,
    creeps: bool,
    /// Whether the share was measured, and whether it is adapted no more, as it was measured or the model is believed.
    measured: bool,
    kept: bool,
}

impl<const N: usize> ConfirmedFriction<N> {
    /// Nothing is confirmed of joints of these inertias (kg m^2 or kg); where one is not known, the model is believed.
    pub(super) fn new(inertia: &SVector<f64, N>) -> Self {
        let probe =
            |known| FrictionProbe { left: if known { PROBE_TICKS } else { 0 }, ..FrictionProbe::default() };
        Self {
            share: inertia.map(|m| if m > 0.0 { 0.0 } else { 1.0 }),
            speed: SVector::zeros(),
            probes: std::array::from_fn(|i| probe(inertia[i] > 0.0)),
            wanted: false,
            waits: 0,
            believed: SVector::repeat(1.0),
            again: false,
        }
    }

    /// Lets joints be probed, once more or at last, whose friction the file does not tell and that have been found to resist; nothing of it is believed before.
    pub(super) fn probe_untold(&mut self, untold: &[bool; N]) {
        for i in (0..N).filter(|i| untold[*i]) {
            (self.share[i], self.believed[i], self.speed[i]) = (0.0, 0.0, 0.0);
            self.probes[i] = FrictionProbe { left: PROBE_TICKS, ..FrictionProbe::default() };
        }
        self.again = true;
    }

    /// The shares, 0 to `MAX_MEASURED`.
    pub(super) fn share(&self) -> &SVector<f64, N> {
        &self.share
    }

    /// The velocities that the joints of a standing arm are asked for while they are probed and go back after it by their distances `e` to the
    /// reference (rad or m), rad/s or m/s.
    pub(super) fn probe_velocity(&self, e: &SVector<f64, N>) -> SVector<f64, N> {
        SVector::from_fn(|i, _| match self.speed[i] {
            speed if speed > 0.0 => speed,
            _ if self.probes[i].settles > 0 && self.probes[i].measured && self.probes[i].creeps => {
                let since = f64::from(SETTLE_TICKS - self.probes[i].settles) / BACK_TICKS;
                (BACK_1_S * since.min(1.0) * e[i]).clamp(-PROBE, PROBE)
            }
            _ => 0.0,
        })
    }

    /// Lets the joints of an arm be probed that is to move next, or not; whether any is still to be.
    pub(super) fn probe(&mut self, wanted: bool) -> bool {
        self.wanted = wanted;
        self.probes.iter().any(|probe| probe.left > 0 || probe.settles > 0)
    }

    /// Whether a joint is being probed: the motion of the arm tells of no other disturbance then.
    pub(super) fn is_probing(&self) -> bool {
        let is_over = |probe: &FrictionProbe| self.again || self.wanted && probe.rested > REST_TICKS;
        self.probes.iter().any(|probe| probe.left > 0 && is_over(probe) || probe.settles > 0)
    }

    /// Believes the models: where something else than friction moves the arm, or where no reference tells what a joint is to do.
    pub(super) fn believe(&mut self) {
        self.share = self.believed;
        self.speed.fill(0.0);
        self.probes = [FrictionProbe { kept: true, ..FrictionProbe::default() }; N];
    }

    /// Takes in what joint `i`, counted from 0, did.
    pub(super) fn note(&mut self, i: usize, model: &Friction, response: &FrictionResponse) {
        let all = model.torque(SLOW);
        let FrictionResponse { inertia, speed, noise, .. } = *response;
        if !(inertia > 0.0 && all > HARMLESS * inertia && noise.0 < PROBE) {
            (self.share[i], self.speed[i], self.probes[i]) =
                (self.believed[i], 0.0, FrictionProbe::default());
            return;
        }
        if self.probes[i].left > 0 && (!response.rests || self.probes[i].rests(speed)) {
            if !self.again && self.probes[i].sinks(speed, noise.0) {
                self.wait();
            }
            return;
        }
        let along = Along::of(response, self.speed[i] > 0.0);
        // Near standstill a joint that sticks tells nothing of how much it rubs, unless it is probed.
        let least = if self.speed[i] > 0.0 || self.probes[i].left > 0 { 0.0 } else { PROBE };
        let tells = along.requested > least && along.torque > TELLS * self.share[i] * all;
        let holds = self.probes[i].left > 0 && {
            let resisted = along.torque * (1.0 - along.unresisted) / model.torque(along.speed);
            self.probes[i].hold(along.speed, resisted, noise.0)
        };
        if !self.probes[i].kept {
            self.share[i] = adapted(self.share[i], &along, response, tells, holds);
        }
        self.go_on(i, &along, noise.0, tells, holds);
        let most = if self.probes[i].left > 0 || self.probes[i].kept { MAX_MEASURED } else { MAX_SHARE };
        self.share[i] = self.share[i].max(inertia * FIRST / all).min(most);
    }

    /// Waits for a payload that makes joints sink, or believes the model.
    fn wait(&mut self) {
        self.waits += 1;
        self.probes.iter_mut().for_each(|probe| probe.rested = 0);
        if self.waits > WAITS {
            self.believe();
        }
    }

    /// Goes on with the probing of joint `i`: takes the share of a steady speed, and ends it where the joint was found to move.
    fn go_on(&mut self, i: usize, along: &Along, noise: f64, tells: bool, holds: bool) {
        let is_busy = self.speed.amax() > 0.0;
        let (share, asked, probe) = (&mut self.share[i], &mut self.speed[i], &mut self.probes[i]);
        if holds && probe.held == HOLD_TICKS && probe.ratio > STEADY {
            let same = (probe.ratio - 1.0).abs() < AS_MODELLED;
            *share = if same { 1.0 } else { probe.ratio };
            (probe.left, probe.measured, probe.kept) = (0, true, true);
            *asked = along.speed.min(*asked);
        }
        probe.settles = if is_busy { SETTLE_TICKS } else { probe.settles.saturating_sub(1) };
        let top = (PROBE + 2.0 * noise).min(SLOW);
        if probe.left > 0 && *asked >= top {
            let is_found = *share >= MAX_MEASURED || tells && !along.lags;
            probe.left = if is_found { 0 } else { probe.left - 1 };
        }
        let slope = PROBE_SLOPE * top / PROBE * TICK.as_s();
        let goal = if self.wanted && probe.left > 0 { top } else { 0.0 };
        *asked += (goal - *asked).clamp(-slope, slope);
    }
}

/// What a joint did, along the torque that was applied against its friction.
struct Along {
    torque: f64,
    excess: f64,
    speed: f64,
    requested: f64,
    /// Whether it lags behind the requested speed, and whether it is faster.
    lags: bool,
    leads: bool,
    /// The share of the torque that shows as an acceleration.
    unresisted: f64,
}

impl Along {
    /// Of a `response`; `probes`: to probing.
    fn of(response: &FrictionResponse, probes: bool) -> Self {
        let FrictionResponse { torque, excess, inertia, requested, speed, noise, .. } = *response;
        let along = torque.signum();
        let (torque, excess, speed, requested) =
            (torque.abs(), excess * along, speed * along, requested * along);
        let same = if probes { SAME_AT_REST + noise.0.min(HIDDEN * requested.abs()) } else { SAME + noise.0 };
        Self {
            torque,
            excess,
            speed,
            requested,
            lags: speed < LAGS * requested - if probes { same - SAME_AT_REST } else { same },
            leads: speed > LEADS * requested + same,
            unresisted: inertia * excess / torque.max(f64::MIN_POSITIVE),
        }
    }
}

/// The `share` after a tick in which the joint did what `along` and `response` say; whether that `tells` of its friction, and whether the torque is
/// held.
fn adapted(share: f64, along: &Along, response: &FrictionResponse, tells: bool, holds: bool) -> f64 {
    let noise = response.noise.1;
    if along.excess > HARMLESS + noise {
        return if along.leads { share * (1.0 - along.unresisted).max(0.0) } else { share };
    }
    if !tells {
        return share;
    }
    if along.lags && along.excess < noise + RESISTED * along.torque / response.inertia {
        let grows = if share < LITTLE { GROWS } else { GROWS_ON };
        return share * if holds { 1.0 } else { grows };
    }
    share * if along.leads || along.unresisted > UNRESISTED { SINKS } else { 1.0 }
}

impl FrictionProbe {
    /// Takes in the speed of a joint to which nothing is applied; whether it is one of the first ticks.
    fn rests(&mut self, speed: f64) -> bool {
        self.rested = (self.rested + 1).min(REST_TICKS + 1);
        if self.rested == EARLY_TICKS {
            self.early = speed;
        }
        self.rested <= REST_TICKS
    }

    /// Whether the joint has sunk slowly in the first ticks, at the end with `speed`; `noise` is a speed that is not distinguished from none.
    fn sinks(&self, speed: f64, noise: f64) -> bool {
        let grows = speed / self.early;
        self.rested == REST_TICKS && speed.abs() > SINKING + noise && grows > 1.0 / FALLS && grows < FALLS
    }

    /// Whether the torque is to be held, so that a joint that creeps with `v` and resists `ratio` of its model's friction comes to a steady
    /// speed; `noise` is a speed that is not distinguished from none. At the end `ratio` is that of the steady speed, 0 if it was not.
    fn hold(&mut self, v: f64, ratio: f64, noise: f64) -> bool {
        if self.held > 0 {
            self.held += 1;
        } else if v > self.hold_from.max(CREEPS).max(3.0 * noise) {
            (self.held, self.hold_from) = (1, 2.0 * v);
            self.creeps = self.speed > CREPT * v;
        }
        self.speed = v;
        match self.held {
            HOLD_FROM => self.ratio = ratio,
            HOLD_TICKS => self.ratio = if (ratio - self.ratio).abs() < STEADY * ratio { ratio } else { 0.0 },
            n if n > HOLD_TICKS => self.held = 0,
            _ => {}
        }
        self.held > 0
    }
}

#[cfg(test)]
mod tests;
