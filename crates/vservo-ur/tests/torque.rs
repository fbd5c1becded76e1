//! Torques over the program on the robot: what moves, what stops it, and which software takes them.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{Q, assert_at_rest, drive, robot, settings, started};
use vservo_ur::emulator::Fault;
use vservo_ur::{Arm, Command, SafetyMode, Series};

fn torque(tau: f64) -> Command {
    Command::Torque { tau: [tau, 0.0, 0.0, 0.0, 0.0, 0.0], contain_friction: true }
}

/// The joints behind the emulator are rotors of 1 kg m2: the torque over the robot's own time is their speed.
#[test]
fn torques_move_the_arm_and_it_rests() {
    for (minor, bugfix) in [(26, 0), (25, 0), (23, 4)] {
        let robot = robot(Series::ESeries, true);
        robot.inject(Fault::Software { minor, bugfix });
        let mut arm = started(settings(&robot)).unwrap();
        arm.takes_torques().unwrap();
        for contain_friction in [true, false] {
            let push = |tau| Command::Torque { tau: [tau, 0.0, 0.0, 0.0, 0.0, -tau], contain_friction };
            drive(&mut arm, 0.5, |_| push(0.6)).unwrap();
            drive(&mut arm, 0.2, |_| push(0.0)).unwrap();
            let (_, qd) = robot.arm();
            // A command or two come late in either direction, 2 ms each; a busy machine adds some.
            assert!((qd[0] - 0.3).abs() < 0.06, "5.{minor}: {}", qd[0]);
            assert!((qd[5] + qd[0]).abs() < 1e-12);
            let coasts = robot.arm().0[0];
            drive(&mut arm, 0.1, |_| push(0.0)).unwrap();
            assert!((robot.arm().0[0] - coasts - 0.1 * qd[0]).abs() < 0.02, "without a torque it goes on");
            drive(&mut arm, 0.3, |_| Command::Hold).unwrap();
            assert!(robot.arm().1.iter().all(|v| v.abs() < 1e-6), "braked by a command");
        }
        arm.come_to_rest().unwrap();
        assert_at_rest(&robot);
        assert_eq!(robot.log(), [""; 0]);
    }
}

/// A torque that nobody renews is not kept up for the watchdog's tenth of a second, which would leave 0.2 rad/s. An emulated program that its machine does not let run counts fewer cycles than
/// there were: the best of some trials tells.
#[test]
fn a_driver_that_dies_leaves_no_torque_behind() {
    let mut least = f64::INFINITY;
    for _ in 0..5 {
        let robot = robot(Series::ESeries, true);
        let mut arm = started(settings(&robot)).unwrap();
        drive(&mut arm, 0.2, |_| torque(2.0)).unwrap();
        let before = robot.arm().1[0];
        drop(arm);
        let mut fastest = before;
        for _ in 0..400 {
            fastest = robot.arm().1[0].max(fastest);
            std::thread::sleep(std::time::Duration::from_micros(500));
        }
        assert_at_rest(&robot);
        least = (fastest - before).min(least);
    }
    // 20 ms, and ten cycles between the last command and the look before.
    assert!(least < 2.0 * 0.04, "{least}");
}

#[test]
fn software_that_takes_no_torques_says_which_does() {
    let robot = robot(Series::ESeries, true);
    robot.inject(Fault::Software { minor: 22, bugfix: 0 });
    let mut arm = started(settings(&robot)).unwrap();
    let words = arm.takes_torques().unwrap_err().to_string();
    assert!(words.contains("5.22.0") && words.contains("needs 5.23"), "{words}");
    // Its program does not know such a command, and holds.
    drive(&mut arm, 0.2, |_| torque(1.0)).unwrap();
    assert_eq!(robot.arm().0, Q);
    arm.come_to_rest().unwrap();
    assert_at_rest(&robot);
    let old = common::robot(Series::Cb3, true);
    let arm = Arm::connect(settings(&old)).unwrap();
    assert!(arm.takes_torques().is_err());
}

/// Torques that would make the arm too fast end in a stop by the robot.
#[test]
fn the_robot_stops_an_arm_that_torques_make_too_fast() {
    let robot = robot(Series::ESeries, true);
    let mut arm = started(settings(&robot)).unwrap();
    let words = drive(&mut arm, 5.0, |_| torque(8.0)).expect_err("a stop").to_string();
    assert!(words.contains("protective stop while the arm moved"), "{words}");
    assert!(robot.log().iter().any(|line| line.contains("speed")));
    arm.abandon();
    assert_at_rest(&robot);
    assert_eq!(robot.modes().1, SafetyMode::ProtectiveStop);
}

/// What is not a number moves nothing.
#[test]
fn torques_that_are_none_hold_the_arm() {
    let robot = robot(Series::ESeries, true);
    let mut arm = started(settings(&robot)).unwrap();
    drive(&mut arm, 0.2, |_| torque(f64::NAN)).unwrap();
    assert_eq!(robot.arm().0, Q);
    arm.come_to_rest().unwrap();
}
