//! A controller that is none: the wire as its maker documents it, and joints behind it. It listens on loopback addresses alone.
//!
//! ```text
//! 30004  rtde_server       recipes, states in every cycle, registers ─► core: modes, stops, motion, registers ─► JointModel
//! 29999  dashboard_server  power, brakes, unlocking                      ▲
//! 30001 to 30003  programs: their text is run by an interpreter ─────────┘ registers, servoj, speedj, direct_torque, stopj; 30001 tells why something stops
//! ```
//! Programs are executed as they are written: `interpreter` knows as much of URScript as ours needs, and refuses the rest with the line. The program of `ur_rtde`
//! is recognised, and its protocol of registers served for what it needs to hold, servo, move by speed and stop.
//!
//! What it is not: a robot. Times of power and brakes are short, forces, tool and digital ports are zero, and `servoj` has a lag of our own.

mod core;
mod dashboard_server;
mod faults;
mod interpreter;
mod motion;
mod programs;
mod rtde_server;
mod syntax;
mod ur_rtde;
mod variables;

pub use self::core::{JointModel, StiffJoints, Torque};
pub use faults::Fault;

use self::core::Core;
use crate::program::Payload;
use crate::{Joints, RobotMode, RuntimeState, SafetyMode, Series, dashboard, primary, program, rtde};
use faults::Pieces;
use rtde_server::Client;
use std::io::ErrorKind;
use std::net::{IpAddr, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use variables::Sink;

/// What is emulated.
pub struct EmulatorSettings {
    /// A loopback address; others are refused. Every address of 127.0.0.0/8 has its own ports.
    pub address: IpAddr,
    /// The series.
    pub series: Series,
    /// Where the arm stands, rad.
    pub q: Joints,
    /// Whether it is powered with open brakes, as somebody has left it.
    pub running: bool,
    /// What is behind the controller.
    pub joints: Box<dyn JointModel>,
}

/// An emulator that runs in threads of this process, until it is dropped.
pub struct Emulator {
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
    address: IpAddr,
}

/// What the threads share. Locks are taken in the order of the fields.
struct Shared {
    core: Mutex<Core>,
    clients: Mutex<Vec<Arc<Mutex<Client>>>>,
    /// Registers that have an owner.
    owners: Mutex<Vec<(u64, Sink)>>,
    cycle: Condvar,
    ends: AtomicBool,
}

impl Shared {
    fn core(&self) -> MutexGuard<'_, Core> {
        self.core.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn clients(&self) -> MutexGuard<'_, Vec<Arc<Mutex<Client>>>> {
        self.clients.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Whether somebody else owns a register.
    fn is_taken(&self, number: u64, sink: Sink) -> bool {
        let owners = self.owners.lock().unwrap_or_else(PoisonError::into_inner);
        owners.iter().any(|(owner, owned)| *owned == sink && *owner != number)
    }

    fn take(&self, number: u64, sinks: &[Sink]) {
        let mut owners = self.owners.lock().unwrap_or_else(PoisonError::into_inner);
        let registers = sinks.iter().filter(|sink| matches!(sink, Sink::Int(_) | Sink::Double(_)));
        owners.extend(registers.map(|sink| (number, *sink)));
    }

    /// Gives back the registers of clients that are gone.
    fn release(&self, present: &[u64]) {
        let mut owners = self.owners.lock().unwrap_or_else(PoisonError::into_inner);
        owners.retain(|(owner, _)| present.contains(owner));
    }
}

/// The next client; none when the emulator ends.
fn accept(shared: &Shared, listener: &TcpListener) -> Option<TcpStream> {
    while !shared.ends.load(Ordering::Relaxed) {
        match listener.accept() {
            Ok((stream, from)) if from.ip().is_loopback() && stream.set_nonblocking(false).is_ok() => {
                return Some(stream);
            }
            // Chosen by hand: a client does not notice the wait.
            _ => std::thread::sleep(Duration::from_millis(5)),
        }
    }
    None
}

impl Emulator {
    /// Begins to listen, and to count time.
    ///
    /// # Errors
    /// When the address is none of this machine's alone, or its ports are taken.
    pub fn start(settings: EmulatorSettings) -> std::io::Result<Self> {
        let EmulatorSettings { address, series, q, running, joints } = settings;
        if !address.is_loopback() {
            let words =
                format!("{address} is no loopback address: an emulated robot is for this machine alone");
            return Err(std::io::Error::new(ErrorKind::InvalidInput, words));
        }
        let mut core = Core::new(series, q, joints);
        if running {
            core.run_at_once();
        }
        let shared = Arc::new(Shared {
            core: Mutex::new(core),
            clients: Mutex::default(),
            owners: Mutex::default(),
            cycle: Condvar::new(),
            ends: AtomicBool::new(false),
        });
        let bind = |port| {
            let listener = TcpListener::bind(SocketAddr::new(address, port)).map_err(|cause| {
                std::io::Error::new(cause.kind(), format!("cannot listen on {address}:{port}: {cause}"))
            })?;
            listener.set_nonblocking(true)?;
            Ok::<_, std::io::Error>(listener)
        };
        let mut emulator = Self { shared, threads: Vec::new(), address };
        let listener = bind(rtde::PORT)?;
        emulator.spawn("ur-rtde", move |shared| rtde_server::serve(shared, &listener))?;
        let listener = bind(dashboard::PORT)?;
        emulator.spawn("ur-dashboard", move |shared| dashboard_server::serve(shared, &listener))?;
        for port in [primary::PORT, program::PORT, program::PORT + 1] {
            let listener = bind(port)?;
            emulator.spawn("ur-programs", move |shared| {
                programs::serve(shared, &listener, port == primary::PORT)
            })?;
        }
        emulator.spawn("ur-cycle", |shared| run_cycles(shared))?;
        Ok(emulator)
    }

    fn spawn(&mut self, name: &str, work: impl FnOnce(&Arc<Shared>) + Send + 'static) -> std::io::Result<()> {
        let shared = Arc::clone(&self.shared);
        self.threads.push(std::thread::Builder::new().name(name.into()).spawn(move || work(&shared))?);
        Ok(())
    }

    /// Where it listens.
    #[must_use]
    pub fn address(&self) -> IpAddr {
        self.address
    }

    /// Lets something go wrong.
    pub fn inject(&self, fault: Fault) {
        let newest = rtde_server::newest(&self.shared);
        let mut core = self.shared.core();
        let core = &mut *core;
        match fault {
            Fault::Stop(mode) => {
                core.stop_by_safety(mode);
                // A number that no controller has.
                core.say_error(9999, 0, "stopped by the emulator, as it was asked to");
            }
            Fault::PowerOff => {
                core.power_off();
            }
            Fault::Reboot => {
                core.reboot();
                core.faults.reset_before = newest;
            }
            Fault::ResetConnections => core.faults.reset_before = newest,
            Fault::Mute => core.faults.mute = true,
            Fault::Deaf => core.faults.deaf_until_s = Some(f64::INFINITY),
            Fault::DeafFor(s) => core.faults.deaf_until_s = Some(core.time_s + s),
            Fault::StaleStamps => core.faults.stale_at_s = Some(core.time_s),
            Fault::HalfPackages => core.faults.pieces = Pieces::Halves,
            Fault::ByteByByte => core.faults.pieces = Pieces::Bytes,
            Fault::CutPackage => core.faults.cut_once = true,
            Fault::UnknownType => core.faults.unknown_type_once = true,
            Fault::NotANumber => core.faults.not_a_number = true,
            Fault::JumpingJoint => core.faults.jump_rad = 1.0,
            Fault::StopProgram => core.end_program(),
            Fault::PauseProgram => {
                core.end_program();
                core.runtime = RuntimeState::Paused;
            }
            Fault::RefusePrograms => core.faults.refuse_programs = true,
            Fault::WrongProtocol => core.faults.wrong_protocol = true,
            Fault::OldSoftware => core.version.minor = 2,
            Fault::Software { minor, bugfix } => (core.version.minor, core.version.bugfix) = (minor, bugfix),
            Fault::RegistersInUse => core.faults.registers_in_use = true,
            Fault::UnknownVariables => core.faults.unknown_variables = true,
            Fault::SilentSetup => core.faults.silent_setup = true,
            Fault::LocalControl => core.remote_control = false,
            Fault::SilentDashboard => core.faults.silent_dashboard = true,
            Fault::SilentPrimaryFor(s) => core.faults.silent_primary_until_s = Some(core.time_s + s),
            Fault::Slider(share) => core.slider = share.clamp(0.0, 1.0),
            Fault::LoseStates => core.faults.lose_states = true,
            Fault::LateBy(s) => core.faults.late_s = s,
        }
    }

    /// Where the arm is, and how fast it moves: rad, rad/s.
    #[must_use]
    pub fn arm(&self) -> (Joints, Joints) {
        let core = self.shared.core();
        (core.q, core.qd)
    }

    /// Mode of robot, safety and program.
    #[must_use]
    pub fn modes(&self) -> (RobotMode, SafetyMode, RuntimeState) {
        let core = self.shared.core();
        (core.mode, core.safety, core.runtime)
    }

    /// What the controller was told to carry.
    #[must_use]
    pub fn payload(&self) -> Payload {
        self.shared.core().payload
    }

    /// What was told since the last call: programs that are refused, stops, what is wrong on the wire.
    #[must_use]
    pub fn log(&self) -> Vec<String> {
        std::mem::take(&mut self.shared.core().log)
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        self.shared.ends.store(true, Ordering::Relaxed);
        self.shared.cycle.notify_all();
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

/// The controller, once its program has done its part of the cycle: a real one gives it the time in each. A program that takes no end is not waited for.
#[allow(clippy::disallowed_methods)] // the emulator is a machine of its own
fn with_program_ready(shared: &Shared) -> MutexGuard<'_, Core> {
    let begin = Instant::now();
    let mut core = shared.core();
    // Chosen by hand: a machine that keeps a thread back for so long cannot emulate.
    while core.program_waits == Some(false) && begin.elapsed() < Duration::from_millis(100) {
        let waited = shared.cycle.wait_timeout(core, Duration::from_millis(1));
        core = waited.unwrap_or_else(PoisonError::into_inner).0;
    }
    core
}

/// The controller's cycles, by the clock. Cycles that are late are made up for, one after the other.
#[allow(clippy::disallowed_methods)] // the emulator is a machine of its own
fn run_cycles(shared: &Shared) {
    let period = Duration::from_secs_f64(shared.core().period_s());
    let mut due = Instant::now();
    while !shared.ends.load(Ordering::Relaxed) {
        due += period;
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        // Chosen by hand: after a tenth of a second without a processor the time is given up.
        if due.elapsed() > Duration::from_millis(100) {
            due = Instant::now();
        }
        let mut core = with_program_ready(shared);
        core.step();
        rtde_server::send_all(shared, &mut core);
        drop(core);
        let present: Vec<u64> = shared
            .clients()
            .iter()
            .map(|c| c.lock().unwrap_or_else(PoisonError::into_inner).number())
            .collect();
        shared.release(&present);
        shared.cycle.notify_all();
    }
}
