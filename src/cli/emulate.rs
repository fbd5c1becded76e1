//! `vservo emulate`: a robot that there is not, for whoever wants to see the whole way without one.

use super::emulate_franka::{EmulateFrankaArguments, emulate_franka};
use super::emulated_plant::{EMULATOR_PRIORITY, EmulatedPlant, attend, tell_of, timed_fault};
use crate::config::Config;
use crate::config::assemble::q_start;
use crate::process::{ProcessError, StopFlag};
use crate::rt::{tell, with_priority};
use crate::time::{SpanNs, TICK};
use clap::{Args, Subcommand, ValueEnum};
use nalgebra::SVector;
use std::net::IpAddr;
use std::path::PathBuf;
use vservo_ur::emulator::{Emulator, EmulatorSettings, Fault, JointModel, Torque};
use vservo_ur::{JOINTS, Joints, Payload, Series};

/// Farthest from its zero that a joint may start, rad. Chosen by hand: twice the 360 degrees that these arms turn either way by the maker's data sheets.
const MOST_RAD: f64 = 4.0 * std::f64::consts::PI;

/// Robots that can be emulated.
#[derive(Debug, Subcommand)]
pub enum EmulateCommand {
    /// An arm of Universal Robots: RTDE, dashboard, and programs, on loopback addresses alone
    Ur(EmulateUrArguments),
    /// An arm of Franka: its real-time interface (FCI), on loopback addresses alone
    Franka(EmulateFrankaArguments),
}

/// Series of Universal Robots.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum UrSeries {
    /// 500 Hz
    ESeries,
    /// 125 Hz
    Cb3,
}

/// `vservo emulate ur`.
#[derive(Debug, Args)]
pub struct EmulateUrArguments {
    /// Run file, or the name of a shipped one, with the arm that stands behind the controller
    #[arg(default_value = "ur5e-emulated")]
    pub config: PathBuf,
    /// Change one value first; may be repeated
    #[arg(long, value_name = "key.path=value")]
    pub set: Vec<String>,
    /// The controller's series
    #[arg(long, value_enum, default_value_t = UrSeries::ESeries)]
    pub series: UrSeries,
    /// A loopback address; each has ports of its own
    #[arg(long, value_name = "IP", default_value = "127.0.0.1")]
    pub address: IpAddr,
    /// Where the arm stands, rad, separated by commas; the run file's start where it is left out
    #[arg(long, value_name = "Q1,..,Q6", value_delimiter = ',', allow_hyphen_values = true)]
    pub start: Vec<f64>,
    /// Powered off, as after switching on; else it runs, its brakes open
    #[arg(long)]
    pub off: bool,
    /// SCHED_FIFO priority, where it can be had; 0: none. A robot's controller has a computer of its own: control, which has 80, does not keep it waiting
    #[arg(long, default_value_t = EMULATOR_PRIORITY, value_parser = clap::value_parser!(u32).range(0..=99))]
    pub priority: u32,
    /// What goes wrong, and when, s after the start: for example protective-stop@12.5; may be repeated
    #[arg(long, value_name = "FAULT@S", value_parser = timed_fault::<Fault>)]
    pub fault: Vec<(Fault, f64)>,
}

/// Emulates a robot until a stop is requested.
pub(super) fn emulate(what: &EmulateCommand) -> Result<u8, ProcessError> {
    match what {
        EmulateCommand::Ur(arguments) => emulate_ur(arguments),
        EmulateCommand::Franka(arguments) => emulate_franka(arguments),
    }
}

fn emulate_ur(arguments: &EmulateUrArguments) -> Result<u8, ProcessError> {
    let stop = StopFlag::on_signals()?;
    let config = Config::load(Some(&arguments.config), &arguments.set)?;
    let q: SVector<f64, JOINTS> = match arguments.start.as_slice() {
        [] => q_start(&config)?,
        q if q.len() == JOINTS && q.iter().all(|q| q.abs() <= MOST_RAD) => SVector::from_column_slice(q),
        _ => {
            tell(format_args!("vservo: --start takes {JOINTS} numbers, rad, within two turns"));
            return Ok(2);
        }
    };
    let joints = UrPlant { arm: EmulatedPlant::new(&config, q)?, reference: q };
    let series = match arguments.series {
        UrSeries::ESeries => Series::ESeries,
        UrSeries::Cb3 => Series::Cb3,
    };
    let settings = EmulatorSettings {
        address: arguments.address,
        series,
        q: q.into(),
        running: !arguments.off,
        joints: Box::new(joints),
    };
    let emulator =
        with_priority(arguments.priority, || Emulator::start(settings)).map_err(ProcessError::Emulator)?;
    tell_of(emulator.address());
    attend(&stop, &arguments.fault, |fault| emulator.inject(fault), || emulator.log());
    Ok(0)
}

/// The simulated arm. Between the controller's cycles its position loop gets interpolated references, as motors do.
struct UrPlant {
    arm: EmulatedPlant<JOINTS>,
    /// The last reference, rad.
    reference: SVector<f64, JOINTS>,
}

/// Ticks of the simulated arm in a cycle of the controller.
fn ticks(dt_s: f64) -> i64 {
    (SpanNs::from_s(dt_s).0 / TICK.0).max(1)
}

impl JointModel for UrPlant {
    fn step(&mut self, q: &Joints, qd: &Joints, dt_s: f64) -> (Joints, Joints) {
        let (begin, end) = (self.reference, SVector::from(*q));
        for tick in 1..=ticks(dt_s) {
            let q_r = begin + (end - begin) * (tick as f64 / ticks(dt_s) as f64);
            self.arm.follow(&q_r, &(*qd).into());
        }
        self.reference = end;
        (self.arm.q.into(), self.arm.qd.into())
    }

    fn push(&mut self, torque: &Torque, dt_s: f64) -> (Joints, Joints) {
        for _ in 0..ticks(dt_s) {
            self.arm.push(&torque.tau, &torque.viscous_share, &torque.coulomb_share);
        }
        self.reference = self.arm.q;
        (self.arm.q.into(), self.arm.qd.into())
    }

    fn carry(&mut self, payload: &Payload) {
        self.arm.carry(payload.mass_kg, payload.com_m);
    }
}
