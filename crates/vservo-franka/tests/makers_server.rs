//! Our client and driver against a server that is nobody's here: the mock server of the maker's own client library, around which `contrib/crosswise/franka_mock.sh` builds a
//! robot, and which `VSERVO_FRANKA_MOCK` names. Without it the tests say `skipped`.
//!
//! Messages and limits are the maker's there; what the robot does is played. While its arm moves, it waits with each state for the command that answers the last: so
//! nothing here depends on how busy the machine is.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // what is skipped is told

mod common;

use common::{Q, address, clock, started, wait_until};
use std::io::{BufRead, BufReader};
use std::net::IpAddr;
use std::process::{Child, Command as Process, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;
use vservo_franka::arm::{ArmState, Recovered};
use vservo_franka::client::FciClient;
use vservo_franka::robot::{Controller, Generator};
use vservo_franka::wire::{
    CollisionBehavior, Load, MoveController, MoveGenerator, MoveStatus, Request, RobotCommand, RobotState,
};
use vservo_franka::{Arm, ArmSettings, Command, CommandKind, FrankaError, JointLimits, Joints, RobotMode};

/// Longest that anything is waited for: a machine may be busy.
const PATIENCE: Duration = Duration::from_secs(20);

/// The maker's server, and what it says. Ends with the test.
struct Mock {
    process: Child,
    address: IpAddr,
    lines: Receiver<String>,
}

impl Drop for Mock {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// The server with a script; none where it was not built.
fn mock(script: &[&str]) -> Option<Mock> {
    let Some(program) = std::env::var_os("VSERVO_FRANKA_MOCK") else {
        println!("skipped: no VSERVO_FRANKA_MOCK (contrib/crosswise/franka_mock.sh builds it)");
        return None;
    };
    let address = address();
    let mut process =
        Process::new(program).arg(address.to_string()).args(script).stdout(Stdio::piped()).spawn().unwrap();
    let output = BufReader::new(process.stdout.take().unwrap());
    let (to, lines) = channel();
    let thread = std::thread::Builder::new().name("mock-output".into());
    drop(thread.spawn(move || output.lines().map_while(Result::ok).try_for_each(|line| to.send(line))).unwrap());
    let mock = Mock { process, address, lines };
    assert_eq!(mock.lines.recv_timeout(PATIENCE).unwrap(), "listening");
    Some(mock)
}

impl Mock {
    fn settings(&self) -> ArmSettings {
        let mut settings = ArmSettings::new(self.address, clock);
        (settings.patience, settings.silence) = (PATIENCE, PATIENCE);
        settings
    }

    fn client(&self) -> FciClient {
        FciClient::connect(self.address, PATIENCE, clock).unwrap()
    }

    /// What it has said, when its client is gone. The server itself looks then whether anything is left that it was sent, and says so.
    fn end(mut self) -> Log {
        let mut status = None;
        wait_until("the end of the maker's server", || {
            status = self.process.try_wait().unwrap();
            status.is_some()
        });
        let log = Log(self.lines.iter().collect());
        assert!(status.unwrap().success(), "{:?}", log.others());
        assert_eq!(log.0.last().unwrap(), "the maker's server is content");
        log
    }
}

/// What the server has taken.
struct Log(Vec<String>);

impl Log {
    /// Everything but commands.
    fn others(&self) -> Vec<&str> {
        self.0.iter().map(String::as_str).filter(|line| !line.starts_with("command ")).collect()
    }

    /// Commands as they came, and whether all that our driver never sets was zero.
    fn commands(&self) -> Vec<RobotCommand> {
        let lines = self.0.iter().filter_map(|line| line.strip_prefix("command "));
        let read = |line: &str| {
            let (number, rest) = line.split_once(' ').unwrap();
            let mut words = rest.split(' ');
            let values: Vec<f64> = words.by_ref().take(45).map(number_of).collect();
            let flags: Vec<_> = words.collect();
            let joints = |from: usize| -> Joints { values[from..from + 7].try_into().unwrap() };
            assert!(values[14..38].iter().all(|v| v.to_bits() == 0) && flags[0] == "0", "Cartesian: {line}");
            RobotCommand {
                message_id: number.parse().unwrap(),
                q_c: joints(0),
                dq_c: joints(7),
                motion_finished: flags[1] == "1",
                tau_c: joints(38),
                torque_finished: flags[2] == "1",
            }
        };
        lines.map(read).collect()
    }

    /// The numbers of a request, where there was one of this name.
    fn told(&self, name: &str) -> Vec<Vec<f64>> {
        let of = |line: &&str| line.split(' ').next() == Some(name);
        let numbers = |line: &str| line.split(' ').skip(1).filter(|word| word.len() == 16).map(number_of).collect();
        self.others().into_iter().filter(of).map(numbers).collect()
    }

    /// A number of the last line.
    fn at_the_end(&self, name: &str) -> f64 {
        let line = self.0.iter().find(|line| line.starts_with("over ")).expect("the end of the script");
        let mut words = line.split(' ').skip_while(|word| *word != name).skip(1);
        words.next().unwrap().parse().unwrap()
    }
}

fn number_of(word: &str) -> f64 {
    f64::from_bits(u64::from_str_radix(word, 16).unwrap())
}

fn number(state: &ArmState) -> u64 {
    (state.robot_s * 1e3).round() as u64
}

/// Answers so many states by commands, by their number.
fn drive(
    arm: &mut Arm,
    states: u64,
    command: impl Fn(u64) -> Command,
    mut each: impl FnMut(&ArmState),
) -> Result<(), FrankaError> {
    let (mut count, until) = (0, clock() + 3 * PATIENCE.as_nanos() as i64);
    while count < states {
        if let Some(state) = arm.next(Duration::from_millis(20))? {
            each(&state);
            arm.command(command(count))?;
            count += 1;
        }
        assert!(clock() < until, "no state, and no error");
    }
    Ok(())
}

/// Turns the first joint, and the fourth the other way.
fn swing(count: u64) -> Command {
    let rise = 1.0 - (-(count as f64) / 100.0).exp();
    Command::Velocity([0.4 * rise, 0.0, 0.0, -0.2 * rise, 0.0, 0.0, 0.0])
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
    let motion = Request::Move { controller: MoveController::JointImpedance, generator: MoveGenerator::JointPosition };
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
        let far = Command::Position { q: far, qd: [0.0; 7], at: 0 };
        let mut states: Vec<ArmState> = vec![*arm.last().unwrap()];
        drive(&mut arm, 1500, |k| command.map_or(far, |c| c(k)), |state| states.push(*state)).unwrap();
        arm.come_to_rest().unwrap();
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
            for i in 0..7 {
                expected[i] = if kind == CommandKind::Position { c.q_c[i] } else { expected[i] + 1e-3 * c.dq_c[i] };
            }
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
        println!("{kind:?}: {} commands, moved by {moved:.3?}, beyond the maker's limiter {beyond:?}", commands.len());
        assert!(moved.iter().zip(&way).all(|(a, b)| (a - b).abs() < 0.1), "{kind:?}: {moved:?}");
        assert!(beyond.iter().all(|b| *b < 1e-9), "{kind:?}: {beyond:?}");
        let requests = log.others();
        assert!(requests[1].starts_with(&format!("move {modes} 0 ")), "{requests:?}");
        assert_eq!(requests[2], "ended 0");
        assert_eq!(log.told("move")[0], [10.0, 3.12, std::f64::consts::TAU].repeat(2));
    }
}
