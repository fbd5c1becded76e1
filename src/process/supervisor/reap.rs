//! The end of a child process, and what it used: the kernel tells both in one call, and only once.

use crate::report::summary::ProcessUsage;
use crate::time::SpanNs;
use rustix::process::Pid;
use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;

/// What a process used up in its life.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Used {
    cpu_s: f64,
    max_resident_mb: f64,
}

impl Used {
    /// With what another process used before.
    pub(super) fn with(self, before: Self) -> Self {
        Self {
            cpu_s: self.cpu_s + before.cpu_s,
            max_resident_mb: self.max_resident_mb.max(before.max_resident_mb),
        }
    }

    /// With the length of its life.
    pub(super) fn over(self, life: SpanNs) -> ProcessUsage {
        let cpu_share = if life.0 > 0 { self.cpu_s / life.as_s() } else { 0.0 };
        ProcessUsage { cpu_s: self.cpu_s, cpu_share, max_resident_mb: self.max_resident_mb }
    }
}

/// What a child is found to be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum ChildState {
    /// It runs.
    Running,
    /// It has ended, and is reaped now.
    Ended(ExitStatus, Used),
    /// It cannot be waited for.
    Lost,
}

/// Reaps the child `pid`, which must not have been reaped before; waits for its end when `wait` is set.
#[allow(unsafe_code)]
pub(super) fn reap(pid: Pid, wait: bool) -> ChildState {
    let flags = if wait { 0 } else { libc::WNOHANG };
    loop {
        let mut status = 0;
        // SAFETY: `rusage` is a record of numbers, for which zero is a valid value.
        let mut usage: libc::rusage = unsafe { std::mem::zeroed() };
        // SAFETY: the call writes one integer and one record, which both live until it returns.
        let result = unsafe { libc::wait4(pid.as_raw_pid(), &mut status, flags, &mut usage) };
        match result {
            0 => return ChildState::Running,
            -1 if std::io::Error::last_os_error().kind() == std::io::ErrorKind::Interrupted => {}
            -1 => return ChildState::Lost,
            _ => return ChildState::Ended(ExitStatus::from_raw(status), used(&usage)),
        }
    }
}

fn used(usage: &libc::rusage) -> Used {
    let seconds = |t: &libc::timeval| t.tv_sec as f64 + t.tv_usec as f64 * 1e-6;
    Used {
        cpu_s: seconds(&usage.ru_utime) + seconds(&usage.ru_stime),
        max_resident_mb: usage.ru_maxrss as f64 * 1024e-6, // the kernel counts in KiB
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::{Command, Stdio};

    #[test]
    #[allow(clippy::zombie_processes)] // waited for by what is tested
    fn a_child_is_found_running_then_ended_then_lost() {
        let mut child = Command::new("cat").stdin(Stdio::piped()).stdout(Stdio::null()).spawn().unwrap();
        let pid = Pid::from_child(&child);
        assert_eq!(reap(pid, false), ChildState::Running);
        drop(child.stdin.take());
        let ChildState::Ended(status, used) = reap(pid, true) else { panic!("it ended") };
        assert!(status.success());
        assert!(used.max_resident_mb > 0.1 && used.cpu_s >= 0.0, "{used:?}");
        assert_eq!(reap(pid, false), ChildState::Lost);
    }

    #[test]
    fn the_share_is_of_one_core_over_the_whole_life() {
        let used = Used { cpu_s: 3.0, max_resident_mb: 12.0 };
        assert_eq!(used.over(SpanNs::from_s(2.0)).cpu_share, 1.5);
        assert_eq!(used.over(SpanNs(0)).cpu_share, 0.0);
        let both = used.with(Used { cpu_s: 1.0, max_resident_mb: 20.0 });
        assert_eq!(both, Used { cpu_s: 4.0, max_resident_mb: 20.0 });
    }
}
