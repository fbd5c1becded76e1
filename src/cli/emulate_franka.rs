//! `vservo emulate franka`: the arm of a run file behind a controller that speaks FCI.

use crate::config::Config;
use crate::config::assemble::{AssembleError, q_start, simulated_settings};
use crate::drive::{CommandMode, Drive, DriveCommand, SimulatedDrive, SimulatedDriveSettings};
use crate::process::{ProcessError, StopFlag};
use crate::robot::{Inertia, Robot};
use crate::rt::{now, tell};
use crate::time::{MonoNs, TICK};
use clap::Args;
use nalgebra::SVector;
use std::net::IpAddr;
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Duration;
use vservo_franka::emulator::{Emulator, EmulatorSettings, Fault, JointPlant};
use vservo_franka::wire::Load;
use vservo_franka::{JOINTS, JointLimits, Joints};

/// `vservo emulate franka`.
#[derive(Debug, Args)]
pub struct EmulateFrankaArguments {
    /// Run file, or the name of a shipped one, with the arm that stands behind the controller
    #[arg(default_value = "fr3-emulated")]
    pub config: PathBuf,
    /// Change one value first; may be repeated
    #[arg(long, value_name = "key.path=value")]
    pub set: Vec<String>,
    /// A loopback address; each has a port of its own
    #[arg(long, value_name = "IP", default_value = "127.0.0.1")]
    pub address: IpAddr,
    /// Where the arm stands, rad, separated by commas; the run file's start where it is left out
    #[arg(long, value_name = "Q1,..,Q7", value_delimiter = ',', allow_hyphen_values = true)]
    pub start: Vec<f64>,
    /// Cycles in a row without a command that end a motion: 20 as a robot; more for a busy machine
    #[arg(long, value_name = "N", default_value_t = vservo_franka::emulator::MISSED_CYCLES, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub missed_cycles: u32,
    /// What goes wrong, and when, s after the start: for example reflex@12.5; may be repeated
    #[arg(long, value_name = "FAULT@S", value_parser = timed_fault::<Fault>)]
    pub fault: Vec<(Fault, f64)>,
}

/// A fault of either maker's emulator, and when it comes, s: `reflex@12.5`.
pub(super) fn timed_fault<F: FromStr<Err = String>>(text: &str) -> Result<(F, f64), String> {
    let (word, time) = text.split_once('@').unwrap_or((text, "0"));
    let seconds: f64 = time.parse().map_err(|_| format!("`{time}` is no time"))?;
    Ok((word.parse()?, seconds))
}

/// Emulates a robot until a stop is requested.
pub(super) fn emulate_franka(arguments: &EmulateFrankaArguments) -> Result<u8, ProcessError> {
    let stop = StopFlag::on_signals()?;
    let config = Config::load(Some(&arguments.config), &arguments.set)?;
    let settings = simulated_settings::<JOINTS>(&config)?;
    let robot = config.robot.build::<JOINTS>()?;
    let limits = JointLimits::fr3();
    let q: SVector<f64, JOINTS> = match arguments.start.as_slice() {
        [] => q_start(&config)?,
        q if q.len() == JOINTS => SVector::from_column_slice(q),
        _ => {
            tell(format_args!("vservo: --start takes {JOINTS} numbers, rad"));
            return Ok(2);
        }
    };
    if let Some((i, limit)) =
        (0..).zip(&limits.0).find(|(i, limit)| !(limit.lower..=limit.upper).contains(&q[*i]))
    {
        let (from, to) = (limit.lower, limit.upper);
        tell(format_args!(
            "vservo: joint {} of an FR3 turns from {from} to {to} rad, and cannot start at {}",
            i + 1,
            q[i]
        ));
        return Ok(2);
    }
    let plant = Box::new(SimulatedPlant::new(robot, &config.tool, q, settings)?);
    let emulator = Emulator::start(EmulatorSettings {
        address: arguments.address,
        q: q.into(),
        limits,
        missed_cycles: arguments.missed_cycles,
        plant,
    })
    .map_err(ProcessError::Emulator)?;
    tell(format_args!("a robot that is none listens on {}, for this machine alone", emulator.address()));
    let start = now();
    let mut faults = arguments.fault.clone();
    while !stop.is_requested() {
        faults.retain(|(fault, after_s)| {
            let due = (now() - start).as_s() >= *after_s;
            if due {
                tell(format_args!("now: {fault:?}"));
                emulator.inject(*fault);
            }
            !due
        });
        for line in emulator.log() {
            tell(format_args!("controller: {}", crate::input::printable(&line)));
        }
        // Chosen by hand: nobody notices it.
        std::thread::sleep(Duration::from_millis(20));
    }
    Ok(0)
}

/// The crate's own simulated arm behind an emulated controller: in a position loop, or under torques, to which the weights are added that the robot knows: its own, and
/// that of the load that it was told.
struct SimulatedPlant {
    robot: Robot<JOINTS>,
    /// Without anything on its flange, and with what it was told.
    bare: Robot<JOINTS>,
    known: Robot<JOINTS>,
    settings: SimulatedDriveSettings<JOINTS>,
    drive: SimulatedDrive<JOINTS>,
    mode: CommandMode,
    time: MonoNs,
    q: SVector<f64, JOINTS>,
    qd: SVector<f64, JOINTS>,
}

impl SimulatedPlant {
    fn new(
        robot: Robot<JOINTS>,
        tool: &Inertia,
        q: SVector<f64, JOINTS>,
        mut settings: SimulatedDriveSettings<JOINTS>,
    ) -> Result<Self, AssembleError> {
        let mode = CommandMode::Position;
        settings.mode = mode;
        let drive = SimulatedDrive::new(robot.clone(), q, settings.clone())?;
        let nothing = Inertia { mass: -tool.mass, com: tool.com, about_com: -tool.about_com };
        let bare = robot.clone().with_load(&nothing);
        let known = bare.clone();
        Ok(Self { robot, bare, known, settings, drive, mode, time: MonoNs::ZERO, q, qd: SVector::zeros() })
    }

    fn step(&mut self, mode: CommandMode, command: &DriveCommand<JOINTS>) -> (Joints, Joints) {
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
}

impl JointPlant for SimulatedPlant {
    fn follow(&mut self, q_d: &Joints, qd_d: &Joints) -> (Joints, Joints) {
        let command = DriveCommand {
            tau: SVector::zeros(),
            q_r: (*q_d).into(),
            qd_r: (*qd_d).into(),
            qdd_r: SVector::zeros(),
        };
        self.step(CommandMode::Position, &command)
    }

    fn push(&mut self, tau: &Joints) -> (Joints, Joints) {
        let tau = SVector::from(*tau) + self.known.gravity(&self.q);
        self.step(
            CommandMode::Torque,
            &DriveCommand { tau, q_r: self.q, qd_r: self.qd, qdd_r: SVector::zeros() },
        )
    }

    fn carry(&mut self, load: &Load) {
        // For weights the moments of inertia do not matter.
        let load = Inertia::point(load.mass_kg, load.com_F.into());
        self.known = self.bare.clone().with_load(&load);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    /// Under torques without gravity the arm stays, and from one way of commanding to the other it does not leap.
    #[test]
    fn weights_are_carried_and_a_change_of_mode_is_smooth() {
        let config = Config::load(Some(Path::new("fr3-emulated")), &[]).unwrap();
        let (robot, q) = (config.robot.build::<JOINTS>().unwrap(), q_start::<JOINTS>(&config).unwrap());
        let mut plant =
            SimulatedPlant::new(robot, &config.tool, q, simulated_settings(&config).unwrap()).unwrap();
        let mut at = q;
        for _ in 0..500 {
            at[1] += 1e-4;
            plant.follow(&at.into(), &[0.0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0]);
        }
        assert!((plant.q - at).amax() < 2e-3, "{}", plant.q - at);
        let (before, speed) = (plant.q, plant.qd[1]);
        assert!((speed - 0.1).abs() < 0.01, "{speed}");
        let (after, _) = plant.push(&[0.0; JOINTS]);
        assert!((SVector::from(after) - before).amax() < 2e-4, "no leap");
        for _ in 0..200 {
            plant.push(&std::array::from_fn(|i| -5.0 * plant.qd[i]));
        }
        assert!(
            (plant.q - before).amax() < 0.05 && plant.qd.amax() < 0.2,
            "{} {}",
            plant.q - before,
            plant.qd
        );
    }
}
