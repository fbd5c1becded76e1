//! How long a control step takes, measured at the drive: from its state to its command.

use crate::config::Config;
use crate::config::assemble::{self, AnyDrive};
use crate::drive::{CommandMode, Drive, DriveCommand, DriveHealth, DriveState};
use crate::robot::Robot;
use crate::rt::now;
use crate::sim::{Drives, SimError};
use crate::time::MonoNs;
use std::sync::{Arc, Mutex};

/// Times of a run that are kept. Chosen by hand: ten seconds of ticks, from which a median is taken.
const KEPT: usize = 10_000;

/// The drives of run files, with a clock about the control step.
#[derive(Default)]
pub(super) struct TimedDrives {
    spans_ns: Arc<Mutex<Vec<i64>>>,
}

impl TimedDrives {
    /// From a state of the drive to the command after it, in the middle.
    pub(super) fn median_ns(&self) -> Option<f64> {
        let mut spans = self.spans_ns.lock().ok()?;
        spans.sort_unstable();
        spans.get(spans.len() / 2).map(|ns| *ns as f64)
    }
}

impl Drives for TimedDrives {
    fn drive<const N: usize>(&mut self, config: &Config, robot: &Robot<N>) -> Result<AnyDrive<N>, SimError> {
        let drive = assemble::drive(config, robot)?;
        Ok(Box::new(TimedDrive { drive, read: None, spans_ns: Arc::clone(&self.spans_ns) }))
    }
}

/// A drive that notes how long control takes.
struct TimedDrive<const N: usize> {
    drive: AnyDrive<N>,
    read: Option<MonoNs>,
    spans_ns: Arc<Mutex<Vec<i64>>>,
}

impl<const N: usize> Drive<N> for TimedDrive<N> {
    fn read(&mut self, at: MonoNs) -> DriveState<N> {
        let state = self.drive.read(at);
        self.read = Some(now());
        state
    }

    fn write(&mut self, command: &DriveCommand<N>) {
        let span = self.read.take().map(|read| (now() - read).0);
        if let (Some(span), Ok(mut spans)) = (span, self.spans_ns.lock())
            && spans.len() < KEPT
        {
            spans.push(span);
        }
        self.drive.write(command);
    }

    fn modes(&self) -> &'static [CommandMode] {
        self.drive.modes()
    }

    fn health(&self) -> DriveHealth {
        self.drive.health()
    }

    fn reset(&mut self) {
        self.drive.reset();
    }

    fn clear_robot(&mut self, asked: bool) {
        self.drive.clear_robot(asked);
    }

    fn end(&mut self, last: &DriveCommand<N>) {
        self.drive.end(last);
    }
}
