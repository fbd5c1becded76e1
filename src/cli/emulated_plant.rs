//! The crate's own simulated arm behind an emulated controller: in a position loop, or under torques, to which the weights are added that a robot knows, its own
//! and that of the load that it was told.

use crate::config::Config;
use crate::config::assemble::{AssembleError, simulated_settings};
use crate::drive::{CommandMode, Drive, DriveCommand, SimulatedDrive, SimulatedDriveSettings};
use crate::process::StopFlag;
use crate::robot::{Inertia, Robot};
use crate::rt::{now, tell};
use crate::time::{MonoNs, TICK};
use nalgebra::SVector;
use std::fmt::{Debug, Display};
use std::str::FromStr;
use std::time::Duration;

/// Tells where the robot listens.
pub(super) fn tell_of(address: impl Display) {
    tell(format_args!("a robot that is none listens on {address}, for this machine alone"));
}

/// Until a stop is requested: lets each of the `faults` come in its time, s from now, and tells what the controller writes in its log.
pub(super) fn attend<F: Copy + Debug>(
    stop: &StopFlag,
    faults: &[(F, f64)],
    inject: impl Fn(F),
    log: impl Fn() -> Vec<String>,
) {
    let start = now();
    let mut faults = faults.to_vec();
    while !stop.is_requested() {
        faults.retain(|(fault, after_s)| {
            let due = (now() - start).as_s() >= *after_s;
            if due {
                tell(format_args!("now: {fault:?}"));
                inject(*fault);
            }
            !due
        });
        for line in log() {
            tell(format_args!("controller: {}", crate::input::printable(&line)));
        }
        // Chosen by hand: nobody notices it.
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// A fault of either maker's emulator, and when it comes, s: `reflex@12.5`.
pub(super) fn timed_fault<F: FromStr<Err = String>>(text: &str) -> Result<(F, f64), String> {
    let (word, time) = text.split_once('@').unwrap_or((text, "0"));
    let seconds: f64 = time.parse().map_err(|_| format!("`{time}` is no time"))?;
    Ok((word.parse()?, seconds))
}

/// Priority of an emulated robot. Chosen by hand: above control and its guardian, because a real one does not share their cores; an hour at 500 Hz and at 1 kHz was run so.
pub(super) const EMULATOR_PRIORITY: u32 = 85;

/// Positions and velocities of the joints, rad and rad/s.
type JointsSeen<const N: usize> = ([f64; N], [f64; N]);

/// The arm.
pub(super) struct EmulatedPlant<const N: usize> {
    robot: Robot<N>,
    /// Without anything on its flange, and with what it was told.
    bare: Robot<N>,
    known: Robot<N>,
    settings: SimulatedDriveSettings<N>,
    drive: SimulatedDrive<N>,
    mode: CommandMode,
    time: MonoNs,
    pub(super) q: SVector<f64, N>,
    pub(super) qd: SVector<f64, N>,
}

impl<const N: usize> EmulatedPlant<N> {
    /// The arm of a run file, at rest at `q`.
    pub(super) fn new(config: &Config, q: SVector<f64, N>) -> Result<Self, AssembleError> {
        let robot: Robot<N> = config.robot.build()?;
        let mode = CommandMode::Position;
        let mut settings = simulated_settings::<N>(config)?;
        settings.mode = mode;
        let drive = SimulatedDrive::new(robot.clone(), q, settings.clone())?;
        let tool = &config.tool;
        let nothing = Inertia { mass: -tool.mass, com: tool.com, about_com: -tool.about_com };
        let bare = robot.clone().with_load(&nothing);
        let known = bare.clone();
        Ok(Self { robot, bare, known, settings, drive, mode, time: MonoNs::ZERO, q, qd: SVector::zeros() })
    }

    fn step(&mut self, mode: CommandMode, command: &DriveCommand<N>) -> JointsSeen<N> {
        if mode != self.mode {
            self.settings.mode = mode;
            // The same settings as before, which were right.
            if let Ok(drive) = SimulatedDrive::new(self.robot.clone(), self.q, self.settings.clone()) {
                (self.drive, self.mode) = (drive.with_velocity(self.qd), mode);
                self.drive.read(self.time);
            }
        }
        self.drive.write(command);
        self.time = self.time + TICK;
        let state = self.drive.read(self.time);
        (self.q, self.qd) = (state.q, state.qd);
        (state.q.into(), state.qd.into())
    }

    /// A tick in the position loop.
    pub(super) fn follow(&mut self, q_d: &SVector<f64, N>, qd_d: &SVector<f64, N>) -> JointsSeen<N> {
        let command = DriveCommand { tau: SVector::zeros(), q_r: *q_d, qd_r: *qd_d, qdd_r: SVector::zeros() };
        self.step(CommandMode::Position, &command)
    }

    /// A tick under torques, beside the weight and these shares of the file's viscous and Coulomb friction.
    pub(super) fn push(&mut self, tau: &[f64; N], viscous: &[f64; N], coulomb: &[f64; N]) -> JointsSeen<N> {
        let shared = |(i, mut friction): (usize, crate::robot::Friction)| {
            friction.viscous *= viscous[i];
            friction.coulomb *= coulomb[i];
            friction
        };
        let mut shares = self.robot.friction().iter().copied().enumerate().map(shared);
        let shares = std::array::from_fn(|_| shares.next().unwrap_or_default());
        let friction = self.robot.clone().with_friction(shares).friction_torque(&self.qd);
        let tau = SVector::from(*tau) + self.known.gravity(&self.q) + friction;
        self.step(
            CommandMode::Torque,
            &DriveCommand { tau, q_r: self.q, qd_r: self.qd, qdd_r: SVector::zeros() },
        )
    }

    /// What the controller is told to carry.
    pub(super) fn carry(&mut self, mass_kg: f64, com_m: [f64; 3]) {
        // For weights the moments of inertia do not matter.
        self.known = self.bare.clone().with_load(&Inertia::point(mass_kg, com_m.into()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::assemble::q_start;
    use std::path::Path;

    /// Under torques without gravity the arm stays, and from one way of commanding to the other it does not leap.
    #[test]
    fn weights_are_carried_and_a_change_of_mode_is_smooth() {
        let config = Config::load(Some(Path::new("fr3-emulated")), &[]).unwrap();
        let q = q_start::<7>(&config).unwrap();
        let mut plant = EmulatedPlant::new(&config, q).unwrap();
        let mut at = q;
        let (still, creeps) = ([0.0; 7], [0.0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0]);
        for _ in 0..500 {
            at[1] += 1e-4;
            plant.follow(&at, &creeps.into());
        }
        assert!((plant.q - at).amax() < 2e-3, "{}", plant.q - at);
        let (before, speed) = (plant.q, plant.qd[1]);
        assert!((speed - 0.1).abs() < 0.01, "{speed}");
        let (after, _) = plant.push(&still, &still, &still);
        assert!((SVector::from(after) - before).amax() < 2e-4, "no leap");
        for _ in 0..200 {
            plant.push(&std::array::from_fn(|i| -5.0 * plant.qd[i]), &still, &still);
        }
        assert!(
            (plant.q - before).amax() < 0.05 && plant.qd.amax() < 0.2,
            "{} {}",
            plant.q - before,
            plant.qd
        );
    }

    /// Of a joint that turns, its controller takes away as much of the friction as it is told: the torque that keeps a speed tells it.
    #[test]
    fn friction_is_compensated_by_the_share_that_is_told() {
        let config = Config::load(Some(Path::new("xarm7")), &[]).unwrap();
        let q = q_start::<7>(&config).unwrap();
        let mut slowed = [0.0; 2];
        for (slowed, share) in slowed.iter_mut().zip([0.0, 0.5]) {
            let mut plant = EmulatedPlant::new(&config, q).unwrap();
            let mut at = q;
            for _ in 0..300 {
                at[0] += 2e-4;
                plant.follow(&at, &[0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0].into());
            }
            let before = plant.qd[0];
            for _ in 0..2 {
                plant.push(&[0.0; 7], &[share; 7], &[share; 7]);
            }
            *slowed = before - plant.qd[0];
        }
        assert!(slowed[0] > 1e-3, "{slowed:?}");
        assert!((slowed[1] / slowed[0] - 0.5).abs() < 0.1, "{slowed:?}");
    }
}
