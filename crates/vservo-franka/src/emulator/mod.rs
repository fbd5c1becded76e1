//! A controller that is none: the wire as the maker's client speaks it, and joints behind it. It listens on loopback addresses alone.
//!
//! ```text
//! TCP 1337  connection   requests, replies ──────────────┐
//! UDP       cycle        a state each millisecond, the command that answers it ─► core: modes, motions, limits, errors ─► JointPlant
//! ```
//! A command counts when it answers the newest state before the next one is due. Without one, accelerations go on, and torques stay; twenty in a row end the motion.
//!
//! What it is not: a robot. Its poses are none, forces and contacts are zero, errors are cleared in a tenth of a second, and how far limits may be passed is chosen by
//! hand, for the maker does not tell.

mod connection;
mod core;
mod faults;
mod plant;

pub use self::core::MISSED_CYCLES;
pub use faults::Fault;
pub use plant::{JointPlant, LaggingJoints};

use self::core::Core;
use crate::robot::RobotMode;
use crate::wire::{Load, PORT, ROBOT_COMMAND_SIZE, RobotCommand};
use crate::{CYCLE_S, JointLimits, Joints};
use connection::Client;
use faults::Pieces;
use std::collections::VecDeque;
use std::io::ErrorKind;
use std::net::{IpAddr, SocketAddr, TcpListener, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// What is emulated.
pub struct EmulatorSettings {
    /// A loopback address; others are refused. Every address of 127.0.0.0/8 has its own port.
    pub address: IpAddr,
    /// Where the arm stands, rad.
    pub q: Joints,
    /// Limits that the robot tells and watches.
    pub limits: JointLimits,
    /// Cycles in a row without a command that end a motion: [`MISSED_CYCLES`] as a robot; more where the machine is busy. From 20 on the arm brakes meanwhile.
    pub missed_cycles: u32,
    /// What is behind the controller.
    pub plant: Box<dyn JointPlant>,
}

impl EmulatorSettings {
    /// An FR3 whose joints follow by a stated lag.
    #[must_use]
    pub fn fr3(address: IpAddr, q: Joints) -> Self {
        Self {
            address,
            q,
            limits: JointLimits::fr3(),
            missed_cycles: MISSED_CYCLES,
            plant: Box::new(LaggingJoints::at(q)),
        }
    }
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
    client: Mutex<Option<Client>>,
    ends: AtomicBool,
}

impl Shared {
    fn core(&self) -> MutexGuard<'_, Core> {
        self.core.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn client(&self) -> MutexGuard<'_, Option<Client>> {
        self.client.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Emulator {
    /// Begins to listen, and to count time.
    ///
    /// # Errors
    /// When the address is none of this machine's alone, or its port is taken.
    pub fn start(settings: EmulatorSettings) -> std::io::Result<Self> {
        let EmulatorSettings { address, q, limits, missed_cycles, plant } = settings;
        if !address.is_loopback() {
            let words =
                format!("{address} is no loopback address: an emulated robot is for this machine alone");
            return Err(std::io::Error::new(ErrorKind::InvalidInput, words));
        }
        let taken = |cause: std::io::Error| {
            std::io::Error::new(cause.kind(), format!("cannot listen on {address}:{PORT}: {cause}"))
        };
        let listener = TcpListener::bind(SocketAddr::new(address, PORT)).map_err(taken)?;
        listener.set_nonblocking(true)?;
        let udp = UdpSocket::bind(SocketAddr::new(address, 0)).map_err(taken)?;
        udp.set_nonblocking(true)?;
        let shared = Arc::new(Shared {
            core: Mutex::new(Core::new(q, limits, plant, missed_cycles)),
            client: Mutex::default(),
            ends: AtomicBool::new(false),
        });
        let mut emulator = Self { shared, threads: Vec::new(), address };
        emulator.spawn("fci-requests", move |shared| connection::serve(shared, &listener))?;
        emulator.spawn("fci-cycle", move |shared| run_cycles(shared, &udp))?;
        Ok(emulator)
    }

    fn spawn(&mut self, name: &str, work: impl FnOnce(&Shared) + Send + 'static) -> std::io::Result<()> {
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
        let mut core = self.shared.core();
        let core = &mut *core;
        let faults = &mut core.faults;
        match fault {
            Fault::Reflex(error) => core.reflex(error.bit()),
            Fault::ManualRecovery => faults.manual_recovery = true,
            Fault::UserStop => core.enter(RobotMode::UserStopped),
            Fault::Guiding => core.enter(RobotMode::Guiding),
            Fault::Brakes => core.enter(RobotMode::Other),
            Fault::Ready => core.enter(RobotMode::Idle),
            Fault::RefuseMotions => faults.refuse_motions = true,
            Fault::OldVersion => faults.old_version = true,
            Fault::SilentTcp => faults.silent_tcp = true,
            Fault::Mute => faults.mute = true,
            Fault::Deaf => faults.deaf = true,
            Fault::LoseStates => faults.lose_states = true,
            Fault::StrangeDatagrams => faults.strange_datagrams = true,
            Fault::LoseCommands => faults.lose_commands = true,
            Fault::HalfPackets => faults.pieces = Pieces::Halves,
            Fault::ByteByByte => faults.pieces = Pieces::Bytes,
            Fault::EarlyReplies => faults.held_back = Some(VecDeque::new()),
            Fault::WrongSize => faults.wrong_size = true,
            Fault::ShortStates => faults.short_states = true,
            Fault::StaleNumbers => faults.stale_number = Some(core.state.message_id),
            Fault::NotANumber => faults.not_a_number = true,
            Fault::JumpingJoint => faults.jump_rad = 0.5,
            Fault::Close => faults.close = true,
        }
    }

    /// Measured positions and velocities, rad and rad/s.
    #[must_use]
    pub fn arm(&self) -> (Joints, Joints) {
        let core = self.shared.core();
        (core.state.q, core.state.dq)
    }

    /// The robot's mode, and whether a motion runs.
    #[must_use]
    pub fn mode(&self) -> (RobotMode, bool) {
        let core = self.shared.core();
        (core.state.mode, core.is_moved())
    }

    /// What the controller was told to carry.
    #[must_use]
    pub fn load(&self) -> Option<Load> {
        self.shared.core().load
    }

    /// What is told since the last call: reflexes, and what was asked for and is not there.
    #[must_use]
    pub fn log(&self) -> Vec<String> {
        self.shared.core().log.drain(..).collect()
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        self.shared.ends.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

/// Longest time that is made up for, cycles. Chosen by hand: after a tenth of a second without a processor the time is given up.
const MADE_UP: u32 = 100;

/// A cycle each millisecond. Those that the machine slept through are counted, without states and without blame for commands that could not come.
#[allow(clippy::disallowed_methods)] // the emulator is a machine of its own
fn run_cycles(shared: &Shared, udp: &UdpSocket) {
    let period = Duration::from_secs_f64(CYCLE_S);
    let mut due = Instant::now();
    let mut sent = None;
    while !shared.ends.load(Ordering::Relaxed) {
        due += period;
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        let command = newest_command(udp, sent);
        let mut core = shared.core();
        let lost = core.faults.lose_commands && core.state.message_id.is_multiple_of(5);
        core.step(command.as_ref().filter(|_| !lost), sent.is_some());
        let mut late = 0;
        while due + period < Instant::now() {
            due += period;
            late += 1;
            if late > MADE_UP {
                due = Instant::now();
                break;
            }
            core.step(None, false);
        }
        sent = connection::send_cycle(shared, &mut core, udp);
    }
}

/// The command that answers the state of this number; older ones have come too late.
fn newest_command(udp: &UdpSocket, sent: Option<u64>) -> Option<RobotCommand> {
    let mut found = None;
    let mut bytes = [0; 2 * ROBOT_COMMAND_SIZE];
    loop {
        match udp.recv_from(&mut bytes) {
            Ok((size, from)) if from.ip().is_loopback() => {
                let command = RobotCommand::decode(bytes.get(..size).unwrap_or_default()).ok();
                found = command.filter(|c| Some(c.message_id) == sent).or(found);
            }
            Ok(_) => {}
            Err(e) if matches!(e.kind(), ErrorKind::Interrupted | ErrorKind::ConnectionRefused) => {}
            Err(_) => return found,
        }
    }
}
