//! A rigid-body arm: `B(q) qdd + C(q, qd) qd + g(q) = tau`, integrated by Runge-Kutta of fourth order in equal
//! sub-steps of at most 1 ms. The torque is held between commands, as a real drive does.

use super::{Drive, DriveCommand, DriveState};
use crate::robot::Robot;
use crate::time::MonoNs;
use nalgebra::SVector;
use thiserror::Error;

/// Longest integration step: the dynamics of an arm is well resolved below it.
const LONGEST_STEP_NS: i64 = 1_000_000;

/// A simulated arm cannot be made like this.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum SimulatedDriveError {
    /// No sub-steps.
    #[error("the number of sub-steps in a tick must be at least 1")]
    NoSubsteps,
}

/// A simulated arm.
#[derive(Debug, Clone)]
pub struct SimulatedDrive<const N: usize> {
    robot: Robot<N>,
    q: SVector<f64, N>,
    qd: SVector<f64, N>,
    tau: SVector<f64, N>,
    time: Option<MonoNs>,
    step_ns: i64,
}

impl<const N: usize> SimulatedDrive<N> {
    /// An arm at rest in `q`, integrated in `substeps` equal steps per millisecond.
    ///
    /// Until the first command it is held by its brakes: torque that balances gravity in `q`.
    ///
    /// # Errors
    /// When `substeps` is zero.
    pub fn new(robot: Robot<N>, q: SVector<f64, N>, substeps: u32) -> Result<Self, SimulatedDriveError> {
        if substeps == 0 {
            return Err(SimulatedDriveError::NoSubsteps);
        }
        let tau = robot.gravity(&q);
        let step_ns = (LONGEST_STEP_NS / i64::from(substeps)).max(1);
        Ok(Self { robot, q, qd: SVector::zeros(), tau, time: None, step_ns })
    }

    /// Kinetic and potential energy, J.
    #[must_use]
    pub fn energy_j(&self) -> f64 {
        self.robot.kinetic_energy(&self.q, &self.qd) + self.robot.potential_energy(&self.q)
    }

    fn integrate(&mut self, h: f64) {
        let f = |q: &SVector<f64, N>, qd: &SVector<f64, N>| self.robot.forward_dynamics(q, qd, &self.tau);
        let (q, v) = (self.q, self.qd);
        let a1 = f(&q, &v);
        let (q2, v2) = (q + v * (h / 2.0), v + a1 * (h / 2.0));
        let a2 = f(&q2, &v2);
        let (q3, v3) = (q + v2 * (h / 2.0), v + a2 * (h / 2.0));
        let a3 = f(&q3, &v3);
        let (q4, v4) = (q + v3 * h, v + a3 * h);
        let a4 = f(&q4, &v4);
        self.q = q + (v + v2 * 2.0 + v3 * 2.0 + v4) * (h / 6.0);
        self.qd = v + (a1 + a2 * 2.0 + a3 * 2.0 + a4) * (h / 6.0);
    }
}

impl<const N: usize> Drive<N> for SimulatedDrive<N> {
    fn read(&mut self, now: MonoNs) -> DriveState<N> {
        let mut time = *self.time.get_or_insert(now);
        while time < now {
            let step_ns = (now - time).0.min(self.step_ns);
            self.integrate(step_ns as f64 * 1e-9);
            time.0 += step_ns;
        }
        self.time = Some(time);
        DriveState { q: self.q, qd: self.qd, truth: Some((self.q, self.qd)) }
    }

    fn write(&mut self, command: &DriveCommand<N>) {
        self.tau = command.tau;
    }
}
