//! What ends a motion, or lets none begin, before the robot that is built around the maker's mock server, as in `makers_server.rs`.

#![allow(clippy::unwrap_used, clippy::expect_used)]

mod common;

use common::mock::{PATIENCE, drive, mock, rest, swing};
use common::{clock, started, wait_until};
use std::time::Duration;
use vservo_franka::arm::Recovered;
use vservo_franka::wire::{CollisionBehavior, Load};
use vservo_franka::{Arm, CommandKind, FrankaError};

#[test]
fn a_request_that_the_robot_refuses_is_told_in_words() {
    for (answer, expected) in [
        ("collision=3", "refuses its collision thresholds: a safety function is active"),
        ("load=2", "refuses its load: the values are out of their range"),
        ("stiffness=1", "refuses the stiffness of its joints: it is in no mode"),
        ("move=4", "the motion did not begin: a safety function is active"),
        ("move=5", "the motion did not begin: the robot is in no mode"),
        ("move=6", "cannot begin at a singular posture"),
        ("move=7", "an argument is out of its range"),
    ] {
        let Some(server) = mock(&["--answer", answer]) else { return };
        let mut settings = server.settings();
        settings.collision = Some(CollisionBehavior::uniform(20.0, 30.0));
        settings.load = Some(Load { mass_kg: 0.1, com_F: [0.0; 3], inertia_kg_m2: [0.0; 9] });
        settings.stiffness = Some([3000.0; 7]);
        let error = started(settings, CommandKind::Position).map(drop).expect_err(answer);
        assert!(error.to_string().contains(expected), "{answer}: {error}");
        let log = server.end();
        assert!(log.commands().is_empty(), "{answer}: nothing is commanded");
    }
}

/// In motion, until the robot ends it.
fn ended(arm: &mut Arm) -> FrankaError {
    let error = drive(arm, 5000, swing, |_| ()).expect_err("the robot ends the motion");
    assert!(error.is_of_the_robot(), "{error}");
    arm.halt();
    error
}

/// Takes states and recovers with them until the robot is ready, or refuses.
fn recover(arm: &mut Arm) -> Result<(), FrankaError> {
    let until = clock() + 3 * PATIENCE.as_nanos() as i64;
    loop {
        if arm.next(Duration::from_millis(20))?.is_some() && arm.recover(true)? == Recovered::Ready {
            return Ok(());
        }
        assert!(clock() < until, "never ready, and no error");
    }
}

/// Whichever comes first, the states in which the robot has stopped, or the reply that ends the motion: the words are the same, and the arm comes back when that is asked for.
#[test]
fn a_stop_is_told_and_recovered_whichever_word_of_it_is_first() {
    for (end, expected) in [
        ("8@300", "stopped by a reflex while the arm moved (joint_reflex)"),
        ("9@300", "the user stop is pressed while the arm moved: release the button"),
        ("11@300", "the motion was ended: the robot has ended it, or somebody in Desk"),
    ] {
        for state_first in [true, false] {
            let script: &[&str] = &["--end", end, "--state-first"];
            let Some(server) = mock(&script[..2 + usize::from(state_first)]) else { return };
            let mut arm = started(server.settings(), CommandKind::Velocity).unwrap();
            let words = ended(&mut arm).to_string();
            assert!(words.contains(expected), "{end}, {state_first}: {words}");
            recover(&mut arm).unwrap();
            let q = arm.last().unwrap().q[0];
            drive(&mut arm, 500, swing, |_| ()).unwrap();
            rest(&mut arm);
            assert!(arm.last().unwrap().q[0] > q + 0.1, "it obeys again");
            drop(arm);
            let log = server.end();
            let begun = log.others().iter().filter(|line| line.starts_with("move ")).count();
            let cleared = log.others().iter().filter(|line| **line == "recovery").count();
            assert_eq!((begun, cleared), (2, usize::from(end.starts_with('8'))));
        }
    }
}

#[test]
fn a_recovery_that_the_robot_refuses_is_told_in_words() {
    for (answer, expected) in [
        ("recovery=1", "there is none that can be cleared in its mode"),
        ("recovery=2", "a safety function is active"),
        ("recovery=3", "somebody has to see to it in Desk"),
        ("recovery=5", "the user stop is pressed"),
    ] {
        let Some(server) = mock(&["--end", "8@100", "--state-first", "--answer", answer]) else { return };
        let mut arm = started(server.settings(), CommandKind::Torque).unwrap();
        ended(&mut arm);
        let words = recover(&mut arm).expect_err("it refuses").to_string();
        assert!(words.contains(expected), "{answer}: {words}");
        drop(arm);
        server.end();
    }
}

#[test]
fn a_driver_that_gives_up_stops_the_motion_at_the_makers_server() {
    for kind in [CommandKind::Position, CommandKind::Velocity, CommandKind::Torque] {
        let Some(server) = mock(&[]) else { return };
        let mut arm = started(server.settings(), kind).unwrap();
        drive(&mut arm, 300, swing, |_| ()).unwrap();
        arm.abandon();
        drop(arm);
        let log = server.end();
        assert_eq!(log.others()[2..4], ["stop", "ended 2"], "{kind:?}");
    }
}

/// A server that closes, and a driver that falls silent, for longer than the robot waits.
#[test]
fn a_lost_driver_or_server_ends_in_words() {
    let Some(server) = mock(&["--close", "300"]) else { return };
    let mut arm = started(server.settings(), CommandKind::Velocity).unwrap();
    let words = drive(&mut arm, 5000, swing, |_| ()).expect_err("it closes").to_string();
    assert!(words.contains("has closed the connection"), "{words}");
    drop(arm);
    server.end();
    let Some(server) = mock(&["--wait-ms", "1000"]) else { return };
    let mut arm = started(server.settings(), CommandKind::Velocity).unwrap();
    drive(&mut arm, 300, swing, |_| ()).unwrap();
    let mut words = String::new();
    wait_until("the robot's stop", || {
        words = arm.next(Duration::from_millis(20)).err().map(|error| error.to_string()).unwrap_or_default();
        !words.is_empty()
    });
    assert!(words.contains("communication_constraints_violation"), "{words}");
    drop(arm);
    server.end();
}
