//! `vservo emulate franka`: the arm of a run file behind a controller that speaks FCI.

use super::emulated_plant::{EMULATOR_PRIORITY, EmulatedPlant, attend, tell_of, timed_fault};
use crate::config::Config;
use crate::config::assemble::q_start;
use crate::process::{ProcessError, StopFlag};
use crate::rt::{tell, with_priority};
use clap::Args;
use nalgebra::SVector;
use std::net::IpAddr;
use std::path::PathBuf;
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
    /// SCHED_FIFO priority, where it can be had; 0: none. A robot's controller has a computer of its own: control, which has 80, does not keep it waiting
    #[arg(long, default_value_t = EMULATOR_PRIORITY, value_parser = clap::value_parser!(u32).range(0..=99))]
    pub priority: u32,
    /// What goes wrong, and when, s after the start: for example reflex@12.5; may be repeated
    #[arg(long, value_name = "FAULT@S", value_parser = timed_fault::<Fault>)]
    pub fault: Vec<(Fault, f64)>,
}

/// Emulates a robot until a stop is requested.
pub(super) fn emulate_franka(arguments: &EmulateFrankaArguments) -> Result<u8, ProcessError> {
    let stop = StopFlag::on_signals()?;
    let config = Config::load(Some(&arguments.config), &arguments.set)?;
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
    let plant = Box::new(EmulatedPlant::new(&config, q)?);
    let settings = EmulatorSettings {
        address: arguments.address,
        q: q.into(),
        limits,
        missed_cycles: arguments.missed_cycles,
        plant,
    };
    let emulator =
        with_priority(arguments.priority, || Emulator::start(settings)).map_err(ProcessError::Emulator)?;
    tell_of(emulator.address());
    attend(&stop, &arguments.fault, |fault| emulator.inject(fault), || emulator.log());
    Ok(0)
}

impl JointPlant for EmulatedPlant<JOINTS> {
    fn follow(&mut self, q_d: &Joints, qd_d: &Joints) -> (Joints, Joints) {
        EmulatedPlant::follow(self, &(*q_d).into(), &(*qd_d).into())
    }

    fn push(&mut self, tau: &Joints) -> (Joints, Joints) {
        // The run file's arm has no friction that such a robot would leave.
        EmulatedPlant::push(self, tau, &[0.0; JOINTS], &[0.0; JOINTS])
    }

    fn carry(&mut self, load: &Load) {
        EmulatedPlant::carry(self, load.mass_kg, load.com_F);
    }
}
