//! `vservo-drive-ur`: the command line of the drive for arms of Universal Robots.

use super::{LogArguments, exit_code, log_as_asked};
use crate::ipc::Instance;
use crate::process::{DriveJoining, DrivePayload, ProcessError, StopFlag, drive_ur};
use crate::rt::now;
use clap::Parser;
use std::net::IpAddr;
use std::process::ExitCode;
use std::time::Duration;
use vservo_ur::ArmSettings;

/// Longest name of a joint, bytes: seven of them fit into a text of the protocol.
const LONGEST_NAME: usize = 63;

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
    /// States and commands in a second: 500, 250 or 125; as many as the robot has cycles where it is left out
    #[arg(long, value_name = "HZ", value_parser = rate)]
    pub rate_hz: Option<f64>,
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
    /// The same while torques are commanded, ms
    #[arg(long, value_name = "MS", default_value_t = 20, value_parser = clap::value_parser!(u64).range(8..=1000))]
    pub torque_watchdog_ms: u64,
    /// Longest time without a state of the robot, ms
    #[arg(long, value_name = "MS", default_value_t = 100, value_parser = clap::value_parser!(u64).range(16..=5000))]
    pub silence_ms: u64,
    /// Names of the joints, in the robot's order, which are compared with those of the robot file; `none` tells none
    #[arg(long, value_name = "NAME,NAME,...", value_delimiter = ',', num_args = 1, default_values_t = drive_ur::JOINT_NAMES.map(String::from))]
    pub joint_names: Vec<String>,
    /// Mass on the flange that the robot is told, kg, instead of `[tool]` of the run file
    #[arg(long, value_name = "KG", value_parser = |s: &str| within(s, 0.0, 70.0))]
    pub payload_kg: Option<f64>,
    /// Its centre of mass in the frame of the flange, m
    #[arg(long, value_name = "X,Y,Z", value_delimiter = ',', num_args = 1, allow_hyphen_values = true, requires = "payload_kg", value_parser = |s: &str| within(s, -1.0, 1.0))]
    pub payload_com_m: Vec<f64>,
    /// Its moments of inertia about that: xx, yy, zz, xy, xz, yz, kg m2 (software 5.10 and later)
    #[arg(long, value_name = "XX,..,YZ", value_delimiter = ',', num_args = 1, allow_hyphen_values = true, requires = "payload_kg", value_parser = |s: &str| within(s, -100.0, 100.0))]
    pub payload_inertia_kg_m2: Vec<f64>,
    /// Tell the robot no payload: it stays as it is set there
    #[arg(long, conflicts_with = "payload_kg")]
    pub payload_as_set: bool,
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

/// Rates that are whole parts of an e-Series' one.
fn rate(text: &str) -> Result<f64, String> {
    let rate = ["500", "250", "125"].into_iter().find(|rate| *rate == text);
    rate.and_then(|rate| rate.parse().ok()).ok_or_else(|| "must be 500, 250 or 125".into())
}

/// A number within bounds, which are those of the maker's documentation or of what an arm can do.
fn within(text: &str, least: f64, most: f64) -> Result<f64, String> {
    let number: f64 = text.parse().map_err(|_| "must be a number".to_owned())?;
    if (least..=most).contains(&number) { Ok(number) } else { Err(format!("must be {least} to {most}")) }
}

/// What the options of a drive say of the payload.
pub(super) struct PayloadOptions<'a> {
    /// The word that they begin with.
    pub(super) name: &'static str,
    pub(super) mass_kg: Option<f64>,
    pub(super) com_m: &'a [f64],
    pub(super) moments_kg_m2: &'a [f64],
    pub(super) as_set: bool,
}

impl PayloadOptions<'_> {
    /// What is told; says what is wrong with numbers that no body has.
    pub(super) fn payload(&self) -> Option<DrivePayload> {
        let name = self.name;
        let Some(mass_kg) = self.mass_kg else {
            return Some(if self.as_set { DrivePayload::AsSet } else { DrivePayload::OfRunFile });
        };
        let com_m = match *self.com_m {
            [] => [0.0; 3],
            [x, y, z] => [x, y, z],
            _ => {
                crate::rt::tell(format_args!("--{name}-com-m takes three numbers, m"));
                return None;
            }
        };
        let moments = match self.moments_kg_m2 {
            [] => [0.0; 6],
            &[xx, yy, zz, xy, xz, yz] => [xx, yy, zz, xy, xz, yz],
            _ => {
                crate::rt::tell(format_args!(
                    "--{name}-inertia-kg-m2 takes six numbers, xx,yy,zz,xy,xz,yz, kg m2"
                ));
                return None;
            }
        };
        let given = DrivePayload::given(mass_kg, com_m, moments);
        given.map_err(|problem| crate::rt::tell(format_args!("--{name}-inertia-kg-m2: {problem}"))).ok()
    }
}

/// The names that are told; says what is wrong with a list that no robot of so many joints has.
pub(super) fn joint_names(given: &[String], joints: usize) -> Option<Vec<String>> {
    if given == ["none"] {
        return Some(Vec::new());
    }
    let fits = given.len() == joints && given.iter().all(|name| (1..=LONGEST_NAME).contains(&name.len()));
    if !fits {
        crate::rt::tell(format_args!(
            "--joint-names takes {joints} names of 1 to {LONGEST_NAME} bytes with commas between them, or `none`"
        ));
    }
    fits.then(|| given.to_vec())
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
    settings.rate_hz = cli.rate_hz;
    settings.lookahead_s = cli.lookahead_s;
    settings.gain = cli.gain;
    settings.stop_deceleration_rad_s2 = cli.stop_rad_s2;
    settings.watchdog = Duration::from_millis(cli.watchdog_ms);
    settings.torque_watchdog = Duration::from_millis(cli.torque_watchdog_ms);
    settings.silence = Duration::from_millis(cli.silence_ms);
    if cli.unlock {
        return drive_ur::unlock(&settings);
    }
    let options = PayloadOptions {
        name: "payload",
        mass_kg: cli.payload_kg,
        com_m: &cli.payload_com_m,
        moments_kg_m2: &cli.payload_inertia_kg_m2,
        as_set: cli.payload_as_set,
    };
    let Some(payload) = options.payload() else { return Ok(2) };
    let Some(joint_names) = joint_names(&cli.joint_names, vservo_ur::JOINTS) else { return Ok(2) };
    let name = cli.instance.clone().or_else(|| std::env::var("VSERVO_INSTANCE").ok());
    let instance: Instance = name.as_deref().unwrap_or("default").parse()?;
    let joining = DriveJoining { instance, priority: cli.priority, joint_names, payload };
    drive_ur::run(settings, cli.enable, &joining, &stop)
}
