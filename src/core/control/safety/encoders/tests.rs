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
    let mut timing = DriveTiming::default();
    let traits = EncoderTraits {
        step: Vector2::repeat(step),
        inertia: Vector2::repeat(1.0),
        coulomb: Vector2::repeat(1.0),
        lag: Vector2::zeros(),
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
        let drive = DriveState { q: Vector2::new(raw_q, 0.3), qd: Vector2::new(raw_qd, 0.0), truth: None };
        let reference = Vector2::new(q, 0.3);
        let now = MonoNs(k * 1_000_000);
        timing.note(false);
        let (believed, told) = watch.take((now, timing), &drive, &reference, expected.as_ref(), &traits);
        if k > 10 {
            worst_q = worst_q.max((believed.q[0] - q).abs());
            worst_qd = worst_qd.max((believed.qd[0] - qd).abs());
        }
        fault = fault.or(told.map(|fault| (k, fault)));
        expected = Some(ExpectedMotion { q: believed.q, qd: believed.qd, qdd: Vector2::new(wanted, 0.0) });
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
    let mut timing = DriveTiming::default();
    let traits = EncoderTraits {
        step: Vector1::repeat(0.015),
        inertia: Vector1::repeat(1.0),
        coulomb: Vector1::zeros(),
        lag: Vector1::zeros(),
    };
    let still = DriveState { q: Vector1::new(0.3), qd: Vector1::zeros(), truth: None };
    for k in 0..100 {
        let expected = ExpectedMotion { q: still.q, qd: Vector1::new(0.1), qdd: Vector1::zeros() };
        timing.note(false);
        let told = watch.take((MonoNs(k * 1_000_000), timing), &still, &still.q, Some(&expected), &traits);
        assert_eq!(told, (still, None), "{k}");
    }
}

/// A drive, or control, that hangs for 10 ms, in which the drive does not obey: its joint is elsewhere then. Without the gap in the states the same leap is a fault.
#[test]
fn behind_a_gap_in_the_states_the_reading_is_believed() {
    for (hangs, held_up, is_fault) in [(true, false, false), (false, true, false), (false, false, true)] {
        let mut watch = EncoderWatch::<1>::default();
        let mut timing = DriveTiming::default();
        let (zero, one) = (Vector1::zeros(), Vector1::repeat(1.0));
        let traits = EncoderTraits { step: zero, inertia: one, coulomb: zero, lag: zero };
        let (mut expected, mut fault, mut off) = (None, None, 0.0_f64);
        let mut before = 0.0;
        for k in (0..200_i64).filter(|k| !held_up || !(100..110).contains(k)) {
            let is_late = hangs && (100..110).contains(&k);
            let leap = if k >= 110 { -0.008 } else { 0.0 };
            let q = if is_late { before } else { 0.2e-3 * k as f64 + leap };
            before = q;
            timing.note(is_late);
            let state = DriveState { q: Vector1::new(q), qd: Vector1::new(0.2), truth: None };
            let (believed, told) =
                watch.take((MonoNs(k * 1_000_000), timing), &state, &state.q, expected.as_ref(), &traits);
            expected = Some(ExpectedMotion { q: believed.q, qd: Vector1::new(0.2), qdd: zero });
            fault = fault.or(told);
            off = if is_late { off } else { (believed.q[0] - q).abs() };
        }
        assert_eq!(fault, is_fault.then_some(Fault::DriveStateImplausible), "{hangs} {held_up}");
        assert!(off < 1e-9, "{hangs} {held_up}: {off}");
    }
}

/// A joint that goes with `speed`, rad/s, behind a drive with a new state every `period` ms, which stands still for `stalls` ms from 100 ms on, and whose reading leaps by 20 mrad at 300 ms where it `leaps`; the fault, and when.
fn behind_a_slower_drive(speed: f64, period: i64, stalls: i64, leaps: bool) -> Option<(i64, Fault)> {
    let mut watch = EncoderWatch::<1>::default();
    let mut timing = DriveTiming::default();
    let (zero, one) = (Vector1::zeros(), Vector1::repeat(1.0));
    let traits = EncoderTraits { step: zero, inertia: one, coulomb: zero, lag: zero };
    let mut expected: Option<ExpectedMotion<1>> = None;
    let mut told = 0.0;
    (0..600_i64).find_map(|ms| {
        // The drive's own time: neither states nor arm go on while it stands.
        let own = if ms < 100 { ms } else { (ms - stalls).max(100) };
        let stands = (100..100 + stalls).contains(&ms);
        let is_new = own % period == 0 && !stands;
        timing.note(!is_new);
        if is_new {
            told = speed * 1e-3 * own as f64 + if leaps && ms >= 300 { 20e-3 } else { 0.0 };
        }
        let state = DriveState { q: Vector1::new(told), qd: Vector1::new(speed), truth: None };
        let (believed, fault) =
            watch.take((MonoNs(ms * 1_000_000), timing), &state, &state.q, expected.as_ref(), &traits);
        expected = Some(ExpectedMotion { q: believed.q, qd: Vector1::new(speed), qdd: zero });
        fault.map(|fault| (ms, fault))
    })
}

#[test]
fn slower_drives_may_stall_and_their_encoders_may_not_leap() {
    for period in [1, 2, 4, 8] {
        for stalls in [0, 1, 2, 3, 5, 9, 14, 19] {
            assert_eq!(behind_a_slower_drive(1.0, period, stalls, false), None, "{period} {stalls}");
        }
        let (at, fault) = behind_a_slower_drive(0.2, period, 0, true).unwrap();
        assert_eq!(fault, Fault::DriveStateImplausible, "{period}");
        // As many ticks as readings are replaced for, and one or two states.
        assert!((300..300 + i64::from(LONGEST) + 2 * period + 1).contains(&at), "{period}: {at}");
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
        watched(1.0, 0.0, |k, q, qd, before| if (400..420).contains(&k) { (before, 0.0) } else { (q, qd) });
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

/// Too slow for the displacement of a tick to tell anything: the motion before does.
#[test]
fn an_encoder_that_freezes_in_slow_even_motion_is_told() {
    for speed in [0.03, 0.06, 0.1] {
        let (_, worst_qd, fault) =
            watched(speed, 0.0, |k, q, qd, before| if k >= 400 { (before, 0.0) } else { (q, qd) });
        let (at, fault) = fault.unwrap();
        assert!(fault == Fault::EncoderFrozen && (430..=432).contains(&at), "{speed}: {at} {fault:?}");
        assert!(worst_qd < 0.3, "{speed}: {worst_qd}");
    }
    let (.., fault) = watched(0.01, 0.0, |k, q, qd, before| if k >= 400 { (before, 0.0) } else { (q, qd) });
    assert_eq!(fault, None, "slower than an arm at rest may be");
}

/// However hard something brakes a joint that was in even motion, and wherever in the tick that begins: in the tick in which it stops it has moved. Behind a velocity that is filtered by 100 Hz that holds up to five times the speed
/// in a tick.
#[test]
fn a_joint_that_something_stops_dead_is_no_frozen_encoder() {
    let zero = Vector1::zeros();
    let traits = EncoderTraits { step: zero, inertia: Vector1::repeat(1.0), coulomb: zero, lag: zero };
    let stops = [
        (0.03, 20.0, 0.0),
        (0.03, 1e3, 0.0),
        (0.06, 60.0, 0.0),
        (0.06, 1e3, 0.0),
        (0.09, 90.0, 0.0),
        (0.09, 1e4, 0.0),
        (0.03, 30.0, 1.6),
        (0.03, 140.0, 1.6),
        (0.06, 60.0, 1.6),
        (0.06, 150.0, 1.6),
        (0.06, 290.0, 1.6),
        (0.09, 440.0, 1.6),
    ];
    for (speed, brakes, filter_ms) in stops {
        for part in (0..20).map(|part| 0.05 * f64::from(part)) {
            let begins = 0.05 + 1e-3 * part;
            let at = |t: f64| {
                let t = (t - begins).clamp(0.0, speed / brakes);
                (begins + t, speed - brakes * t, 0.5 * brakes * t * t)
            };
            let mut watch = EncoderWatch::<1>::default();
            let mut timing = DriveTiming::default();
            let mut expected: Option<ExpectedMotion<1>> = None;
            let mut seen = speed;
            for k in 0..200_i64 {
                let t = 1e-3 * k as f64;
                let (until, qd, lost) = at(t);
                // From rest: its step is not known before.
                let way = if t < 0.03 { t * t / 0.06 } else { t.min(until) - 0.015 };
                let q = Vector1::new(speed * way - lost);
                let share = if filter_ms > 0.0 { 1.0 - f64::exp(-1.0 / filter_ms) } else { 1.0 };
                seen += (if t < begins { speed } else { qd } - seen) * share;
                let drive = DriveState { q, qd: Vector1::new(seen), truth: None };
                timing.note(false);
                let now = MonoNs(k * 1_000_000);
                let told = watch.take((now, timing), &drive, &q, expected.as_ref(), &traits);
                assert_eq!(told, (drive, None), "{speed} {brakes} {filter_ms} {part}: {k}");
                expected = Some(ExpectedMotion { q, qd: drive.qd, qdd: zero });
            }
        }
    }
}

/// Before a drive that closes its own loop: a joint that goes with 0.1 rad/s until 0.2 s, and then `goes` on by so much in each ms, rad; when its reading counts as one that stays.
fn stays_from(step: f64, period: i64, goes: f64) -> Option<i64> {
    let mut watch = EncoderWatch::<1>::default();
    let mut timing = DriveTiming::default();
    let mut seen = 0.0;
    (0..600_i64).find(|&ms| {
        timing.note(ms % period != 0);
        if ms % period == 0 {
            // From rest, with 0.1 rad/s after 0.1 s.
            let t = 1e-3 * ms.min(200) as f64;
            let q = if t < 0.1 { t.powi(3) / 0.3 } else { 0.01 / 3.0 + 0.1 * (t - 0.1) };
            let q = q + goes * (ms - 200).max(0) as f64;
            seen = if step > 0.0 { (q / step).round() * step } else { q };
        }
        let state = DriveState { q: Vector1::new(seen), qd: Vector1::new(0.0), truth: None };
        let now = MonoNs(ms * 1_000_000);
        watch.note((now, timing), &state, &Vector1::new(0.1), &Vector1::repeat(step));
        watch.is_stuck(0, now, step)
    })
}

#[test]
fn readings_that_stay_are_known_before_a_drive_with_a_servo() {
    for (step, period, within) in
        [(0.0, 1, 202..=206), (0.0, 4, 204..=212), (0.0, 8, 208..=216), (1e-5, 1, 203..=208)]
    {
        let at = stays_from(step, period, 0.0).unwrap();
        assert!(within.contains(&at), "{step} {period}: {at}");
    }
    // Held by what yields by a nanometre; behind steps that hide what a gear yields.
    assert_eq!(stays_from(0.0, 1, 1e-9), None);
    assert_eq!(stays_from(1e-4, 1, 0.0), None);
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
    let mut timing = DriveTiming::default();
    let traits = EncoderTraits {
        step: Vector1::zeros(),
        inertia: Vector1::repeat(1.0),
        coulomb: Vector1::zeros(),
        lag: Vector1::zeros(),
    };
    let (mut q, mut qd, mut seen) = (0.0_f64, 0.4_f64, 0.4_f64);
    let mut expected: Option<ExpectedMotion<1>> = None;
    for k in 0..200 {
        seen += (qd - seen) * (1.0 - (-1.0_f64 / 1.6).exp());
        let drive = DriveState { q: Vector1::new(q), qd: Vector1::new(seen), truth: None };
        timing.note(false);
        let told = watch.take((MonoNs(k * 1_000_000), timing), &drive, &drive.q, expected.as_ref(), &traits);
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
    let mut timing = DriveTiming::default();
    let traits = EncoderTraits {
        step: Vector2::zeros(),
        inertia: Vector2::repeat(1.0),
        coulomb: Vector2::zeros(),
        lag: Vector2::zeros(),
    };
    let still = DriveState { q: Vector2::new(0.1, 0.3), qd: Vector2::zeros(), truth: None };
    // It turns back before something else is a fault.
    let mut r = Vector2::new(0.1, 0.3);
    for k in 0..100 {
        r[0] += if k < 60 { 2e-5 } else { -2e-5 };
        let expected = ExpectedMotion { q: still.q, qd: still.qd, qdd: Vector2::new(5.0, 0.0) };
        timing.note(false);
        let seen = watch.take((MonoNs(k * 1_000_000), timing), &still, &r, Some(&expected), &traits);
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
    let believed = watch.distrust_still(&still, &reference, &Vector2::zeros());
    assert_eq!((believed.q, believed.qd), (r, reference.qd));
    assert_eq!(watch.distrusted(), [true, false]);
    watch.restart();
    assert_eq!(watch.distrusted(), [false; 2]);
}

/// A reference that is less than two steps of a coarse encoder away, and one that is farther.
#[test]
fn a_reading_within_its_step_is_no_frozen_encoder() {
    for (way, is_frozen) in [(9e-4, false), (3e-3, true)] {
        let mut watch = EncoderWatch::<1>::default();
        let mut timing = DriveTiming::default();
        let (zero, step) = (Vector1::zeros(), Vector1::repeat(5e-4));
        let traits = EncoderTraits { step, inertia: Vector1::repeat(1.0), coulomb: zero, lag: zero };
        let still = DriveState { q: Vector1::repeat(0.1), qd: zero, truth: None };
        let mut r = Vector1::repeat(0.1);
        for k in 0..50 {
            r[0] += way / 50.0;
            let expected = ExpectedMotion { q: still.q, qd: zero, qdd: zero };
            timing.note(false);
            watch.take((MonoNs(k * 1_000_000), timing), &still, &r, Some(&expected), &traits);
        }
        let limits = crate::motion::ActingLimits::default();
        watch.distrust_still(&still, &ReferenceState { q: r, qd: zero, qdd: zero, a: zero, limits }, &step);
        assert_eq!(watch.distrusted(), [is_frozen], "{way}");
    }
}

/// An observer of 80 rad/s behind an acceleration that is 20 rad/s^2 more than expected is 3 mrad off for as long as that lasts.
#[test]
fn what_the_observer_is_behind_is_no_leap() {
    for (bandwidth, told) in [(80.0_f64, None), (400.0, Some(Fault::DriveStateImplausible))] {
        let mut watch = EncoderWatch::<1>::default();
        let mut timing = DriveTiming::default();
        let one = Vector1::repeat(1.0);
        let lag = Vector1::repeat(bandwidth.powi(-2));
        let traits = EncoderTraits { step: Vector1::zeros(), inertia: one, coulomb: Vector1::zeros(), lag };
        let mut fault = None;
        for k in 0..100 {
            let q = Vector1::repeat(1e-5 * f64::from(k));
            let drive = DriveState { q: q.add_scalar(4e-3), qd: Vector1::repeat(0.01), truth: None };
            let expected = ExpectedMotion { q, qd: Vector1::repeat(0.01), qdd: Vector1::zeros() };
            timing.note(false);
            let now = MonoNs(i64::from(k) * 1_000_000);
            fault = fault.or(watch.take((now, timing), &drive, &q, Some(&expected), &traits).1);
        }
        assert_eq!(fault, told, "{bandwidth} rad/s");
    }
}
