use super::*;
use crate::robot::load;
use nalgebra::Vector2;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

#[derive(Clone, Default)]
struct Wire(Arc<Mutex<(VecDeque<DriveStateMsg>, Vec<DriveCommandMsg>)>>);

impl DriveLink for Wire {
    fn receive(&mut self) -> Option<DriveStateMsg> {
        self.0.lock().unwrap().0.pop_front()
    }

    fn send(&mut self, command: &DriveCommandMsg) {
        self.0.lock().unwrap().1.push(*command);
    }
}

impl Wire {
    fn state(&self, ms: i64, q: f64, flags: u32) {
        let mut m = DriveStateMsg { stamp: MonoNs(ms * 1_000_000), joints: 2, flags, ..Default::default() };
        m.q[..2].fill(q);
        m.q_true[..2].fill(q + 0.5);
        self.0.lock().unwrap().0.push_back(m);
    }

    fn sent(&self) -> Vec<DriveCommandMsg> {
        self.0.lock().unwrap().1.clone()
    }
}

fn drive(wire: &Wire) -> ExternalDrive<2> {
    let timeout = SpanNs(20_000_000);
    ExternalDrive::new(Box::new(wire.clone()), CommandMode::Velocity, timeout, Vector2::new(7.0, 7.0))
}

fn at(ms: i64) -> MonoNs {
    MonoNs(ms * 1_000_000)
}

#[test]
fn the_newest_state_counts_with_its_truth() {
    let wire = Wire::default();
    let mut d = drive(&wire);
    wire.state(0, 0.1, 0);
    wire.state(1, 0.2, drive_flag::TRUTH);
    let s = d.read(at(1));
    assert_eq!(s.q, Vector2::new(0.2, 0.2));
    assert_eq!(s.truth, Some((Vector2::new(0.7, 0.7), Vector2::zeros())));
    wire.state(0, 0.9, 0);
    assert_eq!(d.read(at(2)).q, s.q, "an older state does not replace a newer one");
    assert_eq!(d.health(), DriveHealth { late_states: 1, is_old: true, ..Default::default() });
}

/// A drive of 500 Hz has a state for every second tick: late is what it does not have then.
#[test]
fn a_slower_drive_is_late_by_its_own_cycle() {
    let wire = Wire::default();
    let mut d = drive(&wire);
    for ms in 0..100 {
        if ms % 2 == 0 && ms != 60 {
            wire.state(ms, 0.1, 0);
        }
        d.read(at(ms));
        assert_eq!(d.health().is_old, ms % 2 == 1 || ms == 60, "{ms}");
    }
    // Before the second state has come nobody knows the cycle; of the one that was lost, two ticks are late.
    assert_eq!(d.health().late_states, 1 + 2);
}

#[test]
fn late_states_are_counted_and_stale_ones_are_a_fault() {
    let wire = Wire::default();
    let mut d = drive(&wire);
    wire.state(99, 0.1, 0);
    wire.state(100, 0.1, 0);
    for ms in 100..=120 {
        d.read(at(ms));
        let (late_states, is_old) = ((ms - 100) as u64, ms > 100);
        assert_eq!(d.health(), DriveHealth { late_states, is_old, ..Default::default() }, "{ms}");
    }
    wire.state(118, 0.2, 0);
    d.read(at(121));
    assert_eq!(d.health().late_states, 21, "new, but three ticks old");
    d.read(at(138));
    assert_eq!(d.health().fault, None);
    d.read(at(139));
    assert_eq!(d.health().fault, Some(DriveFault::Stale));
    wire.state(139, 0.2, 0);
    d.read(at(140));
    assert_eq!(d.health().fault, Some(DriveFault::Stale), "a fault stays");
}

#[test]
fn before_the_first_tick_nothing_grows_stale() {
    let wire = Wire::default();
    let mut d = drive(&wire);
    wire.state(0, 0.1, 0);
    d.read(at(1000));
    assert_eq!(d.health().fault, None);
    d.read(at(1021));
    assert_eq!(d.health().fault, Some(DriveFault::Stale));
}

#[test]
fn commands_are_numbered_by_time_and_the_last_one_says_so() {
    let wire = Wire::default();
    let mut d = drive(&wire);
    let c = DriveCommand {
        tau: Vector2::new(1.0, 2.0),
        q_r: Vector2::new(3.0, 4.0),
        qd_r: Vector2::new(5.0, 6.0),
        qdd_r: Vector2::new(7.0, 8.0),
    };
    let last = DriveCommand { qd_r: Vector2::zeros(), ..c };
    d.end(&last);
    assert!(wire.sent().is_empty(), "nothing was begun, nothing is ended");
    for ms in [50, 51, 53] {
        d.read(at(ms));
        d.write(&c);
    }
    d.end(&last);
    d.end(&last);
    let sent = wire.sent();
    let ticks: Vec<_> = sent.iter().map(|m| m.tick).collect();
    assert_eq!(ticks, [0, 1, 3, 4]);
    let m = sent[2];
    assert_eq!((m.stamp, m.joints, m.mode, m.flags), (at(53), 2, 1, 0));
    assert_eq!(
        (&m.tau[..3], &m.q_r[..3], &m.qd_r[..3]),
        (&[1.0, 2.0, 0.0][..], &[3.0, 4.0, 0.0][..], &[5.0, 6.0, 0.0][..])
    );
    assert_eq!(sent[3].flags, drive_flag::LAST);
    let held = (&sent[3].tau[..2], &sent[3].q_r[..2], sent[3].qd_r);
    assert_eq!(held, (&[1.0, 2.0][..], &[3.0, 4.0][..], [0.0; MAX_JOINTS]), "what it was given, no more");
}

#[test]
fn a_state_of_another_arm_is_a_fault() {
    let wire = Wire::default();
    let mut d = drive(&wire);
    wire.state(0, 0.1, 0);
    wire.0.lock().unwrap().0[0].joints = 3;
    assert_eq!(d.read(at(0)).q, Vector2::new(7.0, 7.0));
    assert_eq!(d.health().fault, Some(DriveFault::OutOfStep));
}

#[test]
fn the_robot_is_heard_and_asked_to_clear_its_error() {
    let wire = Wire::default();
    let mut d = drive(&wire);
    let hears = |d: &mut ExternalDrive<2>, ms: i64, robot_state: u32| {
        let m =
            DriveStateMsg { stamp: at(ms), joints: 2, robot_state, robot_code: 703, ..Default::default() };
        wire.0.lock().unwrap().0.push_back(m);
        d.read(at(ms));
        d.health().robot
    };
    let command = DriveCommand {
        tau: Vector2::zeros(),
        q_r: Vector2::zeros(),
        qd_r: Vector2::zeros(),
        qdd_r: Vector2::zeros(),
    };
    assert_eq!(d.health().robot, RobotReport::default(), "nothing was told");
    let stop = RobotReport { state: RobotState::ProtectiveStop, code: 703 };
    assert_eq!(hears(&mut d, 1, 6), stop);
    assert_eq!(d.health().fault, None, "its states are as good as before");
    assert_eq!(hears(&mut d, 2, 99).state, RobotState::Fault, "a code that nobody knows");
    d.write(&command);
    d.clear_robot(true);
    d.write(&command);
    d.clear_robot(false);
    d.write(&command);
    let flags: Vec<_> = wire.sent().iter().map(|c| c.flags).collect();
    assert_eq!(flags, [0, drive_flag::CLEAR, 0]);
}

#[test]
fn torques_leave_out_the_weight_that_the_robot_holds() {
    let robot: Robot<2> = load("pan_tilt").unwrap().build().unwrap();
    let robot = robot.with_gravity(nalgebra::Vector3::new(3.0, -4.0, -8.0));
    let (q, tau) = (Vector2::new(0.3, 0.3), Vector2::new(0.25, -0.5));
    let weight = robot.gravity(&q);
    assert!(weight.amin() > 1e-6, "{weight}");
    for (gravity, friction, flags) in [
        (true, true, drive_flag::GRAVITY | drive_flag::FRICTION),
        (true, false, drive_flag::GRAVITY),
        (false, true, drive_flag::FRICTION),
        (false, false, 0),
    ] {
        let wire = Wire::default();
        let (mode, contents) = (CommandMode::Torque, TorqueContents { gravity, friction });
        let link = Box::new(wire.clone());
        let mut d = ExternalDrive::new(link, mode, SpanNs(20_000_000), Vector2::zeros())
            .with_contents(contents, robot.clone());
        wire.state(0, 0.3, 0);
        d.read(at(0));
        let command =
            DriveCommand { tau, q_r: q, qd_r: Vector2::new(0.1, 0.2), qdd_r: Vector2::new(1.0, -2.0) };
        d.write(&command);
        d.end(&command);
        for sent in wire.sent() {
            let given = if gravity { tau } else { tau - weight };
            assert_eq!(sent.tau[..2], *given.as_slice(), "{contents:?}");
            assert_eq!(
                (sent.qd_r[..2].to_vec(), sent.qdd_r[..2].to_vec()),
                (vec![0.1, 0.2], vec![1.0, -2.0])
            );
            assert_eq!(sent.flags & !drive_flag::LAST, flags);
        }
        assert_eq!(wire.sent().len(), 2);
    }
}
