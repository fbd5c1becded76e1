use super::*;
use nalgebra::Vector2;
use proptest::prelude::*;

fn limits() -> MotionLimits<2> {
    MotionLimits {
        lower: Vector2::new(-0.5, -0.1),
        upper: Vector2::new(0.8, 0.2),
        velocity: Vector2::new(1.0, 0.3),
        acceleration: Vector2::new(4.0, 2.0),
        jerk: Vector2::new(100.0, 30.0),
    }
}

fn check(r: &mut Reference<2>, requested_qd: &Vector2<f64>) -> Result<(), TestCaseError> {
    let (l, dt_s) = (r.limits.clone(), 1e-3);
    let (before, a_before) = (*r.state(), r.state().a);
    let s = *r.advance(requested_qd, SpanNs::MILLISECOND);
    for i in 0..2 {
        prop_assert!(s.q[i] >= l.lower[i] - 1e-9 && s.q[i] <= l.upper[i] + 1e-9, "position {}", s.q);
        prop_assert!(s.qd[i].abs() <= l.velocity[i] * (1.0 + 1e-9), "velocity {}", s.qd);
        prop_assert!(
            r.state().a[i].abs() <= l.acceleration[i] * (1.0 + 1e-9),
            "acceleration {}",
            r.state().a
        );
        prop_assert!(s.qdd[i].abs() <= l.acceleration[i] * (1.0 + 1e-9), "mean acceleration {}", s.qdd);
        prop_assert!(
            (r.state().a[i] - a_before[i]).abs() <= l.jerk[i] * dt_s * (1.0 + 1e-9),
            "jerk of joint {i}"
        );
        prop_assert!((s.qdd[i] - before.qdd[i]).abs() <= l.jerk[i] * dt_s * (1.0 + 1e-6) + 1e-9);
        prop_assert!(
            (s.q[i] - before.q[i] - before.qd[i] * dt_s).abs() <= 0.5 * l.acceleration[i] * 1e-6 + 1e-12
        );
    }
    Ok(())
}

proptest! {
    #[test]
    fn no_limit_is_ever_passed(
        start in (-0.5..0.8f64, -0.1..0.2f64),
        requests in prop::collection::vec((-5.0..5.0f64, -5.0..5.0f64, 1usize..400), 1..12)
    ) {
        let mut r = Reference::new(limits(), Vector2::new(start.0, start.1));
        for (a, b, ticks) in requests {
            for _ in 0..ticks {
                check(&mut r, &Vector2::new(a, b))?;
            }
        }
        // The soft stop: within the limits too, and it ends at rest.
        for _ in 0..1500 {
            check(&mut r, &Vector2::zeros())?;
        }
        prop_assert!(r.state().qd.amax() < 1e-9 && r.state().a.amax() < 1e-6, "{:?}", r.state());
    }

    /// Motion commands that change at every tick, as noise makes them.
    #[test]
    fn no_noise_passes_a_limit(requests in prop::collection::vec((-2.0..2.0f64, -2.0..2.0f64), 300)) {
        let mut r = Reference::new(limits(), Vector2::new(0.7, -0.05));
        for (a, b) in requests.iter().cycle().take(1200) {
            check(&mut r, &Vector2::new(*a, *b))?;
        }
    }

    /// The overshoot depends on the tick: it is at most a few times the velocity that one tick of full jerk makes.
    #[test]
    fn a_steady_request_is_reached_without_overshoot(a in -0.9..0.9f64, b in -0.25..0.25f64) {
        let mut free = limits();
        free.lower.fill(f64::NEG_INFINITY);
        free.upper.fill(f64::INFINITY);
        let requested_qd = Vector2::new(a, b);
        let mut r = Reference::new(free, Vector2::zeros());
        for _ in 0..1000 {
            let s = r.advance(&requested_qd, SpanNs::MILLISECOND);
            for i in 0..2 {
                let quantum = limits().jerk[i] * 1e-6;
                prop_assert!(s.qd[i].abs() <= requested_qd[i].abs() + 4.0 * quantum, "{} {requested_qd}", s.qd);
            }
            prop_assert!((s.qd[0] * b - s.qd[1] * a).abs() < 1e-9, "direction {}", s.qd);
        }
        prop_assert!((r.state().qd - requested_qd).amax() < 1e-9);
        prop_assert!(!r.state().limits.any());
    }

    /// A joint that starts outside its range moves no farther out and may come back.
    #[test]
    fn outside_the_range_the_way_back_is_open(beyond in 0.001..0.5f64, requested_qd in -1.0..1.0f64) {
        let mut r = Reference::new(limits(), Vector2::new(0.8 + beyond, 0.0));
        for _ in 0..3000 {
            r.advance(&Vector2::new(requested_qd, 0.0), SpanNs::MILLISECOND);
            prop_assert!(r.state().q[0] <= 0.8 + beyond + 1e-9);
        }
        if requested_qd < -0.1 {
            prop_assert!(r.state().q[0] < 0.8 + beyond - 0.05);
        }
    }
}

#[test]
fn direction_is_kept_when_speed_is_cut() {
    let mut r = Reference::new(limits(), Vector2::zeros());
    for _ in 0..150 {
        r.advance(&Vector2::new(4.0, 0.8), SpanNs::MILLISECOND);
        let s = r.state();
        assert!((s.qd[1] - 0.2 * s.qd[0]).abs() < 1e-12, "{}", s.qd);
    }
    assert_ne!(r.state().limits.joints(Limit::Velocity), 0);
}

#[test]
fn the_acting_limit_and_its_joint_are_told() {
    let mut r = Reference::new(limits(), Vector2::zeros());
    let s = r.advance(&Vector2::new(0.0, 0.1), SpanNs::MILLISECOND);
    assert_eq!(s.limits.joints(Limit::Jerk), 0b10, "a start is slowed down by the jerk limit");
    for _ in 0..3000 {
        r.advance(&Vector2::new(0.0, 0.1), SpanNs::MILLISECOND);
    }
    let s = r.state();
    assert_eq!(s.limits.joints(Limit::Position), 0b10, "the end of the range stops joint 2");
    assert!((s.q[1] - 0.2).abs() < 1e-3 && s.qd[1].abs() < 1e-3, "{s:?}");
}

#[test]
fn nonsense_stops_the_reference() {
    let mut r = Reference::new(limits(), Vector2::zeros());
    for _ in 0..500 {
        r.advance(&Vector2::new(0.2, 0.1), SpanNs::MILLISECOND);
    }
    for _ in 0..500 {
        r.advance(&Vector2::new(f64::NAN, 0.1), SpanNs::MILLISECOND);
    }
    assert!(r.state().qd.amax() < 1e-9);
    assert!(r.state().q.iter().all(|q| q.is_finite()));
}
