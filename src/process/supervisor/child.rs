//! A process that the supervisor started: this same executable in another role.

use super::RunOutputs;
use super::reap::{ChildState, Used, reap};
use crate::ipc::{Instance, Role, is_suspended};
use crate::messages::CameraId;
use crate::process::ProcessError;
use crate::process::drive_guard::{CAMERA_VARIABLE, program_key};
use crate::report::summary::ProcessUsage;
use crate::rt::{log_environment, now};
use crate::time::{MonoNs, SpanNs};
use rustix::process::{Pid, Signal, kill_process};
use std::fmt;
use std::fs::File;
use std::io::Read;
use std::os::fd::AsFd;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};
use std::thread::JoinHandle;

/// What counts as the end of a process that cannot be waited for: exit code 1, never a success.
const LOST_CODE: i32 = 1;

/// How a process ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::process) struct ProcessEnd(ExitStatus);

impl From<ExitStatus> for ProcessEnd {
    fn from(status: ExitStatus) -> Self {
        Self(status)
    }
}

impl ProcessEnd {
    /// Its exit code; `None` when a signal ended it.
    pub(in crate::process) fn exit_code(self) -> Option<u8> {
        self.0.code().and_then(|c| u8::try_from(c).ok())
    }
}

impl fmt::Display for ProcessEnd {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.0.code(), self.0.signal()) {
            (Some(code), _) => write!(f, "exit code {code}"),
            // The kernel has no other way to say that a page of shared memory cannot be had.
            (None, Some(signal)) if signal == Signal::BUS.as_raw() => {
                write!(f, "killed by signal {signal} (SIGBUS): /dev/shm is full? free some space there")
            }
            (None, Some(signal)) => write!(f, "killed by signal {signal}"),
            (None, None) => write!(f, "{}", self.0),
        }
    }
}

/// A started process; killed and reaped when dropped.
pub(in crate::process) struct Child {
    role: Role,
    process: std::process::Child,
    started: MonoNs,
    end: Option<ProcessEnd>,
    /// What it used, and in how long a life; with those before it in its place.
    used: Option<(Used, SpanNs)>,
    before: (Used, SpanNs),
    output: Option<JoinHandle<String>>,
}

impl Child {
    /// Starts `role` of `instance`. It reads its configuration from the very file that was written, not from a path
    /// under which another could lie.
    pub(super) fn spawn(
        role: Role,
        instance: &Instance,
        config: &File,
        outputs: RunOutputs<'_>,
    ) -> Result<Self, ProcessError> {
        let failed = |cause| ProcessError::Start { what: role.command(), cause };
        let mut command = Command::new(std::env::current_exe().map_err(failed)?);
        command
            .arg(role.command())
            .arg(instance.config_path())
            .args(["--instance", &instance.to_string()])
            .args(["--supervised-by", &std::process::id().to_string(), "--config-on-stdin"])
            .envs(log_environment())
            .stdin(config.try_clone().map_err(failed)?)
            // A group of its own: Ctrl-C reaches the supervisor alone, which ends its children in order.
            .process_group(0);
        if let Some(camera) = role.camera() {
            command.args(["--camera", &camera.to_string()]);
        }
        if let Some(folder) =
            outputs.report.filter(|_| matches!(role, Role::Control | Role::Vision(CameraId::FIRST)))
        {
            command.arg("--report").arg(folder.path());
        }
        if let Some(file) = outputs.recording.filter(|_| role == Role::Recorder) {
            command.arg("--out").arg(file);
        }
        if let Some(settings) = outputs.black_box.filter(|_| role == Role::BlackBox) {
            command.args(["--last", &settings.last.as_s().to_string()]).arg("--out").arg(&settings.folder);
        }
        if role == Role::Control {
            command.arg("--json").stdout(Stdio::piped());
        }
        keep_descriptors_here(&mut command);
        let started = now();
        let mut process = command.spawn().map_err(failed)?;
        let output = process.stdout.take().and_then(|mut pipe| {
            let read = move || {
                let mut text = String::new();
                let _ = pipe.read_to_string(&mut text);
                text
            };
            std::thread::Builder::new().name("control-output".into()).spawn(read).ok()
        });
        Ok(Self::of(role, process, started, output))
    }

    /// A process that was just `started`, and who reads its output.
    fn of(
        role: Role,
        process: std::process::Child,
        started: MonoNs,
        output: Option<JoinHandle<String>>,
    ) -> Self {
        Self { role, process, started, end: None, used: None, before: Default::default(), output }
    }

    /// Starts the program of an external drive or camera, behind its guard: it ends when the supervisor has, but not before control.
    pub(in crate::process) fn spawn_program(
        role: Role,
        all: &[String],
        folder: &Path,
        instance: &Instance,
    ) -> Result<Option<Self>, ProcessError> {
        let [program, ..] = all else { return Ok(None) };
        let key = program_key(role.camera().is_some());
        let failed = |cause| ProcessError::ForeignProgram {
            key,
            program: program.clone(),
            folder: folder.into(),
            cause,
        };
        let mut command = Command::new(std::env::current_exe().map_err(failed)?);
        command
            .args(["drive-guard", "--instance", &instance.to_string()])
            .args(["--supervised-by", &std::process::id().to_string(), "--"])
            .args(all)
            .current_dir(folder)
            .envs(instance.environment())
            .envs(role.camera().map(|camera| (CAMERA_VARIABLE, camera.to_string())))
            .envs(log_environment())
            .stdin(Stdio::null())
            // stdout belongs to the results of the run.
            .stdout(std::io::stderr().as_fd().try_clone_to_owned().map_err(failed)?)
            .process_group(0);
        keep_descriptors_here(&mut command);
        let started = now();
        let process = command.spawn().map_err(failed)?;
        Ok(Some(Self::of(role, process, started, None)))
    }

    pub(super) fn role(&self) -> Role {
        self.role
    }

    /// How it ended, if it has.
    pub(in crate::process) fn poll(&mut self) -> Option<ProcessEnd> {
        if self.end.is_none() {
            self.reap(false);
        }
        self.end
    }

    /// Whether it is suspended by a signal.
    pub(super) fn is_suspended(&self) -> bool {
        self.end.is_none() && is_suspended(Pid::from_child(&self.process).as_raw_nonzero().get())
    }

    /// What it used, once it has ended, with those before it in its place.
    pub(super) fn usage(&self) -> Option<ProcessUsage> {
        self.used.map(|(used, life)| used.over(life))
    }

    /// The same process in the place of `dead`, which has ended.
    pub(super) fn in_place_of(mut self, dead: &Self) -> Self {
        self.before = dead.used.unwrap_or(dead.before);
        self
    }

    /// Takes note of its end. It must not have ended before: its number may belong to another process by now.
    fn reap(&mut self, wait: bool) {
        let (status, used) = match reap(Pid::from_child(&self.process), wait) {
            ChildState::Running => return,
            ChildState::Ended(status, used) => (status, Some(used)),
            ChildState::Lost => (ExitStatus::from_raw(LOST_CODE << 8), None),
        };
        self.end = Some(ProcessEnd(status));
        let (before, life_before) = self.before;
        self.used = used.map(|used| (used.with(before), SpanNs((now() - self.started).0 + life_before.0)));
    }

    /// Asks it to end.
    pub(in crate::process) fn terminate(&mut self) {
        if self.poll().is_none() {
            let _ = kill_process(Pid::from_child(&self.process), Signal::TERM);
        }
    }

    /// Ends it.
    pub(in crate::process) fn kill(&mut self) {
        if self.poll().is_none() {
            let _ = kill_process(Pid::from_child(&self.process), Signal::KILL);
        }
    }

    /// Waits for its end.
    pub(super) fn wait(&mut self) -> ProcessEnd {
        if self.end.is_none() {
            self.reap(true);
        }
        self.end.unwrap_or(ProcessEnd(ExitStatus::from_raw(LOST_CODE << 8)))
    }

    /// All that it wrote to stdout, once it has ended.
    pub(super) fn take_output(&mut self) -> Option<String> {
        self.output.take()?.join().ok()
    }
}

/// Has the kernel close all files of this process but stdin, stdout and stderr in the program that `command` starts: those of the transport are not marked so
/// by themselves, and would be open in a process that is started later for as long as it lives.
#[allow(unsafe_code)]
fn keep_descriptors_here(command: &mut Command) {
    /// The first descriptor after stderr, since those up to it are given on purpose.
    const FIRST: libc::c_uint = 3;
    let mark = || {
        // SAFETY: the call takes three numbers and touches no memory. A kernel before 5.11 does not know it, and leaves the files open.
        unsafe { libc::syscall(libc::SYS_close_range, FIRST, libc::c_uint::MAX, libc::CLOSE_RANGE_CLOEXEC) };
        Ok(())
    };
    // SAFETY: between fork and exec the closure makes one system call and neither allocates nor takes a lock.
    unsafe { command.pre_exec(mark) };
}

impl Drop for Child {
    fn drop(&mut self) {
        self.kill();
        self.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bus_error_is_told_as_what_it_means_here() {
        let by_signal = |signal: Signal| ProcessEnd(ExitStatus::from_raw(signal.as_raw())).to_string();
        assert!(by_signal(Signal::BUS).contains("/dev/shm is full?"));
        assert_eq!(by_signal(Signal::KILL), "killed by signal 9");
        assert_eq!(ProcessEnd(ExitStatus::from_raw(3 << 8)).to_string(), "exit code 3");
    }
}
