//! A drive without dynamics: the joints are where the reference says, `q = q_r` of (10.75).

use super::{Drive, DriveCommand, DriveState};
use crate::time::MonoNs;
use nalgebra::SVector;

/// Joints that follow the reference exactly.
#[derive(Debug, Clone)]
pub struct IdealDrive<const N: usize> {
    q: SVector<f64, N>,
    qd: SVector<f64, N>,
}

impl<const N: usize> IdealDrive<N> {
    /// An arm at rest in `q`.
    #[must_use]
    pub fn new(q: SVector<f64, N>) -> Self {
        Self { q, qd: SVector::zeros() }
    }
}

impl<const N: usize> Drive<N> for IdealDrive<N> {
    fn read(&mut self, _now: MonoNs) -> DriveState<N> {
        DriveState { q: self.q, qd: self.qd, truth: Some((self.q, self.qd)) }
    }

    fn write(&mut self, command: &DriveCommand<N>) {
        self.q = command.q_r;
        self.qd = command.qd_r;
    }
}
