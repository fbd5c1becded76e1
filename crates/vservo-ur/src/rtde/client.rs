//! The client's end of RTDE. Every wait has an end, and nothing is allocated once data flows.

use super::frame::Framer;
use super::recipe::{Recipe, SetupReply};
use super::wire::{PackageType, Reader, WireError, Writer};
use super::{PORT, PROTOCOL_VERSION};
use crate::robot::Version;
use crate::socket::receive;
use crate::{Clock, UrError};
use std::io::Write;
use std::net::{IpAddr, SocketAddr, TcpStream};
use std::time::Duration;

/// What this end is called in messages.
const WHAT: &str = "the robot's RTDE server";

/// Where a controller is, and how long it may take to answer.
#[derive(Debug, Clone, Copy)]
pub struct RtdeSettings {
    /// The controller's address and port.
    pub address: SocketAddr,
    /// Longest wait for a connection, and for an answer.
    pub patience: Duration,
    /// Reads the caller's clock.
    pub clock: Clock,
}

impl RtdeSettings {
    /// A controller at its usual port. Five seconds are chosen by hand: a controller that boots takes longer, one that is there a tenth.
    #[must_use]
    pub fn new(host: IpAddr, clock: Clock) -> Self {
        Self { address: SocketAddr::new(host, PORT), patience: Duration::from_secs(5), clock }
    }
}

/// A connection to a controller.
#[derive(Debug)]
pub struct RtdeClient {
    stream: TcpStream,
    settings: RtdeSettings,
    framer: Framer,
    writer: Writer,
    /// Read time-out that the socket has now; zero: it does not wait.
    wait: Duration,
    /// The controller's last message in words.
    text: Option<String>,
    version: Version,
}

impl RtdeClient {
    /// Connects, agrees on the protocol, and asks for the controller's version.
    ///
    /// # Errors
    /// When nobody answers, or not in this protocol.
    pub fn connect(settings: RtdeSettings) -> Result<Self, UrError> {
        let failed = |cause| UrError::Connect { what: WHAT, address: settings.address.to_string(), cause };
        let stream = TcpStream::connect_timeout(&settings.address, settings.patience).map_err(failed)?;
        stream.set_nodelay(true).map_err(failed)?;
        stream.set_read_timeout(Some(settings.patience)).map_err(failed)?;
        stream.set_write_timeout(Some(settings.patience)).map_err(failed)?;
        let version = Version { major: 0, minor: 0, bugfix: 0, build: 0 };
        let mut client = Self {
            stream,
            settings,
            framer: Framer::default(),
            // As large as any package that is sent here; a larger one would only allocate.
            writer: Writer::with_capacity(4096),
            wait: settings.patience,
            text: None,
            version,
        };
        let accepted =
            client.ask(PackageType::ProtocolVersion, &PROTOCOL_VERSION.to_be_bytes(), |reader| {
                reader.u8("accepted").map(|byte| byte != 0)
            })?;
        if !accepted {
            return Err(UrError::Protocol { address: settings.address.to_string() });
        }
        client.version = client.ask(PackageType::ControlVersion, &[], |reader| {
            Ok(Version {
                major: reader.u32("major")?,
                minor: reader.u32("minor")?,
                bugfix: reader.u32("bugfix")?,
                build: reader.u32("build")?,
            })
        })?;
        Ok(client)
    }

    /// Version of the controller's software.
    #[must_use]
    pub fn version(&self) -> Version {
        self.version
    }

    /// The controller's last message in words.
    #[must_use]
    pub fn text(&self) -> Option<&str> {
        self.text.as_deref()
    }

    /// Asks for these variables at this rate.
    ///
    /// # Errors
    /// When the controller does not know one, or does not answer.
    pub fn set_up_outputs(&mut self, names: &[String], rate_hz: f64) -> Result<Recipe, UrError> {
        let payload = [&rate_hz.to_be_bytes()[..], names.join(",").as_bytes()].concat();
        let reply =
            self.ask(PackageType::SetupOutputs, &payload, |reader| SetupReply::read(reader.rest()))?;
        self.recipe(names, &reply)
    }

    /// Claims these registers.
    ///
    /// # Errors
    /// When the controller does not know one, another program has it, or the controller does not answer.
    pub fn set_up_inputs(&mut self, names: &[String]) -> Result<Recipe, UrError> {
        let payload = names.join(",");
        let reply =
            self.ask(PackageType::SetupInputs, payload.as_bytes(), |reader| SetupReply::read(reader.rest()))?;
        let in_use = reply.named("IN_USE", names);
        if !in_use.is_empty() {
            return Err(UrError::InUse { names: in_use });
        }
        self.recipe(names, &reply)
    }

    fn recipe(&self, names: &[String], reply: &SetupReply) -> Result<Recipe, UrError> {
        let unknown = reply.named("NOT_FOUND", names);
        if !unknown.is_empty() {
            return Err(UrError::NotFound { names: unknown, version: self.version });
        }
        Recipe::new(names, reply).map_err(|error| self.wire(error))
    }

    /// Lets data flow.
    ///
    /// # Errors
    /// When the controller does not.
    pub fn start(&mut self) -> Result<(), UrError> {
        let started =
            self.ask(PackageType::Start, &[], |reader| reader.u8("accepted").map(|byte| byte != 0))?;
        if started { Ok(()) } else { Err(UrError::NotStarted) }
    }

    /// Stops the data.
    ///
    /// # Errors
    /// When the controller does not answer.
    pub fn pause(&mut self) -> Result<(), UrError> {
        self.ask(PackageType::Pause, &[], |reader| reader.u8("accepted")).map(drop)
    }

    /// The next data of `recipe`, handed to `use_` with the time at which it came: what waits already, or what comes within `wait`.
    /// None when nothing came. Messages in words are kept, data of other recipes is passed over.
    ///
    /// # Errors
    /// When the connection is lost, or what comes is no package.
    pub fn data<T>(
        &mut self,
        recipe: &Recipe,
        wait: Duration,
        use_: impl FnOnce(&[u8], i64) -> T,
    ) -> Result<Option<T>, UrError> {
        let clock = self.settings.clock;
        let deadline = clock() + nanoseconds(wait);
        let mut tried = false;
        loop {
            match self.framer.next() {
                Ok(Some(package)) => match package.kind {
                    PackageType::Data if recipe.fits(package.payload) => {
                        return Ok(Some(use_(package.payload, clock())));
                    }
                    PackageType::Text => self.text = words(package.payload).or(self.text.take()),
                    _ => {}
                },
                Ok(None) => {
                    let left = deadline - clock();
                    if tried && left <= 0 {
                        return Ok(None);
                    }
                    tried = true;
                    self.fill(left)?;
                }
                Err(error) => return Err(self.wire(error)),
            }
        }
    }

    /// Sends the values of an input recipe; `fill` writes them.
    ///
    /// # Errors
    /// When the connection is lost.
    pub fn send(&mut self, recipe: &Recipe, fill: impl FnOnce(&mut Writer)) -> Result<(), UrError> {
        fill(self.writer.begin(PackageType::Data).put(&[recipe.id()]));
        // A robot that takes nothing for so long that the socket is full is lost.
        let sent = self.stream.write_all(self.writer.package());
        sent.map_err(|cause| self.lost(&cause.to_string()))
    }

    /// One question and its answer.
    fn ask<T>(
        &mut self,
        kind: PackageType,
        payload: &[u8],
        read: impl FnOnce(&mut Reader<'_>) -> Result<T, WireError>,
    ) -> Result<T, UrError> {
        let sent = self.stream.write_all(self.writer.begin(kind).put(payload).package());
        sent.map_err(|cause| self.lost(&cause.to_string()))?;
        let clock = self.settings.clock;
        let deadline = clock() + nanoseconds(self.settings.patience);
        loop {
            match self.framer.next() {
                Ok(Some(package)) if package.kind == kind => {
                    let answer = read(&mut Reader::new(package.payload));
                    return answer.map_err(|error| self.wire(error));
                }
                Ok(Some(package)) => {
                    if package.kind == PackageType::Text {
                        self.text = words(package.payload).or(self.text.take());
                    }
                }
                Ok(None) => {
                    let left = deadline - clock();
                    if left <= 0 {
                        return Err(UrError::Silent {
                            what: WHAT,
                            address: self.settings.address.to_string(),
                            awaited: awaited(kind),
                            seconds: self.settings.patience.as_secs_f64(),
                        });
                    }
                    self.fill(left)?;
                }
                Err(error) => return Err(self.wire(error)),
            }
        }
    }

    /// Reads what comes within so many nanoseconds, or what is there.
    fn fill(&mut self, left_ns: i64) -> Result<(), UrError> {
        // In whole milliseconds, as a kernel waits no more finely, so that the socket is told anew only when it matters; zero is no wait.
        let wait = Duration::from_millis(left_ns.max(0).unsigned_abs().div_ceil(1_000_000));
        if wait != self.wait {
            let told = match (self.wait.is_zero(), wait.is_zero()) {
                (_, true) => self.stream.set_nonblocking(true),
                (true, false) => {
                    self.stream.set_nonblocking(false).and_then(|()| self.stream.set_read_timeout(Some(wait)))
                }
                (false, false) => self.stream.set_read_timeout(Some(wait)),
            };
            told.map_err(|cause| self.lost(&cause.to_string()))?;
            self.wait = wait;
        }
        let count = receive(&mut self.stream, self.framer.room());
        let count = count.map_err(|cause| self.lost(&cause.to_string()))?;
        self.framer.filled(count.unwrap_or(0));
        Ok(())
    }

    fn lost(&self, cause: &str) -> UrError {
        UrError::Lost { what: WHAT, address: self.settings.address.to_string(), cause: cause.to_owned() }
    }

    fn wire(&self, error: WireError) -> UrError {
        UrError::Wire { address: self.settings.address.to_string(), error }
    }
}

pub(crate) fn nanoseconds(span: Duration) -> i64 {
    i64::try_from(span.as_nanos()).unwrap_or(i64::MAX / 2).min(i64::MAX / 2)
}

/// The words of a message.
fn words(payload: &[u8]) -> Option<String> {
    let mut reader = Reader::new(payload);
    let count = reader.u8("message").ok()?;
    let message = reader.take(usize::from(count), "message").ok()?;
    Some(String::from_utf8_lossy(message).into_owned())
}

fn awaited(kind: PackageType) -> &'static str {
    match kind {
        PackageType::ProtocolVersion => "its protocol version",
        PackageType::ControlVersion => "its software version",
        PackageType::SetupOutputs => "what it will send",
        PackageType::SetupInputs => "the registers",
        PackageType::Start => "the start of the data",
        PackageType::Pause => "the end of the data",
        PackageType::Text | PackageType::Data => "data",
    }
}
