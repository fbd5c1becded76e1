//! The controller's end of the sockets: one client at a time.

use super::Shared;
use super::core::Core;
use super::faults::Pieces;
use crate::wire::{Framer, Request, RequestKind, VERSION, encode_connect_reply, encode_reply, read_request};
use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::atomic::Ordering;
use std::time::Duration;

/// Longest wait of a thread before it looks whether the emulator ends. Chosen by hand: nobody notices it.
const LOOK: Duration = Duration::from_millis(20);

/// The client that there is.
pub(super) struct Client {
    stream: TcpStream,
    /// Where it takes states, once it may.
    udp: Option<SocketAddr>,
}

/// Takes one client after another in until the emulator ends.
pub(super) fn serve(shared: &Shared, listener: &TcpListener) {
    while !shared.ends.load(Ordering::Relaxed) {
        match listener.accept() {
            Ok((stream, from)) if from.ip().is_loopback() => {
                let prepared = stream
                    .set_nonblocking(false)
                    .and_then(|()| stream.set_nodelay(true))
                    .and_then(|()| stream.set_read_timeout(Some(LOOK)))
                    .and_then(|()| stream.set_write_timeout(Some(LOOK)))
                    .and_then(|()| stream.try_clone());
                let Ok(reader) = prepared else { continue };
                *shared.client() = Some(Client { stream, udp: None });
                listen(shared, listener, reader, from);
                let mut core = shared.core();
                *shared.client() = None;
                core.abandon();
                core.faults.close = false;
            }
            // Chosen by hand: a client does not notice the wait.
            _ => std::thread::sleep(Duration::from_millis(5)),
        }
    }
}

/// Reads what the client asks for, until it is gone. Others are turned away.
fn listen(shared: &Shared, listener: &TcpListener, mut stream: TcpStream, from: SocketAddr) {
    let mut framer = Framer::default();
    while !shared.ends.load(Ordering::Relaxed) && !shared.core().faults.close {
        match stream.read(framer.room()) {
            Ok(0) => return,
            Ok(count) => framer.filled(count),
            Err(e)
                if matches!(
                    e.kind(),
                    ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
                ) => {}
            Err(_) => return,
        }
        while let Ok((other, _)) = listener.accept() {
            drop(other);
        }
        loop {
            let (number, request) = match framer.message() {
                Ok(Some(message)) => match read_request(message.kind, message.payload) {
                    Ok(request) => (message.number, request),
                    Err(error) => return shared.core().tell(format!("a request that is none: {error}")),
                },
                Ok(None) => break,
                Err(error) => return shared.core().tell(format!("a request that is none: {error}")),
            };
            if !obey(shared, number, &request, from) {
                return;
            }
        }
    }
}

/// Serves a request; whether the client may stay.
fn obey(shared: &Shared, number: u32, request: &Request, from: SocketAddr) -> bool {
    let mut core = shared.core();
    let mut client = shared.client();
    let Some(client) = client.as_mut() else { return false };
    if core.faults.silent_tcp {
        return true;
    }
    match request {
        Request::Connect { version, udp_port } => {
            let speaks = if core.faults.old_version { VERSION - 1 } else { VERSION };
            let mut reply = encode_connect_reply(number, speaks);
            if let Some(status) = reply.get_mut(crate::wire::HEADER_SIZE) {
                *status = u8::from(*version != speaks);
            }
            let sent = client.write(&reply, core.faults.pieces).is_ok() && *version == speaks;
            client.udp = sent.then_some(SocketAddr::new(from.ip(), *udp_port));
            sent
        }
        _ if client.udp.is_none() => {
            core.tell("a request before Connect");
            false
        }
        Request::GetRobotModel => {
            let text = core.limits.urdf();
            let reply = encode_reply(RequestKind::GetRobotModel, number, 0, text.as_bytes());
            client.write(&reply, core.faults.pieces).is_ok()
        }
        _ => {
            core.request(number, request);
            client.reply(&mut core).is_ok()
        }
    }
}

impl Client {
    /// Sends the replies that wait.
    fn reply(&mut self, core: &mut Core) -> std::io::Result<()> {
        for (kind, number, status) in core.replies.drain(..) {
            if std::mem::take(&mut core.faults.wrong_size) {
                self.stream.write_all(&[0; crate::wire::HEADER_SIZE])?;
            }
            self.write(&encode_reply(kind, number, status, &[]), core.faults.pieces)?;
        }
        Ok(())
    }

    fn write(&mut self, bytes: &[u8], pieces: Pieces) -> std::io::Result<()> {
        let size = match pieces {
            Pieces::Whole => bytes.len(),
            Pieces::Halves => bytes.len().div_ceil(2),
            Pieces::Bytes => 1,
        };
        for (i, piece) in bytes.chunks(size.max(1)).enumerate() {
            if i > 0 && pieces == Pieces::Halves {
                // Chosen by hand: so long that the first half is read alone, and less than a cycle.
                std::thread::sleep(Duration::from_micros(700));
            }
            self.stream.write_all(piece)?;
        }
        Ok(())
    }
}

/// Sends what a cycle has to tell: replies, then the state; its number where it was sent.
pub(super) fn send_cycle(shared: &Shared, core: &mut Core, udp: &UdpSocket) -> Option<u64> {
    let mut client = shared.client();
    let Some((client, to)) = client.as_mut().and_then(|client| client.udp.map(|udp| (client, udp))) else {
        core.replies.clear();
        return None;
    };
    if core.faults.close {
        let _ = client.stream.shutdown(std::net::Shutdown::Both);
        return None;
    }
    // A client that does not read is gone as soon as its thread sees that.
    let _ = client.reply(core);
    let mut state = core.state;
    core.faults.hold_back(&mut state);
    let faults = &core.faults;
    if faults.mute || faults.lose_states && !state.message_id.is_multiple_of(3) {
        return None;
    }
    if let Some(number) = faults.stale_number {
        state.message_id = number;
    }
    if faults.not_a_number {
        state.q[2] = f64::NAN;
    }
    state.q[0] += faults.jump_rad;
    let bytes = state.encode();
    let size = if faults.short_states { bytes.len() / 2 } else { bytes.len() };
    udp.send_to(bytes.get(..size).unwrap_or_default(), to).ok()?;
    if faults.strange_datagrams {
        let ip = udp.local_addr().ok()?.ip();
        UdpSocket::bind(SocketAddr::new(ip, 0)).and_then(|other| other.send_to(&[7; 300], to)).ok()?;
    }
    Some(state.message_id)
}
