//! A robot for each test: an emulator on a loopback address of its own.

#![allow(
    dead_code,
    unreachable_pub,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::print_stdout,
    clippy::disallowed_methods
)]

pub mod mock;

use std::net::{IpAddr, Ipv4Addr};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU8, Ordering};
use std::time::{Duration, Instant};
use vservo_franka::emulator::{Emulator, EmulatorSettings};
use vservo_franka::{Arm, ArmSettings, Command, CommandKind, FrankaError, Joints};

pub const Q: Joints = [0.1, -0.5, 0.0, -2.1, 0.1, 1.8, 0.2];

/// Monotonic, ns, from the first call on.
pub fn clock() -> i64 {
    static ORIGIN: OnceLock<Instant> = OnceLock::new();
    // A second, so that no stamp is zero.
    1_000_000_000 + ORIGIN.get_or_init(Instant::now).elapsed().as_nanos() as i64
}

/// A loopback address that no other test of this machine has.
pub fn address() -> IpAddr {
    static COUNT: AtomicU8 = AtomicU8::new(1);
    let [_, _, b, c] = std::process::id().to_be_bytes();
    Ipv4Addr::new(127, 10 + b % 200, c, COUNT.fetch_add(1, Ordering::Relaxed)).into()
}

/// A robot that waits longer than one for commands that a busy machine keeps back: half a second.
pub fn robot() -> Emulator {
    robot_with(500)
}

pub fn robot_with(missed_cycles: u32) -> Emulator {
    Emulator::start(EmulatorSettings { missed_cycles, ..EmulatorSettings::fr3(address(), Q) }).unwrap()
}

pub fn settings(robot: &Emulator) -> ArmSettings {
    let mut settings = ArmSettings::new(robot.address(), clock);
    // Machines of tests are slow, and their processors have other work.
    settings.silence = Duration::from_millis(400);
    settings.patience = Duration::from_secs(3);
    settings
}

/// An arm that is ready for commands.
pub fn started(settings: ArmSettings, kind: CommandKind) -> Result<Arm, FrankaError> {
    let mut arm = Arm::connect(settings)?;
    arm.make_ready()?;
    arm.start(kind)?;
    Ok(arm)
}

/// Commands the arm in every cycle, by its time since the first, s, until it ends or `for_s` are over.
pub fn drive(
    arm: &mut Arm,
    for_s: f64,
    mut command: impl FnMut(f64, &Arm) -> Command,
) -> Result<(), FrankaError> {
    let begin = arm.last().unwrap().robot_s;
    let until = clock() + (for_s * 5e9) as i64;
    loop {
        if let Some(state) = arm.next(Duration::from_millis(20))? {
            let t = state.robot_s - begin;
            if t >= for_s {
                return Ok(());
            }
            let what = command(t, arm);
            arm.command(what)?;
        }
        assert!(clock() < until, "no state, and no error");
    }
}

pub fn wait_until(what: &str, mut is: impl FnMut() -> bool) {
    let end = Instant::now() + Duration::from_secs(20);
    while !is() {
        assert!(Instant::now() < end, "in vain: {what}");
        std::thread::sleep(Duration::from_millis(2));
    }
}

/// The arm stands, and no motion moves it.
pub fn assert_at_rest(robot: &Emulator) {
    wait_until("the arm at rest", || {
        let (q, qd) = robot.arm();
        std::thread::sleep(Duration::from_millis(50));
        qd.iter().all(|v| v.abs() < 1e-3)
            && robot.arm().0.iter().zip(&q).all(|(a, b)| (a - b).abs() < 1e-5)
            && !robot.mode().1
    });
}
