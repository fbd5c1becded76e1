//! A command that a step runs, with all that it starts.

use crate::rt::kill_with_group;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, ExitStatus, Stdio};

/// A command in a process group of its own; what is left of it is killed when this is dropped before its end.
#[derive(Debug)]
pub(super) struct RunningCommand {
    child: Child,
    has_ended: bool,
}

impl RunningCommand {
    /// Starts `program`. In a group of its own it has no keys of a terminal: Ctrl-C comes to this process, which ends it.
    pub(super) fn start(program: &str, arguments: &[String]) -> std::io::Result<Self> {
        let child = Command::new(program).args(arguments).stdin(Stdio::null()).process_group(0).spawn()?;
        Ok(Self { child, has_ended: false })
    }

    /// How it has ended; `None` before.
    pub(super) fn ended(&mut self) -> std::io::Result<Option<ExitStatus>> {
        let status = self.child.try_wait()?;
        self.has_ended = status.is_some();
        Ok(status)
    }
}

impl Drop for RunningCommand {
    /// All of its group, and at once: what it has started would act later, when nobody expects it any more.
    fn drop(&mut self) {
        if !self.has_ended {
            kill_with_group(&mut self.child);
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use std::time::Duration;

    #[test]
    fn what_a_command_has_started_ends_with_it() {
        let folder = tempfile::tempdir().unwrap();
        let (begun, acted) = (folder.path().join("begun"), folder.path().join("acted"));
        let script = format!(
            "(echo $$ > {begun}; sleep 1; echo acts > {acted}) & wait",
            begun = begun.display(),
            acted = acted.display()
        );
        let mut command = RunningCommand::start("sh", &["-c".into(), script]).unwrap();
        while !begun.exists() {
            assert!(command.ended().unwrap().is_none());
            std::thread::sleep(Duration::from_millis(5));
        }
        drop(command);
        std::thread::sleep(Duration::from_millis(1500));
        assert!(!acted.exists(), "a grandchild went on");
    }
}
