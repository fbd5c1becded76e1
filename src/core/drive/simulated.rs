//! A rigid-body arm: `B(q) qdd + C(q, qd) qd + g(q) + friction(qd) = tau`, integrated by Runge-Kutta of fourth order,
//! its friction implicitly, in equal sub-steps of at most 1 ms, with what a real drive has beside it: effort limits,
//! encoders, a delay of its commands, a load that the controller does not know.
//!
//! ```text
//! write ─► delay ─► torque, or inner servo (velocity, position) ─► effort limits ─► arm ─► truth
//! read  ◄───────────────────────────────────────────────────────────── encoders ◄───┘
//! ```
//! Until the first command arrives the arm is held by its brakes and does not move.

use super::delay::{Delay, MAX_DELAY};
use super::elastic_joints::ElasticJoints;
use super::encoder::Encoder;
use super::friction::{after_friction, has_friction};
use super::hard_friction::HardFriction;
use super::inner_servo::VelocityLoop;
use super::surroundings::Surroundings;
use super::{
    CommandMode, Drive, DriveCommand, DriveState, EncoderModel, InnerServo, ShakingBase, TorqueRipple,
};
use crate::faults::JointFaults;
use crate::robot::{Friction, Inertia, Robot};
use crate::time::{MonoNs, SpanNs};
use nalgebra::{SVector, Vector3};
use thiserror::Error;

/// Longest integration step. Chosen by hand: the tick of control; the energy tests of `tests/cores/robot_energy.rs` measure the integrator.
const LONGEST_STEP_NS: i64 = 1_000_000;

/// A simulated arm cannot be made like this.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum SimulatedDriveError {
    /// No sub-steps.
    #[error("drive.simulated.substeps: the number of sub-steps in a tick must be at least 1")]
    NoSubsteps,
    /// The delay does not fit the delay line.
    #[error("drive.simulated.command_delay_ticks: {0} ticks, at most {MAX_DELAY} are possible")]
    Delay(usize),
}

/// What a simulated arm is made of, beside its rigid bodies.
#[derive(Debug, Clone)]
pub struct SimulatedDriveSettings<const N: usize> {
    /// What it obeys.
    pub mode: CommandMode,
    /// Integration steps per millisecond, at least 1.
    pub substeps: u32,
    /// Whether the joints' friction acts.
    pub friction: bool,
    /// How it does near to a standstill; `None`: it changes its sign smoothly, as in the model.
    pub hard_friction: Option<HardFriction>,
    /// Inertia of the rotors beyond that of the arm's file, as the joints feel it, kg m^2 or kg.
    pub rotor_inertia: SVector<f64, N>,
    /// By how much joints yield to their largest efforts, rad or m; `None`: they are rigid. The encoders are on the motors.
    pub wind_up: Option<f64>,
    /// Ripple of the motors' torques.
    pub ripple: Option<TorqueRipple>,
    /// Motion of the base.
    pub base: Option<ShakingBase>,
    /// Whether torques are cut at the effort limits.
    pub effort_limits: bool,
    /// Whether states tell the torques of the motors.
    pub tells_torque: bool,
    /// Commands between the one that is written and the one that acts.
    pub command_delay_ticks: usize,
    /// The arm as it is, where that is not what controller and inner servo believe.
    pub arm: Option<Robot<N>>,
    /// True joint positions less what the encoders read, rad or m.
    pub q_offset: SVector<f64, N>,
    /// A load on the flange, in its frame, that neither controller nor inner servo knows.
    pub payload: Inertia,
    /// Encoders.
    pub encoder: EncoderModel<N>,
    /// The servo for velocity and position commands.
    pub servo: InnerServo,
    /// What acts on the arm from outside.
    pub surroundings: Surroundings,
    /// What is put wrong about its encoders and motors on purpose.
    pub faults: JointFaults<N>,
}

impl<const N: usize> Default for SimulatedDriveSettings<N> {
    /// Commanded by torque, with friction and effort limits, everything else ideal.
    fn default() -> Self {
        Self {
            mode: CommandMode::Torque,
            substeps: 1,
            friction: true,
            hard_friction: None,
            rotor_inertia: SVector::zeros(),
            wind_up: None,
            ripple: None,
            base: None,
            effort_limits: true,
            tells_torque: false,
            command_delay_ticks: 0,
            arm: None,
            q_offset: SVector::zeros(),
            payload: Inertia::ZERO,
            encoder: EncoderModel::exact(),
            servo: InnerServo { natural_frequency_rad_s: 60.0 },
            surroundings: Surroundings::default(),
            faults: JointFaults::new(&[], 0),
        }
    }
}

/// A simulated arm.
#[derive(Debug, Clone)]
pub struct SimulatedDrive<const N: usize> {
    /// As its maker knows it, rotors and friction as they are: what the inner servo computes with.
    nominal: Robot<N>,
    /// As it is.
    robot: Robot<N>,
    /// True positions.
    q: SVector<f64, N>,
    qd: SVector<f64, N>,
    q_offset: SVector<f64, N>,
    time: Option<MonoNs>,
    step_ns: i64,
    mode: CommandMode,
    friction: bool,
    hard_friction: Option<HardFriction>,
    elastic: Option<Box<ElasticJoints<N>>>,
    ripple: Option<TorqueRipple>,
    base: Option<ShakingBase>,
    /// Gravity of the arm on a base at rest, m/s^2 in B, and the time since the start, s.
    gravity_B: Vector3<f64>,
    elapsed_s: f64,
    effort_limits: bool,
    tells_torque: bool,
    /// The torques of the motors in the last step, N m or N.
    tau: Option<SVector<f64, N>>,
    commands: Delay<N>,
    servo: VelocityLoop<N>,
    surroundings: Surroundings,
    encoder: Encoder<N>,
    faults: JointFaults<N>,
}

impl<const N: usize> SimulatedDrive<N> {
    /// An arm at rest where its encoders read `q`.
    ///
    /// # Errors
    /// When there are no sub-steps, or the delay is too long.
    pub fn new(
        robot: Robot<N>,
        q: SVector<f64, N>,
        settings: SimulatedDriveSettings<N>,
    ) -> Result<Self, SimulatedDriveError> {
        if settings.substeps == 0 {
            return Err(SimulatedDriveError::NoSubsteps);
        }
        if settings.command_delay_ticks > MAX_DELAY {
            return Err(SimulatedDriveError::Delay(settings.command_delay_ticks));
        }
        let arm = settings.arm.unwrap_or_else(|| robot.clone());
        let q_true = q + settings.q_offset;
        let true_arm = arm.with_load(&settings.payload).with_armature(&settings.rotor_inertia);
        let friction = settings.friction && has_friction(&true_arm);
        let rubs = if settings.friction { *true_arm.friction() } else { [Friction::default(); N] };
        let nominal = robot.with_friction(rubs).with_armature(&settings.rotor_inertia);
        let (elastic, true_arm, q_true) = match settings.wind_up {
            None => (None, true_arm, q_true),
            Some(wind_up) => {
                let (joints, links, hangs) = ElasticJoints::new(&true_arm, &q_true, wind_up);
                (Some(Box::new(joints)), links, hangs)
            }
        };
        // A drive that closes its own loop holds the arm before a run begins, whatever it carries.
        let unknown = true_arm.gravity(&q_true) - nominal.gravity(&q);
        let servo = VelocityLoop::new(settings.servo).holding(&nominal, settings.mode, &q, &unknown);
        Ok(Self {
            q: q_true,
            elastic,
            ripple: settings.ripple,
            base: settings.base,
            gravity_B: true_arm.gravity_vector(),
            elapsed_s: 0.0,
            q_offset: settings.q_offset,
            qd: SVector::zeros(),
            time: None,
            step_ns: (LONGEST_STEP_NS / i64::from(settings.substeps)).max(1),
            mode: settings.mode,
            friction,
            hard_friction: settings.hard_friction,
            robot: true_arm,
            nominal,
            effort_limits: settings.effort_limits,
            tells_torque: settings.tells_torque,
            tau: None,
            commands: Delay::new(settings.command_delay_ticks),
            servo,
            surroundings: settings.surroundings,
            encoder: Encoder::new(settings.encoder),
            faults: settings.faults,
        })
    }

    /// The same arm moving with `qd`, rad/s or m/s.
    #[must_use]
    pub fn with_velocity(self, qd: SVector<f64, N>) -> Self {
        let mut drive = Self { qd, ..self };
        if let Some(joints) = &mut drive.elastic {
            joints.theta_d = qd;
        }
        drive
    }

    /// Kinetic and potential energy, J.
    #[must_use]
    pub fn energy_j(&self) -> f64 {
        self.robot.kinetic_energy(&self.q, &self.qd) + self.robot.potential_energy(&self.q)
    }

    /// The torque that acts for the next `h` seconds; `None` while the brakes hold.
    fn torque(&mut self, h: f64) -> Option<SVector<f64, N>> {
        let command = self.commands.arrived()?;
        let (q, qd) = self.motors();
        let read = q - self.q_offset;
        let mut tau = self.servo.torque(&self.nominal, self.mode, command, (&read, &qd), h);
        if self.effort_limits {
            for (tau, limit) in tau.iter_mut().zip(self.robot.limits()) {
                *tau = tau.clamp(-limit.effort, limit.effort);
            }
        }
        if let Some(ripple) = &self.ripple {
            tau += ripple.torque(&q, |i| self.robot.limits()[i].effort);
        }
        self.faults.weaken(SpanNs::from_s(self.elapsed_s), &mut tau);
        Some(tau)
    }

    /// Where the motors are, and how fast: what encoders read.
    fn motors(&self) -> (SVector<f64, N>, SVector<f64, N>) {
        self.elastic.as_ref().map_or((self.q, self.qd), |elastic| (elastic.theta, elastic.theta_d))
    }

    fn integrate(&mut self, h: f64) {
        let Some(tau) = self.torque(h) else { return };
        self.tau = Some(tau);
        if let Some(base) = &self.base {
            // What accelerates the base is felt as gravity against it.
            let gravity_B = self.gravity_B - base.acceleration(self.elapsed_s + 0.5 * h);
            self.robot.set_gravity(gravity_B);
        }
        self.surroundings.jam(&mut self.robot, &mut self.qd, self.elapsed_s);
        let outside = self.surroundings.torque(&self.robot, (&self.q, &self.qd), self.elapsed_s);
        if let Some(elastic) = &mut self.elastic {
            let friction = self.friction.then_some(self.hard_friction);
            return elastic.integrate(
                &self.robot,
                (&mut self.q, &mut self.qd),
                (&tau, &outside),
                friction,
                h,
            );
        }
        let tau = tau + outside;
        let v = self.qd;
        // The friction of the step's beginning acts throughout; what it changes by is settled at the end.
        let friction = match (self.friction, self.hard_friction) {
            (false, _) => SVector::zeros(),
            (true, None) => self.robot.friction_torque(&v),
            (true, Some(hard)) => hard.torque(&self.robot, &v),
        };
        let before = self.q;
        (self.q, self.qd) = self.robot.integrate(&self.q, &v, &(tau - friction), h);
        if self.friction {
            let smooth = self.qd;
            let impulse = friction * h;
            self.qd = match self.hard_friction {
                None => after_friction(&self.robot, &self.q, v, (&smooth, &impulse), h),
                Some(hard) => hard.after(&self.robot, &self.q, &v, (&smooth, &impulse), h),
            };
            self.q += (self.qd - smooth) * (h / 2.0);
            if self.hard_friction.is_some() {
                // What is held does not creep, not even by the last digits.
                (0..N).filter(|i| v[*i] == 0.0 && self.qd[*i] == 0.0).for_each(|i| self.q[i] = before[i]);
            }
        }
    }
}

impl<const N: usize> Drive<N> for SimulatedDrive<N> {
    fn read(&mut self, now: MonoNs) -> DriveState<N> {
        let before = *self.time.get_or_insert(now);
        let mut time = before;
        while time < now {
            let step_ns = (now - time).0.min(self.step_ns);
            self.integrate(step_ns as f64 * 1e-9);
            self.elapsed_s += step_ns as f64 * 1e-9;
            time.0 += step_ns;
        }
        self.time = Some(time);
        let (motors, motors_d) = self.motors();
        let read = self.encoder.read(&(motors - self.q_offset), &motors_d, (time - before).as_s());
        let (q, qd) = self.faults.reported(SpanNs::from_s(self.elapsed_s), read);
        DriveState { q, qd, truth: Some((self.q, self.qd)) }
    }

    fn write(&mut self, command: &DriveCommand<N>) {
        if self.faults.loses_command(SpanNs::from_s(self.elapsed_s)) {
            return;
        }
        self.commands.push(command);
        if let Some(command) = self.commands.arrived() {
            let speed = self.elastic.as_ref().map_or(self.qd, |elastic| elastic.theta_d);
            self.servo.take(command, &speed);
        }
    }

    fn measured_torque(&self) -> Option<SVector<f64, N>> {
        self.tau.filter(|_| self.tells_torque)
    }

    fn modes(&self) -> &'static [CommandMode] {
        &CommandMode::ALL
    }
}

#[cfg(test)]
mod tests;
