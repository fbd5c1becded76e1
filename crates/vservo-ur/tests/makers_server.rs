//! Our client against a server that is nobody's here: the fake RTDE server of the maker's own client library, which `contrib/crosswise/ur_fake_rtde.sh` builds and
//! `VSERVO_UR_FAKE_RTDE` names. Without it the tests say `skipped`.
//!
//! That server answers a set-up with the names that were asked for, where a controller tells their types, and its data has a recipe's number that nobody has set; the maker's own client reads
//! neither. Between both ends stands a relay that puts in the types and the number, and changes nothing else.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout)] // what is skipped is told

mod common;

use common::{address, clock, wait_until};
use std::io::{Read, Write};
use std::net::{IpAddr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::process::{Child, Command, Stdio};
use std::time::Duration;
use vservo_ur::rtde::{self, DataType, Framer, PackageType, Recipe, RtdeClient, RtdeSettings, Writer};
use vservo_ur::{Arm, ArmSettings, RobotMode, Series, UrError};

/// The maker's server, and the address at which the relay listens. Ends with the test.
struct MakersServer {
    process: Child,
    address: IpAddr,
}

impl Drop for MakersServer {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// The server behind a relay; none where it was not built.
fn makers_server() -> Option<MakersServer> {
    let Some(program) = std::env::var_os("VSERVO_UR_FAKE_RTDE") else {
        println!("skipped: no VSERVO_UR_FAKE_RTDE (contrib/crosswise/ur_fake_rtde.sh builds it)");
        return None;
    };
    // Given back at once; nobody else has it in between, or the server ends and the test says so.
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let server: SocketAddr = ([127, 0, 0, 1], port).into();
    let process = Command::new(program).arg(port.to_string()).stdout(Stdio::null()).spawn().unwrap();
    let relay = address();
    let listener = TcpListener::bind((relay, rtde::PORT)).unwrap();
    let made = MakersServer { process, address: relay };
    let mut first = None;
    wait_until("the maker's server", || {
        first = TcpStream::connect(server).ok();
        first.is_some()
    });
    let thread = |name: &str| std::thread::Builder::new().name(name.into());
    let relayed = move || {
        // It takes one client, which the one that looked for it was.
        let (client, _) = listener.accept().unwrap();
        let server = first.unwrap();
        let (mut from, mut to) = (client.try_clone().unwrap(), server.try_clone().unwrap());
        let written = thread("relay-in").spawn(move || {
            let _ = std::io::copy(&mut from, &mut to);
            let _ = to.shutdown(Shutdown::Both);
        });
        drop(written.unwrap());
        relay_answers(server, client);
    };
    thread("relay-out").spawn(relayed).unwrap();
    Some(made)
}

/// What the server sends, with types for names in the answers to set-ups, and their number in data.
fn relay_answers(mut server: TcpStream, mut client: TcpStream) {
    let (mut framer, mut writer) = (Framer::default(), Writer::with_capacity(4096));
    let mut outputs = 0;
    loop {
        while let Some(package) = framer.next().expect("packages as the protocol has them") {
            let is_answer = matches!(package.kind, PackageType::SetupOutputs | PackageType::SetupInputs);
            let payload = match package.payload.split_first() {
                Some((id, names)) if is_answer => {
                    outputs = if package.kind == PackageType::SetupOutputs { *id } else { outputs };
                    let names = String::from_utf8(names.to_vec()).unwrap();
                    let types: Vec<_> = names.split(',').map(|name| type_of(name).name()).collect();
                    [&[*id], types.join(",").as_bytes()].concat()
                }
                Some((_, values)) if package.kind == PackageType::Data => [&[outputs], values].concat(),
                _ => package.payload.to_vec(),
            };
            if client.write_all(writer.begin(package.kind).put(&payload).package()).is_err() {
                return;
            }
        }
        match server.read(framer.room()) {
            Ok(0) | Err(_) => return,
            Ok(count) => framer.filled(count),
        }
    }
}

/// The type of a variable, by the maker's documentation of RTDE.
fn type_of(name: &str) -> DataType {
    match name {
        "actual_q" | "actual_qd" => DataType::Vector6D,
        "runtime_state" | "speed_slider_mask" => DataType::Uint32,
        "robot_mode" | "safety_mode" => DataType::Int32,
        _ if name.contains("int_register") => DataType::Int32,
        _ => DataType::Double,
    }
}

fn settings(at: IpAddr) -> ArmSettings {
    let mut settings = ArmSettings::new(at, clock);
    settings.silence = Duration::from_millis(400);
    settings
}

/// The driver agrees with it on protocol, version and recipes, receives its states, and says in words that a controller of zeros cannot be moved.
#[test]
fn the_driver_takes_the_states_of_the_makers_server() {
    let Some(server) = makers_server() else { return };
    let mut arm = Arm::connect(settings(server.address)).unwrap();
    assert_eq!((arm.version().to_string().as_str(), arm.series()), ("10.10.10.10", Series::ESeries));
    let (first, begin) = (*arm.last().unwrap(), clock());
    let (mut count, mut last) = (0, first);
    while last.robot_s - first.robot_s < 3.0 {
        assert!(clock() - begin < 20_000_000_000, "its time does not go on");
        if let Some(state) = arm.next(Duration::from_millis(20)).unwrap() {
            assert!(state.robot_s > last.robot_s && state.stamp >= last.stamp && state.stamp <= clock());
            assert_eq!((state.q, state.mode), ([0.0; 6], RobotMode::Disconnected));
            (count, last) = (count + 1, state);
            arm.command(vservo_ur::Command::Hold).unwrap(); // which its parser reads
        }
    }
    // It sleeps for 2 ms between two; a busy machine makes that longer.
    assert!(count > 500, "{count} states in 3 s");
    let passed = (last.stamp - first.stamp) as f64 * 1e-9;
    assert!(
        (passed - (last.robot_s - first.robot_s)).abs() < 5e-3,
        "{passed} s of ours are 3 s of its clock"
    );
    assert!(matches!(arm.make_ready(false, &|| false), Err(UrError::Stopped { .. })));
}

/// What our client writes is read by the maker's parser: the server answers a speed slider by the speed that it tells from then on.
#[test]
fn what_the_client_writes_is_read_by_the_makers_parser() {
    let Some(server) = makers_server() else { return };
    let mut client = RtdeClient::connect(RtdeSettings::new(server.address, clock)).unwrap();
    let names = |of: &[&str]| of.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
    let outputs =
        client.set_up_outputs(&names(&["timestamp", "actual_q", "target_speed_fraction"]), 125.0).unwrap();
    let inputs = client
        .set_up_inputs(&names(&["speed_slider_mask", "input_int_register_24", "speed_slider_fraction"]))
        .unwrap();
    client.start().unwrap();
    let place = outputs.place("target_speed_fraction", DataType::Double).unwrap();
    for slider in [0.4, 1.0, 0.125] {
        client
            .send(&inputs, |writer| {
                writer.put(&1_u32.to_be_bytes()).put(&(-7_i32).to_be_bytes()).put(&f64::to_be_bytes(slider));
            })
            .unwrap();
        wait_until("the speed that was set", || {
            let read = |payload: &[u8], _| Recipe::double(payload, place);
            client.data(&outputs, Duration::from_millis(50), read).unwrap() == Some(slider)
        });
    }
    client.pause().unwrap();
}
