use super::*;

const MS: i64 = 1_000_000;

fn limits() -> GuardedLimits {
    let joint = GuardedJoint { lower: -2.0, upper: 2.0, velocity: 1.5, acceleration: 10.0, effort: 50.0 };
    GuardedLimits {
        joints: vec![joint; 2],
        silence: SpanNs(100 * MS),
        states: SpanNs(400 * MS),
        space: GuardedSpace::default(),
    }
}

fn command(tick: u64, q: f64, qd: f64) -> DriveCommandMsg {
    let mut m = DriveCommandMsg { tick, joints: 2, mode: POSITION, ..DriveCommandMsg::default() };
    m.q_r[..2].copy_from_slice(&[q, 0.0]);
    m.qd_r[..2].copy_from_slice(&[qd, 0.0]);
    m
}

fn state(ms: i64, q: f64, qd: f64) -> DriveStateMsg {
    let mut m = DriveStateMsg { stamp: MonoNs(ms * MS), joints: 2, ..DriveStateMsg::default() };
    (m.q[0], m.qd[0]) = (q, qd);
    m
}

/// Two commands, the second of them a tick after the first; what is found in it.
fn after(first: DriveCommandMsg, change: impl FnOnce(&mut DriveCommandMsg)) -> Option<GuardianFinding> {
    let mut guardian = Guardian::new(limits());
    assert_eq!(guardian.command(&first), None);
    let mut second = DriveCommandMsg { tick: first.tick + 1, ..first };
    change(&mut second);
    guardian.command(&second)
}

fn beyond(finding: Option<GuardianFinding>) -> Option<(usize, GuardedNumber)> {
    match finding {
        Some(GuardianFinding::Beyond { joint, what, .. }) => Some((joint, what)),
        _ => None,
    }
}

#[test]
fn a_motion_at_the_limits_is_nothing_to_stop() {
    let mut guardian = Guardian::new(limits());
    let (mut q, mut qd) = (-1.9, 0.0);
    for tick in 0..3000 {
        let a = if tick < 150 { 10.0 } else { 0.0 };
        let a = if q + qd * qd / 20.0 > 1.9 && qd > 0.0 { -10.0 } else { a };
        let next: f64 = (qd + a * 1e-3_f64).clamp(0.0, 1.5);
        (q, qd) = (q + 0.5e-3 * (qd + next), next);
        assert_eq!(guardian.command(&command(tick, q, qd)), None, "{tick}: {q} {qd}");
        assert_eq!(guardian.state(&state(tick as i64, q, 1.4 * qd)), None);
        assert_eq!(guardian.look(MonoNs(tick as i64 * MS), || ControlLife::Runs), None);
    }
    assert!(q > 1.8 && guardian.is_armed());
}

#[test]
fn each_wrong_number_is_found_by_its_name() {
    let rests = command(7, 0.5, 0.0);
    for number in [f64::NAN, f64::INFINITY] {
        let found = after(rests, |c| c.tau[1] = number);
        assert_eq!(found, Some(GuardianFinding::NotFinite { joint: 1 }));
    }
    let found = after(rests, |c| c.joints = 3);
    assert_eq!(found, Some(GuardianFinding::Malformed { joints: 3, mode: POSITION }));
    assert!(matches!(after(rests, |c| c.mode = 1), Some(GuardianFinding::Malformed { .. })));
    assert!(matches!(after(rests, |c| c.mode = 9), Some(GuardianFinding::Malformed { .. })));
    assert_eq!(beyond(after(rests, |c| c.qd_r[0] = -1.6)), Some((0, GuardedNumber::Velocity)));
    assert_eq!(beyond(after(rests, |c| c.qd_r[1] = 0.0115)), Some((1, GuardedNumber::Acceleration)));
    assert_eq!(beyond(after(rests, |c| c.q_r[0] += 0.002)), Some((0, GuardedNumber::Step)));
    assert_eq!(after(rests, |c| c.tau[0] = 60.0), None, "a torque for information");
    let torque = DriveCommandMsg { mode: 0, ..rests };
    assert_eq!(beyond(after(torque, |c| c.tau[0] = -60.0)), Some((0, GuardedNumber::Effort)));
    let velocity = DriveCommandMsg { mode: 1, ..rests };
    assert_eq!(after(velocity, |c| c.q_r[0] += 0.1), None, "a position for information");
    let edge = command(7, 2.0, 0.5);
    let found = after(edge, |c| c.q_r[0] += 0.5e-3);
    assert_eq!(beyond(found), Some((0, GuardedNumber::Position)));
    assert_eq!(
        found.unwrap().describe(&["elbow".into()]),
        "joint \"elbow\" is commanded to 2.0005 rad or m, beyond 2.0000"
    );
    assert_eq!(
        after(command(7, 2.1, -0.5), |c| c.q_r[0] -= 0.5e-3),
        None,
        "an arm that started outside goes inward"
    );
    assert_eq!(after(command(7, 2.1, 0.0), |_| {}), None, "or stands there");
}

/// A range on one side of zero has an inside and an outside as any.
#[test]
fn a_range_beside_zero_is_left_outwards_alone() {
    for (q, way, is_out) in
        [(1.0, -4e-4, true), (1.0, 4e-4, false), (0.9, -4e-4, true), (0.9, 4e-4, false), (2.0, 4e-4, true)]
    {
        let mut limits = limits();
        limits.joints[0].lower = 1.0;
        let mut guardian = Guardian::new(limits);
        assert_eq!(guardian.command(&command(7, q, 0.0)), None);
        let found = beyond(guardian.command(&command(8, q + way, 0.0)));
        assert_eq!(found, is_out.then_some((0, GuardedNumber::Position)), "{q} {way}");
    }
}

/// What `docs/safety.md` says of it: 5 % and 1e-4 more than the limit pass, and no more.
#[test]
fn a_number_may_be_a_little_beyond_its_limit() {
    for (qd, passes) in [(1.575 + 0.9e-4, true), (1.575 + 1.1e-4, false)] {
        for side in [1.0, -1.0] {
            let found = Guardian::new(limits()).command(&command(7, 0.0, side * qd));
            assert_eq!(beyond(found).is_none(), passes, "{side} {qd}");
        }
    }
}

/// What rounding makes of the end of a range is no way out of it.
#[test]
fn a_position_at_the_end_of_its_range_may_be_rounded() {
    for side in [1.0, -1.0] {
        assert_eq!(after(command(7, 2.0 * side, 0.0), |c| c.q_r[0] += side * 5e-5), None);
        assert_eq!(
            beyond(after(command(7, 2.0 * side, 0.0), |c| c.q_r[0] += side * 5e-4)),
            Some((0, GuardedNumber::Position))
        );
    }
}

/// A range that ends at zero, where the difference of two numbers is exact: 1e-4 beyond it is rounding, and more is not.
#[test]
fn rounding_ends_at_what_is_told_of_it() {
    for (q, is_out) in [(1e-4, false), (1.01e-4, true)] {
        let mut limits = limits();
        limits.joints[0].upper = 0.0;
        let mut guardian = Guardian::new(limits);
        assert_eq!(guardian.command(&command(7, 0.0, 0.0)), None);
        assert_eq!(guardian.command(&command(8, q, 0.0)).is_some(), is_out, "{q}");
    }
}

/// A clock that is set back tells no speed, however far the arm is from where it was.
#[test]
fn states_of_a_clock_that_is_set_back_tell_no_speed() {
    let mut guardian = Guardian::new(limits());
    assert_eq!(guardian.command(&command(7, 0.0, 0.0)), None);
    assert_eq!(guardian.state(&state(1000, 0.0, 0.0)), None);
    assert_eq!(guardian.state(&state(900, 0.5, 0.0)), None);
    assert_eq!(
        beyond(guardian.state(&state(1000, 0.9, 0.0))),
        Some((0, GuardedNumber::MeasuredSpeed)),
        "judged anew from there"
    );
}

/// Where states were missing for longer than three spans nobody knows how fast the arm was; up to there its mean speed counts. Before the first command none does.
#[test]
fn states_behind_a_gap_tell_no_speed() {
    let speed_after = |gap_ms: i64, is_armed: bool| {
        let mut guardian = Guardian::new(limits());
        if is_armed {
            assert_eq!(guardian.command(&command(7, 0.0, 0.0)), None);
        }
        assert_eq!(guardian.state(&state(1000, 0.0, 0.0)), None);
        beyond(guardian.state(&state(1000 + gap_ms, 1.0, 0.0))).is_some()
    };
    for (gap_ms, tells) in [(39, false), (40, true), (120, true), (121, false), (200, false)] {
        assert_eq!(speed_after(gap_ms, true), tells, "{gap_ms}");
        assert!(!speed_after(gap_ms, false));
    }
}

#[test]
fn skipped_ticks_give_a_step_the_time_that_passed() {
    let slow = command(7, 0.5, 0.0);
    assert_eq!(after(slow, |c| (c.tick, c.qd_r[0]) = (17, 0.09)), None);
    assert_eq!(
        beyond(after(slow, |c| (c.tick, c.qd_r[0]) = (17, 0.11))),
        Some((0, GuardedNumber::Acceleration))
    );
}

/// Looks each millisecond after a command; when it stops, and by what.
fn silence(life: impl Fn(i64) -> ControlLife) -> (i64, GuardianFinding) {
    let mut guardian = Guardian::new(limits());
    assert_eq!(guardian.look(MonoNs(0), || ControlLife::Runs), None);
    assert_eq!(guardian.command(&command(0, 0.0, 0.0)), None);
    for ms in 1..1000 {
        if let Some(finding) = guardian.look(MonoNs(ms * MS), || life(ms)) {
            assert!(guardian.has_stopped());
            return (ms, finding);
        }
    }
    panic!("it never stopped")
}

#[test]
fn a_suspended_or_dead_control_is_stopped_at_once() {
    for (life, words) in [(ControlLife::Suspended, "is suspended"), (ControlLife::Dead, "has ended")] {
        let (ms, finding) = silence(|_| life);
        assert_eq!(ms, 5);
        assert!(finding.describe(&[]).starts_with("no command from control for 5.0 ms"), "{finding:?}");
        assert!(finding.describe(&[]).ends_with(words), "{finding:?}");
    }
    assert_eq!(silence(|ms| if ms < 30 { ControlLife::Runs } else { ControlLife::Suspended }).0, 30);
}

#[test]
fn a_control_that_is_late_has_as_long_as_it_is_told() {
    assert_eq!(silence(|_| ControlLife::Runs).0, 100);
}

#[test]
fn a_machine_that_stood_as_a_whole_stops_nothing() {
    let mut guardian = Guardian::new(limits());
    assert_eq!(guardian.look(MonoNs(0), || ControlLife::Runs), None);
    assert_eq!(guardian.command(&command(0, 0.0, 0.0)), None);
    assert_eq!(guardian.look(MonoNs(3_600_000 * MS), || ControlLife::Suspended), None);
    assert_eq!(guardian.command(&command(3_600_000, 0.0, 0.0)), None);
    assert_eq!(guardian.look(MonoNs(3_600_001 * MS), || ControlLife::Suspended), None);
}

#[test]
fn before_the_first_command_and_after_last_nothing_is_silent() {
    let mut guardian = Guardian::new(limits());
    let mut time = 0;
    let mut wait = |guardian: &mut Guardian| {
        (0..500).for_each(|_| {
            time += MS;
            assert_eq!(guardian.look(MonoNs(time), || ControlLife::Dead), None);
        });
    };
    wait(&mut guardian);
    let start = DriveCommandMsg { flags: drive_flag::START, joints: 2, ..DriveCommandMsg::default() };
    assert_eq!(guardian.command(&start), None);
    wait(&mut guardian);
    assert_eq!(guardian.command(&command(0, 0.0, 0.0)), None);
    assert!(guardian.is_armed());
    // The last command may have any step: it names where to stay, and no velocity.
    let last = DriveCommandMsg { flags: drive_flag::LAST, ..command(1, 1.0, 0.0) };
    assert_eq!(guardian.command(&last), None);
    wait(&mut guardian);
}

#[test]
fn a_stop_stands_until_it_is_reset() {
    let mut guardian = Guardian::new(limits());
    guardian.stop();
    let wrong = command(5, f64::NAN, 0.0);
    assert_eq!(guardian.command(&wrong), None, "it stands already");
    assert_eq!(guardian.command(&DriveCommandMsg { flags: drive_flag::START, ..wrong }), None);
    assert!(guardian.has_stopped());
    guardian.reset();
    assert_eq!(guardian.command(&wrong), Some(GuardianFinding::NotFinite { joint: 0 }));
}

#[test]
fn a_measured_arm_that_is_too_fast_is_stopped_and_noise_is_not() {
    let run = |speed: f64, noise: f64, limit: f64| {
        let mut limits = limits();
        limits.joints[0].velocity = limit;
        let mut guardian = Guardian::new(limits);
        assert_eq!(guardian.command(&command(0, 0.0, 0.0)), None);
        (0..300).find_map(|ms| {
            let q = speed * ms as f64 * 1e-3 + if ms % 2 == 0 { noise } else { -noise };
            guardian.state(&state(ms, q, speed)).map(|finding| (ms, finding))
        })
    };
    assert_eq!(run(2.2, 2e-3, 1.5), None);
    // What is noise is no speed of a slow joint either.
    assert_eq!(run(0.0, 2e-3, 0.05), None);
    for (speed, limit) in [(3.0, 1.5), (-3.0, 1.5), (0.4, 0.05)] {
        let (ms, finding) = run(speed, 0.0, limit).unwrap();
        assert_eq!((ms, beyond(Some(finding))), (40, Some((0, GuardedNumber::MeasuredSpeed))));
    }
}

#[test]
fn rest_is_twenty_states_without_speed() {
    let mut guardian = Guardian::new(limits());
    for ms in 0..20 {
        assert!(!guardian.is_at_rest());
        assert_eq!(guardian.state(&state(ms, 0.0, 0.001)), None);
    }
    assert!(guardian.is_at_rest());
    assert_eq!(guardian.state(&state(21, 0.0, 0.2)), None);
    assert!(!guardian.is_at_rest());
}

/// A joint about z in the origin, and one that slides along what was x: the sphere at its tip must stay below x = 1.
fn with_a_wall() -> GuardedLimits {
    let axis = |direction, slides| GuardedAxis { point: [0.0; 3], direction, slides };
    let mut space = GuardedSpace::default();
    (space.axes[0], space.axes[1]) = (axis([0.0, 0.0, 1.0], false), axis([1.0, 0.0, 0.0], true));
    space.spheres = vec![GuardedSphere { center: [0.5, 0.0, 0.2], joints: 2, radius_m: 0.1 }];
    space.sides = vec![GuardedSide { normal: [-1.0, 0.0, 0.0], offset_m: -1.0 }];
    GuardedLimits { space, ..limits() }
}

/// The command whose second joint slides to `x`, with so much speed.
fn slid(tick: u64, x: f64, speed: f64) -> DriveCommandMsg {
    let mut m = command(tick, 0.0, 0.0);
    (m.q_r[1], m.qd_r[1]) = (x, speed);
    m
}

#[test]
fn an_arm_that_moves_beyond_a_plane_is_stopped() {
    let mut guardian = Guardian::new(with_a_wall());
    let found: Vec<_> = (0..300).map(|k| guardian.command(&slid(k, 0.3 + 1e-3 * k as f64, 1.0))).collect();
    // The sphere touches the plane at 0.4; 5 mm are passed after the tick 105.
    let first = found.iter().position(Option::is_some).unwrap();
    assert!((115..125).contains(&first), "{first}");
    assert!(
        matches!(found[first], Some(GuardianFinding::Outside { sphere: 1, beyond_m }) if (0.01..0.03).contains(&beyond_m))
    );
    // Measured, where commands stay inside.
    let mut guardian = Guardian::new(with_a_wall());
    let measured = |k: i64| {
        let mut m = state(k, 0.0, 0.0);
        m.q[1] = 0.45;
        m
    };
    let found: Vec<_> = (0..60)
        .map(|k| {
            let of_state = guardian.state(&if k < 20 { state(k, 0.0, 0.0) } else { measured(k) });
            of_state.or(guardian.command(&slid(k as u64, 1e-3 * k as f64, 1.0)))
        })
        .collect();
    assert!(
        found[..34].iter().all(Option::is_none) && found[34..36].iter().any(Option::is_some),
        "{found:?}"
    );
}

/// A sphere without radius that slides along x, and must stay below zero: places are exact.
fn with_a_point_at_a_wall() -> GuardedLimits {
    let mut limits = with_a_wall();
    limits.space.spheres[0] = GuardedSphere { center: [0.0; 3], joints: 2, radius_m: 0.0 };
    limits.space.sides[0].offset_m = 0.0;
    limits
}

#[test]
fn five_millimetres_beyond_a_plane_are_none() {
    // Where the motion begins, how far it is then, and whether that is too far.
    for (begins, x, is_outside) in [
        (0.0, 5e-3, false),
        (0.0, 5.01e-3, true),
        (5e-3, 6e-3, true),
        (5.01e-3, 6e-3, false),
        (5.01e-3, 10e-3, false),
        (5.01e-3, 10.02e-3, true),
    ] {
        let mut guardian = Guardian::new(with_a_point_at_a_wall());
        assert_eq!(guardian.command(&slid(0, begins, 0.0)), None);
        // It takes ten ticks, so that no step is too long.
        let found = (1..60).find_map(|k| guardian.command(&slid(10 * k, x, 0.01)));
        assert_eq!(found.is_some(), is_outside, "{begins} {x} {found:?}");
        assert!(found.is_none_or(|found| matches!(found, GuardianFinding::Outside { .. })), "{found:?}");
    }
    // A tenth of the speed of a rest is none: an arm that is pushed there is not stopped.
    let mut guardian = Guardian::new(with_a_point_at_a_wall());
    assert_eq!(guardian.command(&slid(0, 0.0, 0.0)), None);
    assert!((1..60).all(|k| guardian.command(&slid(10 * k, 8e-3, 1e-3)).is_none()));
}

#[test]
fn an_arm_beyond_a_plane_may_rest_and_come_back() {
    let mut guardian = Guardian::new(with_a_wall());
    for k in 0..100 {
        assert_eq!(guardian.command(&slid(k, 0.5, 0.0)), None, "rests");
    }
    for k in 100..300 {
        assert_eq!(guardian.command(&slid(k, 0.5 - 1e-3 * (k - 100) as f64, -0.01)), None, "comes back");
    }
    for k in 300..400 {
        assert_eq!(guardian.command(&slid(k, 0.3, 0.0)), None, "rests inside");
    }
    // What was allowed there is not any more.
    assert!((400..560).any(|k| guardian.command(&slid(k, 0.3 + 1e-3 * (k - 400) as f64, 0.01)).is_some()));
}

#[test]
fn control_that_moves_an_arm_that_tells_nothing_is_stopped() {
    for (speed, frozen) in [(1.0, true), (1.0, false), (0.0, false)] {
        let mut guardian = Guardian::new(limits());
        let found = (0..1500).find_map(|k| {
            let x = if speed > 0.0 { -1.5 + 1e-3 * k as f64 } else { 0.0 };
            assert_eq!(guardian.command(&slid(k, x, speed)), None);
            if k < 500 {
                assert_eq!(guardian.state(&state(k as i64, 0.0, 0.0)), None);
            } else if frozen {
                let _ = guardian.state(&state(499, 0.0, 0.0));
            }
            guardian.look(MonoNs(k as i64 * MS), || ControlLife::Runs).map(|finding| (k, finding))
        });
        let Some((k, finding)) = found else {
            assert!(speed == 0.0, "an arm that is held may be silent: control tells it");
            continue;
        };
        assert!(speed > 0.0 && (895..905).contains(&k), "{k}");
        assert!(matches!(finding, GuardianFinding::Blind { .. }));
        assert!(
            finding.describe(&[]).ends_with("no state has come from the drive for 400.0 ms"),
            "{finding:?}"
        );
    }
}

/// Each motion goes 4 mm farther out than the one before and ends in a rest: not farther than a single one may.
#[test]
fn rests_beyond_a_plane_do_not_add_up() {
    let mut guardian = Guardian::new(with_a_wall());
    let mut tick = 0;
    let mut command = |x: f64, speed: f64, guardian: &mut Guardian| {
        tick += 1;
        guardian.command(&slid(tick, x, speed))
    };
    let mut stopped_at = None;
    'motions: for motion in 1..5 {
        let end = 0.4 + 4e-3 * f64::from(motion);
        for k in 0..40 {
            let x = end - 4e-3 * f64::from((20 - k).max(0)) / 20.0;
            if command(x, 0.01, &mut guardian).is_some() {
                stopped_at = Some(motion);
                break 'motions;
            }
        }
        for _ in 0..10 {
            assert_eq!(command(end, 0.0, &mut guardian), None);
        }
    }
    assert_eq!(stopped_at, Some(2));
}
