//! What the controller says by itself, over its primary interface: why it has stopped the arm or a program, in its own words.
//!
//! ```text
//! package   length 4, type 1 (20: a message), time 8, source 1, kind 1, then by kind, big endian
//! 6  error               code 4, argument 4, level 4, kind of data 4, data 4, text
//! 7  key message         code 4, argument 4, length of the title 1, title, text
//! 10 runtime exception   line 4, column 4, text
//! ```
//! A thread of its own listens, so that nothing here waits. A robot that cannot be heard is commanded all the same: its states tell that it has stopped, if not why.

use std::fmt;
use std::io::{ErrorKind, Read};
use std::net::{IpAddr, SocketAddr, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// The port, by the maker's documentation.
pub const PORT: u16 = 30_001;
/// The type of packages that are messages.
pub const MESSAGE: u8 = 20;
/// Longest package that is taken, bytes: chosen by hand, ten times what a controller sends of its state.
const LONGEST: usize = 20_000;
/// Longest text that is kept, bytes: chosen by hand, some lines.
const LONGEST_TEXT: usize = 300;
/// Messages that wait at most; what comes beyond them is lost. Chosen by hand: a stop has one to three.
const WAITING: usize = 16;
/// So often the thread looks whether it shall end. Chosen by hand: nobody waits longer for the end of a driver.
const LOOKS: Duration = Duration::from_millis(100);
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

/// Listens to a controller until it is dropped.
#[derive(Debug)]
pub struct MessageListener {
    messages: Mutex<Receiver<ControllerMessage>>,
    ends: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl MessageListener {
    /// Connects within `patience`.
    ///
    /// # Errors
    /// When nobody is there.
    pub fn connect(host: IpAddr, patience: Duration) -> std::io::Result<Self> {
        let stream = TcpStream::connect_timeout(&SocketAddr::new(host, PORT), patience)?;
        stream.set_read_timeout(Some(LOOKS))?;
        let (sender, messages) = sync_channel(WAITING);
        let ends = Arc::new(AtomicBool::new(false));
        let asked = Arc::clone(&ends);
        let thread = std::thread::Builder::new()
            .name("ur-messages".into())
            .spawn(move || listen(stream, &asked, &sender))?;
        Ok(Self { messages: Mutex::new(messages), ends, thread: Some(thread) })
    }

    /// The next message that has come.
    #[must_use]
    pub fn next(&self) -> Option<ControllerMessage> {
        self.messages.lock().unwrap_or_else(PoisonError::into_inner).try_recv().ok()
    }
}

impl Drop for MessageListener {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Takes packages until the end, or until the controller is gone or speaks otherwise.
fn listen(mut stream: TcpStream, ends: &AtomicBool, sender: &SyncSender<ControllerMessage>) {
    let mut waiting = Vec::new();
    let mut piece = [0; 4096];
    while !ends.load(Ordering::Relaxed) {
        match stream.read(&mut piece) {
            Ok(0) => return,
            Ok(count) => waiting.extend_from_slice(piece.get(..count).unwrap_or_default()),
            Err(e)
                if matches!(
                    e.kind(),
                    ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
                ) =>
            {
                continue;
            }
            Err(_) => return,
        }
        while let Some(length) = waiting.first_chunk().map(|bytes| u32::from_be_bytes(*bytes) as usize) {
            if !(5..=LONGEST).contains(&length) {
                return;
            }
            if waiting.len() < length {
                break;
            }
            let package: Vec<u8> = waiting.drain(..length).collect();
            if let (Some(&MESSAGE), Some(payload)) = (package.get(4), package.get(5..))
                && let Some(message) = message(payload)
            {
                let _ = sender.try_send(message);
            }
        }
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
