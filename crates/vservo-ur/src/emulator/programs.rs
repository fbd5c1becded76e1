//! The controller's end of programs: text comes in, and the newest program runs in a thread of its own.

use super::core::{Inputs, REGISTERS};
use super::motion::Motion;
use super::{Shared, accept, interpreter, syntax, ur_rtde};
use crate::RuntimeState;
use crate::primary;
use crate::program::{Payload, TorqueInterface};
use crate::socket::receive;
use std::io::Write;
use std::net::{TcpListener, TcpStream};
use std::sync::atomic::Ordering;
use std::sync::{Arc, PoisonError};
use std::time::Duration;

/// Largest program that is taken, bytes. Chosen by hand: twenty times that of `ur_rtde`.
const LARGEST: usize = 1_000_000;
/// So long a stream must be still before its text is taken for whole, and so often a thread looks whether the emulator ends. Chosen by hand: the
/// controller begins with a program when its last line has come.
const STILL: Duration = Duration::from_millis(20);

/// Largest mass that a program may tell, kg: twice what the strongest arm of this maker carries by its data sheet.
const MOST_KG: f64 = 70.0;

/// Why a program does not go on.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum End {
    /// Another has taken its place, or it was stopped.
    Stopped,
    /// It does what cannot be done, in words.
    Wrong(String),
}

/// Takes programs until the emulator ends.
/// On the primary interface they are told messages, and states ten times a second, which are empty.
pub(super) fn serve(shared: &Arc<Shared>, listener: &TcpListener, is_primary: bool) {
    let mut threads = Vec::new();
    loop {
        while is_primary && shared.core().is_primary_silent() && !shared.ends.load(Ordering::Relaxed) {
            std::thread::sleep(STILL);
        }
        let Some(stream) = accept(shared, listener) else { break };
        let own = Arc::clone(shared);
        let thread = std::thread::Builder::new().name("ur-program-client".into());
        threads.extend(thread.spawn(move || take_programs(&own, stream, is_primary)).ok());
        threads.retain(|thread| !thread.is_finished());
    }
    for thread in threads {
        let _ = thread.join();
    }
}

/// Reads programs from one client. Each is run by a thread of its own, which the next one ends.
fn take_programs(shared: &Arc<Shared>, mut stream: TcpStream, is_primary: bool) {
    let mut told = {
        let core = shared.core();
        core.messages_gone + core.messages.len()
    };
    let mut text = Vec::new();
    let mut threads = Vec::new();
    let mut state_due = 0;
    let mut open = stream.set_read_timeout(Some(STILL)).is_ok();
    while open && !shared.ends.load(Ordering::Relaxed) {
        if is_primary {
            let (packages, is_silent) = {
                let core = shared.core();
                let from = told.saturating_sub(core.messages_gone);
                told = core.messages_gone + core.messages.len();
                let mut packages = core.messages.get(from..).unwrap_or_default().concat();
                if core.cycle >= state_due {
                    state_due = core.cycle + (0.1 / core.period_s()) as u64;
                    packages.extend_from_slice(&[0, 0, 0, 5, primary::ROBOT_STATE]);
                }
                (packages, core.is_primary_silent())
            };
            open &= !is_silent && stream.write_all(&packages).is_ok();
        }
        let mut piece = [0; 4096];
        let received = receive(&mut stream, &mut piece);
        open &= received.is_ok();
        let count = received.ok().flatten();
        text.extend_from_slice(piece.get(..count.unwrap_or(0)).unwrap_or_default());
        if count.is_none() && !text.is_empty() || text.len() > LARGEST {
            let program = String::from_utf8_lossy(&std::mem::take(&mut text)).into_owned();
            let own = Arc::clone(shared);
            let thread = std::thread::Builder::new().name("ur-program".into());
            threads.extend(thread.spawn(move || run(&own, &program)).ok());
        }
    }
    for thread in threads {
        let _ = thread.join();
    }
}

fn run(shared: &Shared, text: &str) {
    let of_ur_rtde = text.contains("def rtde_control():");
    let parsed = if of_ur_rtde { Ok(syntax::Program::default()) } else { syntax::parse(text) };
    let program = match parsed {
        Ok(program) => program,
        Err(error) => return shared.core().tell(format!("a program was sent that is none: {error}")),
    };
    let begun = shared.core().begin_program();
    let number = match begun {
        Ok(number) => number,
        Err(why) => return shared.core().tell(why),
    };
    let mut host = Host { shared, number, seen: 0, inputs: Inputs::default() };
    let end = host.sync().and_then(|()| {
        if of_ur_rtde { ur_rtde::run(&mut host, text) } else { interpreter::run(&program, &mut host) }
    });
    let mut core = shared.core();
    if let Err(End::Wrong(why)) = end {
        let (line, text) = why
            .strip_prefix("line ")
            .and_then(|rest| rest.split_once(": "))
            .and_then(|(line, text)| Some((line.parse().ok()?, text)))
            .unwrap_or((0, why.as_str()));
        core.say_exception(line, text);
        core.tell(format!("a program has ended by an error: {why}"));
    }
    core.program_over(number);
}

/// What a program has of the controller.
pub(super) struct Host<'a> {
    shared: &'a Shared,
    number: u64,
    seen: u64,
    /// The registers as this cycle began.
    inputs: Inputs,
}

impl Host<'_> {
    /// Waits for the next cycle.
    pub(super) fn sync(&mut self) -> Result<(), End> {
        let mut core = self.shared.core();
        loop {
            if self.shared.ends.load(Ordering::Relaxed)
                || core.program != self.number
                || core.runtime != RuntimeState::Playing
            {
                return Err(End::Stopped);
            }
            if core.cycle > self.seen {
                self.seen = core.cycle;
                self.inputs = core.inputs;
                return Ok(());
            }
            if core.program_waits.replace(true) != Some(true) {
                self.shared.cycle.notify_all();
            }
            // Chosen by hand: the emulator's end is looked for from time to time.
            let waited = self.shared.cycle.wait_timeout(core, Duration::from_millis(50));
            core = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    pub(super) fn input_int(&self, i: usize) -> Option<i32> {
        self.inputs.ints.get(i).copied()
    }

    pub(super) fn input_double(&self, i: usize) -> Option<f64> {
        self.inputs.doubles.get(i).copied()
    }

    pub(super) fn put_int(&self, i: usize, value: i32) {
        if i < REGISTERS {
            self.shared.core().out_ints[i] = value;
        }
    }

    pub(super) fn put_double(&self, i: usize, value: f64) {
        if i < REGISTERS {
            self.shared.core().out_doubles[i] = value;
        }
    }

    /// Takes a payload that a controller of this version can be told, and an arm can have.
    pub(super) fn carry(&self, payload: Payload) -> Result<(), End> {
        let mut core = self.shared.core();
        let with_inertia = payload.inertia_kg_m2.is_some();
        if with_inertia && !core.version.has_payload_inertia() {
            return Err(End::Wrong(format!("software {} does not know `set_target_payload`", core.version)));
        }
        let numbers = payload.com_m.iter().chain(payload.inertia_kg_m2.iter().flatten());
        if !(payload.mass_kg >= 0.0 && payload.mass_kg <= MOST_KG && numbers.copied().all(f64::is_finite)) {
            return Err(End::Wrong(format!("no arm carries {} kg", payload.mass_kg)));
        }
        core.carry(payload);
        Ok(())
    }

    /// How programs of this version command torques.
    pub(super) fn torques(&self) -> Result<TorqueInterface, End> {
        let version = self.shared.core().version;
        let none = || End::Wrong(format!("software {version} does not know `direct_torque`"));
        version.torques().ok_or_else(none)
    }

    pub(super) fn tell(&self, text: String) {
        self.shared.core().tell(text);
    }

    pub(super) fn period_s(&self) -> f64 {
        self.shared.core().period_s()
    }

    /// Where the reference stands, rad.
    pub(super) fn target(&self) -> crate::Joints {
        self.shared.core().reference.q
    }

    /// Begins an instruction, and waits as long as it takes.
    pub(super) fn go(&mut self, motion: Motion, time_s: f64) -> Result<(), End> {
        self.begin(motion)?;
        let cycles = (time_s / self.period_s()).round().max(1.0) as u64;
        (0..cycles).try_for_each(|_| self.sync())
    }

    /// Begins an instruction.
    pub(super) fn begin(&mut self, motion: Motion) -> Result<(), End> {
        let may = self.shared.core().obey(self.number, motion);
        if may { Ok(()) } else { Err(End::Stopped) }
    }

    /// Brakes, and waits until the reference stands.
    pub(super) fn stop(&mut self, deceleration: f64) -> Result<(), End> {
        self.begin(Motion::Stop { deceleration })?;
        while !self.shared.core().reference.stands() {
            self.sync()?;
        }
        Ok(())
    }
}
