//! An arm that does not move, whatever the commands: for runs whose images come from files, where the loop is open.

use super::{CommandMode, Drive, DriveCommand, DriveState};
use crate::time::MonoNs;
use nalgebra::SVector;

/// Joints that stand still.
#[derive(Debug, Clone)]
pub struct StandstillDrive<const N: usize> {
    q: SVector<f64, N>,
}

impl<const N: usize> StandstillDrive<N> {
    /// An arm that stays in `q`.
    #[must_use]
    pub fn new(q: SVector<f64, N>) -> Self {
        Self { q }
    }
}

impl<const N: usize> Drive<N> for StandstillDrive<N> {
    fn read(&mut self, _now: MonoNs) -> DriveState<N> {
        DriveState { q: self.q, qd: SVector::zeros(), truth: None }
    }

    fn write(&mut self, _command: &DriveCommand<N>) {}

    fn modes(&self) -> &'static [CommandMode] {
        &CommandMode::ALL
    }
}
