//! `vservo-drive-ur`: the command line of the drive for arms of Universal Robots.

use super::{LogArguments, exit_code, log_as_asked};
use crate::ipc::Instance;
use crate::process::{ProcessError, StopFlag, drive_ur};
use crate::rt::now;
use clap::Parser;
use std::net::IpAddr;
use std::process::ExitCode;
use std::time::Duration;
use vservo_ur::ArmSettings;

/// `vservo-drive-ur`: moves an arm of Universal Robots for a run, as `drive.external.command` or by hand.
#[derive(Debug, Parser)]
#[command(
    version,
    about = "The drive of an arm of Universal Robots (e-Series, CB3), over RTDE and the dashboard"
)]
pub struct DriveUrCli {
    /// Address of the robot's controller
    #[arg(long, value_name = "IP")]
    pub host: IpAddr,
    /// Name of the run that it belongs to (VSERVO_INSTANCE, else `default`)
    #[arg(long)]
    pub instance: Option<String>,
    /// Power the arm and release its brakes when a run begins; a stop is never unlocked by that
    #[arg(long)]
    pub enable: bool,
    /// Unlock a protective stop, after its cause was found, and do nothing else
    #[arg(long)]
    pub unlock: bool,
    /// First RTDE register that is used: 24, or 0 where another program has those
    #[arg(long, default_value_t = 24, value_parser = registers)]
    pub registers: u8,
    /// `lookahead_time` of servoj, s (position mode): 0.03 to 0.2
    #[arg(long, value_name = "S", default_value_t = 0.03, value_parser = |s: &str| within(s, 0.03, 0.2))]
    pub lookahead_s: f64,
    /// `gain` of servoj (position mode): 100 to 2000
    #[arg(long, default_value_t = 2000.0, value_parser = |s: &str| within(s, 100.0, 2000.0))]
    pub gain: f64,
    /// Deceleration with which the robot brakes by itself, rad/s2
    #[arg(long, value_name = "RAD_S2", default_value_t = 4.0, value_parser = |s: &str| within(s, 0.1, 40.0))]
    pub stop_rad_s2: f64,
    /// How long the robot goes on without a new command, ms
    #[arg(long, value_name = "MS", default_value_t = 100, value_parser = clap::value_parser!(u64).range(8..=1000))]
    pub watchdog_ms: u64,
    /// Longest time without a state of the robot, ms
    #[arg(long, value_name = "MS", default_value_t = 100, value_parser = clap::value_parser!(u64).range(16..=5000))]
    pub silence_ms: u64,
    /// SCHED_FIFO priority, where it can be had; 0: none. Control has 80, and the thread that carries its messages one less
    #[arg(long, default_value_t = 78, value_parser = clap::value_parser!(u32).range(0..=99))]
    pub priority: u32,
    /// How it logs.
    #[command(flatten)]
    pub log: LogArguments,
}

fn registers(text: &str) -> Result<u8, String> {
    match text {
        "0" => Ok(0),
        "24" => Ok(24),
        _ => Err("must be 0 or 24".into()),
    }
}

/// A number within bounds, which are those of the maker's documentation or of what an arm can do.
fn within(text: &str, least: f64, most: f64) -> Result<f64, String> {
    let number: f64 = text.parse().map_err(|_| "must be a number".to_owned())?;
    if (least..=most).contains(&number) { Ok(number) } else { Err(format!("must be {least} to {most}")) }
}

/// `vservo-drive-ur`.
#[must_use]
pub fn drive_ur_main() -> ExitCode {
    let cli = DriveUrCli::parse();
    log_as_asked(&cli.log);
    exit_code(drive(&cli))
}

fn drive(cli: &DriveUrCli) -> Result<u8, ProcessError> {
    let stop = StopFlag::on_signals()?;
    let mut settings = ArmSettings::new(cli.host, || now().0);
    settings.registers = cli.registers;
    settings.lookahead_s = cli.lookahead_s;
    settings.gain = cli.gain;
    settings.stop_deceleration_rad_s2 = cli.stop_rad_s2;
    settings.watchdog = Duration::from_millis(cli.watchdog_ms);
    settings.silence = Duration::from_millis(cli.silence_ms);
    if cli.unlock {
        return drive_ur::unlock(&settings);
    }
    let name = cli.instance.clone().or_else(|| std::env::var("VSERVO_INSTANCE").ok());
    let instance: Instance = name.as_deref().unwrap_or("default").parse()?;
    drive_ur::run(settings, cli.enable, cli.priority, &instance, &stop)
}
