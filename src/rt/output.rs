//! Output to stdout and stderr. Nothing here panics, and no message during a run blocks: a full disk, a
//! closed terminal or a reader that stopped reading must never reach the arm.

use super::log_format::{LogFormat, log_format};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::stdio;
use std::io::{self, IsTerminal, Write, stderr};
use tracing_subscriber::fmt::format::Writer;
use tracing_subscriber::fmt::time::{FormatTime, SystemTime};

/// A write of so many bytes to a pipe that is ready does not block: PIPE_BUF, as Linux has it (pipe(7)).
const WITHOUT_WAITING: usize = 4096;

/// Clears the terminal's line: carriage return, and the sequence EL of the standard ECMA-48.
pub const CLEAR_LINE: &str = "\r\x1b[2K";

/// stderr, for lines that matter less than the run: what cannot be written at once is lost.
#[derive(Debug, Clone, Copy, Default)]
pub struct Stderr;

impl Write for Stderr {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        for part in bytes.chunks(WITHOUT_WAITING) {
            if !is_ready() || rustix::io::write(stdio::stderr(), part) != Ok(part.len()) {
                break;
            }
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Whether stderr takes bytes without a wait.
fn is_ready() -> bool {
    let mut fds = [PollFd::from_borrowed_fd(stdio::stderr(), PollFlags::OUT)];
    let at_once = Timespec { tv_sec: 0, tv_nsec: 0 };
    matches!(poll(&mut fds, Some(&at_once)), Ok(1..))
}

/// Whole lines on stderr, each in one write: on a terminal they take the place of the progress, which is written again below them.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct StderrLines;

impl Write for StderrLines {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if stderr().is_terminal() {
            Stderr.write_all(&[CLEAR_LINE.as_bytes(), bytes].concat())?;
            return Ok(bytes.len());
        }
        Stderr.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A line on stderr, however much is logged; an object where the log is read by programs.
pub fn tell(line: impl std::fmt::Display) {
    let line = match log_format() {
        LogFormat::Text => format!("{line}\n"),
        LogFormat::Json => object(&line.to_string()),
    };
    let _ = StderrLines.write_all(line.as_bytes());
}

/// Results, on stdout. A reader that has enough (`| head`) is no error.
///
/// # Errors
/// When stdout cannot be written: the results are lost.
pub fn print(text: &str) -> io::Result<()> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        result => result,
    }
}

/// A message as a JSON object like those of the log.
fn object(message: &str) -> String {
    let mut timestamp = String::new();
    // of a clock that gives none, none
    let _ = SystemTime.format_time(&mut Writer::new(&mut timestamp));
    let level = if message.contains("warning:") { "WARN" } else { "INFO" };
    let fields = serde_json::json!({ "message": message });
    let told =
        serde_json::json!({ "timestamp": timestamp, "level": level, "fields": fields, "target": "vservo" });
    format!("{told}\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_that_is_told_is_an_object_with_a_time() {
        let told: serde_json::Value = serde_json::from_str(&object("vservo: warning: \"x\"\n\u{7}")).unwrap();
        assert_eq!(told["fields"]["message"], "vservo: warning: \"x\"\n\u{7}");
        assert_eq!(told["level"], "WARN");
        assert!(told["timestamp"].as_str().is_some_and(|t| t.ends_with('Z') && t.contains('T')), "{told}");
    }
}
