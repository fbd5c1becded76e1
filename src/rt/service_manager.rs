//! Words for systemd, where it started this process with `Type=notify`: sd_notify(3), a datagram to the socket that the environment names.

use crate::time::{MonoNs, SpanNs};
use std::ffi::OsStr;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};

/// Tells the service manager a state such as `READY=1`; where there is none, or it does not listen, nothing is told.
pub fn tell_service_manager(state: &str) {
    if let Some(name) = std::env::var_os("NOTIFY_SOCKET") {
        let _ = send(&name, state); // as sd_notify(3) advises, a program goes on without it
    }
}

/// Parts of the time that the service manager waits for a sign of life after which the next one is sent. Chosen by hand: sd_watchdog_enabled(3)
/// advises half of it, and a third leaves one to be lost.
const SIGNS_PER_WAIT: i64 = 3;

/// The service manager's watchdog (`WatchdogSec` of a unit), which ends this process when signs of life stay out.
#[derive(Debug)]
pub struct ServiceWatchdog {
    /// Time between two signs of life; `None` where nobody waits for them.
    period: Option<SpanNs>,
    next: MonoNs,
}

impl ServiceWatchdog {
    /// As `WATCHDOG_USEC` and `WATCHDOG_PID` of the environment say.
    #[must_use]
    pub fn from_environment() -> Self {
        let variable = |name| std::env::var(name).ok();
        let is_meant = variable("WATCHDOG_PID").is_none_or(|pid| pid.parse() == Ok(std::process::id()));
        let wait_us = variable("WATCHDOG_USEC").filter(|_| is_meant);
        Self { period: wait_us.and_then(|text| period(&text)), next: MonoNs::ZERO }
    }

    /// Control has ticked: tells that at `now`, no more often than needed.
    pub fn feed(&mut self, now: MonoNs) {
        if let Some(period) = self.period.filter(|_| now >= self.next) {
            self.next = now + period;
            tell_service_manager("WATCHDOG=1");
        }
    }
}

/// Time between two signs of life where the service manager waits for so many microseconds.
fn period(wait_us: &str) -> Option<SpanNs> {
    let wait_us: i64 = wait_us.trim().parse().ok().filter(|us| *us > 0)?;
    Some(SpanNs(wait_us.saturating_mul(1000) / SIGNS_PER_WAIT))
}

fn send(name: &OsStr, state: &str) -> std::io::Result<()> {
    let address = match name.as_bytes() {
        // An `@` stands for the zero byte of the abstract namespace.
        [b'@', name @ ..] => SocketAddr::from_abstract_name(name)?,
        _ => SocketAddr::from_pathname(name)?,
    };
    UnixDatagram::unbound()?.send_to_addr(state.as_bytes(), &address).map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_watchdog_is_fed_three_times_as_often_as_it_bites() {
        assert_eq!(period("3000000"), Some(SpanNs(1_000_000_000)));
        for nothing in ["", "0", "-5", "soon"] {
            assert_eq!(period(nothing), None, "{nothing}");
        }
        assert!(period(&i64::MAX.to_string()).is_some_and(|period| period.0 > 0));
    }

    #[test]
    fn states_reach_both_kinds_of_sockets() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify");
        let name = format!("vservo-test-{}", std::process::id());
        let listening = [
            (UnixDatagram::bind(&path).unwrap(), path.into_os_string()),
            (
                UnixDatagram::bind_addr(&SocketAddr::from_abstract_name(&name).unwrap()).unwrap(),
                format!("@{name}").into(),
            ),
        ];
        for (socket, address) in listening {
            send(&address, "READY=1").unwrap();
            let mut buffer = [0; 16];
            let length = socket.recv(&mut buffer).unwrap();
            assert_eq!(&buffer[..length], b"READY=1");
        }
        assert!(send(OsStr::new("/nowhere/at/all"), "READY=1").is_err());
    }
}
