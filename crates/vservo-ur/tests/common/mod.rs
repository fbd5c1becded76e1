//! A robot for each test: an emulator on a loopback address of its own.

#![allow(dead_code, unreachable_pub, clippy::unwrap_used, clippy::disallowed_methods)]

use std::net::{IpAddr, Ipv4Addr};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU8, Ordering};
use std::time::{Duration, Instant};
use vservo_ur::emulator::{Emulator, EmulatorSettings, StiffJoints};
use vservo_ur::{Arm, ArmSettings, Command, Joints, RuntimeState, Series, UrError};

pub const Q: Joints = [0.3, -1.6, 1.4, -1.3, -1.7, 0.9];

/// Monotonic, ns, from the first call on.
pub fn clock() -> i64 {
    static ORIGIN: OnceLock<Instant> = OnceLock::new();
    // A second, so that no stamp is zero.
    1_000_000_000 + ORIGIN.get_or_init(Instant::now).elapsed().as_nanos() as i64
}

/// A loopback address that no other test of this machine has.
pub fn address() -> IpAddr {
    static COUNT: AtomicU8 = AtomicU8::new(1);
    let pid = std::process::id();
    let [_, _, b, c] = pid.to_be_bytes();
    Ipv4Addr::new(127, 10 + b % 200, c, COUNT.fetch_add(1, Ordering::Relaxed)).into()
}

pub fn robot(series: Series, running: bool) -> Emulator {
    Emulator::start(EmulatorSettings {
        address: address(),
        series,
        q: Q,
        running,
        joints: Box::new(StiffJoints::default()),
    })
    .unwrap()
}

pub fn settings(robot: &Emulator) -> ArmSettings {
    let mut settings = ArmSettings::new(robot.address(), clock);
    // Machines of tests are slow, and their processors have other work.
    settings.silence = Duration::from_millis(400);
    settings.patience = Duration::from_secs(3);
    settings
}

/// An arm that is ready for commands.
pub fn started(settings: ArmSettings) -> Result<Arm, UrError> {
    let mut arm = Arm::connect(settings)?;
    arm.make_ready(false, &|| false)?;
    arm.start()?;
    Ok(arm)
}

/// Commands the arm in every cycle, by its time since the first, s, until it ends or `for_s` are over.
pub fn drive(arm: &mut Arm, for_s: f64, mut command: impl FnMut(f64) -> Command) -> Result<(), UrError> {
    let begin = arm.last().unwrap().robot_s;
    let until = clock() + (for_s * 3e9) as i64;
    loop {
        if let Some(state) = arm.next(Duration::from_millis(20))? {
            let t = state.robot_s - begin;
            if t >= for_s {
                return Ok(());
            }
            arm.command(command(t))?;
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

/// The arm stands, and no program moves it.
pub fn assert_at_rest(robot: &Emulator) {
    wait_until("the arm at rest", || {
        let (q, qd) = robot.arm();
        std::thread::sleep(Duration::from_millis(100));
        qd == [0.0; 6] && robot.arm().0 == q && robot.modes().2 != RuntimeState::Playing
    });
}
