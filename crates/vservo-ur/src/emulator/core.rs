//! The emulated controller itself: modes, stops, registers and joints. It knows neither sockets nor threads.

use super::faults::Faults;
use super::motion::{Motion, Reference};
use crate::primary;
use crate::program::Payload;
use crate::{JOINTS, Joints, RobotMode, RuntimeState, SafetyMode, Series, Version};

/// Registers of each kind, by the maker's documentation.
pub(super) const REGISTERS: usize = 48;
/// Time that the motors take to get power, the brakes to open, and the controller to boot, s. Chosen by hand: shorter than a robot's, so that nobody waits.
const POWER_S: f64 = 0.5;
const BRAKES_S: f64 = 0.3;
const BOOT_S: f64 = 1.0;
/// Time after which a protective stop may be unlocked, s, by the maker's documentation.
const UNLOCK_S: f64 = 5.0;

/// The shares of its friction that a controller compensates where nobody tells others, by the maker's own client.
pub(super) const VISCOUS_SHARE: Joints = [0.9, 0.9, 0.8, 0.9, 0.9, 0.9];
pub(super) const COULOMB_SHARE: Joints = [0.8, 0.8, 0.7, 0.8, 0.8, 0.8];

/// The payload of a robot that was told none.
const NO_PAYLOAD: Payload = Payload { mass_kg: 0.0, com_m: [0.0; 3], inertia_kg_m2: None };

/// What stands behind the emulated controller: motors and links.
pub trait JointModel: Send {
    /// Measured positions and velocities after `dt_s` under a reference, rad and rad/s.
    fn step(&mut self, q: &Joints, qd: &Joints, dt_s: f64) -> (Joints, Joints);
    /// Measured positions and velocities after `dt_s` under torques, rad and rad/s.
    fn push(&mut self, torque: &Torque, dt_s: f64) -> (Joints, Joints);
    /// What the controller is told to carry, whose weight it adds to torques.
    fn carry(&mut self, _: &Payload) {}
}

/// What `direct_torque` commands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Torque {
    /// Torques of the joints beside the weight of arm and payload, N m.
    pub tau: Joints,
    /// The share of the viscous friction that the controller adds, 0 to 1.
    pub viscous_share: Joints,
    /// The share of the Coulomb friction.
    pub coulomb_share: Joints,
}

/// Joints that follow their reference at once. Under torques each is a rotor of 1 kg m2 without friction or weight.
#[derive(Debug, Clone, Copy, Default)]
pub struct StiffJoints {
    q: Joints,
    qd: Joints,
}

impl JointModel for StiffJoints {
    fn step(&mut self, q: &Joints, qd: &Joints, _: f64) -> (Joints, Joints) {
        (self.q, self.qd) = (*q, *qd);
        (*q, *qd)
    }

    fn push(&mut self, torque: &Torque, dt_s: f64) -> (Joints, Joints) {
        for ((q, qd), tau) in self.q.iter_mut().zip(&mut self.qd).zip(&torque.tau) {
            *qd += tau * dt_s;
            *q += *qd * dt_s;
        }
        (self.q, self.qd)
    }
}

/// The input registers.
#[derive(Debug, Clone, Copy)]
pub(super) struct Inputs {
    pub(super) ints: [i32; REGISTERS],
    pub(super) doubles: [f64; REGISTERS],
}

impl Default for Inputs {
    fn default() -> Self {
        Self { ints: [0; REGISTERS], doubles: [0.0; REGISTERS] }
    }
}

/// The controller.
pub(super) struct Core {
    pub(super) series: Series,
    pub(super) version: Version,
    pub(super) mode: RobotMode,
    pub(super) safety: SafetyMode,
    pub(super) runtime: RuntimeState,
    pub(super) remote_control: bool,
    pub(super) slider: f64,
    pub(super) reference: Reference,
    pub(super) q: Joints,
    pub(super) qd: Joints,
    /// Since it was switched on, s.
    pub(super) time_s: f64,
    /// Cycles since the emulator began.
    pub(super) cycle: u64,
    /// Which program may run: whoever has another number ends.
    pub(super) program: u64,
    /// Where a program runs: whether it has done its part of this cycle.
    pub(super) program_waits: Option<bool>,
    pub(super) inputs: Inputs,
    /// What has come since the last cycle.
    pub(super) coming: Inputs,
    pub(super) out_ints: [i32; REGISTERS],
    pub(super) out_doubles: [f64; REGISTERS],
    /// What it was told to carry: of the installation, nothing.
    pub(super) payload: Payload,
    pub(super) faults: Faults,
    /// Packages for whoever listens to the primary interface, newest last, and how many there were before them.
    pub(super) messages: Vec<Vec<u8>>,
    pub(super) messages_gone: usize,
    /// What was told, newest last.
    pub(super) log: Vec<String>,
    joints: Box<dyn JointModel>,
    /// When what is under way is done, s, and the mode that follows.
    under_way: Option<(f64, RobotMode)>,
    stopped_at_s: f64,
}

impl Core {
    pub(super) fn new(series: Series, q: Joints, joints: Box<dyn JointModel>) -> Self {
        let (major, minor) = match series {
            Series::Cb3 => (3, 15),
            Series::ESeries => (5, 26),
        };
        Self {
            series,
            version: Version { major, minor, bugfix: 6, build: 101 },
            mode: RobotMode::PowerOff,
            safety: SafetyMode::Normal,
            runtime: RuntimeState::Stopped,
            remote_control: true,
            slider: 1.0,
            reference: Reference::at(q),
            q,
            qd: [0.0; JOINTS],
            time_s: 0.0,
            cycle: 0,
            program: 0,
            program_waits: None,
            inputs: Inputs::default(),
            coming: Inputs::default(),
            out_ints: [0; REGISTERS],
            out_doubles: [0.0; REGISTERS],
            payload: NO_PAYLOAD,
            faults: Faults::default(),
            messages: Vec::new(),
            messages_gone: 0,
            log: Vec::new(),
            joints,
            under_way: None,
            stopped_at_s: f64::NEG_INFINITY,
        }
    }

    pub(super) fn period_s(&self) -> f64 {
        1.0 / self.series.rate_hz()
    }

    pub(super) fn tell(&mut self, text: impl Into<String>) {
        // Chosen by hand: whoever does not read them misses the oldest, and memory stays flat.
        if self.log.len() >= 1000 {
            self.log.remove(0);
        }
        self.log.push(text.into());
    }

    /// Says an error over the primary interface, as a violation.
    pub(super) fn say_error(&mut self, code: i32, argument: i32, text: &str) {
        let numbers = [code, argument, 3, 0, 0].map(i32::to_be_bytes).concat();
        self.say(6, &[&numbers, text.as_bytes()].concat());
    }

    /// Says that a program cannot go on.
    pub(super) fn say_exception(&mut self, line: i32, text: &str) {
        self.say(10, &[&[line, 0].map(i32::to_be_bytes).concat(), text.as_bytes()].concat());
    }

    fn say(&mut self, kind: u8, body: &[u8]) {
        // Source 254 is the controller itself by the maker's protocol; the time is in microseconds.
        let time = ((self.time_s * 1e6) as u64).to_be_bytes();
        let payload = [&[primary::MESSAGE][..], &time, &[254, kind], body].concat();
        let length = (payload.len() as u32 + 4).to_be_bytes();
        // Chosen by hand, as for the log.
        if self.messages.len() >= 100 {
            self.messages.remove(0);
            self.messages_gone += 1;
        }
        self.messages.push([&length[..], &payload].concat());
    }

    /// Whether the primary interface is not served now.
    pub(super) fn is_primary_silent(&self) -> bool {
        self.faults.silent_primary_until_s.is_some_and(|until| self.time_s < until)
    }

    /// One cycle.
    pub(super) fn step(&mut self) {
        let dt_s = self.period_s();
        self.cycle += 1;
        self.program_waits = self.program_waits.map(|_| false);
        self.time_s += dt_s;
        if self.faults.deaf_until_s.is_none_or(|until| self.time_s > until) {
            self.inputs = self.coming;
        }
        if let Some((_, next)) = self.under_way.filter(|(at, _)| self.time_s >= *at) {
            self.under_way = None;
            self.mode = next;
        }
        if self.mode == RobotMode::Running {
            let torque = self.reference.torque();
            let passes = match torque {
                Some(torque) => {
                    (self.q, self.qd) = self.joints.push(&torque, dt_s);
                    self.reference.follow(&self.q, &self.qd)
                }
                None => self.reference.step(dt_s),
            };
            if let Err(violation) = passes {
                self.tell(violation.to_string());
                self.say_error(violation.code, violation.argument, violation.text);
                self.stop_by_safety(SafetyMode::ProtectiveStop);
            }
            if torque.is_none() {
                (self.q, self.qd) = self.joints.step(&self.reference.q, &self.reference.qd, dt_s);
            }
            if matches!(self.safety, SafetyMode::RobotEmergencyStop | SafetyMode::SystemEmergencyStop)
                && self.reference.stands()
            {
                self.power_off();
            }
        } else {
            self.reference = Reference::at(self.q);
            self.qd = [0.0; JOINTS];
        }
    }

    /// Begins an instruction of the program `number`; false when that shall end.
    pub(super) fn obey(&mut self, number: u64, motion: Motion) -> bool {
        let may = self.program == number && self.runtime == RuntimeState::Playing;
        if may {
            self.reference.obey(motion);
        }
        may
    }

    /// A program begins, the one before ends; its number, or why it does not.
    pub(super) fn begin_program(&mut self) -> Result<u64, &'static str> {
        self.end_program();
        if self.mode != RobotMode::Running || !self.safety.lets_move() {
            return Err("a program was sent, but the robot is not running");
        }
        if !self.remote_control {
            return Err("a program was sent, but the robot is not under remote control");
        }
        if self.faults.refuse_programs {
            return Err("a program was sent, and is refused");
        }
        self.runtime = RuntimeState::Playing;
        Ok(self.program)
    }

    /// Takes what it is told to carry.
    pub(super) fn carry(&mut self, payload: Payload) {
        self.payload = payload;
        self.joints.carry(&payload);
    }

    /// Ends whatever program runs, and brakes.
    pub(super) fn end_program(&mut self) {
        self.program += 1;
        self.program_waits = None;
        self.runtime = RuntimeState::Stopped;
        self.reference.safety_stop();
    }

    /// A program has come to its end.
    pub(super) fn program_over(&mut self, number: u64) {
        if self.program == number {
            self.end_program();
        }
    }

    pub(super) fn stop_by_safety(&mut self, mode: SafetyMode) {
        self.safety = mode;
        self.stopped_at_s = self.time_s;
        self.end_program();
    }

    pub(super) fn power_on(&mut self) -> &'static str {
        if self.mode == RobotMode::PowerOff {
            self.mode = RobotMode::PowerOn;
            self.under_way = Some((self.time_s + POWER_S, RobotMode::Idle));
        }
        "Powering on"
    }

    pub(super) fn release_brakes(&mut self) -> &'static str {
        if self.mode == RobotMode::Idle && self.safety.lets_move() {
            self.under_way = Some((self.time_s + BRAKES_S, RobotMode::Running));
        }
        "Brake releasing"
    }

    pub(super) fn power_off(&mut self) -> &'static str {
        self.end_program();
        self.mode = RobotMode::PowerOff;
        self.under_way = None;
        "Powering off"
    }

    /// Powered, with open brakes, at once: as somebody has left it.
    pub(super) fn run_at_once(&mut self) {
        self.mode = RobotMode::Running;
        self.under_way = None;
    }

    pub(super) fn unlock(&mut self) -> &'static str {
        if self.time_s - self.stopped_at_s < UNLOCK_S {
            return "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective stop before unlocking";
        }
        if self.safety == SafetyMode::ProtectiveStop {
            self.safety = SafetyMode::Normal;
        }
        "Protective stop releasing"
    }

    /// Switched off and on.
    pub(super) fn reboot(&mut self) {
        self.end_program();
        self.mode = RobotMode::Booting;
        self.safety = SafetyMode::Normal;
        self.time_s = 0.0;
        self.under_way = Some((BOOT_S, RobotMode::PowerOff));
        (self.inputs, self.coming) = (Inputs::default(), Inputs::default());
        (self.out_ints, self.out_doubles) = ([0; REGISTERS], [0.0; REGISTERS]);
        self.carry(NO_PAYLOAD);
    }
}
