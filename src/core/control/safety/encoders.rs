//! Readings of encoders that no motion explains, before a drive that obeys torques.
//!
//! There what an encoder says becomes torque within a tick: a joint that seems to stand while it moves is pushed by its whole velocity error, and one whose reading leaps by
//! its position error. So readings are held against what the command of the last tick does to the joint, `q^' = v^`, `v^' = u`.
//!
//! | reading | meanwhile | after [`LONGEST`] |
//! | --- | --- | --- |
//! | leaps by more than the joint can move, and by more than noise | the joint is believed to do what it was told | the drive's state is implausible; behind a gap in the states, in which drive or control was held up, the reading is believed |
//! | is, with those of all other joints, the one before once more, while the arm moves | likewise | likewise |
//! | stays the same to the last digit while the joint moves | likewise | its encoder is frozen: a fault, and the joint is believed to do what it is told until a reset |
//!
//! A joint that begins to move while its encoder is frozen seems to be blocked, and something else finds that. In that fault it is believed to be on its reference, if its
//! reading has not changed although the reference moved ([`EncoderWatch::distrust_still`]): a joint that is blocked indeed is then carried and not pushed. Laws that output
//! torques have no such reference.

use super::Fault;
use crate::drive::DriveState;
use crate::motion::ReferenceState;
use crate::time::{MonoNs, SpanNs, TICK};
use nalgebra::SVector;

/// Difference between reading and expectation up to which a reading is believed beside its steps, rad or m. Chosen by hand: at 40 rad/s (1600 1/s^2) it pushes a joint by 3.2 rad/s^2
/// for a tick, a third of the usual limit; an acceleration of 10 rad/s^2 that is not expected makes as much in 20 ms.
const LEAP: f64 = 2e-3;
/// Time by which a state may be off beside that, s. Derived: one that was sampled a tick of 1 ms too early or late.
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
/// The share of a joint's friction beyond its model's that may have stopped it: friction is tested up to twice that of the file.
const FRICTION: f64 = 2.0;
/// Inertia of a joint for which friction is reckoned may be smaller by this factor: that of the whole chain is least where it is stretched. Chosen by hand.
const LIGHT: f64 = 0.5;
/// Steps of an encoder by which a reading is off that is right: half a step each, and a flicker.
const STEPS: f64 = 2.0;
/// For how long readings are replaced by what is expected, in ticks. Derived: an acceleration that is unexpected by 10 rad/s^2 makes 4.5 mrad in it, and 0.3 rad/s.
pub(super) const LONGEST: u32 = 30;
/// So many states in a row that come late are a gap, in which a drive that hangs may not have obeyed. Chosen by hand: a drive of 250 Hz, which is late three times in four, has none.
const LATE_IN_ROW: u32 = 4;
/// Control that was held up for longer may begin with a state as old, and an arm that did not obey meanwhile: a gap too. Derived: as many ticks.
const HELD_UP: SpanNs = SpanNs(TICK.0 * LATE_IN_ROW as i64);
/// After a gap a leap for good is believed and no fault, for so many ticks. Derived: it is told after [`LONGEST`], and may begin as late as that.
const AFTER_GAP: u32 = 2 * LONGEST;
/// The longest time between two states of the drive over which a motion is expected. Chosen by hand: after more, 50 rad/s^2 make more than 10 mrad.
const GAP: SpanNs = SpanNs(20_000_000);
/// How far a joint's reference must have moved while its reading stayed the same, rad or m, for the joint to be distrusted in a fault. Chosen by hand: ten times [`UNMOVED`].
const TOLD: f64 = 1e-3;

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
}

/// Watches the encoders of an arm with `N` joints.
#[derive(Debug, Clone)]
pub struct EncoderWatch<const N: usize> {
    /// What the drive reported last, positions and speeds, and when.
    last: Option<(MonoNs, SVector<f64, N>, SVector<f64, N>)>,
    joints: [EncoderReading; N],
    is_late: bool,
    /// States in a row that came late.
    late_in_row: u32,
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
    /// Where its reference was then, rad or m.
    reference: f64,
    is_distrusted: bool,
}

impl<const N: usize> Default for EncoderWatch<N> {
    fn default() -> Self {
        let reading = EncoderReading {
            least_step: f64::INFINITY,
            unexplained: 0,
            changed: MonoNs::ZERO,
            reference: 0.0,
            is_distrusted: false,
        };
        Self { last: None, joints: [reading; N], is_late: false, late_in_row: 0, after_gap: 0 }
    }
}

impl<const N: usize> EncoderWatch<N> {
    /// Takes in the state that the drive reports at `now`, of which `expected` tells what should be seen (`None` while no command acts), and the positions of the reference, rad or m.
    /// Returns the state that is believed, and the fault of encoders that are not believed any longer.
    pub fn take(
        &mut self,
        now: MonoNs,
        drive: &DriveState<N>,
        reference: &SVector<f64, N>,
        expected: Option<&ExpectedMotion<N>>,
        traits: &EncoderTraits<N>,
    ) -> (DriveState<N>, Option<Fault>) {
        let is_late = std::mem::take(&mut self.is_late);
        self.late_in_row = if is_late { self.late_in_row.saturating_add(1) } else { 0 };
        self.after_gap =
            if self.late_in_row >= LATE_IN_ROW { AFTER_GAP } else { self.after_gap.saturating_sub(1) };
        let before = self.last.replace((now, drive.q, drive.qd));
        let (Some((then, last, last_qd)), Some(expected)) = (before, expected) else {
            self.forget(now, reference);
            return (*drive, None);
        };
        let passed = now - then;
        if passed > HELD_UP {
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
            let off = (drive.q[i] - q).abs() - STEPS * traits.step[i].max(joint.least_step);
            let wrong = if is_still {
                let is_frozen = drive.qd[i] == 0.0 || drive.qd[i] == last_qd[i];
                let unmoved = if is_frozen { UNMOVED } else { UNMOVED_BY_PLACE };
                is_repeated || off > unmoved + stops * TICK.as_s().powi(2)
            } else {
                let unheard = (now - joint.changed).as_s();
                joint.changed = now;
                joint.reference = reference[i];
                off > LEAP + OFF_S * qd.abs() + UNEXPECTED * unheard * unheard
            };
            if !wrong && !joint.is_distrusted {
                joint.unexplained = 0;
                continue;
            }
            (believed.q[i], believed.qd[i]) = (q, qd);
            if joint.is_distrusted || is_late {
                continue;
            }
            joint.unexplained += 1;
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

    /// The next state came late: that it is the one before tells nothing.
    pub fn late(&mut self) {
        self.is_late = true;
    }

    /// In a fault: distrusts joints whose readings stayed the same although their `reference` moved. They are believed to be on it; returns the state with them there.
    pub fn distrust_still(&mut self, state: &DriveState<N>, reference: &ReferenceState<N>) -> DriveState<N> {
        let mut believed = *state;
        for (i, joint) in self.joints.iter_mut().enumerate() {
            if !joint.is_distrusted && (reference.q[i] - joint.reference).abs() > TOLD {
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
            (joint.unexplained, joint.changed, joint.reference) = (0, now, *reference);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linalg::Random;
    use nalgebra::{Vector1, Vector2};

    /// Two joints, of which the first moves to and fro with up to `speed` rad/s, and what is wrong with its reading `reported(k, q, qd, q_before)` at tick `k`.
    /// Returns the largest errors of what is believed of it from tick 10 on, and the first fault with its tick.
    fn watched(
        speed: f64,
        step: f64,
        reported: impl Fn(i64, f64, f64, f64) -> (f64, f64),
    ) -> (f64, f64, Option<(i64, Fault)>) {
        let mut watch = EncoderWatch::<2>::default();
        let traits = EncoderTraits {
            step: Vector2::repeat(step),
            inertia: Vector2::repeat(1.0),
            coulomb: Vector2::repeat(1.0),
        };
        let round = |q: f64| if step > 0.0 { (q / step).round() * step } else { q };
        let mut random = Random::new(5);
        // The joint has an acceleration of up to 4 rad/s^2 that is not in what is expected.
        let (mut q, mut qd) = (0.0, 0.0);
        let mut expected: Option<ExpectedMotion<2>> = None;
        let (mut worst_q, mut worst_qd, mut fault, mut before) = (0.0_f64, 0.0_f64, None, 0.0);
        for k in 0..2000_i64 {
            let wanted = speed * (k as f64 * 4e-3).cos() * 4.0;
            let (raw_q, raw_qd) = reported(k, round(q), qd, before);
            before = raw_q;
            let drive =
                DriveState { q: Vector2::new(raw_q, 0.3), qd: Vector2::new(raw_qd, 0.0), truth: None };
            let reference = Vector2::new(q, 0.3);
            let now = MonoNs(k * 1_000_000);
            let (believed, told) = watch.take(now, &drive, &reference, expected.as_ref(), &traits);
            if k > 10 {
                worst_q = worst_q.max((believed.q[0] - q).abs());
                worst_qd = worst_qd.max((believed.qd[0] - qd).abs());
            }
            fault = fault.or(told.map(|fault| (k, fault)));
            expected =
                Some(ExpectedMotion { q: believed.q, qd: believed.qd, qdd: Vector2::new(wanted, 0.0) });
            let true_qdd = wanted + 4.0 * random.gaussian().clamp(-1.0, 1.0);
            q += 1e-3 * qd + 0.5e-6 * true_qdd;
            qd += 1e-3 * true_qdd;
        }
        (worst_q, worst_qd, fault)
    }

    #[test]
    fn readings_of_a_moving_joint_are_believed_as_they_are() {
        for (speed, step) in [(0.01, 0.0), (0.5, 0.0), (2.0, 0.0), (0.5, 5e-4), (2.0, 1e-3)] {
            let (worst, _, fault) = watched(speed, step, |_, q, qd, _| (q, qd));
            assert!(worst <= 0.5 * step + 1e-12 && fault.is_none(), "{speed} {step}: {worst} {fault:?}");
        }
    }

    /// Steps that nobody told, with the speed that a filter of 100 Hz makes of them.
    #[test]
    fn untold_steps_of_an_encoder_are_no_freeze() {
        for step in [1e-4, 1e-3, 1.5e-2] {
            let filter = std::cell::Cell::new((0.0_f64, 0.0_f64));
            let (.., fault) = watched(0.3, 0.0, |_, q, _, _| {
                let (before, qd) = filter.get();
                let seen = (q / step).round() * step;
                filter.set((seen, qd + ((seen - before) / 1e-3 - qd) * 0.386));
                (seen, filter.get().1)
            });
            assert_eq!(fault, None, "{step}");
        }
    }

    /// An arm that begins to move within a step of its encoders, which are known: all readings stay the same.
    #[test]
    fn motion_within_a_step_is_no_repeated_state() {
        let mut watch = EncoderWatch::<1>::default();
        let traits = EncoderTraits {
            step: Vector1::repeat(0.015),
            inertia: Vector1::repeat(1.0),
            coulomb: Vector1::zeros(),
        };
        let still = DriveState { q: Vector1::new(0.3), qd: Vector1::zeros(), truth: None };
        for k in 0..100 {
            let expected = ExpectedMotion { q: still.q, qd: Vector1::new(0.1), qdd: Vector1::zeros() };
            let told = watch.take(MonoNs(k * 1_000_000), &still, &still.q, Some(&expected), &traits);
            assert_eq!(told, (still, None), "{k}");
        }
    }

    /// A drive, or control, that hangs for 10 ms, in which the drive does not obey: its joint is elsewhere then. Without the gap in the states the same leap is a fault.
    #[test]
    fn behind_a_gap_in_the_states_the_reading_is_believed() {
        for (hangs, held_up, is_fault) in [(true, false, false), (false, true, false), (false, false, true)] {
            let mut watch = EncoderWatch::<1>::default();
            let (zero, one) = (Vector1::zeros(), Vector1::repeat(1.0));
            let traits = EncoderTraits { step: zero, inertia: one, coulomb: zero };
            let (mut expected, mut fault, mut off) = (None, None, 0.0_f64);
            let mut before = 0.0;
            for k in (0..200_i64).filter(|k| !held_up || !(100..110).contains(k)) {
                let is_late = hangs && (100..110).contains(&k);
                let leap = if k >= 110 { -0.008 } else { 0.0 };
                let q = if is_late { before } else { 0.2e-3 * k as f64 + leap };
                before = q;
                if is_late {
                    watch.late();
                }
                let state = DriveState { q: Vector1::new(q), qd: Vector1::new(0.2), truth: None };
                let (believed, told) =
                    watch.take(MonoNs(k * 1_000_000), &state, &state.q, expected.as_ref(), &traits);
                expected = Some(ExpectedMotion { q: believed.q, qd: Vector1::new(0.2), qdd: zero });
                fault = fault.or(told);
                off = if is_late { off } else { (believed.q[0] - q).abs() };
            }
            assert_eq!(fault, is_fault.then_some(Fault::DriveStateImplausible), "{hangs} {held_up}");
            assert!(off < 1e-9, "{hangs} {held_up}: {off}");
        }
    }

    #[test]
    fn a_spike_is_not_believed_and_is_no_fault() {
        let (worst, ..) = watched(1.0, 0.0, |k, q, qd, _| (if k % 100 == 50 { q + 0.006 } else { q }, qd));
        assert!(worst < 1e-4, "{worst}");
        let (_, _, fault) = watched(1.0, 0.0, |k, q, qd, _| (if k % 100 == 50 { q - 0.006 } else { q }, qd));
        assert_eq!(fault, None);
    }

    #[test]
    fn a_short_freeze_in_motion_is_bridged() {
        let (worst, worst_qd, fault) =
            watched(
                1.0,
                0.0,
                |k, q, qd, before| if (400..420).contains(&k) { (before, 0.0) } else { (q, qd) },
            );
        assert!(worst < 1.5e-3 && worst_qd < 0.1 && fault.is_none(), "{worst} {worst_qd} {fault:?}");
    }

    #[test]
    fn a_frozen_encoder_is_told_and_never_believed_again() {
        for speed in [0.3, 1.0, 2.0] {
            let (_, worst_qd, fault) =
                watched(speed, 0.0, |k, q, qd, before| if k >= 400 { (before, 0.0) } else { (q, qd) });
            let (at, fault) = fault.unwrap();
            assert!(fault == Fault::EncoderFrozen && (430..=432).contains(&at), "{speed}: {at} {fault:?}");
            // The joint's own motion without its unexpected part.
            assert!(worst_qd < 0.3, "{speed}: {worst_qd}");
        }
    }

    #[test]
    fn a_reading_that_leapt_for_good_is_a_fault_and_then_believed() {
        let (worst, _, fault) = watched(0.5, 0.0, |k, q, qd, _| (if k >= 800 { q + 0.01 } else { q }, qd));
        assert_eq!(fault, Some((830, Fault::DriveStateImplausible)));
        assert!((worst - 0.01).abs() < 1e-6, "{worst}");
    }

    /// A joint sticks while the speed that is reported is that of a filter: it stands, and no encoder is frozen.
    #[test]
    fn a_joint_that_sticks_behind_a_slow_filter_is_believed() {
        let mut watch = EncoderWatch::<1>::default();
        let traits = EncoderTraits {
            step: Vector1::zeros(),
            inertia: Vector1::repeat(1.0),
            coulomb: Vector1::zeros(),
        };
        let (mut q, mut qd, mut seen) = (0.0_f64, 0.4_f64, 0.4_f64);
        let mut expected: Option<ExpectedMotion<1>> = None;
        for k in 0..200 {
            seen += (qd - seen) * (1.0 - (-1.0_f64 / 1.6).exp());
            let drive = DriveState { q: Vector1::new(q), qd: Vector1::new(seen), truth: None };
            let told = watch.take(MonoNs(k * 1_000_000), &drive, &drive.q, expected.as_ref(), &traits);
            assert_eq!(told, (drive, None), "tick {k}");
            expected = Some(ExpectedMotion { q: drive.q, qd: drive.qd, qdd: Vector1::new(1.0) });
            let slower = (qd - 0.15).max(0.0);
            (q, qd) = (q + 0.5e-3 * (qd + slower), slower);
        }
    }

    /// A joint that stands is told to move, and does not: nothing tells whether it is blocked or its encoder frozen, until something else is a fault.
    #[test]
    fn what_did_not_move_is_believed_on_its_reference_in_a_fault() {
        let mut watch = EncoderWatch::<2>::default();
        let traits = EncoderTraits {
            step: Vector2::zeros(),
            inertia: Vector2::repeat(1.0),
            coulomb: Vector2::zeros(),
        };
        let still = DriveState { q: Vector2::new(0.1, 0.3), qd: Vector2::zeros(), truth: None };
        let mut r = Vector2::new(0.1, 0.3);
        for k in 0..100 {
            r[0] += 2e-5;
            let expected = ExpectedMotion { q: still.q, qd: still.qd, qdd: Vector2::new(5.0, 0.0) };
            let seen = watch.take(MonoNs(k * 1_000_000), &still, &r, Some(&expected), &traits);
            assert_eq!(seen, (still, None));
        }
        assert_eq!(watch.distrusted(), [false; 2]);
        let zero = Vector2::zeros();
        let reference = ReferenceState {
            q: r,
            qd: Vector2::new(0.02, 0.0),
            qdd: zero,
            a: zero,
            limits: crate::motion::ActingLimits::default(),
        };
        let believed = watch.distrust_still(&still, &reference);
        assert_eq!((believed.q, believed.qd), (r, reference.qd));
        assert_eq!(watch.distrusted(), [true, false]);
        watch.restart();
        assert_eq!(watch.distrusted(), [false; 2]);
    }
}
