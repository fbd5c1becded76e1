//! The driver against the emulator: it moves, it rests, and it ends in words whatever goes wrong.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod common;

use common::{Q, assert_at_rest, clock, drive, robot, robot_with, settings, started, wait_until};
use std::time::Duration;
use vservo_franka::arm::Recovered;
use vservo_franka::emulator::{Emulator, EmulatorSettings, Fault, MISSED_CYCLES};
use vservo_franka::robot::RobotError;
use vservo_franka::wire::{CollisionBehavior, Load};
use vservo_franka::{Arm, Command, CommandKind, FrankaError, RobotMode};

fn swing(t: f64, _: &Arm) -> Command {
    let mut qd = [0.0; 7];
    qd[0] = 0.4 * (1.0 - (-t / 0.1).exp());
    Command::keep(qd)
}

#[test]
fn velocities_move_the_arm_and_it_rests() {
    let robot = robot();
    let mut arm = started(settings(&robot), CommandKind::Velocity).unwrap();
    assert_eq!(robot.mode(), (RobotMode::Move, true));
    drive(&mut arm, 1.0, swing).unwrap();
    let (q, qd) = robot.arm();
    // 0.4 rad/s for a second, less the time constant of the start and the lag of the joints.
    assert!((q[0] - Q[0] - 0.4 * 0.9).abs() < 0.05, "{}", q[0] - Q[0]);
    assert!((qd[0] - 0.4).abs() < 0.05, "{}", qd[0]);
    arm.come_to_rest().unwrap();
    assert_at_rest(&robot);
    assert_eq!(robot.mode(), (RobotMode::Idle, false));
    assert_eq!(robot.log(), [""; 0]);
}

/// Behind a slow motion the arm stays by the stated lag of the emulated joints, 10 ms, and two cycles of the way.
#[test]
fn positions_are_followed_with_the_stated_lag() {
    let robot = robot();
    let mut arm = started(settings(&robot), CommandKind::Position).unwrap();
    let turn = |t: f64| 0.1 * (1.0 - (std::f64::consts::PI * t).cos());
    let speed = |t: f64| 0.1 * std::f64::consts::PI * (std::f64::consts::PI * t).sin();
    let (mut sum, mut weight) = (0.0, 0.0);
    drive(&mut arm, 2.0, |t, arm| {
        let state = arm.last().unwrap();
        let (mut q, mut qd) = (Q, [0.0; 7]);
        (q[1], qd[1]) = (Q[1] + turn(t), speed(t));
        sum += speed(t) * (q[1] - state.q[1]);
        weight += speed(t) * speed(t);
        Command::Position { q, qd, qdd: [0.0; 7], at: Some(state.stamp) }
    })
    .unwrap();
    let lag_s = sum / weight;
    assert!((0.007..0.02).contains(&lag_s), "{lag_s} s");
    arm.come_to_rest().unwrap();
    assert_at_rest(&robot);
    assert_eq!(robot.log(), [""; 0]);
}

#[test]
fn torques_push_the_arm_and_hold_it() {
    let robot = robot();
    let mut arm = started(settings(&robot), CommandKind::Torque).unwrap();
    drive(&mut arm, 0.3, |_, _| Command::Hold).unwrap();
    assert!(robot.arm().0.iter().zip(&Q).all(|(a, b)| (a - b).abs() < 1e-3), "it is held");
    drive(&mut arm, 0.5, |_, _| Command::Torque([0.0, 0.0, 2.0, 0.0, 0.0, 0.0, 0.3])).unwrap();
    let (q, qd) = robot.arm();
    assert!(q[2] - Q[2] > 0.05 && q[6] - Q[6] > 0.05 && qd[2] > 0.2, "{q:?} {qd:?}");
    assert!((q[0] - Q[0]).abs() < 1e-3);
    arm.come_to_rest().unwrap();
    assert_at_rest(&robot);
    assert_eq!(robot.mode(), (RobotMode::Idle, false));
    assert_eq!(robot.log(), [""; 0]);
}

#[test]
fn what_is_set_is_taken_and_what_makes_no_sense_is_refused() {
    let robot = robot();
    let mut set = settings(&robot);
    set.collision = Some(CollisionBehavior::uniform(40.0, 40.0));
    set.stiffness = Some([2000.0; 7]);
    let load = Load { mass_kg: 0.7, com_F: [0.0, 0.0, 0.05], inertia_kg_m2: [1e-3; 9] };
    set.load = Some(load);
    assert_eq!(robot.load(), None);
    let mut arm = started(set, CommandKind::Velocity).unwrap();
    assert_eq!(robot.load(), Some(load));
    arm.come_to_rest().unwrap();
    let other = Load { mass_kg: 0.9, ..load };
    arm.set_load(Some(other));
    arm.start(CommandKind::Velocity).unwrap();
    assert_eq!(robot.load(), Some(other), "the next motion has the next load");
    arm.come_to_rest().unwrap();
    drop(arm);
    set.load = Some(Load { mass_kg: -1.0, com_F: [0.0; 3], inertia_kg_m2: [0.0; 9] });
    let mut words = String::new();
    wait_until("a robot that is free again", || {
        words = started(set, CommandKind::Velocity).expect_err("a load of -1 kg").to_string();
        words.contains("out of their range")
    });
    assert!(words.contains("refuses its load"), "{words}");
}

/// What goes wrong while the arm moves, the words it ends in, and how the arm is left.
#[test]
fn every_fault_in_motion_ends_at_rest_and_in_words() {
    let faults = [
        (Fault::Reflex(RobotError::JointReflex), "stopped by a reflex while the arm moved (joint_reflex)"),
        (Fault::UserStop, "the user stop is pressed while the arm moved: release the button"),
        (Fault::Guiding, "guided by hand"),
        (Fault::Brakes, "open its brakes in Desk"),
        (Fault::Deaf, "communication_constraints_violation); of the last hundred commands"),
        (Fault::Mute, "no state came from the robot for"),
        (Fault::Close, "has closed the connection"),
        (Fault::ShortStates, "a message of 688 bytes"),
        (Fault::StaleNumbers, "repeats an old one"),
        (Fault::NotANumber, "not finite"),
        (Fault::JumpingJoint, "joint 1 from"),
    ];
    for (fault, expected) in faults {
        let robot = robot();
        let mut arm = started(settings(&robot), CommandKind::Velocity).unwrap();
        drive(&mut arm, 0.4, swing).unwrap();
        assert!(robot.arm().1[0] > 0.3, "{fault:?}: the arm moves");
        robot.inject(fault);
        let words = drive(&mut arm, 5.0, swing).expect_err("a fault").to_string();
        assert!(words.contains(expected), "{fault:?}: {words}");
        arm.abandon();
        drop(arm);
        assert_at_rest(&robot);
        assert!(robot.arm().0.iter().all(|q| q.is_finite()));
    }
}

/// The reply that ends a motion may come before the states that say why: the words are those of the states.
#[test]
fn a_reply_that_comes_first_does_not_take_the_words() {
    for (fault, expected) in [
        (REFLEX, "stopped by a reflex while the arm moved (joint_reflex)"),
        (Fault::UserStop, "the user stop is pressed while the arm moved: release the button"),
    ] {
        let robot = robot();
        robot.inject(Fault::EarlyReplies);
        let mut arm = started(settings(&robot), CommandKind::Velocity).unwrap();
        drive(&mut arm, 0.4, swing).unwrap();
        robot.inject(fault);
        let error = drive(&mut arm, 5.0, swing).expect_err("a fault");
        assert!(error.is_of_the_robot() && error.to_string().contains(expected), "{fault:?}: {error}");
        assert_at_rest(&robot);
    }
}

/// What is wrong from the beginning: nothing moves, and the words say what to do.
#[test]
fn every_fault_before_the_start_is_refused_in_words() {
    let faults = [
        (Fault::Reflex(RobotError::JointReflex), "vservo-drive-franka --recover"),
        (Fault::UserStop, "release the button"),
        (Fault::Guiding, "let go of its guiding button"),
        (Fault::Brakes, "open its brakes in Desk"),
        (Fault::OldVersion, "the robot speaks version 9 of its interface, this driver version 10"),
        (Fault::SilentTcp, "does not answer within 3.0 s (Connect)"),
        (Fault::RefuseMotions, "the motion did not begin: the robot is in no mode"),
        (Fault::Mute, "does a firewall keep UDP from"),
        (Fault::WrongSize, "does not speak FCI as its maker's client does: a message of 0 bytes"),
    ];
    for (fault, expected) in faults {
        let robot = robot();
        robot.inject(fault);
        let words = started(settings(&robot), CommandKind::Position).expect_err("a fault").to_string();
        assert!(words.contains(expected), "{fault:?}: {words}");
        assert_at_rest(&robot);
        assert_eq!(robot.arm().0, Q, "{fault:?}");
    }
    // Not at 127.0.0.1: there somebody may have a robot.
    let words = Arm::connect(vservo_franka::ArmSettings::new(common::address(), clock));
    assert!(words.unwrap_err().to_string().contains("is FCI activated in Desk"));
}

/// Replies in pieces, and states and commands that are lost, are no faults: the former are counted.
#[test]
fn pieces_are_put_together_and_losses_do_not_stop_the_arm() {
    for fault in [
        Fault::HalfPackets,
        Fault::ByteByByte,
        Fault::LoseStates,
        Fault::LoseCommands,
        Fault::StrangeDatagrams,
    ] {
        for kind in [CommandKind::Position, CommandKind::Velocity, CommandKind::Torque] {
            let robot = robot();
            robot.inject(fault);
            let mut arm = started(settings(&robot), kind).unwrap();
            let before = arm.missed().0;
            drive(&mut arm, 0.5, |t, arm| match kind {
                CommandKind::Torque => Command::Torque([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]),
                _ => swing(t, arm),
            })
            .unwrap();
            let missed = arm.missed().0 - before;
            arm.come_to_rest()
                .unwrap_or_else(|error| panic!("{fault:?} {kind:?}: {error} {:?}", robot.arm()));
            assert_at_rest(&robot);
            assert_eq!(robot.log(), [""; 0], "{fault:?} {kind:?}");
            // 500 cycles, of which two of three are lost; a busy machine loses more.
            assert!(fault != Fault::LoseStates || missed >= 320, "{missed}");
        }
    }
}

/// A robot waits for 20 cycles, as its maker says: a driver that is suspended for longer finds it stopped, and told why.
#[test]
fn a_driver_that_sleeps_finds_the_motion_ended_and_comes_back() {
    let robot = robot_with(MISSED_CYCLES);
    let (mut arm, mut error) = (started(settings(&robot), CommandKind::Velocity), None);
    for _ in 0..20 {
        // On a busy machine the motion may end before it is let sleep.
        match arm.as_mut().map(|arm| drive(arm, 0.1, swing)) {
            Ok(Ok(())) => break,
            _ => {
                arm = Err(FrankaError::TimeStands);
                robot.inject(Fault::Ready);
                wait_until("a robot that is free again", || {
                    arm = started(settings(&robot), CommandKind::Velocity);
                    arm.is_ok()
                });
            }
        }
    }
    let mut arm = arm.unwrap();
    std::thread::sleep(Duration::from_millis(60));
    for _ in 0..50 {
        if let Err(told) = arm.next(Duration::from_millis(20)) {
            error = Some(told);
            break;
        }
    }
    let error = error.expect("the motion has ended");
    assert!(error.to_string().contains("communication_constraints_violation"), "{error}");
    assert!(error.is_of_the_robot());
    assert_at_rest(&robot);
}

/// One that dies leaves an arm that stops by itself, and a robot that another one can use.
#[test]
fn a_driver_that_dies_leaves_an_arm_at_rest() {
    let robot = robot();
    let mut arm = started(settings(&robot), CommandKind::Velocity).unwrap();
    drive(&mut arm, 0.5, swing).unwrap();
    drop(arm);
    wait_until("a reflex", || robot.mode() == (RobotMode::Reflex, false));
    assert_at_rest(&robot);
    let q = robot.arm().0;
    // 0.4 rad/s for 0.4 s, and the way of braking; and what a busy machine adds.
    assert!(q[0] - Q[0] < 0.4 * 0.5 + 0.1, "{}", q[0] - Q[0]);
    let mut arm = Arm::connect(settings(&robot)).unwrap();
    assert!(arm.make_ready().is_err());
    assert_eq!(arm.clear().unwrap(), RobotMode::Idle);
    arm.make_ready().unwrap();
}

/// One that gives up stops the arm first, and leaves a robot without an error.
#[test]
fn a_driver_that_gives_up_stops_the_motion() {
    for kind in [CommandKind::Position, CommandKind::Torque] {
        let robot = robot();
        let mut arm = started(settings(&robot), kind).unwrap();
        drive(&mut arm, 0.4, swing).unwrap();
        arm.abandon();
        drop(arm);
        assert_at_rest(&robot);
        assert_eq!(robot.mode(), (RobotMode::Idle, false));
        assert_eq!(robot.log(), [""; 0]);
    }
}

#[test]
fn a_second_driver_is_turned_away() {
    let robot = robot();
    let mut arm = started(settings(&robot), CommandKind::Velocity).unwrap();
    let second = std::thread::Builder::new().name("second".into()).spawn({
        let settings = settings(&robot);
        move || Arm::connect(settings).map(drop).expect_err("in use").to_string()
    });
    drive(&mut arm, 0.5, swing).unwrap();
    assert!(second.unwrap().join().unwrap().contains("another client has the robot"));
    arm.come_to_rest().unwrap();
    drop(arm);
    wait_until("a robot that is free again", || started(settings(&robot), CommandKind::Position).is_ok());
}

/// A command of numbers that are none moves nothing; a position that jumps is approached within the limits.
#[test]
fn commands_that_are_none_or_jump_do_not_stop_the_arm() {
    for kind in [CommandKind::Position, CommandKind::Velocity, CommandKind::Torque] {
        let robot = robot();
        let mut arm = started(settings(&robot), kind).unwrap();
        drive(&mut arm, 0.1, |_, _| Command::keep([f64::NAN; 7])).unwrap();
        drive(&mut arm, 0.1, |_, _| Command::stand_at([f64::NAN; 7])).unwrap();
        drive(&mut arm, 0.1, |_, _| Command::Torque([f64::INFINITY; 7])).unwrap();
        assert!(robot.arm().0.iter().zip(&Q).all(|(a, b)| (a - b).abs() < 1e-3));
        let mut far = Q;
        far[0] += 0.4;
        far[3] -= 0.1;
        drive(&mut arm, 1.5, |_, _| Command::stand_at(far)).unwrap();
        let off = robot.arm().0.iter().zip(&far).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 2e-3, "{kind:?}: {off} rad");
        arm.come_to_rest().unwrap();
        assert_at_rest(&robot);
        assert_eq!(robot.log(), [""; 0], "{kind:?}");
    }
}

/// An emulated robot is for its machine alone.
#[test]
fn the_emulator_listens_on_loopback_addresses_alone() {
    for address in ["0.0.0.0", "192.168.1.5", "::"] {
        let refused = Emulator::start(EmulatorSettings::fr3(address.parse().unwrap(), Q)).err().unwrap();
        assert!(refused.to_string().contains("no loopback address"), "{refused}");
    }
}

/// Takes states and recovers with them for so long, s, or until it is ready or fails.
fn recover(arm: &mut Arm, asked: bool, for_s: f64) -> Result<Recovered, FrankaError> {
    let until = clock() + (for_s * 1e9) as i64;
    while clock() < until {
        if arm.next(Duration::from_millis(20))?.is_some() && arm.recover(asked)? == Recovered::Ready {
            return Ok(Recovered::Ready);
        }
    }
    Ok(Recovered::Not)
}

/// In motion, until the robot stops.
fn halted(arm: &mut Arm, robot: &Emulator, fault: Fault) {
    drive(arm, 0.4, swing).unwrap();
    robot.inject(fault);
    let error = drive(arm, 5.0, swing).expect_err("a fault");
    assert!(error.is_of_the_robot(), "{error}");
    arm.halt();
    assert!(arm.is_halted());
    assert_at_rest(robot);
}

const REFLEX: Fault = Fault::Reflex(RobotError::JointReflex);

#[test]
fn a_reflex_is_cleared_when_that_is_asked_for() {
    for kind in [CommandKind::Velocity, CommandKind::Torque] {
        let robot = robot();
        let mut arm = started(settings(&robot), kind).unwrap();
        halted(&mut arm, &robot, REFLEX);
        let q = robot.arm().0;
        assert_eq!(recover(&mut arm, false, 0.5).unwrap(), Recovered::Not, "nobody has asked");
        assert_eq!(robot.mode().0, RobotMode::Reflex);
        assert_eq!(recover(&mut arm, true, 10.0).unwrap(), Recovered::Ready);
        assert!(!arm.is_halted());
        assert_eq!(robot.mode(), (RobotMode::Move, true));
        assert!(robot.arm().0.iter().zip(&q).all(|(a, b)| (a - b).abs() < 1e-3), "it is held");
        drive(&mut arm, 0.5, swing).unwrap();
        assert!(robot.arm().0[0] > q[0] + 0.05, "and obeys again");
        arm.come_to_rest().unwrap();
        assert_at_rest(&robot);
    }
}

#[test]
fn a_user_stop_is_waited_for_and_the_motion_begun_again() {
    let robot = robot();
    let mut arm = started(settings(&robot), CommandKind::Velocity).unwrap();
    halted(&mut arm, &robot, Fault::UserStop);
    assert_eq!(recover(&mut arm, true, 0.5).unwrap(), Recovered::Not, "the button is pressed");
    assert_eq!(robot.mode().0, RobotMode::UserStopped);
    robot.inject(Fault::Ready);
    assert_eq!(recover(&mut arm, false, 0.3).unwrap(), Recovered::Not);
    assert_eq!(recover(&mut arm, true, 10.0).unwrap(), Recovered::Ready);
    arm.come_to_rest().unwrap();
    assert_at_rest(&robot);
}

#[test]
fn a_robot_that_refuses_to_come_back_says_why_once() {
    let robot = robot();
    let mut arm = started(settings(&robot), CommandKind::Velocity).unwrap();
    halted(&mut arm, &robot, REFLEX);
    robot.inject(Fault::ManualRecovery);
    let error = recover(&mut arm, true, 10.0).expect_err("by hand");
    assert!(error.to_string().contains("somebody has to see to it in Desk"), "{error}");
    assert_eq!(recover(&mut arm, true, 0.3).unwrap(), Recovered::Not, "told once");
    assert_eq!(recover(&mut arm, false, 0.1).unwrap(), Recovered::Not);
    assert!(recover(&mut arm, true, 10.0).is_err(), "tried again when it is asked for again");
}

#[test]
fn a_reflex_that_follows_a_recovery_is_not_cleared_too() {
    let robot = robot();
    let mut arm = started(settings(&robot), CommandKind::Velocity).unwrap();
    halted(&mut arm, &robot, REFLEX);
    let until = clock() + 10_000_000_000;
    while robot.mode().0 != RobotMode::AutomaticErrorRecovery {
        assert!(clock() < until, "it is never cleared");
        assert_eq!(recover(&mut arm, true, 0.005).unwrap(), Recovered::Not);
    }
    // What made it stop is still there.
    robot.inject(REFLEX);
    let words = recover(&mut arm, true, 20.0).expect_err("no way on").to_string();
    assert!(words.contains("reflex"), "{words}");
    assert_eq!(robot.mode().0, RobotMode::Reflex);
}
