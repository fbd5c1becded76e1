//! Readings of encoders that no motion explains, before a drive that obeys torques.
//!
//! There what an encoder says becomes torque within a tick: a joint that seems to stand while it moves is pushed by its whole velocity error, and one whose reading leaps by
//! its position error. So readings are held against what the command of the last tick does to the joint, `q^' = v^`, `v^' = u`.
//!
//! | reading | meanwhile | after [`LONGEST`] |
//! | --- | --- | --- |
//! | leaps by more than the joint can move, and by more than noise | the joint is believed to do what it was told | the drive's state is implausible; behind a gap in the states, in which drive or control was held up, the reading is believed |
//! | is, with those of all other joints, the one before once more, while the arm moves | likewise | likewise |
//! | stays the same to the last digit while the joint moves, or right after it moved [steadily](STEADY_STATES) | likewise | its encoder is frozen: a fault, and the joint is believed to do what it is told until a reset |
//!
//! What brakes a joint takes a part of its displacement in the tick in which the joint stops: a tenth and more, unless it brakes by five times the speed in a tick. A reading that moved on evenly and is the same in the very
//! next state was not measured. That tells freezes from [`MOVES`] on, where the displacement of a tick alone, which a joint that sticks would miss as well, tells them from five times that speed.
//!
//! A joint that begins to move while its encoder is frozen seems to be blocked, and something else finds that. In that fault it is believed to be on its reference, if its
//! reading has not changed although the reference moved ([`EncoderWatch::distrust_still`]): a joint that is blocked indeed is then carried and not pushed. Laws that output
//! torques have no such reference.

use super::Fault;
use crate::drive::{DriveState, DriveTiming};
use crate::motion::ReferenceState;
use crate::time::{MonoNs, SpanNs, TICK};
use nalgebra::SVector;

/// Difference between reading and expectation up to which a reading is believed beside its steps, rad or m. Chosen by hand: at 40 rad/s (1600 1/s^2) it pushes a joint by 3.2 rad/s^2
/// for a tick, a third of the usual limit; an acceleration of 10 rad/s^2 that is not expected makes as much in 20 ms.
const LEAP: f64 = 2e-3;
/// Time by which a state may be off beside that, s, for each tick from one to the next. Derived: one that was sampled as much too early or late.
const OFF_S: f64 = 1e-3;
/// Acceleration that is not in the expectation, while no reading came, rad/s^2 or m/s^2. Chosen by hand: five times the usual limit of 10 rad/s^2, twice, since both halves of
/// `a t^2 / 2` may be against each other.
const UNEXPECTED: f64 = 50.0;
/// Displacement that a joint must have made while its reading stays the same, rad or m, beside what its friction stops in a tick. Chosen by hand: with 0.1 rad/s, less than a
/// tenth of the limits, it is the first tick: one that sticks has moved in the tick in which it stops.
const UNMOVED: f64 = 1e-4;
/// The same where the reported speed is neither none nor the one before: it is filtered, and late where a joint sticks. Chosen by hand: friction that brakes by 200 rad/s^2 behind a
/// filter of 1.6 ms (100 Hz).
const UNMOVED_BY_PLACE: f64 = 3e-4;
/// Speed of a joint from which on a state that is the one before in all digits was not measured anew, rad/s or m/s. Chosen by hand: that of an arm at rest (`rest.rs`).
const MOVES: f64 = 0.02;
/// For so many new states in a row a joint must have moved evenly for a reading that is then the same to be a frozen one. Chosen by hand, and not varied: longer than
/// an encoder's noise is even by chance.
const STEADY_STATES: u32 = 8;
/// The shares of the displacement before that one of even motion has. Derived: what stops a joint of speed `v` within a tick `T` by the acceleration `a` leaves at most `1 - v / (2 a T)` of it, so that with 0.9 it must brake by `5 v / T`
/// (100 rad/s^2 from 0.02 rad/s) to be taken for an encoder; the upper one, which lets joints start, was chosen by hand.
const EVEN: std::ops::RangeInclusive<f64> = 0.9..=1.5;
/// The share of a displacement that must be expected of the next state. Derived: what takes half of a speed in a tick leaves the other half to the next.
const GOES_ON: f64 = 0.5;
/// Steps of its encoder that a joint must make from state to state for its motion to be even. Derived: with three a flicker of one leaves two.
const EVEN_STEPS: f64 = 3.0;
/// The share of a joint's friction beyond its model's that may have stopped it: friction is tested up to twice that of the file.
const FRICTION: f64 = 2.0;
/// Inertia of a joint for which friction is reckoned may be smaller by this factor: that of the whole chain is least where it is stretched. Chosen by hand.
const LIGHT: f64 = 0.5;
/// Steps of an encoder by which a reading is off that is right: half a step each, and a flicker.
const STEPS: f64 = 2.0;
/// For how long readings are replaced by what is expected, in ticks. Derived: an acceleration that is unexpected by 10 rad/s^2 makes 4.5 mrad in it, and 0.3 rad/s.
pub(super) const LONGEST: u32 = 30;
/// After a gap a leap for good is believed and no fault, for so many ticks. Derived: it is told after [`LONGEST`], and may begin as late as that.
const AFTER_GAP: u32 = 2 * LONGEST;
/// The longest time between two states of the drive over which a motion is expected. Chosen by hand: after more, 50 rad/s^2 make more than 10 mrad.
const GAP: SpanNs = SpanNs(20_000_000);
/// How far a joint's reference must have moved, there or back, while its reading stayed the same, rad or m, for the joint to be distrusted in a fault. Measured (`vservo faults`): with 1e-3,
/// and where only the place at the end counted, a Panda whose shoulder's encoder had frozen at 0.01 rad/s fell at five times its speed limit. Three times [`UNMOVED`].
const TOLD: f64 = 3e-4;

/// For how long a reading must have been the same to count as one that stays, where the joint did not move evenly before. Chosen by hand: drives that obey late are tested up to 32 ms (`tests/processes/explain.rs`), in which a joint stands that
/// is told to move. With 30 ms a SCARA whose commands came 30 ms late was told as stuck in its 45th ms.
const STAYS: SpanNs = SpanNs(50_000_000);
/// The coarsest steps of an encoder whose readings change where a joint is held and pushed, rad or m. Chosen by hand: gears of 100 kN m/rad yield by as much under 2 N m.
const FINE: f64 = 2e-5;

/// What the last commands should have made of the joints.
#[derive(Debug, Clone, Copy)]
pub struct ExpectedMotion<const N: usize> {
    /// Where they were, rad or m.
    pub q: SVector<f64, N>,
    /// How fast they were, rad/s or m/s.
    pub qd: SVector<f64, N>,
    /// What the commands since made of it, rad/s^2 or m/s^2.
    pub qdd: SVector<f64, N>,
}

/// What is known of the joints.
#[derive(Debug, Clone, Copy)]
pub struct EncoderTraits<const N: usize> {
    /// Steps of their encoders, rad or m.
    pub step: SVector<f64, N>,
    /// Their inertia while the others are free, kg m^2 or kg.
    pub inertia: SVector<f64, N>,
    /// Their Coulomb friction, N m or N.
    pub coulomb: SVector<f64, N>,
    /// How far the observer of their positions is behind an acceleration that is not expected, for each rad/s^2 or m/s^2: s^2.
    pub lag: SVector<f64, N>,
}

/// Watches the encoders of an arm with `N` joints.
#[derive(Debug, Clone)]
pub struct EncoderWatch<const N: usize> {
    /// What the drive reported last, positions and speeds, and when.
    last: Option<(MonoNs, SVector<f64, N>, SVector<f64, N>)>,
    joints: [EncoderReading; N],
    /// Ticks left in which what the drive did in a gap is not expected of it.
    after_gap: u32,
}

/// The readings of one joint.
#[derive(Debug, Clone, Copy)]
struct EncoderReading {
    /// The least change so far, rad or m: encoders may be coarser than they are said to be.
    least_step: f64,
    /// For how many ticks no motion explains them.
    unexplained: u32,
    /// When the last one came that differed from the one before.
    changed: MonoNs,
    /// Its last displacement from one new state to the next, rad or m, and for how many of them it moved evenly.
    way: f64,
    even: u32,
    /// Whether the reading stopped from one state to the next in even motion, and has not changed since.
    stopped_dead: bool,
    /// Where its reference was then, rad or m (before a drive that closes its own loop: how far it was asked to move since then), and how far from there it has been since.
    reference: f64,
    told: f64,
    is_distrusted: bool,
}

impl EncoderReading {
    /// Takes in by how much a new state differs from the one before, and by how much it should, rad or m. A joint may be stopped from one state to the next where its displacements are smaller than `held`;
    /// `step` is its encoder's.
    fn note_way(&mut self, (way, expected): (f64, f64), held: f64, step: f64) {
        let before = std::mem::replace(&mut self.way, way);
        if way == 0.0 {
            let goes_on = expected * before.signum() > GOES_ON * before.abs();
            self.stopped_dead |= self.even >= STEADY_STATES && goes_on;
            self.even = 0;
            return;
        }
        self.stopped_dead = false;
        let least = held.max(EVEN_STEPS * step.max(self.least_step));
        let is_even = EVEN.contains(&(way / before)) && way.abs() > least;
        self.even = if is_even { self.even.saturating_add(1) } else { 0 };
    }

    /// Whether its reference moved while its reading stayed the same, by more than the `step` of its encoder, rad or m.
    fn is_told_to_move(&self, step: f64) -> bool {
        self.told > TOLD + STEPS * step
    }
}

impl<const N: usize> Default for EncoderWatch<N> {
    fn default() -> Self {
        let reading = EncoderReading {
            least_step: f64::INFINITY,
            unexplained: 0,
            changed: MonoNs::ZERO,
            way: 0.0,
            even: 0,
            stopped_dead: false,
            reference: 0.0,
            told: 0.0,
            is_distrusted: false,
        };
        Self { last: None, joints: [reading; N], after_gap: 0 }
    }
}

impl<const N: usize> EncoderWatch<N> {
    /// Takes in the state that the drive reports at `now`, of which `expected` tells what should be seen (`None` while no command acts), and the positions of the reference, rad or m.
    /// Returns the state that is believed, and the fault of encoders that are not believed any longer.
    pub fn take(
        &mut self,
        (now, timing): (MonoNs, DriveTiming),
        drive: &DriveState<N>,
        reference: &SVector<f64, N>,
        expected: Option<&ExpectedMotion<N>>,
        traits: &EncoderTraits<N>,
    ) -> (DriveState<N>, Option<Fault>) {
        self.after_gap = if timing.is_gap() { AFTER_GAP } else { self.after_gap.saturating_sub(1) };
        let before = self.last.replace((now, drive.q, drive.qd));
        let (Some((then, last, last_qd)), Some(expected)) = (before, expected) else {
            self.forget(now, reference);
            return (*drive, None);
        };
        let passed = now - then;
        if passed > DriveTiming::HELD_UP {
            self.after_gap = AFTER_GAP;
        }
        if passed > GAP {
            self.forget(now, reference);
            return (*drive, None);
        }
        let h = passed.as_s();
        // Within a step of a coarse encoder all readings stay the same too.
        let goes =
            |i: usize| h * expected.qd[i].abs() - STEPS * traits.step[i].max(self.joints[i].least_step);
        let is_repeated = drive.q == last && drive.qd == last_qd && (0..N).any(|i| goes(i) > h * MOVES);
        let (mut believed, mut fault) = (*drive, None);
        for (i, joint) in self.joints.iter_mut().enumerate() {
            let stops = FRICTION * traits.coulomb[i] / (LIGHT * traits.inertia[i]).max(f64::MIN_POSITIVE);
            let qd = expected.qd[i] + h * expected.qdd[i];
            let q = expected.q[i] + 0.5 * h * (expected.qd[i] + qd);
            let is_still = drive.q[i] == last[i];
            if !is_still {
                joint.least_step = joint.least_step.min((drive.q[i] - last[i]).abs());
            }
            if !timing.is_old() {
                let held = stops * TICK.as_s().powi(2) + MOVES * TICK.as_s();
                let ticks = f64::from(timing.ticks());
                let ways = (drive.q[i] - last[i], ticks * (q - expected.q[i]));
                joint.note_way(ways, ticks * held, traits.step[i]);
            }
            let behind = UNEXPECTED * traits.lag[i];
            let off = (drive.q[i] - q).abs() - STEPS * traits.step[i].max(joint.least_step) - behind;
            let wrong = if is_still {
                joint.told = joint.told.max((reference[i] - joint.reference).abs());
                let is_frozen = drive.qd[i] == 0.0 || drive.qd[i] == last_qd[i];
                let unmoved = if is_frozen { UNMOVED } else { UNMOVED_BY_PLACE };
                is_repeated || joint.stopped_dead || off > unmoved + stops * TICK.as_s().powi(2)
            } else {
                let unheard = (now - joint.changed).as_s();
                joint.changed = now;
                (joint.reference, joint.told) = (reference[i], 0.0);
                off > LEAP
                    + OFF_S * f64::from(timing.usual_ticks()) * qd.abs()
                    + UNEXPECTED * unheard * unheard
            };
            if !wrong && !joint.is_distrusted {
                joint.unexplained = 0;
                continue;
            }
            (believed.q[i], believed.qd[i]) = (q, qd);
            if joint.is_distrusted || timing.is_old() {
                continue;
            }
            joint.unexplained += timing.ticks();
            if joint.unexplained > LONGEST {
                joint.unexplained = 0;
                joint.is_distrusted = is_still;
                if is_still {
                    fault = Some(Fault::EncoderFrozen);
                } else if self.after_gap == 0 {
                    fault = Some(Fault::DriveStateImplausible);
                }
                if !is_still {
                    // It is where the reading leapt to, for all that is known.
                    (believed.q[i], believed.qd[i]) = (drive.q[i], drive.qd[i]);
                }
            }
        }
        (believed, fault)
    }

    /// Before a drive that closes its own loop, whose encoders are believed: takes in the positions that it reports at `now`, rad or m, with the `steps` of the encoders, while `commanded` asks the joints to move, rad/s or m/s.
    pub fn note(
        &mut self,
        (now, timing): (MonoNs, DriveTiming),
        drive: &DriveState<N>,
        commanded: &SVector<f64, N>,
        steps: &SVector<f64, N>,
    ) {
        let before = self.last.replace((now, drive.q, drive.qd));
        let ticks = f64::from(timing.ticks());
        for (i, joint) in self.joints.iter_mut().enumerate() {
            let way = before.map_or(f64::NAN, |(_, q, _)| drive.q[i] - q[i]);
            let asked = commanded[i] * TICK.as_s();
            if !timing.is_old() {
                joint.note_way((way, ticks * asked), ticks * MOVES * TICK.as_s(), steps[i]);
            }
            if way == 0.0 {
                joint.reference += asked;
                joint.told = joint.told.max(joint.reference.abs());
                continue;
            }
            joint.least_step = joint.least_step.min(way.abs());
            (joint.changed, joint.reference, joint.told) = (now, 0.0, 0.0);
        }
    }

    /// Whether the reading of joint `i` has stayed the same to the last digit at `now`: since it moved evenly, or for longer than a drive repeats states and obeys late. Behind coarse steps, of which the encoder's is `step`, rad or m, nothing
    /// tells that from a joint that is held.
    #[must_use]
    pub fn stays(&self, i: usize, now: MonoNs, step: f64) -> bool {
        let joint = &self.joints[i];
        let is_fine = step <= FINE && (joint.least_step <= FINE || joint.least_step.is_infinite());
        is_fine && (joint.stopped_dead || now - joint.changed > STAYS)
    }

    /// The same, although the joint is told to move.
    #[must_use]
    pub fn is_stuck(&self, i: usize, now: MonoNs, step: f64) -> bool {
        self.stays(i, now, step) && self.joints[i].is_told_to_move(step)
    }

    /// In a fault: distrusts joints whose readings stayed the same although their `reference` moved, by more than the `steps` of the encoders, rad or m. They are believed to be on it; returns the state with them there.
    pub fn distrust_still(
        &mut self,
        state: &DriveState<N>,
        reference: &ReferenceState<N>,
        steps: &SVector<f64, N>,
    ) -> DriveState<N> {
        let mut believed = *state;
        for (i, joint) in self.joints.iter_mut().enumerate() {
            if !joint.is_distrusted && joint.is_told_to_move(steps[i]) {
                joint.is_distrusted = true;
                (believed.q[i], believed.qd[i]) = (reference.q[i], reference.qd[i]);
            }
        }
        believed
    }

    /// The joints that are not where their encoders say.
    #[must_use]
    pub fn distrusted(&self) -> [bool; N] {
        self.joints.map(|joint| joint.is_distrusted)
    }

    /// Trusts all encoders again, after a reset.
    pub fn restart(&mut self) {
        self.last = None;
        self.joints.iter_mut().for_each(|joint| (joint.unexplained, joint.is_distrusted) = (0, false));
    }

    /// The next state has none before it: states were not usable.
    pub fn skip(&mut self) {
        self.last = None;
    }

    /// What was expected so far is forgotten; what is distrusted stays so.
    fn forget(&mut self, now: MonoNs, reference: &SVector<f64, N>) {
        for (joint, reference) in self.joints.iter_mut().zip(reference) {
            (joint.unexplained, joint.changed) = (0, now);
            (joint.even, joint.stopped_dead) = (0, false);
            (joint.reference, joint.told) = (*reference, 0.0);
        }
    }
}

#[cfg(test)]
mod tests;
