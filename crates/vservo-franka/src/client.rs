//! The client's end of the wire. Every wait has an end; once a motion is under way, nothing is allocated and TCP is not waited for.

use crate::wire::{
    Framer, PORT, ROBOT_COMMAND_SIZE, Reader, Request, RequestKind, RobotCommand, RobotState, VERSION,
    WireError,
};
use crate::{Clock, FrankaError};
use std::io::{ErrorKind, Read, Write};
use std::net::{IpAddr, SocketAddr, TcpStream, UdpSocket};
use std::time::Duration;

/// Replies that nobody has asked for yet are kept up to so many, the newest. Chosen by hand: requests that are not waited for are a motion, its stop, a recovery.
const KEPT: usize = 8;
/// Room for a datagram, bytes. Chosen by hand: larger than a state, so that a longer one is seen to be longer.
const DATAGRAM: usize = 2048;

/// A connection to a controller.
#[derive(Debug)]
pub struct FciClient {
    tcp: TcpStream,
    udp: UdpSocket,
    address: SocketAddr,
    /// Where states come from, and commands go to.
    peer: Option<SocketAddr>,
    patience: Duration,
    clock: Clock,
    framer: Framer,
    numbers: u32,
    /// Number and status of replies.
    replies: Vec<(u32, u8)>,
    version: u16,
    model: String,
    /// Time-out that the socket of states has now.
    wait: Duration,
    room: [u8; crate::wire::LONGEST_REQUEST],
}

impl FciClient {
    /// Connects, and agrees on the version.
    ///
    /// # Errors
    /// When nobody answers, or in another version.
    pub fn connect(host: IpAddr, patience: Duration, clock: Clock) -> Result<Self, FrankaError> {
        let address = SocketAddr::new(host, PORT);
        let failed = |cause| FrankaError::Connect { address: address.to_string(), cause };
        let tcp = TcpStream::connect_timeout(&address, patience).map_err(failed)?;
        tcp.set_nodelay(true).map_err(failed)?;
        tcp.set_write_timeout(Some(patience)).map_err(failed)?;
        // States come to the address by which the robot is reached, and to no other.
        let own = tcp.local_addr().map_err(failed)?;
        let udp = UdpSocket::bind(SocketAddr::new(own.ip(), 0)).map_err(failed)?;
        let udp_port = udp.local_addr().map_err(failed)?.port();
        tcp.set_nonblocking(true).map_err(failed)?;
        let mut client = Self {
            tcp,
            udp,
            address,
            peer: None,
            patience,
            clock,
            framer: Framer::default(),
            numbers: 0,
            replies: Vec::with_capacity(KEPT),
            version: 0,
            model: String::new(),
            wait: Duration::ZERO,
            room: [0; crate::wire::LONGEST_REQUEST],
        };
        let status = client.ask(&Request::Connect { version: VERSION, udp_port })?;
        if status != 0 || client.version != VERSION {
            return Err(FrankaError::Version { version: client.version });
        }
        Ok(client)
    }

    /// The controller's address.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// The robot's URDF, which is asked for.
    ///
    /// # Errors
    /// When the robot does not answer.
    pub fn model(&mut self) -> Result<&str, FrankaError> {
        self.ask(&Request::GetRobotModel)?;
        Ok(&self.model)
    }

    /// Sends a request; its number.
    ///
    /// # Errors
    /// When the connection is lost.
    pub fn send(&mut self, request: &Request) -> Result<u32, FrankaError> {
        let number = self.numbers;
        self.numbers = self.numbers.wrapping_add(1);
        let size = request.encode(number, &mut self.room);
        let mut sent = 0;
        let deadline = (self.clock)() + nanoseconds(self.patience);
        while sent < size {
            match self.tcp.write(self.room.get(sent..size).unwrap_or_default()) {
                Ok(count) if count > 0 => sent += count,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                // Requests are short and few: this happens with a robot alone that does not read.
                Err(e) if e.kind() == ErrorKind::WouldBlock && (self.clock)() < deadline => {
                    std::thread::sleep(Duration::from_millis(1));
                }
                Ok(_) => return Err(self.lost("it takes nothing")),
                Err(cause) => return Err(self.lost(cause)),
            }
        }
        Ok(number)
    }

    /// Sends a request, and waits for the status of its reply.
    ///
    /// # Errors
    /// When there is none in time, or the connection is lost.
    pub fn ask(&mut self, request: &Request) -> Result<u8, FrankaError> {
        let number = self.send(request)?;
        let deadline = (self.clock)() + nanoseconds(self.patience);
        loop {
            // A robot that refuses may close the connection behind its reply.
            let read = self.read_replies();
            if let Some(status) = self.reply(number) {
                return Ok(status);
            }
            read?;
            if (self.clock)() > deadline {
                return Err(FrankaError::Silent {
                    address: self.address.to_string(),
                    awaited: request.kind().name(),
                    seconds: self.patience.as_secs_f64(),
                });
            }
            // Chosen by hand: nothing moves while somebody waits for a reply.
            std::thread::sleep(Duration::from_micros(300));
        }
    }

    /// The status of the reply to a request, once, when it has come.
    pub fn reply(&mut self, number: u32) -> Option<u8> {
        let at = self.replies.iter().position(|(of, _)| *of == number)?;
        Some(self.replies.remove(at).1)
    }

    /// Takes in what has come by TCP, without waiting.
    ///
    /// # Errors
    /// When the connection is lost, or what came is no reply.
    pub fn read_replies(&mut self) -> Result<(), FrankaError> {
        loop {
            match self.tcp.read(self.framer.room()) {
                Ok(0) => return Err(self.lost("it was closed")),
                Ok(count) => self.framer.filled(count),
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) if e.kind() == ErrorKind::WouldBlock => return Ok(()),
                Err(cause) => return Err(self.lost(cause)),
            }
            loop {
                let message = match self.framer.message() {
                    Ok(Some(message)) => message,
                    Ok(None) => break,
                    Err(error) => return Err(wire(self.address, error)),
                };
                let mut reader = Reader::new(message.payload);
                let status = reader.u8("status").map_err(|error| wire(self.address, error))?;
                match message.kind {
                    RequestKind::Connect => {
                        let version = reader.take("version").map_err(|error| wire(self.address, error))?;
                        self.version = u16::from_le_bytes(version);
                    }
                    RequestKind::GetRobotModel => {
                        self.model = String::from_utf8_lossy(reader.rest()).into_owned();
                    }
                    _ => {}
                }
                if self.replies.len() >= KEPT {
                    self.replies.remove(0);
                }
                self.replies.push((message.number, status));
            }
        }
    }

    /// The newest state, and when it came, ns: of those that wait, or the next within `wait`.
    ///
    /// # Errors
    /// When the socket fails, or what came is no state.
    pub fn receive(&mut self, wait: Duration) -> Result<Option<(RobotState, i64)>, FrankaError> {
        let mut newest = None;
        if !wait.is_zero() {
            if wait != self.wait {
                self.udp.set_read_timeout(Some(wait)).map_err(|cause| self.lost(cause))?;
                self.wait = wait;
            }
            self.take_state(&mut newest)?;
        }
        self.udp.set_nonblocking(true).map_err(|cause| self.lost(cause))?;
        while self.take_state(&mut newest)? {}
        self.udp.set_nonblocking(false).map_err(|cause| self.lost(cause))?;
        Ok(newest)
    }

    /// Takes a datagram; whether there was one.
    fn take_state(&mut self, newest: &mut Option<(RobotState, i64)>) -> Result<bool, FrankaError> {
        let mut bytes = [0; DATAGRAM];
        let (size, from) = match self.udp.recv_from(&mut bytes) {
            Ok(taken) => taken,
            Err(e)
                if matches!(
                    e.kind(),
                    // A refused command is told here, too: a robot that is gone is noticed by its silence.
                    ErrorKind::WouldBlock
                        | ErrorKind::TimedOut
                        | ErrorKind::Interrupted
                        | ErrorKind::ConnectionRefused
                ) =>
            {
                return Ok(false);
            }
            Err(cause) => return Err(self.lost(cause)),
        };
        let arrival = (self.clock)();
        // Who sent the first state sends all of them; commands go there and nowhere else.
        if from.ip() != self.address.ip() || self.peer.is_some_and(|peer| peer != from) {
            return Ok(true); // somebody else's
        }
        let state = RobotState::decode(bytes.get(..size).unwrap_or_default())
            .map_err(|error| wire(self.address, error))?;
        self.peer = Some(from);
        if newest.is_none_or(|(other, _)| state.message_id >= other.message_id) {
            *newest = Some((state, arrival));
        }
        Ok(true)
    }

    /// Sends the command of a cycle. One that does not get away is as one that is lost on the way.
    ///
    /// # Errors
    /// When the socket fails.
    pub fn command(&mut self, command: &RobotCommand) -> Result<(), FrankaError> {
        let Some(peer) = self.peer else { return Ok(()) };
        let bytes: [u8; ROBOT_COMMAND_SIZE] = command.encode();
        match self.udp.send_to(&bytes, peer) {
            Ok(_) => Ok(()),
            Err(e)
                if matches!(
                    e.kind(),
                    ErrorKind::WouldBlock | ErrorKind::Interrupted | ErrorKind::ConnectionRefused
                ) =>
            {
                Ok(())
            }
            Err(cause) => Err(self.lost(cause)),
        }
    }

    fn lost(&self, cause: impl ToString) -> FrankaError {
        FrankaError::Lost { address: self.address.to_string(), cause: cause.to_string() }
    }
}

fn wire(address: SocketAddr, error: WireError) -> FrankaError {
    FrankaError::Wire { address: address.to_string(), error }
}

/// A span as the clock counts it.
pub(crate) fn nanoseconds(span: Duration) -> i64 {
    i64::try_from(span.as_nanos()).unwrap_or(i64::MAX)
}
