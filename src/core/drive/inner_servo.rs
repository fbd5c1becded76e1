//! The servo inside a simulated drive that is commanded by velocity or position: `tau` by inverse dynamics of the
//! maker's model (rotors and friction as they are, without the payload), with integral action that takes up what that model does not know, from the first: a drive has held its arm before a run begins.
//!
//! ```text
//! position: y = qdd_r + 3 w^2 e + 3 w e' + w^3 int e,   e = q_r - q    (triple pole at -w)
//! velocity: y = qdd_r + 2 w e' + w^2 int e',            e' = qd_r - qd (double pole at -w)
//! ```
//! A joint with viscous friction `D` gets `D` times the output of a loop of one pole less beside that, so that its poles stay at `-w` (and one at `-w - D/I`), and a light
//! wrist in a heavy gear is held against what is not known by its friction, not by its inertia:
//!
//! ```text
//! position: D (2 w e + w^2 int e)        velocity: D w int e'
//! ```
//! A command says where and how fast the arm shall be one tick after it takes effect. On the way there the servo
//! interpolates, as drives in cyclic modes do: between the velocities linearly, which gives `qdd_r`. Without that the
//! servo's zeros would overshoot what the commands accelerate with by `e^-2`, 13.5 %.

use super::{CommandMode, DriveCommand};
use crate::linalg::Ldlt;
use crate::robot::Robot;
use crate::time::TICK;
use nalgebra::SVector;

/// Settings of the inner servo.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InnerServo {
    /// Its poles, rad/s.
    pub natural_frequency_rad_s: f64,
}

/// What it remembers: the integral of its error, per joint.
#[derive(Debug, Clone)]
pub(super) struct VelocityLoop<const N: usize> {
    omega_rad_s: f64,
    integral: SVector<f64, N>,
    /// The velocity at which the command that acts took over, and how long ago that was, s.
    from: SVector<f64, N>,
    elapsed_s: f64,
    target: Option<SVector<f64, N>>,
}

impl<const N: usize> VelocityLoop<N> {
    pub(super) fn new(settings: InnerServo) -> Self {
        let zero = SVector::zeros();
        let omega_rad_s = settings.natural_frequency_rad_s;
        Self { omega_rad_s, integral: zero, from: zero, elapsed_s: 0.0, target: None }
    }

    /// The same of a drive that has held the arm at `q` (rad or m) before, and bears what its model of the `robot` does not know: the torques `unknown`, N m or N.
    pub(super) fn holding(
        mut self,
        robot: &Robot<N>,
        mode: CommandMode,
        q: &SVector<f64, N>,
        unknown: &SVector<f64, N>,
    ) -> Self {
        let w = self.omega_rad_s;
        let mut per_integral = robot.mass_matrix(q) * w;
        for (i, friction) in robot.friction().iter().enumerate() {
            per_integral[(i, i)] += friction.viscous;
        }
        let held = |factors: Ldlt<N>| SVector::from(factors.solve(&(*unknown).into()));
        let integral = Ldlt::of(&per_integral).map_or_else(SVector::zeros, held);
        self.integral = match mode {
            CommandMode::Torque => SVector::zeros(),
            CommandMode::Velocity => integral / w,
            CommandMode::Position => integral / (w * w),
        };
        self
    }

    /// From now on `command` acts; the first one finds the arm moving with `qd`.
    pub(super) fn take(&mut self, command: &DriveCommand<N>, qd: &SVector<f64, N>) {
        self.from = self.target.unwrap_or(*qd);
        self.target = Some(command.qd_r);
        self.elapsed_s = 0.0;
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
        if mode == CommandMode::Torque {
            return command.tau;
        }
        let w = self.omega_rad_s;
        // A command that is not followed by another one holds.
        let left_s = (TICK.as_s() - self.elapsed_s).max(0.0);
        let qdd_r = if left_s > 0.0 { (command.qd_r - self.from) / TICK.as_s() } else { SVector::zeros() };
        let qd_r = command.qd_r - qdd_r * left_s;
        let q_r = command.q_r - (command.qd_r + qd_r) * (0.5 * left_s);
        self.elapsed_s += h;
        let (e, e_dot) = (q_r - q, qd_r - qd);
        let (feedback, against_friction, integrand) = match mode {
            CommandMode::Velocity => (e_dot * (2.0 * w) + self.integral * (w * w), self.integral * w, e_dot),
            CommandMode::Torque | CommandMode::Position => (
                e * (3.0 * w * w) + e_dot * (3.0 * w) + self.integral * (w * w * w),
                e * (2.0 * w) + self.integral * (w * w),
                e,
            ),
        };
        // The middle of the step stands for all of it; friction is that of its end.
        let y = qdd_r + feedback;
        let qd_mid = qd + y * (0.5 * h);
        let q_mid = q + (qd + qd_mid) * (0.25 * h);
        let rubs = SVector::<f64, N>::from_fn(|i, _| robot.friction()[i].viscous * against_friction[i]);
        let tau =
            robot.inverse_dynamics(&q_mid, &qd_mid, &y) + robot.friction_torque(&(qd_r + qdd_r * h)) + rubs;
        for i in 0..N {
            // A joint at its effort limit does not integrate: its integral would only grow.
            if tau[i].abs() < robot.limits()[i].effort {
                self.integral[i] += integrand[i] * h;
            }
        }
        tau
    }
}
