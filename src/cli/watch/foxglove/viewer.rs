//! One viewer: its subscriptions, and what is sent for them.

use super::hub::{ChannelHub, ChannelMessage, ViewerProgress};
use super::protocol::{ServerText, SocketRequest, Subscription, ViewerText, message_data};
use crate::rt::now;
use crate::time::{MonoNs, SpanNs};
use std::io::{Error, ErrorKind, Write};
use std::net::TcpStream;
use std::time::Duration;
use tungstenite::protocol::{Role, WebSocketConfig};
use tungstenite::{Error as SocketError, Message, WebSocket};

/// Wait for what a viewer asks for, and for what is new, in turns. Chosen by hand: half a look of the watching loop, so that nothing waits for it.
const TURN: Duration = Duration::from_millis(25);
/// Longest message of a viewer. Chosen by hand: a subscription has 30 bytes, and there are about twenty channels.
const MAX_MESSAGE: usize = 64 << 10;
/// Subscriptions of a viewer. Chosen by hand, far above the number of channels, so that none can make the loop slow.
const MAX_SUBSCRIPTIONS: usize = 256;
/// Pause between questions whether a viewer is still there, and silence after which it is not. Chosen by hand: browsers answer within a second, and a place that nobody uses
/// any more is free again within half a minute.
const ASKS_EVERY: SpanNs = SpanNs(5_000_000_000);
const GONE_AFTER: SpanNs = SpanNs(25_000_000_000);
/// A warning, as the protocol numbers it.
const WARNING: u8 = 1;

/// A viewer while it is there.
struct Viewer<'a> {
    socket: WebSocket<&'a TcpStream>,
    hub: &'a ChannelHub,
    subscriptions: Vec<Subscription>,
    heard: MonoNs,
    asked: MonoNs,
}

impl Drop for Viewer<'_> {
    fn drop(&mut self) {
        self.subscriptions.iter().for_each(|wanted| self.hub.unsubscribe(wanted.channel_id));
        self.hub.count_viewer(false);
    }
}

/// Serves a viewer that asked for a socket, until it leaves. `send_time`: within which it must take what it is sent.
pub(crate) fn serve_viewer(
    mut stream: &TcpStream,
    request: &SocketRequest,
    hub: &ChannelHub,
    send_time: Duration,
) -> Result<(), Error> {
    stream.set_read_timeout(Some(TURN))?;
    stream.set_write_timeout(Some(send_time))?;
    // Messages are small and meant to be seen at once.
    stream.set_nodelay(true)?;
    let SocketRequest { accept, protocol } = request;
    let head = format!(
        "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Accept: {accept}\r\n\
         Sec-WebSocket-Protocol: {protocol}\r\n\r\n"
    );
    stream.write_all(head.as_bytes())?;
    let limits =
        WebSocketConfig::default().max_message_size(Some(MAX_MESSAGE)).max_frame_size(Some(MAX_MESSAGE));
    let socket = WebSocket::from_raw_socket(stream, Role::Server, Some(limits));
    hub.count_viewer(true);
    let time = now();
    let mut viewer = Viewer { socket, hub, subscriptions: Vec::new(), heard: time, asked: time };
    let mut told = ViewerProgress::default();
    loop {
        if !viewer.listen()? {
            return Ok(());
        }
        viewer.tell_news(&mut told)?;
        viewer.ask_whether_there()?;
    }
}

/// What is told of an error of the socket.
fn failed(error: SocketError) -> Error {
    match error {
        SocketError::Io(error) => error,
        other => Error::new(ErrorKind::InvalidData, other.to_string()),
    }
}

impl Viewer<'_> {
    /// Takes what the viewer asks for. Whether it is still there.
    fn listen(&mut self) -> Result<bool, Error> {
        let message = match self.socket.read() {
            Ok(message) => message,
            Err(SocketError::Io(e)) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                return Ok(true);
            }
            Err(SocketError::Io(e)) if e.kind() == ErrorKind::Interrupted => return Ok(true),
            Err(
                SocketError::ConnectionClosed
                | SocketError::AlreadyClosed
                | SocketError::Protocol(tungstenite::error::ProtocolError::ResetWithoutClosingHandshake),
            ) => return Ok(false),
            Err(SocketError::Io(e))
                if matches!(e.kind(), ErrorKind::ConnectionReset | ErrorKind::BrokenPipe) =>
            {
                return Ok(false);
            }
            Err(error) => return Err(failed(error)),
        };
        self.heard = now();
        match message {
            Message::Text(text) => self.obey(&text)?,
            Message::Binary(_) => self.refuse("vservo takes no messages: its runs are only watched")?,
            // Answered by the socket itself.
            Message::Ping(_) | Message::Pong(_) | Message::Frame(_) | Message::Close(_) => {}
        }
        Ok(true)
    }

    fn obey(&mut self, text: &str) -> Result<(), Error> {
        match ViewerText::read(text) {
            Some(ViewerText::Subscribe { subscriptions }) => {
                for wanted in subscriptions {
                    let is_known = self.subscriptions.iter().any(|known| known.id == wanted.id);
                    if is_known || self.subscriptions.len() >= MAX_SUBSCRIPTIONS {
                        self.refuse("a subscription has a number that is in use, or there are too many")?;
                        continue;
                    }
                    match self.hub.subscribe(wanted.channel_id) {
                        Ok(latched) => {
                            self.subscriptions.push(wanted);
                            latched.map_or(Ok(()), |latched| self.send(wanted.id, &latched))?;
                        }
                        Err(why) => self.refuse(why)?,
                    }
                }
            }
            Some(ViewerText::Unsubscribe { subscription_ids }) => {
                let hub = self.hub;
                self.subscriptions.retain(|known| {
                    let stays = !subscription_ids.contains(&known.id);
                    if !stays {
                        hub.unsubscribe(known.channel_id);
                    }
                    stays
                });
            }
            // Clients tell and ask more than a server that only shows can use; what is no message at all is a mistake.
            Some(ViewerText::Other) => {}
            None => self.refuse("this is no message of the protocol")?,
        }
        Ok(())
    }

    fn tell_news(&mut self, told: &mut ViewerProgress) -> Result<(), Error> {
        let news = self.hub.news(told, TURN);
        if !news.gone.is_empty() {
            let hub = self.hub;
            self.subscriptions.retain(|known| {
                let stays = !news.gone.contains(&known.channel_id);
                if !stays {
                    hub.unsubscribe(known.channel_id);
                }
                stays
            });
            self.tell(&ServerText::Unadvertise { channel_ids: &news.gone })?;
        }
        if let Some((run, name)) = &news.run {
            let session_id = run.to_string();
            let name = if name.is_empty() { "vservo, which waits for a run" } else { name };
            self.tell(&ServerText::ServerInfo { name, capabilities: [], session_id: &session_id })?;
        }
        if !news.new.is_empty() {
            let channels = news.new.iter().map(AsRef::as_ref).collect();
            self.tell(&ServerText::Advertise { channels })?;
        }
        for message in &news.messages {
            let wanted = self.subscriptions.iter().filter(|known| known.channel_id == message.channel);
            let wanted: Vec<u32> = wanted.map(|known| known.id).collect();
            for id in wanted {
                self.send(id, message)?;
            }
        }
        self.socket.flush().map_err(failed)
    }

    fn send(&mut self, id: u32, message: &ChannelMessage) -> Result<(), Error> {
        let data = message_data(id, message.stamp_ns, &message.data);
        self.socket.write(Message::Binary(data.into())).map_err(failed)
    }

    fn tell(&mut self, text: &ServerText<'_>) -> Result<(), Error> {
        self.socket.write(Message::Text(text.to_json().into())).map_err(failed)
    }

    fn refuse(&mut self, message: &str) -> Result<(), Error> {
        self.tell(&ServerText::Status { level: WARNING, message })
    }

    /// Asks a viewer that says nothing whether it is there, and gives one up that does not answer.
    fn ask_whether_there(&mut self) -> Result<(), Error> {
        let time = now();
        if time - self.heard > GONE_AFTER {
            return Err(ErrorKind::TimedOut.into());
        }
        if time - self.heard > ASKS_EVERY && time - self.asked > ASKS_EVERY {
            self.asked = time;
            self.socket.send(Message::Ping(Vec::new().into())).map_err(failed)?;
        }
        Ok(())
    }
}
