use super::*;
use crate::linalg::Random;
use nalgebra::Vector2;

fn limits() -> MotionLimits<2> {
    MotionLimits {
        lower: Vector2::repeat(-3.0),
        upper: Vector2::repeat(3.0),
        velocity: Vector2::new(2.0, 3.0),
        acceleration: Vector2::repeat(10.0),
        jerk: Vector2::repeat(500.0),
    }
}

fn at(ms: i32) -> MonoNs {
    MonoNs(i64::from(ms) * 1_000_000)
}

fn state(q: f64, qd: f64) -> DriveState<2> {
    DriveState { q: Vector2::new(q, 0.0), qd: Vector2::new(qd, 0.0), truth: None }
}

fn note(watch: &mut ArmWatch<2>, ms: i32, state: &DriveState<2>) -> Option<Fault> {
    note_timed(watch, ms, state, DriveTiming::default())
}

fn note_timed(watch: &mut ArmWatch<2>, ms: i32, state: &DriveState<2>, timing: DriveTiming) -> Option<Fault> {
    watch.note(at(ms), state, state, &limits(), timing)
}

#[test]
fn what_no_arm_does_is_told_at_once() {
    for (q, qd, fault) in [
        (f64::NAN, 0.0, Fault::DriveStateNotFinite),
        (0.0, f64::INFINITY, Fault::DriveStateNotFinite),
        (0.0, 1e200, Fault::DriveStateImplausible),
        (0.0, 25.0, Fault::DriveStateImplausible),
        (0.5, 0.0, Fault::DriveStateImplausible),
    ] {
        let mut watch = ArmWatch::default();
        assert_eq!(note(&mut watch, 0, &state(0.0, 0.0)), None);
        assert_eq!(note(&mut watch, 1, &state(q, qd)), Some(fault), "{q} {qd}");
        assert_eq!(note(&mut watch, 2, &state(0.0, 0.0)), None, "a state that was refused is forgotten");
    }
}

#[test]
fn overspeed_is_reported_in_its_window_and_limit_speed_is_not() {
    for (speed, within) in [(2.0, None), (2.9, None), (3.6, Some(24)), (5.0, Some(22))] {
        let mut watch = ArmWatch::default();
        let told = (0..400).find(|k| {
            let q = speed * 1e-3 * f64::from(*k) - 0.5;
            note(&mut watch, *k, &state(q, speed)) == Some(Fault::TooFast)
        });
        assert_eq!(told.is_some(), within.is_some(), "{speed}");
        assert!(told.unwrap_or(0) <= within.unwrap_or(0), "{speed}: {told:?}");
    }
}

/// A joint behind a drive of `period` ms, which is where `joint` says at the time of its states; what is told of it within 3 s. Its reference moves at `speed`.
fn told(period: i32, speed: f64, joint: impl Fn(f64) -> f64) -> Option<(i32, Fault)> {
    let (mut watch, mut timing) = (ArmWatch::default(), DriveTiming::default());
    let mut held = (0.0, 0.0);
    (0..3000).find_map(|k| {
        let t = 1e-3 * f64::from(k);
        timing.note(k % period != 0);
        if k % period == 0 {
            held = (joint(t), (joint(t + 1e-4) - joint(t)) / 1e-4);
        }
        let way = Vector2::new(speed * 1e-3, 0.0);
        let state = state(held.0, held.1);
        let fault = note_timed(&mut watch, k, &state, timing).or_else(|| watch.follow(&state.q, &way));
        fault.or_else(|| watch.swing(&state.q, &way, timing)).map(|fault| (k, fault))
    })
}

#[test]
fn slower_drives_are_supervised_too() {
    let tau = std::f64::consts::TAU;
    for period in [1, 2, 4, 8] {
        assert_eq!(told(period, 1.9, |t| 1.9 * t - 2.9), None, "{period} ms: it follows");
        assert_eq!(told(period, -1.9, |t| 2.9 - 1.9 * (t - 0.034).max(0.0)), None, "{period} ms: with a lag");
        let jam = told(period, 0.5, |_| 0.3);
        assert!(matches!(jam, Some((at, Fault::DoesNotFollow)) if at <= 420), "{period} ms: {jam:?}");
        let swing = told(period, 0.0, |t| 1.5 / (tau * 12.0) * (tau * 12.0 * t).sin());
        assert!(matches!(swing, Some((at, Fault::Oscillates)) if at <= 520), "{period} ms: {swing:?}");
    }
    for period in [1, 2] {
        let fast = told(period, 5.0, |t| 5.0 * t - 2.5);
        assert!(matches!(fast, Some((at, Fault::TooFast)) if at <= 25), "{period} ms: {fast:?}");
    }
    // Longer than a drive's cycle may be, nobody knows whether it moves.
    assert_eq!(told(40, 1.9, |t| 1.9 * t - 2.9), None);
}

#[test]
fn positions_that_come_late_are_no_speed() {
    let mut watch = ArmWatch::default();
    for k in 0..400 {
        let q = 2.0 * 1e-3 * f64::from(k / 15 * 15);
        assert_eq!(note(&mut watch, k, &state(q, 1.9)), None, "{k}");
    }
}

/// A state that is held because none comes says nothing of where the joint is now.
#[test]
fn states_that_come_late_contradict_nothing() {
    for (period, fresh) in [(8, 1), (40, 10), (300, 100)] {
        let (mut watch, mut held) = (ArmWatch::default(), state(0.0, 2.0));
        let mut timing = DriveTiming::default();
        for k in 0..6000 {
            let t = f64::from(k) * 1e-3;
            timing.note(k % period >= fresh);
            if k % period < fresh {
                held = state(0.5 * (4.0 * t).sin(), 2.0 * (4.0 * t).cos());
            }
            assert_eq!(note_timed(&mut watch, k, &held, timing), None, "{period}: {k}");
        }
    }
}

#[test]
fn a_frozen_position_with_a_reported_velocity_is_a_fault() {
    let mut watch = ArmWatch::default();
    let told = (0..1000).find(|k| {
        let q = 0.2e-3 * f64::from((*k).min(300));
        note(&mut watch, *k, &state(q, 0.2)) == Some(Fault::DriveStateImplausible)
    });
    assert!((400..=900).contains(&told.unwrap()), "{told:?}");
}

#[test]
fn coarse_and_noisy_encoders_are_no_speed() {
    let mut watch = ArmWatch::default();
    let mut random = Random::new(3);
    for k in 0..5000 {
        let t = f64::from(k) * 1e-3;
        let q = 1.9 * t.sin() + 3e-4 * random.gaussian();
        let steps = (q / 1e-3).round() * 1e-3;
        let state = state(steps, 1.9 * t.cos() + 0.3 * random.gaussian());
        assert_eq!(note(&mut watch, k, &state), None);
    }
}

#[test]
fn a_blocked_joint_is_reported_within_a_second() {
    for speed in [0.06, 0.3, 2.0] {
        let mut watch = ArmWatch::<2>::default();
        let mut told = None;
        for k in 0..3000 {
            let q = if k < 1000 { speed * 1e-3 * f64::from(k) } else { speed };
            let moving = Vector2::new(q, 0.0);
            if watch.follow(&moving, &Vector2::new(speed * 1e-3, 0.0)).is_some() {
                told.get_or_insert(k);
            }
        }
        let after = told.unwrap() - 1000;
        assert!((0..=600).contains(&after), "{speed}: {after}");
    }
}

/// What a joint did less than its reference, whatever is told of it.
#[test]
fn a_standing_joint_comes_to_a_sum_of_lag_and_a_slow_drive_not() {
    for (share, least, most) in [(0.0, 0.09, 0.11), (0.75, 0.0, 0.02), (1.3, 0.0, 0.02)] {
        let mut watch = ArmWatch::<2>::default();
        for k in 0..5000 {
            let q = 0.02e-3 * f64::from(k);
            watch.follow(&Vector2::new(share * q, 0.0), &Vector2::new(0.02e-3, 0.0));
        }
        assert!((least..most).contains(&watch.lag()), "{share}: {}", watch.lag());
    }
}

/// A reference that creeps towards its goal before a joint that stands: it never goes far in 0.4 s, and goes far in the end. Around a joint that sticks it may go to and fro for as long as it likes.
#[test]
fn a_joint_before_a_creeping_reference_is_told() {
    for speed in [1e-3, 5e-3, 0.04] {
        let mut watch = ArmWatch::<2>::default();
        let way = Vector2::new(speed * 1e-3, 0.0);
        let told_s = (0..40_000)
            .find(|_| watch.follow(&Vector2::zeros(), &way).is_some())
            .map(|k| f64::from(k) * 1e-3);
        // 20 mrad and the parts of 0.4 s, to one part.
        let due_s = 0.02 / speed + 0.4;
        assert!(told_s.is_some_and(|t| (due_s - t).abs() < 0.11), "{speed}: {told_s:?}");
    }
    let mut watch = ArmWatch::<2>::default();
    for k in 0..60_000 {
        let way = 0.015 * 2e-3 * (2e-3 * f64::from(k)).cos();
        assert_eq!(watch.follow(&Vector2::zeros(), &Vector2::new(way, 0.0)), None, "{k}");
    }
    // A joint that creeps behind its reference by a fifth of its speed and an eighth more.
    let mut watch = ArmWatch::<2>::default();
    for k in 0..40_000 {
        let q = Vector2::new(0.225 * 5e-6 * f64::from(k), 0.0);
        assert_eq!(watch.follow(&q, &Vector2::new(5e-6, 0.0)), None, "{k}");
    }
}

#[test]
fn a_joint_that_lags_or_creeps_follows() {
    let mut watch = ArmWatch::<2>::default();
    let mut q = 0.0;
    for k in 0..5000 {
        let r = 0.3 * (f64::from(k) * 2e-3).sin();
        let r_next = 0.3 * (f64::from(k + 1) * 2e-3).sin();
        q += (r - q) * 0.02;
        // The other one stands before a reference that has gone 15 mm in the end.
        let told = watch.follow(&Vector2::new(q, 0.0), &Vector2::new(r_next - r, 3e-6));
        assert_eq!(told, None, "{k}");
    }
}

/// Blows that make joints faster than any arm, far beyond their ranges: such an arm has to be braked by its states.
#[test]
fn a_joint_that_is_seen_to_be_flung_is_believed() {
    let (mut watch, mut q, mut qd) = (ArmWatch::default(), 0.0, 1.0);
    let mut told = Vec::new();
    for ms in 0..900 {
        let acceleration = match ms {
            100..110 => 4000.0,
            300..420 => -350.0,
            _ => 0.0,
        };
        q += qd * 1e-3 + 0.5e-6 * acceleration;
        qd += acceleration * 1e-3;
        told.push(note(&mut watch, ms, &state(q, qd)));
    }
    assert!(q > 9.0 && qd.abs() < 2.0, "{q} {qd}");
    assert!(told.iter().all(|fault| fault.is_none_or(|fault| fault == Fault::TooFast)), "{told:?}");
    assert_eq!(told.iter().position(Option::is_some), Some(104), "at 21 rad/s, before its window is full");
    assert_eq!(told.last(), Some(&None));
}

#[test]
fn readings_that_leap_or_contradict_themselves_are_not_believed() {
    // A reading that leaps, whose velocity is computed from it; a velocity that grows while the joint stands.
    let leaps = (0..50).map(|ms| match ms {
        30 => state(0.23, 200.0),
        ms => state(1e-3 * f64::from(ms), 1.0),
    });
    let grows = (0..50).map(|ms| state(0.0, 1.5_f64.powi(ms - 20)));
    for states in [leaps.collect::<Vec<_>>(), grows.collect()] {
        let mut watch = ArmWatch::default();
        let told: Vec<_> = (0..).zip(&states).filter_map(|(ms, state)| note(&mut watch, ms, state)).collect();
        assert_eq!(told.first(), Some(&Fault::DriveStateImplausible), "{told:?}");
    }
}
