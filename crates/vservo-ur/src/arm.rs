//! A robot that is commanded: from the first look at it to its rest.
//!
//! ```text
//! connect ─► make_ready (power, brakes: only where allowed) ─► start ─► next, command, next, ... ─► come_to_rest
//!                   │ refuses in words                            │ a fault, in words: the program brakes by itself
//!                                                                   └─ halt ─► next, recover, next, ... ─► ready: next, command, ...
//! ```

mod readiness;
mod recovery;
mod slider;
mod state;

pub use recovery::Recovered;
pub use state::{ArmSettings, ArmState, Command, CommandKind};

use crate::dashboard::Dashboard;
use crate::primary::{ControllerMessage, ListenerNotice, MessageListener};
use crate::program::{Payload, ProgramSettings, command, state as program_state};
use crate::robot::{RobotMode, RuntimeState, Series, Version};
use crate::rtde::{DataType, Recipe, RtdeClient, RtdeSettings, nanoseconds};
use crate::{Clock, Joints, UrError};
use crate::{ClockEstimate, ClockMap};
use recovery::{Halt, send_program};
use slider::SliderWatch;
use state::{Places, Registers, plausible, read};
use std::time::Duration;

/// States in a row whose time does not go on before that is a fault. Chosen by hand: 20 ms at 500 Hz.
const STANDING: u32 = 10;
/// Longest wait for rest. Chosen by hand: 3 rad/s at the 4 rad/s2 of `stopj` take 0.8 s.
const REST: Duration = Duration::from_secs(3);

/// A robot.
#[derive(Debug)]
pub struct Arm {
    settings: ArmSettings,
    rtde: RtdeClient,
    series: Series,
    /// States in a second.
    rate_hz: f64,
    outputs: Recipe,
    inputs: Recipe,
    places: Places,
    program: ProgramSettings,
    clock_map: ClockMap,
    /// What the controller says by itself.
    messages: Option<MessageListener>,
    count: i32,
    last: Option<ArmState>,
    /// The first one's time, s.
    first_s: Option<f64>,
    standing: u32,
    /// States that were not there when they were due, by the controller's time.
    gaps: u64,
    /// Whether the program runs.
    started: bool,
    slider: SliderWatch,
    /// What stopped it, until it was started again.
    halt: Option<Halt>,
}

impl Arm {
    /// Connects to a robot, and takes its first state. Nothing moves, and nothing is switched.
    ///
    /// # Errors
    /// When there is none, or not one that this driver can talk to.
    pub fn connect(settings: ArmSettings) -> Result<Self, UrError> {
        let mut wire = RtdeSettings::new(settings.host, settings.clock);
        wire.patience = settings.patience;
        let mut rtde = RtdeClient::connect(wire)?;
        let version = rtde.version();
        let series = version.series().ok_or(UrError::TooOld { version })?;
        if settings.registers >= 24 && !version.has_upper_registers() {
            return Err(UrError::TooOld { version });
        }
        let rate_hz = settings.rate_hz.map_or(series.rate_hz(), |rate| rate.min(series.rate_hz()));
        let program = ProgramSettings {
            registers: settings.registers,
            series,
            session: session(settings.clock),
            lookahead_s: settings.lookahead_s,
            gain: settings.gain,
            fastest_rad_s: settings.fastest_rad_s,
            acceleration_rad_s2: settings.acceleration_rad_s2,
            speed_acceleration_rad_s2: settings.speed_acceleration_rad_s2,
            stop_deceleration_rad_s2: settings.stop_deceleration_rad_s2,
            watchdog: settings.watchdog,
            torque_watchdog: settings.torque_watchdog,
            payload: settings.payload,
            takes_inertia: version.has_payload_inertia(),
            torques: version.torques(),
        };
        let (outputs, places) = Self::set_up_outputs(&mut rtde, &program, rate_hz)?;
        let inputs = rtde.set_up_inputs(&program.inputs())?;
        rtde.start()?;
        let mut arm = Self {
            settings,
            rtde,
            series,
            rate_hz,
            outputs,
            inputs,
            places,
            program,
            clock_map: ClockMap::default(),
            messages: MessageListener::start(settings.host).ok(),
            count: 0,
            last: None,
            first_s: None,
            standing: 0,
            gaps: 0,
            started: false,
            slider: SliderWatch::default(),
            halt: None,
        };
        // What the registers hold of another session must not be there when a program of that session should still run.
        arm.command(Command::Hold)?;
        arm.await_state(settings.patience, |_| true)?.ok_or(UrError::NotStarted)?;
        Ok(arm)
    }

    fn set_up_outputs(
        rtde: &mut RtdeClient,
        program: &ProgramSettings,
        rate_hz: f64,
    ) -> Result<(Recipe, Places), UrError> {
        use DataType::{Double, Int32, Uint32, Vector6D};
        let names = [
            ("timestamp".to_owned(), Double),
            ("actual_q".to_owned(), Vector6D),
            ("actual_qd".to_owned(), Vector6D),
            ("robot_mode".to_owned(), Int32),
            ("safety_mode".to_owned(), Int32),
            ("runtime_state".to_owned(), Uint32),
            ("target_speed_fraction".to_owned(), Double),
            (program.output(0), Int32),
            (program.output(1), Int32),
            (program.output(2), Int32),
        ];
        let asked: Vec<String> = names.iter().map(|(name, _)| name.clone()).collect();
        let outputs = rtde.set_up_outputs(&asked, rate_hz)?;
        let mut found = [0; 10];
        let mut missing = Vec::new();
        for ((name, kind), place) in names.iter().zip(&mut found) {
            match outputs.place(name, *kind) {
                Some(at) => *place = at,
                None => missing.push(name.clone()),
            }
        }
        if !missing.is_empty() {
            return Err(UrError::NotFound { names: missing, version: rtde.version() });
        }
        let [time, q, qd, mode, safety, runtime, slider, p0, p1, p2] = found;
        Ok((outputs, Places { time, q, qd, mode, safety, runtime, slider, program: [p0, p1, p2] }))
    }

    /// Version of the controller's software.
    #[must_use]
    pub fn version(&self) -> Version {
        self.rtde.version()
    }

    /// What the robot is told to carry when its program starts the next time; none: as it is set there.
    pub fn set_payload(&mut self, payload: Option<Payload>) {
        self.program.payload = payload;
    }

    /// Largest acceleration with which the program makes up for late commands when it starts the next time, rad/s2.
    pub fn set_acceleration(&mut self, of_joints: Joints) {
        self.program.acceleration_rad_s2 = of_joints;
    }

    /// That the controller takes torques.
    ///
    /// # Errors
    /// When its software does not.
    pub fn takes_torques(&self) -> Result<(), UrError> {
        let version = self.version();
        version.torques().map(drop).ok_or(UrError::NoTorques { version })
    }

    /// How it is moved.
    #[must_use]
    pub fn settings(&self) -> &ArmSettings {
        &self.settings
    }

    /// Its series.
    #[must_use]
    pub fn series(&self) -> Series {
        self.series
    }

    /// States in a second.
    #[must_use]
    pub fn rate_hz(&self) -> f64 {
        self.rate_hz
    }

    /// By how much the arm is behind what it is commanded, s: `servoj`'s lag, the cycle of the robot in which a command is obeyed, and half of the time for which one stands.
    #[must_use]
    pub fn lag_s(&self, kind: CommandKind) -> f64 {
        let servoj = if kind == CommandKind::Position { self.program.servoj_lag_s() } else { 0.0 };
        servoj + 1.0 / self.series.rate_hz() + 1.0 / self.rate_hz
    }

    /// The newest state.
    #[must_use]
    pub fn last(&self) -> Option<&ArmState> {
        self.last.as_ref()
    }

    /// States that were missing between others, and the longest delay of one beyond the least, ns.
    #[must_use]
    pub fn missed(&self) -> (u64, i64) {
        (self.gaps, self.clock_map.longest_delay_ns())
    }

    /// The next message of the controller about a stop that has come.
    pub fn heard(&mut self) -> Option<ControllerMessage> {
        self.messages.as_ref().and_then(MessageListener::next)
    }

    /// What is newly to be told about the way to its messages: that there is none, or that there is one again.
    pub fn notice(&mut self) -> Option<ListenerNotice> {
        self.messages.as_ref().and_then(MessageListener::notice)
    }

    /// What is newly to be told of the speed slider while the program runs: the arm lags behind what it is commanded where that is below 100 %.
    pub fn slider_notice(&mut self) -> Option<String> {
        let state = self.last.filter(|_| self.started)?;
        self.slider.note(state.slider, state.robot_s)
    }

    /// What is known of the controller's clock.
    #[must_use]
    pub fn clock(&self) -> Option<ClockEstimate> {
        self.clock_map.estimate()
    }

    /// Sends the program, and waits until it runs.
    ///
    /// # Errors
    /// When the controller does not run it.
    pub fn start(&mut self) -> Result<(), UrError> {
        // Registers keep what the program before wrote until this one writes: by its session it is known to run.
        let session = session(self.settings.clock);
        self.program.session = session;
        self.command(Command::Hold)?;
        let _stream = send_program(&self.settings, &self.program.text())?;
        let runs =
            self.await_state(self.settings.patience, |s| s.holds_for(session) || !s.safety.lets_move())?;
        match runs {
            Some(s) if !s.safety.lets_move() => Err(UrError::Stopped { safety: s.safety }),
            Some(_) => {
                self.started = true;
                Ok(())
            }
            None => Err(UrError::ProgramNotStarted { seconds: self.settings.patience.as_secs_f64() }),
        }
    }

    /// The next state, what waits already, or what comes within `wait`; none when nothing came. While the program runs, whatever ends it is told as the error.
    ///
    /// # Errors
    /// When the robot is stopped, lost, or not what it should be.
    pub fn next(&mut self, wait: Duration) -> Result<Option<ArmState>, UrError> {
        let (places, map) = (self.places, &mut self.clock_map);
        let Some(state) =
            self.rtde.data(&self.outputs, wait, |payload, arrival| read(payload, &places, map, arrival))?
        else {
            let last = self.last.map_or(0, |s| s.stamp);
            let quiet = (self.settings.clock)() - last;
            // Chosen by the caller: `silence`. Before the first state nothing is missed.
            if self.last.is_some() && quiet > nanoseconds(self.settings.silence) {
                return Err(UrError::StatesStopped { milliseconds: quiet / 1_000_000 });
            }
            return Ok(None);
        };
        if !state.q.iter().chain(&state.qd).chain([&state.robot_s]).all(|v| v.is_finite()) {
            return Err(UrError::Nonsense { what: "a value is not finite".into() });
        }
        if let Some(last) = self.last {
            if state.robot_s <= last.robot_s {
                self.standing += 1;
                return if self.standing < STANDING { Ok(None) } else { Err(UrError::TimeStands) };
            }
            let passed = state.robot_s - last.robot_s;
            self.gaps += ((passed * self.rate_hz).round() as u64).saturating_sub(1);
            plausible(&last, &state, passed)?;
        }
        self.standing = 0;
        self.last = Some(state);
        self.first_s = self.first_s.or(Some(state.robot_s));
        if let Some(halt) = &mut self.halt {
            halt.note(&state);
        }
        if self.started {
            self.running(&state)?;
        }
        Ok(Some(state))
    }

    /// Whether the program still moves the arm; why not.
    fn running(&self, s: &ArmState) -> Result<(), UrError> {
        if !s.safety.lets_move() {
            return Err(UrError::StoppedInMotion { safety: s.safety });
        }
        if s.mode != RobotMode::Running {
            return Err(UrError::PoweredDown { mode: s.mode });
        }
        let ended = |why| Err(UrError::ProgramEnded { why });
        match (s.runtime, s.program) {
            (RuntimeState::Playing, [program_state::HOLDS | program_state::MOVES, _, session])
                if session == self.program.session =>
            {
                Ok(())
            }
            (_, [_, _, session]) if session != self.program.session => {
                ended("another program has taken its place")
            }
            (_, [program_state::MISSED, ..]) => {
                ended("it missed commands (`watchdog`), and has braked the arm")
            }
            (_, [program_state::ENDED, ..]) => ended("it was asked to"),
            (RuntimeState::Paused | RuntimeState::Pausing, _) => {
                ended("somebody has paused it on the pendant")
            }
            _ => ended("somebody has stopped it, or the controller has, whose log tells why"),
        }
    }

    /// Sends a command, which holds until the next, and at most for the watchdog's time.
    ///
    /// # Errors
    /// When the connection is lost.
    pub fn command(&mut self, what: Command) -> Result<(), UrError> {
        self.count = self.count.wrapping_add(1).max(1);
        let now = self.last.map_or(0, |state| state.stamp);
        let Registers { code, older, values } = what.registers(now, 1.0 / self.series.rate_hz());
        // A number that is none moves no arm.
        let code = if values.as_flattened().iter().all(|v| v.is_finite()) { code } else { command::HOLD };
        let (count, session) = (self.count, self.program.session);
        let cycle = self.cycle().wrapping_sub(older);
        self.rtde.send(&self.inputs, |writer| {
            for int in [code, count, session, cycle] {
                writer.put(&int.to_be_bytes());
            }
            values.iter().fold(writer, |writer, joints| writer.joints(joints));
        })
    }

    /// The robot's cycle of the newest state, since the first one.
    fn cycle(&self) -> i32 {
        let since_s = self.last.map_or(0.0, |state| state.robot_s) - self.first_s.unwrap_or_default();
        (since_s * self.series.rate_hz()).round() as i32
    }

    /// Brakes the arm, waits for its rest, and ends the program.
    ///
    /// # Errors
    /// When it does not come to rest, or whatever stops it before.
    pub fn come_to_rest(&mut self) -> Result<(), UrError> {
        if !self.started {
            return Ok(());
        }
        let clock = self.settings.clock;
        let deadline = clock() + nanoseconds(REST);
        let mut rested = 0;
        while rested < STANDING {
            if clock() > deadline {
                return Err(UrError::NotAtRest { seconds: REST.as_secs_f64() });
            }
            self.command(Command::Hold)?;
            if let Some(s) = self.next(self.settings.silence)? {
                let holds = s.rests() && s.program[0] == program_state::HOLDS;
                rested = if holds { rested + 1 } else { 0 };
            }
        }
        self.started = false;
        self.command(Command::End)?;
        self.await_state(self.settings.patience, |s| s.runtime != RuntimeState::Playing)?;
        Ok(())
    }

    /// After a fault: whatever can still be done so that the arm stands and no program waits to go on. What fails here, the program's watchdog does.
    pub fn abandon(&mut self) {
        if !std::mem::take(&mut self.started) && self.halt.take().is_none() {
            return;
        }
        let _ = self.command(Command::End);
        // Chosen by hand: the arm brakes by itself meanwhile, and whoever waits for the end of this process does not wait long.
        let patience = self.settings.patience.min(Duration::from_secs(1));
        if let Ok(mut dashboard) = Dashboard::connect(self.settings.host, patience, self.settings.clock) {
            let _ = dashboard.stop_program();
        }
    }

    /// The newest of what has come, or the next.
    fn newest(&mut self) -> Result<ArmState, UrError> {
        while self.next(Duration::ZERO)?.is_some() {}
        self.await_state(self.settings.patience, |_| true)?.or(self.last).ok_or(UrError::NotStarted)
    }

    /// Waits for a state that is so; none when there is none in time. Holds the arm meanwhile.
    fn await_state(
        &mut self,
        patience: Duration,
        is: impl Fn(&ArmState) -> bool,
    ) -> Result<Option<ArmState>, UrError> {
        let clock = self.settings.clock;
        let deadline = clock() + nanoseconds(patience);
        while clock() < deadline {
            // Chosen by hand: some cycles of either series.
            if let Some(state) = self.next(Duration::from_millis(20))? {
                if is(&state) {
                    return Ok(Some(state));
                }
                if !self.started {
                    self.command(Command::Hold)?;
                }
            }
        }
        Ok(None)
    }
}

/// A number that the last sessions did not have: microseconds of the clock, as far as they fit.
fn session(clock: Clock) -> i32 {
    ((clock() / 1000) % i64::from(i32::MAX)).max(1) as i32
}
