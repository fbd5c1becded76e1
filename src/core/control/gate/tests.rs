use super::*;
use crate::motion::{ActingLimits, Reference};
use crate::time::SpanNs;
use nalgebra::Vector2;
use proptest::prelude::*;

fn limits() -> MotionLimits<2> {
    MotionLimits {
        lower: Vector2::new(-1.0, -0.1),
        upper: Vector2::new(1.0, 0.2),
        velocity: Vector2::new(2.0, 0.3),
        acceleration: Vector2::new(10.0, 2.0),
        jerk: Vector2::new(500.0, 100.0),
    }
}

fn settings(mode: CommandMode) -> GateSettings<2> {
    let (effort, effort_rate) = (Vector2::new(150.0, 28.0), Vector2::new(15_000.0, 2_800.0));
    GateSettings { effort, effort_rate, mode, max_excess: 0.05 }
}

fn gate(mode: CommandMode) -> Gate<2> {
    Gate::new(settings(mode), &limits(), &Vector2::zeros())
}

/// Independent check of what has passed.
#[derive(Default)]
struct Judge {
    last: Option<(DriveCommand<2>, Vector2<f64>)>,
}

impl Judge {
    fn judge(&mut self, c: &DriveCommand<2>) -> Result<(), TestCaseError> {
        let (l, s) = (limits(), settings(CommandMode::Torque));
        for i in 0..2 {
            prop_assert!(
                c.q_r[i] >= l.lower[i] - 1e-5 && c.q_r[i] <= l.upper[i] + 1e-5,
                "position {}",
                c.q_r
            );
            prop_assert!(c.qd_r[i].abs() <= l.velocity[i] * (1.0 + 1e-5), "velocity {}", c.qd_r);
            prop_assert!(c.tau[i].abs() <= s.effort[i], "effort {}", c.tau);
        }
        let mut qdd = Vector2::zeros();
        if let Some((before, qdd_before)) = &self.last {
            qdd = (c.qd_r - before.qd_r) / 1e-3;
            for i in 0..2 {
                prop_assert!(qdd[i].abs() <= l.acceleration[i] * (1.0 + 1e-5), "acceleration {qdd}");
                // Means over a tick of an acceleration that changes by at most jerk times tick.
                let jerk = (qdd[i] - qdd_before[i]) / 1e-3;
                prop_assert!(jerk.abs() <= 1.51 * l.jerk[i], "jerk {jerk} of joint {i}");
                let rate = (c.tau[i] - before.tau[i]).abs() / 1e-3;
                prop_assert!(rate <= s.effort_rate[i] * (1.0 + 1e-9), "effort rate {rate}");
                let way = c.q_r[i] - before.q_r[i] - 0.5e-3 * (c.qd_r[i] + before.qd_r[i]);
                prop_assert!(way.abs() < 1e-6, "the position does not go with the velocity: {way}");
            }
        }
        self.last = Some((*c, qdd));
        Ok(())
    }
}

/// Past the gate, with an arm that does as it is told, of joints without weight.
fn pass(gate: &mut Gate<2>, reference: &ReferenceState<2>, tau: &Vector2<f64>) -> Passed<2> {
    gate.pass(reference, tau, &at(Vector2::zeros(), Vector2::zeros()), Vector2::zeros)
}

fn at(q: Vector2<f64>, qd: Vector2<f64>) -> DriveState<2> {
    DriveState { q, qd, truth: None }
}

fn any_bits() -> impl Strategy<Value = f64> {
    prop_oneof![any::<u64>().prop_map(f64::from_bits), -3.0..3.0f64, -400.0..400.0f64]
}

fn point(q: Vector2<f64>, qd: Vector2<f64>, a: Vector2<f64>) -> ReferenceState<2> {
    ReferenceState { q, qd, qdd: Vector2::zeros(), a, limits: ActingLimits::default() }
}

proptest! {
    /// For commands of arbitrary bits: no limit is exceeded, and everything is finite.
    #[test]
    fn nothing_beyond_the_limits_passes(
        commands in prop::collection::vec(prop::array::uniform8(any_bits()), 1..200), repeat in 1usize..50
    ) {
        let mut gate = gate(CommandMode::Torque);
        let mut judge = Judge::default();
        let zero = Vector2::zeros();
        judge.judge(&pass(&mut gate, &point(zero, zero, zero), &zero).command)?;
        for c in commands {
            let pair = |i: usize| Vector2::new(c[i], c[i + 1]);
            for _ in 0..repeat {
                let passed = pass(&mut gate, &point(pair(2), pair(4), pair(6)), &pair(0));
                judge.judge(&passed.command)?;
                let numbers = c[..6].iter().all(|x| x.is_finite());
                prop_assert!(numbers || passed.fault == Some(Fault::CommandsRefused));
            }
        }
    }

    /// What a reference makes passes as it is, of motion commands for velocities and for accelerations.
    #[test]
    fn a_reference_passes_unchanged(
        requests in prop::collection::vec((-5.0..5.0f64, -5.0..5.0f64, 1usize..200, any::<bool>()), 1..12)
    ) {
        let mut gate = gate(CommandMode::Position);
        let mut r = Reference::new(limits(), Vector2::zeros());
        for (a, b, ticks, by_acceleration) in requests {
            for _ in 0..ticks {
                let requested_qd = Vector2::new(a, b);
                if by_acceleration {
                    r.accelerate(&requested_qd, SpanNs::MILLISECOND);
                } else {
                    r.advance(&requested_qd, SpanNs::MILLISECOND);
                }
                let passed = pass(&mut gate, r.state(), &Vector2::zeros());
                prop_assert_eq!(gate.changed(), 0, "{:?} {:?}", r.state(), passed);
                prop_assert_eq!((passed.command.q_r, passed.command.qd_r), (r.state().q, r.state().qd));
            }
        }
    }
}

#[test]
fn limits_that_are_none_hold_a_joint_still() {
    let bad = [f64::NAN, -1.0, 0.0, f64::NEG_INFINITY];
    for bad in bad {
        let limits = MotionLimits {
            velocity: Vector2::repeat(bad),
            acceleration: Vector2::repeat(bad),
            jerk: Vector2::repeat(bad),
            ..limits()
        };
        let settings = GateSettings { effort: Vector2::repeat(bad), ..settings(CommandMode::Position) };
        let mut gate = Gate::new(settings, &limits, &Vector2::zeros());
        for _ in 0..1000 {
            let wanted = point(Vector2::new(0.1, 0.1), Vector2::new(0.5, 0.1), Vector2::zeros());
            let command = pass(&mut gate, &wanted, &Vector2::new(5.0, 5.0)).command;
            assert_eq!(command.tau, Vector2::zeros());
            assert!(command.q_r.amax() < 1e-6 && command.qd_r.amax() < 1e-6, "{bad}: {command:?}");
        }
    }
}

#[test]
fn what_it_may_not_follow_at_once_is_come_to_and_reached() {
    let mut gate = gate(CommandMode::Torque);
    let wanted = point(Vector2::new(0.1, 0.05), Vector2::zeros(), Vector2::zeros());
    let mut passed = pass(&mut gate, &wanted, &Vector2::zeros()).command;
    let mut farthest = Vector2::zeros();
    for _ in 0..3000 {
        passed = pass(&mut gate, &wanted, &Vector2::zeros()).command;
        // What a drive is to hold when nothing follows stands, also in the middle of a motion.
        let stands = DriveCommand { qd_r: Vector2::zeros(), qdd_r: Vector2::zeros(), ..passed };
        assert_eq!(gate.last(), stands);
        farthest = farthest.sup(&passed.q_r);
    }
    assert!((passed.q_r - wanted.q).amax() < 1e-5 && passed.qd_r.amax() < 1e-4, "{passed:?}");
    assert!((farthest - wanted.q).max() < 0.02, "it does not pass by: {farthest}");
}

#[test]
fn no_torque_drives_an_arm_that_is_too_fast_or_too_far() {
    let gravity = Vector2::new(20.0, -5.0);
    let rest = point(Vector2::zeros(), Vector2::zeros(), Vector2::zeros());
    // what comes out after the effort rate let it
    let torque = |mode, q: [f64; 2], qd: [f64; 2], tau: [f64; 2]| {
        let mut gate = gate(mode);
        let mut through =
            || gate.pass(&rest, &tau.into(), &at(q.into(), qd.into()), || gravity).command.tau.into();
        (0..100).map(|_| through()).last().unwrap()
    };
    let by_torque = |q, qd, tau| -> [f64; 2] { torque(CommandMode::Torque, q, qd, tau) };
    // as fast as the limits allow, and a little more: all passes
    assert_eq!(by_torque([0.0; 2], [2.2, -0.33], [50.0, -20.0]), [50.0, -20.0]);
    assert_eq!(by_torque([0.0; 2], [2.5, 0.0], [50.0, -20.0]), [50.0, -20.0], "the factor itself");
    // too fast: what would drive it is down to its weight, what brakes passes
    assert_eq!(by_torque([0.0; 2], [2.6, -0.4], [50.0, -20.0]), [20.0, -5.0]);
    assert_eq!(by_torque([0.0; 2], [2.6, -0.4], [-50.0, 20.0]), [-50.0, 20.0]);
    // out of its range and going farther; where it stands it may be held, on its way back braked
    assert_eq!(by_torque([1.06, -0.16], [0.1, -0.1], [50.0, -20.0]), [20.0, -5.0]);
    assert_eq!(by_torque([1.06, -0.16], [0.01, -0.01], [50.0, -20.0]), [50.0, -20.0]);
    assert_eq!(by_torque([1.06, -0.16], [-0.1, 0.1], [50.0, -20.0]), [50.0, -20.0]);
    assert_eq!(by_torque([1.04, -0.14], [0.1, -0.1], [50.0, -20.0]), [50.0, -20.0]);
    assert_eq!(by_torque([1.05, -0.14], [0.1, -0.1], [50.0, -20.0]), [50.0, -20.0], "at the end itself");
    assert_eq!(by_torque([1.04, -0.1 - 0.05], [0.1, -0.1], [50.0, -20.0]), [50.0, -20.0]);
    assert_eq!(
        by_torque([1.06, -0.16], [0.02, -0.02], [50.0, -20.0]),
        [50.0, -20.0],
        "as slow as one that rests"
    );
    // no numbers forbid nothing, and drives that obey references bound themselves
    assert_eq!(by_torque([f64::NAN; 2], [f64::NAN; 2], [50.0, -20.0]), [50.0, -20.0]);
    let by_position: [f64; 2] = torque(CommandMode::Position, [0.0; 2], [2.6, -0.4], [50.0, -20.0]);
    assert_eq!(by_position, [50.0, -20.0]);
}

#[test]
fn an_arm_that_trembles_too_fast_is_a_fault() {
    let rest = point(Vector2::zeros(), Vector2::zeros(), Vector2::zeros());
    let zero = Vector2::zeros();
    // the fault that comes within `ticks` where every `period`-th one shows the second joint at `qd`, to and fro
    let fault = |mode, qd: f64, period: u32, ticks: u32| {
        let mut gate = gate(mode);
        (0..ticks).find_map(|k| {
            let side = if k.is_multiple_of(2 * period) { 1.0 } else { -1.0 };
            let qd = Vector2::new(0.0, if k.is_multiple_of(period) { side * qd } else { 0.0 });
            gate.pass(&rest, &zero, &at(zero, qd), || zero).fault
        })
    };
    let by_torque = |qd, period, ticks| fault(CommandMode::Torque, qd, period, ticks);
    assert_eq!(by_torque(0.4, 3, 500), Some(Fault::TooFast));
    assert_eq!(by_torque(0.4, 1, 99), None);
    assert_eq!(by_torque(0.4, 1, 101), Some(Fault::TooFast));
    // as fast as the limit and a little more, or seldom
    assert_eq!(by_torque(0.37, 1, 2000), None);
    assert_eq!(by_torque(0.4, 12, 5000), None);
    assert_eq!(by_torque(f64::NAN, 1, 2000), None);
    assert_eq!(fault(CommandMode::Velocity, 0.4, 1, 2000), None);
}

#[test]
fn a_posture_is_begun_at_before_the_first_command_alone() {
    let mut gate = gate(CommandMode::Position);
    let (q, zero) = (Vector2::new(0.5, 0.1), Vector2::zeros());
    gate.begin_at(&q);
    gate.begin_at(&Vector2::new(0.2, f64::NAN));
    assert!(!gate.is_open());
    assert_eq!(gate.passed().q_r, q);
    assert_eq!(pass(&mut gate, &point(q, zero, zero), &zero).fault, None);
    assert!(gate.is_open() && gate.changed() == 0, "the reference goes on from there");
    gate.begin_at(&zero);
    assert_eq!(gate.passed().q_r, q, "what has passed does not jump");
}

#[test]
fn a_drive_of_velocities_alone_goes_on_from_the_measured_arm() {
    let (q, zero) = (Vector2::new(0.5, 0.1), Vector2::zeros());
    for mode in [CommandMode::Velocity, CommandMode::Position, CommandMode::Torque] {
        let mut gate = gate(mode);
        gate.begin_at(&q);
        pass(&mut gate, &point(q, zero, zero), &zero);
        gate.relocate(&Vector2::new(f64::INFINITY, 0.0));
        assert_eq!(gate.passed().q_r, q);
        // The second joint is measured outside of its range.
        gate.relocate(&Vector2::new(-0.3, 0.21));
        let goes_on = if mode == CommandMode::Velocity { Vector2::new(-0.3, 0.2) } else { q };
        assert_eq!(gate.passed().q_r, goes_on, "{mode:?}");
    }
}

/// Before a drive that obeys references these count, of whichever joint; torques are for information.
#[test]
fn a_reference_that_leaps_is_a_fault_when_it_persists() {
    let zero = Vector2::zeros();
    for joint in 0..2 {
        let mut gate = gate(CommandMode::Position);
        assert_eq!(pass(&mut gate, &point(zero, zero, zero), &Vector2::new(400.0, 0.0)).fault, None);
        assert_eq!(gate.changed(), 0);
        // To and fro, and never reached: each is a leap.
        let faults = (0..110).filter(|k| {
            let mut q = zero;
            q[joint] = if k % 2 == 0 { 0.1 } else { -0.05 };
            pass(&mut gate, &point(q, zero, zero), &zero).fault == Some(Fault::CommandsRefused)
        });
        assert_eq!(faults.count(), 10);
        assert_eq!(gate.changed(), 110);
    }
}

#[test]
fn only_repeated_wrong_commands_are_a_fault() {
    let mut gate = gate(CommandMode::Torque);
    let rest = point(Vector2::zeros(), Vector2::zeros(), Vector2::zeros());
    let mut command = |tau| pass(&mut gate, &rest, &Vector2::new(tau, 0.0)).fault;
    assert_eq!(command(0.0), None);
    assert_eq!(command(400.0), None);
    assert_eq!(command(10.0), None);
    let faults = (0..110).filter(|_| command(400.0).is_some()).count();
    assert_eq!(faults, 10);
    assert_eq!(gate.changed(), 111);
    // Whose torque was cut is told by a bit for each joint.
    for (tau, cut) in [([400.0, 0.0], 1), ([0.0, 400.0], 2), ([400.0, 400.0], 3)] {
        let mut gate = self::gate(CommandMode::Torque);
        assert_eq!(pass(&mut gate, &rest, &tau.into()).cut, cut);
    }
}
