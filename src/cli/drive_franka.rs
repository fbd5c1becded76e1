//! `vservo-drive-franka`: the command line of the drive for arms of Franka.

use super::drive_ur::{PayloadOptions, joint_names};
use super::{LogArguments, exit_code, log_as_asked};
use crate::ipc::Instance;
use crate::process::{DriveJoining, ProcessError, StopFlag, drive_franka};
use crate::rt::now;
use clap::Parser;
use std::net::IpAddr;
use std::process::ExitCode;
use std::time::Duration;
use vservo_franka::ArmSettings;
use vservo_franka::wire::CollisionBehavior;

/// `vservo-drive-franka`: moves an arm of Franka for a run, as `drive.external.command` or by hand.
#[derive(Debug, Parser)]
#[command(
    version,
    about = "The drive of an arm of Franka (FR3), over its real-time interface (FCI, version 10)"
)]
pub struct DriveFrankaCli {
    /// Address of the robot's controller
    #[arg(long, value_name = "IP")]
    pub host: IpAddr,
    /// Name of the run that it belongs to (VSERVO_INSTANCE, else `default`)
    #[arg(long)]
    pub instance: Option<String>,
    /// Clear a reflex, after its cause was found, and do nothing else
    #[arg(long)]
    pub recover: bool,
    /// Torque of a contact at which the robot stops, N m, of each joint; as it is set there where it is left out
    #[arg(long, value_name = "N_M", requires = "collision_n", value_parser = |s: &str| within(s, 1.0, 100.0))]
    pub collision_n_m: Option<f64>,
    /// Force of a contact at which the robot stops, N, and torque, N m, of each direction of the end effector
    #[arg(long, value_name = "N", requires = "collision_n_m", value_parser = |s: &str| within(s, 1.0, 500.0))]
    pub collision_n: Option<f64>,
    /// Mass of a load beside the end effector that Desk knows, kg, instead of `[tool]` of the run file
    #[arg(long, value_name = "KG", value_parser = |s: &str| within(s, 0.0, 10.0))]
    pub load_kg: Option<f64>,
    /// Its centre of mass in the frame of the flange, m
    #[arg(long, value_name = "X,Y,Z", value_delimiter = ',', num_args = 1, allow_hyphen_values = true, requires = "load_kg", value_parser = |s: &str| within(s, -1.0, 1.0))]
    pub load_com_m: Vec<f64>,
    /// Its moments of inertia about that: xx, yy, zz, xy, xz, yz, kg m2; a point's where they are left out
    #[arg(long, value_name = "XX,..,YZ", value_delimiter = ',', num_args = 1, allow_hyphen_values = true, requires = "load_kg", value_parser = |s: &str| within(s, -100.0, 100.0))]
    pub load_inertia_kg_m2: Vec<f64>,
    /// Tell the robot no load: it stays as it is set there
    #[arg(long, conflicts_with = "load_kg")]
    pub load_as_set: bool,
    /// Longest time without a state of the robot, ms
    #[arg(long, value_name = "MS", default_value_t = 100, value_parser = clap::value_parser!(u64).range(16..=5000))]
    pub silence_ms: u64,
    /// Names of the joints, in the robot's order, which are compared with those of the robot file; `none` tells none
    #[arg(long, value_name = "NAME,NAME,...", value_delimiter = ',', num_args = 1, default_values_t = drive_franka::JOINT_NAMES.map(String::from))]
    pub joint_names: Vec<String>,
    /// SCHED_FIFO priority, where it can be had; 0: none. Control has 80, and the thread that carries its messages one less
    #[arg(long, default_value_t = 78, value_parser = clap::value_parser!(u32).range(0..=99))]
    pub priority: u32,
    /// How it logs.
    #[command(flatten)]
    pub log: LogArguments,
}

/// A number within bounds, which are those of what an arm can do or carry.
fn within(text: &str, least: f64, most: f64) -> Result<f64, String> {
    let number: f64 = text.parse().map_err(|_| "must be a number".to_owned())?;
    if (least..=most).contains(&number) { Ok(number) } else { Err(format!("must be {least} to {most}")) }
}

/// `vservo-drive-franka`.
#[must_use]
pub fn drive_franka_main() -> ExitCode {
    let cli = DriveFrankaCli::parse();
    log_as_asked(&cli.log);
    exit_code(drive(&cli))
}

fn drive(cli: &DriveFrankaCli) -> Result<u8, ProcessError> {
    let stop = StopFlag::on_signals()?;
    let mut settings = ArmSettings::new(cli.host, || now().0);
    settings.silence = Duration::from_millis(cli.silence_ms);
    settings.collision = cli
        .collision_n_m
        .zip(cli.collision_n)
        .map(|(torque, force)| CollisionBehavior::uniform(torque, force));
    let options = PayloadOptions {
        name: "load",
        mass_kg: cli.load_kg,
        com_m: &cli.load_com_m,
        moments_kg_m2: &cli.load_inertia_kg_m2,
        as_set: cli.load_as_set,
    };
    let Some(payload) = options.payload() else { return Ok(2) };
    if cli.recover {
        return drive_franka::recover(&settings);
    }
    let Some(joint_names) = joint_names(&cli.joint_names, vservo_franka::JOINTS) else { return Ok(2) };
    let name = cli.instance.clone().or_else(|| std::env::var("VSERVO_INSTANCE").ok());
    let instance: Instance = name.as_deref().unwrap_or("default").parse()?;
    let joining = DriveJoining { instance, priority: cli.priority, joint_names, payload };
    drive_franka::run(settings, &joining, &stop)
}
