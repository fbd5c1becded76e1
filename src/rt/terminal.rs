//! A terminal that a program has for itself: keys come one by one, and what was on it comes back at the end, however the program ends.
//!
//! It is opened once more, so that it neither waits nor makes others wait who have it: a terminal that takes nothing (a stopped connection) loses output.

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags, open};
use rustix::io::Errno;
use rustix::termios::{OptionalActions, Termios, tcgetattr, tcgetwinsize, tcsetattr};
use std::io::{IsTerminal, stdout};
use std::os::fd::{AsFd, OwnedFd};
use std::sync::Arc;
use std::time::Duration;

/// To the alternate screen, without a cursor (the private modes 1049 and 25, as xterm has them, and all others after it).
const ENTER: &str = "\x1b[?1049h\x1b[?25l\x1b[2J";
/// And back, with the usual colours: the same modes, as xterm has them.
const LEAVE: &str = "\x1b[0m\x1b[?25h\x1b[?1049l";
/// Size of a terminal that does not tell it, as the VT100 has it, which terminals are modelled on.
const USUAL_SIZE: (usize, usize) = (80, 24);
/// Wait for a terminal that takes nothing. Chosen by hand: a person notices no more, and a screen that is lost is followed by the next.
const PATIENCE: Duration = Duration::from_millis(200);
/// Bytes that are read at once. Chosen by hand: keys are typed one by one.
const KEYS_AT_ONCE: usize = 64;

/// The terminal of this process, until it is dropped.
#[derive(Debug)]
pub struct Terminal {
    device: Arc<TerminalDevice>,
}

#[derive(Debug)]
struct TerminalDevice {
    file: OwnedFd,
    before: Termios,
}

impl Terminal {
    /// Takes the terminal that stdout is; `None` where it is none, or one that cannot move its cursor.
    #[must_use]
    pub fn take() -> Option<Self> {
        let is_dumb = std::env::var_os("TERM").is_some_and(|kind| kind == "dumb");
        if is_dumb || !stdout().is_terminal() {
            return None;
        }
        let flags = OFlags::RDWR | OFlags::NONBLOCK | OFlags::NOCTTY | OFlags::CLOEXEC;
        // The second one for whoever became another user in this terminal.
        let file = ["/proc/self/fd/1", "/dev/tty"]
            .into_iter()
            .find_map(|path| open(path, flags, Mode::empty()).ok())?;
        let before = tcgetattr(&file).ok()?;
        let mut raw = before.clone();
        raw.make_raw();
        tcsetattr(&file, OptionalActions::Now, &raw).ok()?;
        let device = Arc::new(TerminalDevice { file, before });
        // A panic is told on the screen that was there before.
        let (mine, tell) = (Arc::downgrade(&device), std::panic::take_hook());
        std::panic::set_hook(Box::new(move |info| {
            if let Some(device) = mine.upgrade() {
                device.restore();
            }
            tell(info);
        }));
        device.write(ENTER);
        Some(Self { device })
    }

    /// Columns and rows.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        match tcgetwinsize(&self.device.file) {
            Ok(size) if size.ws_col > 0 && size.ws_row > 0 => (size.ws_col.into(), size.ws_row.into()),
            _ => USUAL_SIZE,
        }
    }

    /// Writes `text`; whether it took all of it.
    #[must_use]
    pub fn write(&self, text: &str) -> bool {
        self.device.write(text)
    }

    /// What was typed, after `longest` at most; `None` where the terminal is gone.
    #[must_use]
    pub fn keys(&self, longest: Duration) -> Option<Vec<u8>> {
        let mut keys = [0; KEYS_AT_ONCE];
        if !self.device.is_ready(PollFlags::IN, longest) {
            return Some(Vec::new());
        }
        match rustix::io::read(&self.device.file, &mut keys) {
            Ok(0) => None,
            Ok(count) => Some(keys.iter().take(count).copied().collect()),
            Err(Errno::AGAIN | Errno::INTR) => Some(Vec::new()),
            Err(_) => None,
        }
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        self.device.restore();
    }
}

impl TerminalDevice {
    fn is_ready(&self, what: PollFlags, longest: Duration) -> bool {
        let mut fds = [PollFd::from_borrowed_fd(self.file.as_fd(), what)];
        let longest =
            Timespec { tv_sec: longest.as_secs().cast_signed(), tv_nsec: longest.subsec_nanos().into() };
        matches!(poll(&mut fds, Some(&longest)), Ok(1..))
    }

    fn write(&self, text: &str) -> bool {
        let mut rest = text.as_bytes();
        while !rest.is_empty() {
            match rustix::io::write(&self.file, rest) {
                Ok(count) => rest = rest.get(count..).unwrap_or_default(),
                Err(Errno::INTR) => {}
                Err(Errno::AGAIN) if self.is_ready(PollFlags::OUT, PATIENCE) => {}
                Err(_) => return false,
            }
        }
        true
    }

    fn restore(&self) {
        let _ = self.write(LEAVE); // a terminal that is gone needs nothing
        let _ = tcsetattr(&self.file, OptionalActions::Now, &self.before);
    }
}
