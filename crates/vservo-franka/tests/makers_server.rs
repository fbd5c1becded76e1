//! Our client and driver against a server that is nobody's here: the mock server of the maker's own client library, around which `contrib/crosswise/franka_mock.sh` builds a
//! robot, and which `VSERVO_FRANKA_MOCK` names. Without it the tests say `skipped`.
//!
//! Messages and limits are the maker's there; what the robot does is played. While its arm moves, it waits with each state for the command that answers the last: so
//! nothing here depends on how busy the machine is.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // what is skipped is told

mod common;

use common::mock::{PATIENCE, drive, mock, rest, swing};
use common::{Q, clock, started, wait_until};
use std::time::Duration;
use vservo_franka::arm::ArmState;
use vservo_franka::client::FciClient;
use vservo_franka::robot::{Controller, Generator};
use vservo_franka::wire::{
    CollisionBehavior, Load, MoveController, MoveGenerator, MoveStatus, Request, RobotCommand, RobotState,
};
use vservo_franka::{Arm, Command, CommandKind, JointLimits, Joints, RobotMode};

fn number(state: &ArmState) -> u64 {
    (state.robot_s * 1e3).round() as u64
}

fn push(count: u64) -> Command {
    let tau = if count < 300 { [0.0, 0.0, 4.0, 0.0, 0.0, 0.0, -0.5] } else { [0.0; 7] };
    Command::Torque(tau)
}

#[test]
fn the_makers_server_is_told_and_tells_the_version() {
    let Some(server) = mock(&[]) else { return };
    let mut client = server.client();
    assert!(client.model().unwrap().contains("fr3"));
    drop(client);
    assert_eq!(server.end().others()[0], "connect 10");
    for (version, hint) in [("9", "update the robot"), ("11", "update vservo")] {
        let Some(server) = mock(&["--version", version]) else { return };
        let words = Arm::connect(server.settings()).expect_err("another version").to_string();
        assert!(words.contains(&format!("the robot speaks version {version} of its interface")), "{words}");
        assert!(words.contains(hint), "{words}");
        assert_eq!(server.end().others()[0], "connect 10");
    }
}

/// Each value of its states is another, in each state, and stands under the same name here.
#[test]
fn states_are_read_as_the_maker_writes_them() {
    let Some(server) = mock(&["--pattern"]) else { return };
    let mut client = server.client();
    let model = client.model().unwrap().to_owned();
    assert!(model.starts_with("<?xml") && model.trim_end().ends_with("</robot>"), "{} bytes", model.len());
    assert_eq!(JointLimits::of_urdf(&model), Some(JointLimits::fr3()), "the limits of its model");
    let (mut count, mut last) = (0, 0);
    let until = clock() + 3 * PATIENCE.as_nanos() as i64;
    while count < 1000 {
        assert!(clock() < until, "{count} states");
        let Some((state, arrival)) = client.receive(Duration::from_millis(20)).unwrap() else { continue };
        assert!(state.message_id > last && arrival <= clock());
        last = state.message_id;
        // The first one is the server's own, of zeros.
        if last >= 1000 {
            assert_eq!(state, pattern(last));
            count += 1;
        }
    }
    drop(client);
    let log = server.end();
    println!("{count} states read of {} sent", log.at_the_end("states"));
}

fn pattern(number: u64) -> RobotState {
    let value = |field: usize, i: usize| (number % 512) as f64 + (8 * field + i) as f64 / 128.0;
    let joints = |field| std::array::from_fn(|i| value(field, i));
    RobotState {
        message_id: number,
        masses_kg: [value(9, 0), value(9, 1)],
        tau: joints(1),
        tau_d: joints(2),
        q: joints(3),
        q_d: joints(4),
        dq: joints(5),
        dq_d: joints(6),
        ddq_d: joints(7),
        tau_external: joints(8),
        generator: Generator::of((number % 6) as u8),
        controller: Controller::of((number % 4) as u8),
        errors: 1 << (number % 41),
        reflex_reason: 1 << ((number + 7) % 41),
        mode: RobotMode::of((number % 7) as u8),
        success_rate: value(9, 2),
    }
}

/// The next state in which a motion runs, or none does.
fn state_in(client: &mut FciClient, moves: bool) -> RobotState {
    let mut found = None;
    wait_until("a state", || {
        found = client.receive(Duration::from_millis(20)).unwrap().map(|(state, _)| state);
        found.is_some_and(|state| (state.mode == RobotMode::Move) == moves && state.message_id > 1)
    });
    found.unwrap()
}

/// Any bits: also numbers that are none, and as small as there are.
#[test]
fn commands_come_to_the_makers_server_bit_for_bit() {
    let Some(server) = mock(&[]) else { return };
    let mut client = server.client();
    client.model().unwrap();
    state_in(&mut client, false);
    let motion =
        Request::Move { controller: MoveController::JointImpedance, generator: MoveGenerator::JointPosition };
    let motion = client.send(&motion).unwrap();
    let mut seed = 0x9e37_79b9_7f4a_7c15_u64;
    let mut sent = Vec::new();
    for k in 0..500 {
        // An xorshift, whose bits are as good as any.
        let mut any = || -> Joints {
            std::array::from_fn(|_| {
                seed ^= seed << 13;
                seed ^= seed >> 7;
                seed ^= seed << 17;
                f64::from_bits(seed)
            })
        };
        let command = RobotCommand {
            message_id: state_in(&mut client, true).message_id,
            q_c: any(),
            dq_c: any(),
            motion_finished: k == 499,
            tau_c: any(),
            torque_finished: k % 3 == 0,
        };
        client.command(&command).unwrap();
        sent.push(command);
    }
    let mut replies = Vec::new();
    wait_until("the end of the motion", || {
        client.read_replies().unwrap();
        replies.extend(client.reply(motion).map(MoveStatus::of));
        replies.len() == 2
    });
    assert_eq!(replies, [MoveStatus::MotionStarted, MoveStatus::Success]);
    state_in(&mut client, false);
    drop(client);
    let log = server.end();
    let came: Vec<_> = log.commands().iter().map(RobotCommand::encode).collect();
    let sent: Vec<_> = sent.iter().map(RobotCommand::encode).collect();
    assert!(came == sent, "{} came of {}", came.len(), sent.len());
}

/// A motion of each kind, from its begin to its end: every state is answered, once and for itself; the arm is where it was commanded to; and the maker's own limiter would have changed nothing.
#[test]
fn the_driver_moves_the_arm_that_the_maker_plays() {
    for (kind, modes, command) in [
        (CommandKind::Position, "0 0", None),
        (CommandKind::Velocity, "0 1", Some(swing as fn(u64) -> Command)),
        (CommandKind::Torque, "2 4", Some(push as fn(u64) -> Command)),
    ] {
        let Some(server) = mock(&[]) else { return };
        let mut arm = started(server.settings(), kind).unwrap();
        let gaps = arm.missed().0;
        let mut far = Q;
        (far[1], far[6]) = (Q[1] + 0.3, Q[6] - 0.2);
        let far = Command::stand_at(far);
        let mut states: Vec<ArmState> = vec![*arm.last().unwrap()];
        drive(&mut arm, 1500, |k| command.map_or(far, |c| c(k)), |state| states.push(*state)).unwrap();
        rest(&mut arm);
        let end = *arm.last().unwrap();
        assert!(end.rests(), "{end:?}");
        assert_eq!(arm.missed().0, gaps, "{kind:?}: states in a motion that were missed");
        drop(arm);
        let log = server.end();
        let commands = log.commands();
        assert!(commands.len() > 1500, "{}", commands.len());
        assert_eq!((log.at_the_end("commands"), log.at_the_end("unused")), (commands.len() as f64, 0.0));
        let first = number(&states[0]);
        for (k, c) in commands.iter().enumerate() {
            assert_eq!(c.message_id, first + k as u64);
            let last = k + 1 == commands.len();
            assert_eq!(c.motion_finished, last && kind != CommandKind::Torque);
            assert_eq!(c.torque_finished, last && kind == CommandKind::Torque);
            match kind {
                CommandKind::Torque => assert!([c.q_c, c.dq_c].concat().iter().all(|v| v.to_bits() == 0)),
                _ => assert!(c.tau_c.iter().all(|v| v.to_bits() == 0)),
            }
        }
        // What a state tells is the command that answered the one before, in single precision.
        let mut expected = Q;
        for (c, state) in commands.iter().zip(states.iter().skip(1)) {
            assert_eq!(number(state), c.message_id + 1);
            expected = match kind {
                CommandKind::Position => c.q_c,
                _ => std::array::from_fn(|i| expected[i] + 1e-3 * c.dq_c[i]),
            };
            if kind != CommandKind::Torque {
                assert_eq!(state.q, expected.map(|q| f64::from(q as f32)), "{kind:?} {}", c.message_id);
            }
        }
        let moved: Joints = std::array::from_fn(|i| end.q[i] - Q[i]);
        let way: Joints = match kind {
            CommandKind::Position => [0.0, 0.3, 0.0, 0.0, 0.0, 0.0, -0.2],
            CommandKind::Velocity => [0.58, 0.0, 0.0, -0.29, 0.0, 0.0, 0.0],
            CommandKind::Torque => [0.0, 0.0, 0.6, 0.0, 0.0, 0.0, -0.6],
        };
        let beyond = ["beyond_position", "beyond_velocity", "beyond_torque"].map(|name| log.at_the_end(name));
        println!(
            "{kind:?}: {} commands, moved by {moved:.3?}, beyond the maker's limiter {beyond:?}",
            commands.len()
        );
        assert!(moved.iter().zip(&way).all(|(a, b)| (a - b).abs() < 0.1), "{kind:?}: {moved:?}");
        assert!(beyond.iter().all(|b| *b < 1e-9), "{kind:?}: {beyond:?}");
        let requests = log.others();
        assert!(requests[1].starts_with(&format!("move {modes} 0 ")), "{requests:?}");
        assert_eq!(requests[2], "ended 0");
        assert_eq!(log.told("move")[0], [10.0, 3.12, std::f64::consts::TAU].repeat(2));
    }
}

/// Driven as fast as it goes, and to the ends of its joints. The maker's limiter stays 1 mrad/s off the limits of velocity, and goes half of the way there in a cycle; the driver stays a ten-thousandth off.
#[test]
fn the_fastest_motion_is_within_the_makers_limits() {
    for wish in [9.0, -9.0] {
        let Some(server) = mock(&[]) else { return };
        let mut arm = started(server.settings(), CommandKind::Velocity).unwrap();
        drive(&mut arm, 3000, |_| Command::keep([wish; 7]), |_| ()).unwrap();
        rest(&mut arm);
        drop(arm);
        let log = server.end();
        let fastest = log.commands().iter().flat_map(|c| c.dq_c).fold(0.0_f64, |m, v| m.max(v.abs()));
        let beyond = log.at_the_end("beyond_velocity");
        println!("up to {fastest:.4} rad/s, {beyond:.2e} rad/s beyond the maker's limiter");
        assert!(fastest > 2.0 && beyond < 0.6e-3, "{fastest} {beyond}");
    }
}

/// Every millisecond a state, whatever the driver does: what is answered too late is lost, and the robot goes on by itself.
#[test]
fn the_driver_keeps_up_with_a_thousand_states_a_second() {
    let Some(server) = mock(&["--paced"]) else { return };
    let mut arm = started(server.settings(), CommandKind::Position).unwrap();
    let (first, begin, before) = (*arm.last().unwrap(), clock(), arm.missed().0);
    let mut far = Q;
    far[1] += 0.3;
    drive(&mut arm, 2000, |_| Command::stand_at(far), |_| ()).unwrap();
    let (end, took) = (*arm.last().unwrap(), (clock() - begin) as f64 * 1e-9);
    assert!((end.q[1] - far[1]).abs() < 1e-3, "{}", end.q[1]);
    rest(&mut arm);
    let missed = arm.missed().0 - before;
    drop(arm);
    let log = server.end();
    println!(
        "{:.3} s of the robot in {took:.3} s: {} commands in time, {} too late, {missed} states missed",
        end.robot_s - first.robot_s,
        log.at_the_end("commands"),
        log.at_the_end("unused")
    );
    assert!(log.others().contains(&"ended 0"));
}

#[test]
fn what_is_set_comes_to_the_makers_server_as_it_was() {
    let Some(server) = mock(&[]) else { return };
    let mut settings = server.settings();
    let torques = |first: f64| std::array::from_fn(|i| first + i as f64 / 3.0);
    let forces = |first: f64| std::array::from_fn(|i| first + i as f64 / 7.0);
    let collision = CollisionBehavior {
        lower_torques_acceleration: torques(10.0),
        upper_torques_acceleration: torques(20.0),
        lower_torques_nominal: torques(30.0),
        upper_torques_nominal: torques(40.0),
        lower_forces_acceleration: forces(50.0),
        upper_forces_acceleration: forces(60.0),
        lower_forces_nominal: forces(70.0),
        upper_forces_nominal: forces(80.0),
    };
    let load = Load {
        mass_kg: 0.7,
        com_F: [0.01, -0.02, 0.05],
        inertia_kg_m2: std::array::from_fn(|i| i as f64 / 9e3),
    };
    (settings.collision, settings.load, settings.stiffness) =
        (Some(collision), Some(load), Some(torques(2000.0)));
    let mut arm = started(settings, CommandKind::Velocity).unwrap();
    rest(&mut arm);
    arm.set_load(Some(Load { mass_kg: 0.9, ..load }));
    arm.start(CommandKind::Torque).unwrap();
    rest(&mut arm);
    drop(arm);
    let log = server.end();
    let all: Vec<f64> = (1..5)
        .flat_map(|k| torques(10.0 * f64::from(k)))
        .chain((5..9).flat_map(|k| forces(10.0 * f64::from(k))))
        .collect();
    assert_eq!(log.told("collision"), [all.clone(), all]);
    let told = |mass: f64| [&[mass][..], &load.com_F, &load.inertia_kg_m2].concat();
    assert_eq!(log.told("load"), [told(0.7), told(0.9)]);
    assert_eq!(log.told("stiffness"), [torques(2000.0), torques(2000.0)]);
}
