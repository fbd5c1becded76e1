//! The arm as the controller sees it: states come out, commands go in.
//!
//! ```text
//! read(now) -> DriveState -> Controller::step -> DriveCommand -> write(command), held until the next one
//! ```

mod ideal;
mod simulated;
mod standstill;

pub use ideal::IdealDrive;
pub use simulated::{SimulatedDrive, SimulatedDriveError};
pub use standstill::StandstillDrive;

use crate::time::MonoNs;
use nalgebra::SVector;

/// What a drive reports.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriveState<const N: usize> {
    /// Joint positions, rad or m.
    pub q: SVector<f64, N>,
    /// Joint velocities.
    pub qd: SVector<f64, N>,
    /// The true positions and velocities, where the arm is simulated.
    pub truth: Option<(SVector<f64, N>, SVector<f64, N>)>,
}

/// What a drive is told; which part it obeys is its own matter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriveCommand<const N: usize> {
    /// Torques or forces, N m or N.
    pub tau: SVector<f64, N>,
    /// Reference positions, rad or m.
    pub q_r: SVector<f64, N>,
    /// Reference velocities.
    pub qd_r: SVector<f64, N>,
}

/// An arm.
pub trait Drive<const N: usize> {
    /// The state at `now`, which never runs backwards.
    fn read(&mut self, now: MonoNs) -> DriveState<N>;

    /// Takes a command, which holds until the next one.
    fn write(&mut self, command: &DriveCommand<N>);
}
