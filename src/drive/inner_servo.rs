//! The servo inside a simulated drive that is commanded by velocity or position: `tau` by inverse dynamics of the
//! maker's model (without the payload), with integral action that takes up what that model does not know.
//!
//! ```text
//! position: y = 3 w^2 e + 3 w e' + w^3 int e,   e = q_r - q    (triple pole at -w)
//! velocity: y = 2 w e' + w^2 int e',            e' = qd_r - qd (double pole at -w)
//! ```

use super::{CommandMode, DriveCommand};
use crate::robot::Robot;
use nalgebra::SVector;

/// Settings of the inner servo.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InnerServo {
    /// Its poles, rad/s.
    pub natural_frequency_rad_s: f64,
}

/// What it remembers: the integral of its error, per joint.
#[derive(Debug, Clone)]
pub(super) struct Loop<const N: usize> {
    omega_rad_s: f64,
    integral: SVector<f64, N>,
}

impl<const N: usize> Loop<N> {
    pub(super) fn new(settings: InnerServo) -> Self {
        Self { omega_rad_s: settings.natural_frequency_rad_s, integral: SVector::zeros() }
    }

    /// The torque for the next `h` seconds, within the effort limits.
    pub(super) fn torque(
        &mut self,
        robot: &Robot<N>,
        mode: CommandMode,
        command: &DriveCommand<N>,
        (q, qd): (&SVector<f64, N>, &SVector<f64, N>),
        h: f64,
    ) -> SVector<f64, N> {
        let w = self.omega_rad_s;
        let (e, e_dot) = (command.q_r - q, command.qd_r - qd);
        let (y, integrand) = match mode {
            CommandMode::Torque => return command.tau,
            CommandMode::Velocity => (e_dot * (2.0 * w) + self.integral * (w * w), e_dot),
            CommandMode::Position => (e * (3.0 * w * w) + e_dot * (3.0 * w) + self.integral * (w * w * w), e),
        };
        let tau = robot.inverse_dynamics(q, qd, &y) + robot.friction_torque(&command.qd_r);
        for i in 0..N {
            // A joint at its effort limit does not integrate: its integral would only grow.
            if tau[i].abs() < robot.limits()[i].effort {
                self.integral[i] += integrand[i] * h;
            }
        }
        tau
    }
}
