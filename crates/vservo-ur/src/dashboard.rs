//! The dashboard server: a line asks, a line answers. It powers the robot, releases brakes and unlocks stops; nothing here does so by itself.

use crate::robot::Series;
use crate::rtde::nanoseconds;
use crate::socket::receive;
use crate::{Clock, UrError};
use std::io::Write;
use std::net::{IpAddr, SocketAddr, TcpStream};
use std::time::Duration;

/// The port, by the maker's documentation.
pub const PORT: u16 = 29_999;
const WHAT: &str = "the robot's dashboard server";
/// Longest answer that is taken: chosen by hand, as the maker's have less than a hundred characters; one that goes on is cut there.
const LONGEST: usize = 4096;

/// A connection to the dashboard.
#[derive(Debug)]
pub struct Dashboard {
    stream: TcpStream,
    address: SocketAddr,
    patience: Duration,
    clock: Clock,
    waiting: Vec<u8>,
}

impl Dashboard {
    /// Connects, and takes the greeting.
    ///
    /// # Errors
    /// When nobody answers.
    pub fn connect(host: IpAddr, patience: Duration, clock: Clock) -> Result<Self, UrError> {
        let address = SocketAddr::new(host, PORT);
        let failed = |cause| UrError::Connect { what: WHAT, address: address.to_string(), cause };
        let stream = TcpStream::connect_timeout(&address, patience).map_err(failed)?;
        stream.set_read_timeout(Some(patience)).map_err(failed)?;
        stream.set_write_timeout(Some(patience)).map_err(failed)?;
        let mut dashboard = Self { stream, address, patience, clock, waiting: Vec::new() };
        dashboard.line("its greeting")?;
        Ok(dashboard)
    }

    /// One question and its answer.
    ///
    /// # Errors
    /// When no answer comes.
    pub fn ask(&mut self, command: &'static str) -> Result<String, UrError> {
        let sent = self.stream.write_all(format!("{command}\n").as_bytes());
        sent.map_err(|cause| self.lost(&cause.to_string()))?;
        self.line(command)
    }

    /// A command whose answer must begin so.
    fn command(&mut self, command: &'static str, answer: &str) -> Result<(), UrError> {
        let got = self.ask(command)?;
        if got.starts_with(answer) { Ok(()) } else { Err(UrError::Dashboard { command, answer: got }) }
    }

    /// Powers the arm; it then stands in its brakes.
    ///
    /// # Errors
    /// When the dashboard does not answer, or refuses.
    pub fn power_on(&mut self) -> Result<(), UrError> {
        self.command("power on", "Powering on")
    }

    /// Opens the brakes: the arm is held by its motors.
    ///
    /// # Errors
    /// When the dashboard does not answer, or refuses.
    pub fn release_brakes(&mut self) -> Result<(), UrError> {
        self.command("brake release", "Brake releasing")
    }

    /// Takes power from the arm.
    ///
    /// # Errors
    /// When the dashboard does not answer, or refuses.
    pub fn power_off(&mut self) -> Result<(), UrError> {
        self.command("power off", "Powering off")
    }

    /// Ends a protective stop, which the controller allows 5 s after it began.
    ///
    /// # Errors
    /// When the dashboard does not answer, or refuses.
    pub fn unlock_protective_stop(&mut self) -> Result<(), UrError> {
        self.command("close safety popup", "closing safety popup")?;
        self.command("unlock protective stop", "Protective stop releasing")
    }

    /// Ends the running program.
    ///
    /// # Errors
    /// When the dashboard does not answer, or refuses.
    pub fn stop_program(&mut self) -> Result<(), UrError> {
        self.command("stop", "Stopped")
    }

    /// Whether programs are taken over the network. CB3 has no such switch.
    ///
    /// # Errors
    /// When the dashboard does not answer.
    pub fn is_under_remote_control(&mut self, series: Series) -> Result<bool, UrError> {
        // Software before 5.6 does not know the question, and has no such switch either.
        Ok(series == Series::Cb3 || self.ask("is in remote control")? != "false")
    }

    /// The robot's mode, by the maker's word.
    ///
    /// # Errors
    /// When the dashboard does not answer.
    pub fn robot_mode(&mut self) -> Result<String, UrError> {
        self.told("robotmode", "Robotmode: ")
    }

    /// The safety system's status, by the maker's word.
    ///
    /// # Errors
    /// When the dashboard does not answer.
    pub fn safety_status(&mut self) -> Result<String, UrError> {
        self.told("safetystatus", "Safetystatus: ")
    }

    /// The state of the program, by the maker's word, and its name.
    ///
    /// # Errors
    /// When the dashboard does not answer.
    pub fn program_state(&mut self) -> Result<String, UrError> {
        self.ask("programState")
    }

    /// The version of the software, as the maker writes it.
    ///
    /// # Errors
    /// When the dashboard does not answer.
    pub fn version(&mut self) -> Result<String, UrError> {
        self.told("PolyscopeVersion", "URSoftware ")
    }

    fn told(&mut self, command: &'static str, prefix: &str) -> Result<String, UrError> {
        let answer = self.ask(command)?;
        match answer.strip_prefix(prefix) {
            Some(told) => Ok(told.to_owned()),
            None => Err(UrError::Dashboard { command, answer }),
        }
    }

    fn line(&mut self, awaited: &'static str) -> Result<String, UrError> {
        let deadline = (self.clock)() + nanoseconds(self.patience);
        loop {
            if let Some(end) = self.waiting.iter().position(|byte| *byte == b'\n') {
                let line: Vec<u8> = self.waiting.drain(..=end).collect();
                return Ok(String::from_utf8_lossy(&line).trim().to_owned());
            }
            if (self.clock)() > deadline || self.waiting.len() > LONGEST {
                return Err(UrError::Silent {
                    what: WHAT,
                    address: self.address.to_string(),
                    awaited,
                    seconds: self.patience.as_secs_f64(),
                });
            }
            let mut piece = [0; 512];
            let count = receive(&mut self.stream, &mut piece);
            let count = count.map_err(|cause| self.lost(&cause.to_string()))?.unwrap_or(0);
            self.waiting.extend_from_slice(piece.get(..count).unwrap_or_default());
        }
    }

    fn lost(&self, cause: &str) -> UrError {
        UrError::Lost { what: WHAT, address: self.address.to_string(), cause: cause.to_owned() }
    }
}
