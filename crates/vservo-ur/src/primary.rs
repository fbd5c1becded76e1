//! What the controller says by itself, over its primary interface: why it has stopped the arm or a program, in its own words.
//!
//! ```text
//! package   length 4, type 1 (16: a state, which is passed over; 20: a message), time 8, source 1, kind 1, then by kind, big endian
//! 6  error               code 4, argument 4, level 4, kind of data 4, data 4, text
//! 7  key message         code 4, argument 4, length of the title 1, title, text
//! 10 runtime exception   line 4, column 4, text
//! ```
//! A thread of its own connects and listens, so that states and commands never wait for it. A robot that cannot be heard is commanded all the same: its states tell
//! that it has stopped, if not why. That is told, once, and tried again.

use crate::socket::receive;
use std::fmt;
use std::io::ErrorKind;
use std::net::{IpAddr, SocketAddr, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// The port, by the maker's documentation.
pub const PORT: u16 = 30_001;
/// The type of packages that are messages.
pub const MESSAGE: u8 = 20;
/// The type of packages that are states, which come ten times a second.
pub const ROBOT_STATE: u8 = 16;
/// Longest package that is taken, bytes: chosen by hand, ten times what a controller sends of its state.
const LONGEST: usize = 20_000;
/// Longest text that is kept, bytes: chosen by hand, some lines.
const LONGEST_TEXT: usize = 300;
/// Messages that wait at most; what comes beyond them is lost. Chosen by hand: a stop has one to three.
const WAITING: usize = 16;
/// So often the thread looks whether it shall end. Chosen by hand: nobody waits longer for the end of a driver.
const LOOKS: Duration = Duration::from_millis(100);
/// Longest wait for a connection, and for something to be said. Chosen by hand: a controller tells its state ten times a second.
const PATIENCE: Duration = Duration::from_secs(2);
/// Time until a connection that was lost, or not to be had, is tried anew. Chosen by hand: a controller that boots needs longer, and nothing waits for it.
const PAUSE: Duration = Duration::from_secs(5);
/// Levels of errors, by the maker's protocol, from which on something has stopped: 2 warning (protective stops are), 3 violation, 4 fault, 5 critical fault.
const WARNING: i32 = 2;
/// Levels from here on are those of the maker's developers.
const DEVELOPERS: i32 = 128;

/// A message that tells why something has stopped.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ControllerMessage {
    /// An error with the number under which the maker's documentation has it: 153 and 2 of C153A2.
    Error {
        /// 153.
        code: i32,
        /// 2.
        argument: i32,
        /// What it says beside that, often nothing.
        text: String,
    },
    /// A program that cannot go on.
    RuntimeException {
        /// The line of the program.
        line: i32,
        /// What is wrong with it.
        text: String,
    },
}

impl fmt::Display for ControllerMessage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Error { code, argument, text } if text.is_empty() => write!(f, "C{code}A{argument}"),
            Self::Error { code, argument, text } => write!(f, "C{code}A{argument}, {text}"),
            Self::RuntimeException { line, text } => write!(f, "line {line} of the program: {text}"),
        }
    }
}

/// The message of a package's payload behind length and type; none of one that tells of no stop, or is none.
#[must_use]
pub fn message(payload: &[u8]) -> Option<ControllerMessage> {
    let kind = *payload.get(9)?;
    let body = payload.get(10..)?;
    let number = |at: usize| Some(i32::from_be_bytes(body.get(at..at + 4)?.try_into().ok()?));
    let text = |from: usize| {
        let bytes = body.get(from..)?;
        let bytes = bytes.get(..LONGEST_TEXT).unwrap_or(bytes);
        Some(printable(&String::from_utf8_lossy(bytes)))
    };
    match kind {
        6 => {
            let (code, argument, level) = (number(0)?, number(4)?, number(8)?);
            let tells = (WARNING..DEVELOPERS).contains(&level);
            tells.then(|| Some(ControllerMessage::Error { code, argument, text: text(20)? }))?
        }
        10 => Some(ControllerMessage::RuntimeException { line: number(0)?, text: text(8)? }),
        // Key messages say as a title what the error before them is numbered by.
        7 => {
            let length = usize::from(*body.get(8)?);
            let title = printable(&String::from_utf8_lossy(body.get(9..9 + length)?));
            let rest = text(9 + length)?;
            let text = if rest.is_empty() { title } else { format!("{title}: {rest}") };
            let [code, argument] = [number(0)?, number(4)?];
            // Programs that begin and end are told so, too; these have no number.
            (code != 0).then_some(ControllerMessage::Error { code, argument, text })
        }
        _ => None,
    }
}

/// The text in a line, without what terminals obey.
fn printable(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect::<String>().trim().to_owned()
}

/// What is to be told about the way to the controller's words.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ListenerNotice {
    /// They cannot be had.
    Deaf {
        /// Where they were looked for.
        address: SocketAddr,
        /// Why there are none.
        cause: String,
    },
    /// They come again.
    HearsAgain,
}

impl fmt::Display for ListenerNotice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Deaf { address, cause } => write!(
                f,
                "what the robot's controller says cannot be heard ({address}: {cause}): when it stops the arm, its own words and their number will \
                 be missing. Let port {PORT} through between here and the robot, and switch on its primary interface (Settings, Security); it is \
                 tried again every {} s",
                PAUSE.as_secs()
            ),
            Self::HearsAgain => f.write_str("what the robot's controller says is heard again"),
        }
    }
}

/// Listens to a controller until it is dropped.
#[derive(Debug)]
pub struct MessageListener {
    messages: Mutex<Receiver<ControllerMessage>>,
    notices: Mutex<Receiver<ListenerNotice>>,
    ends: Arc<AtomicBool>,
}

impl MessageListener {
    /// Begins to listen in a thread of its own, which also connects: nobody waits for it, at the end neither.
    ///
    /// # Errors
    /// When there is no thread to be had.
    pub fn start(host: IpAddr) -> std::io::Result<Self> {
        let (messages_sender, messages) = sync_channel(WAITING);
        let (notices_sender, notices) = sync_channel(WAITING);
        let ends = Arc::new(AtomicBool::new(false));
        let ear = Ear {
            address: SocketAddr::new(host, PORT),
            messages: messages_sender,
            notices: notices_sender,
            ends: Arc::clone(&ends),
            is_deaf: false,
        };
        std::thread::Builder::new().name("ur-messages".into()).spawn(move || ear.listen())?;
        Ok(Self { messages: Mutex::new(messages), notices: Mutex::new(notices), ends })
    }

    /// The next message that has come.
    #[must_use]
    pub fn next(&self) -> Option<ControllerMessage> {
        self.messages.lock().unwrap_or_else(PoisonError::into_inner).try_recv().ok()
    }

    /// What is newly to be told about the way to them.
    #[must_use]
    pub fn notice(&self) -> Option<ListenerNotice> {
        self.notices.lock().unwrap_or_else(PoisonError::into_inner).try_recv().ok()
    }
}

impl Drop for MessageListener {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
    }
}

/// The thread's end of a listener.
struct Ear {
    address: SocketAddr,
    messages: SyncSender<ControllerMessage>,
    notices: SyncSender<ListenerNotice>,
    ends: Arc<AtomicBool>,
    /// Whether it was told that nothing is heard.
    is_deaf: bool,
}

impl Ear {
    fn listen(mut self) {
        while !self.ends() {
            let connected = TcpStream::connect_timeout(&self.address, PATIENCE);
            let Err(cause) = connected.and_then(|stream| self.hear(stream)) else { return };
            if !std::mem::replace(&mut self.is_deaf, true) {
                self.tell(ListenerNotice::Deaf { address: self.address, cause: cause.to_string() });
            }
            let mut waited = Duration::ZERO;
            while waited < PAUSE && !self.ends() {
                std::thread::sleep(LOOKS);
                waited += LOOKS;
            }
        }
    }

    fn ends(&self) -> bool {
        self.ends.load(Ordering::Relaxed)
    }

    /// What is not fetched is lost.
    fn tell(&self, notice: ListenerNotice) {
        let _ = self.notices.try_send(notice);
    }

    /// Takes packages until the end, or until the controller is gone, is silent or speaks otherwise.
    fn hear(&mut self, mut stream: TcpStream) -> std::io::Result<()> {
        stream.set_read_timeout(Some(LOOKS))?;
        let mut waiting = Vec::new();
        let mut piece = [0; 4096];
        let mut silence = Duration::ZERO;
        while !self.ends() {
            if let Some(count) = receive(&mut stream, &mut piece)? {
                silence = Duration::ZERO;
                waiting.extend_from_slice(piece.get(..count).unwrap_or_default());
            } else {
                silence += LOOKS;
                if silence >= PATIENCE {
                    return Err(std::io::Error::new(ErrorKind::TimedOut, "it says nothing"));
                }
            }
            while let Some(length) = waiting.first_chunk().map(|bytes| u32::from_be_bytes(*bytes) as usize) {
                if !(5..=LONGEST).contains(&length) {
                    let words = "what it says is no package of the primary interface";
                    return Err(std::io::Error::new(ErrorKind::InvalidData, words));
                }
                if waiting.len() < length {
                    break;
                }
                let package: Vec<u8> = waiting.drain(..length).collect();
                if std::mem::take(&mut self.is_deaf) {
                    self.tell(ListenerNotice::HearsAgain);
                }
                if let (Some(&MESSAGE), Some(payload)) = (package.get(4), package.get(5..))
                    && let Some(message) = message(payload)
                {
                    let _ = self.messages.try_send(message);
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Put together by the table above, byte by byte.
    fn error(code: i32, argument: i32, level: i32, text: &str) -> Vec<u8> {
        let numbers = [code, argument, level, 0, 0].map(i32::to_be_bytes).concat();
        [&[0, 0, 0, 0, 0, 0, 0, 1, 254, 6][..], &numbers, text.as_bytes()].concat()
    }

    #[test]
    fn errors_have_their_number_and_words() {
        let told = |code, argument, level, text: &str| {
            message(&error(code, argument, level, text)).map(|m| m.to_string())
        };
        assert_eq!(told(153, 2, 2, "joint 3 is off").as_deref(), Some("C153A2, joint 3 is off"));
        assert_eq!(told(204, 3, 3, "").as_deref(), Some("C204A3"));
        for level in [0, 1, 128, 130, -1] {
            assert_eq!(told(1, 0, level, "no stop"), None, "{level}");
        }
        let exception = [&[0; 9][..], &[10, 0, 0, 0, 7, 0, 0, 0, 3], b"type_error:x"].concat();
        assert_eq!(message(&exception).unwrap().to_string(), "line 7 of the program: type_error:x");
        let key = [&[0; 9][..], &[7, 0, 0, 0, 160, 0, 0, 0, 1, 4], b"Stopnow"].concat();
        assert_eq!(message(&key).unwrap().to_string(), "C160A1, Stop: now");
        assert_eq!(told(1, 0, 2, "a\u{1b}[2J\nb").map(|text| text.contains('\u{1b}')), Some(false));
    }

    proptest! {
        #[test]
        fn whatever_comes_is_a_message_or_none(payload in prop::collection::vec(any::<u8>(), 0..80)) {
            let _ = message(&payload).map(|m| m.to_string());
        }
    }
}
